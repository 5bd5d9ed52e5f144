"""Sealed joints: the geometry of a pulley, closed chambers, an unknown torque from outside, and the measured joint."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from pam_antagonist.cli.identify import main as identify_command
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.identification import sealed, sealed_tuning
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.model import equilibrium, muscle
from pam_antagonist.recording import Recording, read_bag, write_bag
from pam_antagonist.recording.csv_import import notes, read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.recording.notes import SEALED, write_notes
from pam_antagonist.replays import replay
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import write_rig

FILE = Path(__file__).parents[3] / "shared" / "data" / "measured" / "sealed_joint" / "sealed_joint.csv"
measured_only = pytest.mark.skipif(not FILE.exists(), reason="no ../shared/data/measured beside the project")


NOISE = 20.0
"""Of the simulated pressures [Pa]: of sensors as they are; the measured recording was low-passed."""


@pytest.fixture(scope="module")
def joint() -> Rig:
    return load_rig("sealed_joint")


def recording_of(joint: Rig, seconds: float = 25.0, seed: int = 1, noise: float = NOISE) -> Recording:
    """The rig itself, driven by a known torque, behind sensors with noise: a simulator, not the measured joint."""
    rng = np.random.default_rng(seed)
    time = np.arange(int(seconds * 1000)) * 1e-3
    external = 1.2 * np.sin(2 * np.pi * 0.15 * time) + 0.4 * np.sin(2 * np.pi * 0.047 * time)
    pressures = np.array([joint.valves.charge_1, joint.valves.charge_2])
    run = simulate_model(joint, np.zeros((len(time), 2)), pressures, external_torque=external)
    return Recording(
        path=Path("simulated"), stamp_ns=np.arange(1, len(time) + 1) * 1_000_000,
        pressure=run.pressure + rng.normal(0.0, noise, run.pressure.shape), voltage=np.zeros((len(time), 2)),
        angle=run.angle + rng.normal(0.0, 5e-4, len(time)), torque=None, external_torque=external,
    )  # fmt: skip


def test_sealed_chambers_keep_their_air(joint):
    time = np.arange(3000) * 1e-3
    external = 1.5 * np.sin(2 * np.pi * 0.7 * time)
    run = simulate_model(joint, np.full((3000, 2), 7.0), np.array([469540.0, 465690.0]), external_torque=external)
    assert np.ptp(run.angle) > math.radians(5.0)
    p = joint.parameters()
    for i in (0, 1):
        volume = np.array([muscle.volume(i, muscle.length(i, angle, p), p)[0] for angle in run.angle])
        content = np.log(run.pressure[:, i]) + joint.gas.polytropic_volume * np.log(volume)
        assert np.ptp(content) < 1e-6


def test_a_filter_starts_at_the_angle_that_the_charge_tells(joint):
    p = joint.parameters()
    for angle in (-0.08, 0.0, 0.05):
        pressures = [equilibrium.closed_pressure(i, angle, p) for i in (0, 1)]
        assert equilibrium.start_angle(*pressures, p) == pytest.approx(angle, abs=1e-12)
    # A common loss of air moves no angle.
    assert equilibrium.start_angle(*(0.99 * value for value in pressures), p) == pytest.approx(0.05, abs=1e-12)


def test_the_truth_is_found_from_a_wrong_start(joint):
    start = moved(
        joint,
        {
            "muscle_1.volume.d2": 0.85 * joint.muscle_1.volume.d2,
            "muscle_1.volume.d3": joint.muscle_1.volume.d3 + 0.15 * joint.muscle_1.volume.d2 * 0.2,
            "joint.stiffness": 4.0,
            "friction.shaft": 0.15,
            "valves.charge_1": 460e3,
        },
    )
    trials = [sealed.sealed_trial(recording_of(joint), "simulated")]
    chamber = sealed.closed_chambers(trials, start, 0)
    assert chamber.values["muscle_1.volume.d2"] == pytest.approx(joint.muscle_1.volume.d2, rel=0.01)
    assert chamber.values["valves.charge_1"] == pytest.approx(joint.valves.charge_1, rel=2e-4)
    balance = sealed.balance(trials, moved(start, chamber.values))
    assert balance.values["joint.stiffness"] == pytest.approx(joint.joint.stiffness, rel=0.03)
    assert balance.values["friction.shaft"] == pytest.approx(joint.friction.shaft, rel=0.05)


def test_the_filter_finds_angle_and_torque_from_the_pressures_alone(joint, tmp_path):
    write_bag(tmp_path / "bag", recording_of(joint))
    recording = read_bag(tmp_path / "bag")
    noisy = joint.replaced(
        sensors=joint.sensors.replaced(pressure_std=NOISE),
        tunings={"default": joint.tuning("default").replaced(measurement=(NOISE**2, NOISE**2))},
    )
    done = replay(recording, noisy)
    # The rig allows for the drift of a real joint's readings, which this simulated one does not have.
    assert done.report.ukf.angle.rmse < 0.25
    external = done.report.ukf.external_torque
    # Where the joint sticks, the torque may be anything within the friction's bound.
    assert external.rmse < 0.3 < np.std(recording.external_torque)
    assert done.report.model_alone.angle.rmse < 0.05, "the model alone is given the torque"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angle": None}, "no measured angle"),
        ({"angle": np.zeros(25000)}, "angle moves by 0.00 deg only"),
    ],
    ids=["no angle", "still"],
)
def test_a_recording_that_tells_nothing_is_refused(joint, change, words):
    with pytest.raises(BadInput, match=words):
        sealed.sealed_trial(dataclasses.replace(recording_of(joint), **change), "bag")


def test_without_a_known_torque_there_is_no_balance(joint):
    quiet = dataclasses.replace(recording_of(joint), external_torque=None)
    with pytest.raises(BadInput, match="measured/external_torque"):
        sealed.balance([sealed.sealed_trial(quiet, "bag")], joint)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    mapping = load_map("sealed_joint")
    bag = tmp_path_factory.mktemp("sealed") / "bag"
    write_bag(bag, read_csv(FILE, mapping))
    write_notes(bag, notes(FILE, mapping))
    return read_bag(bag)


@measured_only
def test_the_rig_file_is_what_its_first_two_thirds_give(joint, measured):
    trials = [sealed.sealed_trial(measured, "measured", 2.0 / 3.0)]
    for number in (1, 2):
        stage = sealed.closed_chambers(trials, joint, number - 1)
        for name, value in stage.values.items():
            assert value == pytest.approx(joint.value(name), rel=2e-4), name
    balance = sealed.balance(trials, joint)
    for name in ("joint.stiffness", "friction.shaft", "muscle_1.force.w2", "muscle_2.force.w2"):
        assert balance.values[name] == pytest.approx(joint.value(name), abs=0.1 * balance.std[name]), name


@measured_only
def test_the_angle_of_the_measured_joint_from_its_pressures(joint, measured):
    done = replay(measured, joint)
    assert measured.angle is not None
    rest = np.flatnonzero(done.run.index >= len(measured.stamp_ns) * 2 // 3)
    error = np.degrees((done.run.rows["angle"] - measured.angle[done.run.index])[rest])
    assert math.sqrt(float(np.mean(error**2))) <= 0.20
    assert np.abs(error).max() / np.degrees(np.ptp(measured.angle)) <= 0.08
    assert not any("sealed" in issue for issue in done.report.recording.issues)
    # The drift of the readings is a state: R is the sensors' noise alone, and the covariance is honest all the same.
    assert 1.5 <= done.report.innovation.nis_mean <= 2.5
    assert done.report.ukf.angle.coverage95 >= 0.9


@measured_only
def test_the_filter_starts_well_in_the_middle_of_a_motion(joint, measured):
    estimator, worst = Estimator(joint), []
    for begin in np.linspace(0, len(measured.stamp_ns) - 1000, 40).astype(int):
        part = slice(begin, begin + 1000)
        estimator.reset()
        run = estimator.run(measured.stamp_ns[part], measured.pressure[part], measured.voltage[part])
        assert len(run.rows) == 1000, "an estimate from the first sample on"
        worst.append(np.degrees(np.abs(run.rows["angle"] - measured.angle[part]).max()))
    assert max(worst) <= 0.5, np.round(worst, 2)


@pytest.mark.parametrize("name", ["sealed_joint", "shin2022", "shin2022_as_printed"])
def test_no_rig_hides_anything_in_its_measurement_variance(name):
    rig = load_rig(name)
    assert rig.tuning("default").measurement == pytest.approx([rig.sensors.error("pressure") ** 2] * 2, rel=0.01)


def test_readings_that_drift_are_followed_with_an_honest_covariance(joint):
    """A simulated joint whose readings drift as the rig says. It is moved smoothly, where the rig allows for slips."""
    time, size = joint.value("effects.pressure_sensor.drift_time"), 250.0
    recording, rng = recording_of(joint, seconds=12.0, noise=joint.sensors.pressure_std), np.random.default_rng(5)
    driven = sealed_tuning.drift_noise(size, time) * math.sqrt(1e-3) * rng.standard_normal((len(recording.stamp_ns), 2))
    pole = math.exp(-1e-3 / time)  # two of them: exact at zero order for what changes within a millisecond
    for _ in range(2):
        driven = signal.lfilter([1.0], [1.0, -pole], driven, axis=0)
    drift = driven * 1e-3
    assert np.std(drift) == pytest.approx(size, rel=0.3)
    run = Estimator(joint).run(recording.stamp_ns, recording.pressure + drift, recording.voltage)
    assert 0.7 < np.nanmean(run.rows["nis"]) < 2.5
    error = run.rows["angle"] - recording.angle
    assert 0.3 < np.mean(error**2 / run.rows["covariance"][:, 0, 0]) < 2.0
    assert np.std(run.added["reading_drift_1"] - drift[:, 0]) < 0.7 * size


@pytest.mark.slow(9)
def test_identify_takes_a_sealed_joint_through_the_same_command(joint, tmp_path, capsys):
    write_bag(tmp_path / "bag", recording_of(joint, seconds=20.0))
    write_rig(
        joint.replaced(joint=joint.joint.replaced(stiffness=5.0), friction=joint.friction.replaced(shaft=0.2)),
        tmp_path / "start.yaml",
    )
    command = [str(tmp_path / "bag"), "--rig", str(tmp_path / "start.yaml"), "--out", str(tmp_path / "out")]
    assert identify_command([*command, "--no-figures"]) == 0
    found = load_rig(tmp_path / "out" / "rig.yaml")
    assert found.joint.stiffness == pytest.approx(joint.joint.stiffness, rel=0.05)
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    kept = json.loads((Path(__file__).parents[1] / "golden" / "identify.json").read_text(encoding="utf-8"))
    assert list(report)[: len(kept)] == list(kept), "the report has the keys of all others"
    (held,) = report["held_out"]
    assert held["identified"]["ukf"]["angle"]["rmse_deg"] < 0.1
    assert (
        held["identified"]["model_alone"]["angle"]["rmse_deg"]
        < held["as_configured"]["model_alone"]["angle"]["rmse_deg"]
    )
    assert "valves.charge_1" in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    # The page is that of every identification, with sections of its own.
    for words in ("Errors of the filter with the identified rig", "External torque (RMS)", "What is assumed"):
        assert words in page, words


def test_a_sealed_recording_wants_a_sealed_rig(joint, tmp_path, capsys):
    write_bag(tmp_path / "bag", recording_of(joint, seconds=8.0))
    write_notes(tmp_path / "bag", {SEALED: "1 2"})
    assert identify_command([str(tmp_path / "bag"), "--rig", "shin2022", "--out", str(tmp_path / "out")]) == 2
    assert "valves.sealed: true" in capsys.readouterr().err


def test_valves_that_move_are_not_those_of_a_sealed_rig(joint, tmp_path, capsys):
    moving = recording_of(joint, seconds=8.0)
    moving = dataclasses.replace(moving, voltage=np.linspace(4.0, 6.0, len(moving.stamp_ns))[:, None] * np.ones(2))
    write_bag(tmp_path / "bag", moving)
    assert identify_command([str(tmp_path / "bag"), "--rig", "sealed_joint", "--out", str(tmp_path / "out")]) == 2
    assert "a valve moves by 2.00 V" in capsys.readouterr().err
