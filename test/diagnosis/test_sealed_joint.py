"""The diagnosis of sealed joints: simulated ones with a known truth, and the measured one."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import diagnose as with_laws
from pam_antagonist.cli.close_loop import main as close_loop
from pam_antagonist.diagnosis import Diagnosis, diagnose
from pam_antagonist.diagnosis.preparation import base_without_friction, cut, driven_trial
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import simulate_model
from pam_antagonist.inference.angle_driven import AIR, BALANCE, AngleDriven, motion_of
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.trial import PRESSURE_1, TORQUE
from pam_antagonist.recording import Recording, read_bag, write_bag
from pam_antagonist.recording.csv_import import notes, read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.recording.notes import write_notes
from pam_antagonist.replays import replay
from pam_antagonist.report.close_loop import DiagnoseResult
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.learned import Law, laws_of, with_law

FILE = Path(__file__).parents[3] / "shared" / "data" / "measured" / "sealed_joint" / "sealed_joint.csv"
measured_only = pytest.mark.skipif(not FILE.exists(), reason="no ../shared/data/measured beside the project")
PLAIN = {"friction.shaft": 0.0, "friction.muscle": 0.0}


@pytest.fixture(scope="module")
def joint() -> Rig:
    return load_rig("sealed_joint")


@pytest.fixture(scope="module")
def recorded(joint: Rig) -> Callable[..., Recording]:
    """Records a simulated joint without friction of its own, with effects, driven to and fro."""

    def make(
        effects: dict[str, dict[str, float]], seconds: float = 18.0, seed: int = 3, law: Law | None = None
    ) -> Recording:
        known = {name: std for name, std in joint.uncertainty.items() if name not in PLAIN}
        rig = moved(joint, PLAIN).replaced(effects=effects, uncertainty=known)
        rig = rig if law is None else with_law(rig, law)
        rng = np.random.default_rng(seed)
        time = np.arange(int(seconds * 1000)) * 1e-3
        external = (0.9 + 0.3 * np.sin(2 * np.pi * 0.031 * time)) * np.sin(2 * np.pi * 0.3 * time)
        pressures = np.array([joint.valves.charge_1, joint.valves.charge_2])
        run = simulate_model(rig, np.zeros((len(time), 2)), pressures, external_torque=external)
        return Recording(
            path=Path("simulated"), stamp_ns=np.arange(1, len(time) + 1) * 1_000_000,
            pressure=run.pressure + rng.normal(0.0, 20.0, run.pressure.shape), voltage=np.zeros((len(time), 2)),
            angle=run.angle + rng.normal(0.0, 2e-4, len(time)), torque=None, external_torque=external,
        )  # fmt: skip

    return make


def diagnosed(recording: Recording, rig: Rig) -> Diagnosis:
    return diagnose([recording], rig, profiles=False, estimator=False)


@pytest.mark.slow(4)
def test_friction_and_a_leak_of_one_muscle_are_found_with_their_sizes(recorded, joint) -> None:
    found = diagnosed(recorded({"friction": {"coulomb": 0.2}, "leak": {"area_1": 8e-12}}), joint)
    assert found.verdict == "effect"
    effects = {effect.name: effect for effect in found.effects}
    assert set(effects) == {"friction", "leak"}
    value, std, _ = effects["friction"].parameters["coulomb"]
    assert abs(value - 0.2) < 2.0 * std < 0.15
    (loop,) = (item for item in found.ambiguities if item.found == "friction")
    assert loop.size == pytest.approx(0.2, rel=0.1), "fitted where the joint slides"
    assert effects["leak"].muscle == 1
    assert effects["leak"].parameters["area_1"][0] == pytest.approx(8e-12, rel=0.1)
    before, after = (model.torque.rmse for model in found.errors.all[1:])
    assert after < 0.7 * before
    assert found.rig_extended.effects["friction"]["coulomb"] == value
    assert found.rig_extended.friction.shaft == 0.0


def test_each_part_of_the_joint_is_judged_by_itself(recorded, joint) -> None:
    found = diagnosed(recorded({"leak": {"area_1": 2e-11, "area_2": 2e-11}}), joint)
    assert {part.name: part.verdict for part in found.parts} == {"pressures": "effect", "torque": "none"}
    assert found.share == next(part.share_explained for part in found.parts if part.name == "pressures")
    assert [tried.effect for tried in found.ranking if tried.taken] == ["leak"]


def test_each_recording_has_its_own_rig_beside_the_common_one(recorded, joint) -> None:
    """On a warmer day the charge is higher: each recording's own rig has its charge, the common one is between them."""
    warmer = (1.0, 1.004)
    taken = [recorded({}, seconds=14.0, seed=seed) for seed in (3, 4)]
    recordings = [
        dataclasses.replace(recording, path=Path(f"take/{k}"), pressure=factor * recording.pressure)
        for k, (recording, factor) in enumerate(zip(taken, warmer, strict=True))
    ]
    found = diagnose(recordings, joint, profiles=False, estimator=False)
    assert [name for name, _ in found.own] == ["take/0", "take/1"]
    own = [rig.valves.charge_1 / joint.valves.charge_1 for _, rig in found.own]
    assert own == pytest.approx(warmer, abs=5e-4)
    assert own[0] < found.rig_recalibrated.valves.charge_1 / joint.valves.charge_1 < own[1]


@pytest.mark.slow(4)
def test_a_wide_hysteresis_is_not_called_friction(recorded, joint) -> None:
    found = diagnosed(recorded({"hysteresis": {"amplitude_1": 12.0, "amplitude_2": 12.0, "width": 4e-4}}), joint)
    assert [effect.name for effect in found.effects] == ["hysteresis"]
    assert found.effects[0].parameters["width"][0] == pytest.approx(4e-4, rel=0.3)
    assert "friction" not in found.ambiguous_with, found.ambiguities


RUBBING = Law("friction", (-0.1, 0.0, 0.1), (0.0, 0.1, 0.2), None, "angle")


@pytest.mark.thorough(50)
def test_friction_in_a_form_that_nobody_wrote_is_learned(recorded, joint, tmp_path: Path) -> None:
    recording = recorded({"friction": {"coulomb": 0.1}}, seconds=24.0, law=RUBBING)
    found = with_laws([recording], joint, profiles=False)
    assert isinstance(found, DiagnoseResult)
    (law,) = (effect.law for effect in found.effects if effect.law is not None)
    assert (law.place, law.argument) == ("friction", "angle")
    assert law.value(0.08) - law.value(-0.08) == pytest.approx(RUBBING.value(0.08) - RUBBING.value(-0.08), rel=0.15)
    assert "friction, in another form than the catalogue's law" in found.sentence
    assert any("depends on P1" in other for other in found.effects[-1].alternatives), "it moves with the angle"
    before, after = (model.sliding.rmse_sliding_nm for model in found.errors.all[1:])
    assert after < 0.1 * before
    assert {part.name: part.verdict for part in found.parts} == {"torque": "effect", "pressures": "none"}
    assert laws_of(found.rig_extended)[1].values == law.values
    # The page compares what both models leave, the filter's innovations included.
    rows = found.by_recording[0].residuals
    named = {model: {(row.kind, row.channel) for row in rows[model]} for model in ("recalibrated", "extended")}
    assert named["recalibrated"] == named["extended"]
    assert {kind for kind, _ in named["extended"]} >= {"sensor", "innovation"}
    found.save(tmp_path / "out", figures=False)
    assert "Statistics of the residuals" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_no_law_is_learned_from_a_few_sweeps(recorded, joint) -> None:
    recording = recorded({"friction": {"coulomb": 0.1}}, seconds=12.0, law=RUBBING)
    found = with_laws([recording], joint, profiles=False, estimator=False)
    assert [effect.name for effect in found.effects] == ["friction"]


def test_a_joint_with_nothing_wrong_has_no_effect(recorded, joint) -> None:
    found = diagnosed(recorded({}), joint)
    assert found.verdict == "none"
    assert found.effects == ()
    assert found.ambiguous_with == ()


def test_the_driven_model_says_what_the_simulation_did(recorded, joint) -> None:
    rig = moved(joint, PLAIN).replaced(effects={"leak": {"area_2": 2e-11}, "thermal": {"share_1": 0.2, "time": 2.0}})
    recording = recorded(rig.effects)
    trial = driven_trial(recording, rig, "auto", 1 / 3)
    driven = AngleDriven(rig, trial, 12000, part=BALANCE)
    ((pressure, needed),) = driven.driven([driven.origin], whole=True)
    # Noise of 20 Pa in what was recorded, and what smoothing the angle leaves; the simulation's charge is a little off.
    error = (pressure - trial.measured[:, PRESSURE_1:])[500:-500]
    assert np.all(error.std(axis=0) < 40.0)
    assert np.all(np.ptp(trial.measured[:, PRESSURE_1:], axis=0) > 5e3)
    assert np.sqrt(np.mean((needed - trial.measured[:, TORQUE])[500:-500] ** 2)) < 0.01


def test_the_direction_of_motion_fades_where_the_velocity_is_noise() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(8000) * 1e-3
    angle = 0.1 * np.clip(time - 4.0, 0.0, None)
    noisy = motion_of(angle + rng.normal(0.0, 1e-3, len(time)), 1e-3)
    assert np.abs(noisy.direction[1000:3000]).mean() < 0.7
    assert noisy.direction[5000:7000].min() > 0.9
    clean = motion_of(angle, 1e-3)
    np.testing.assert_array_equal(clean.angle, angle)
    assert clean.direction[5000:7000].min() > 0.999


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angle": None}, "no measured angle"),
        ({"voltage": np.linspace(4.0, 6.0, 12000)[:, None] * np.ones(2)}, "a valve moves by 2.00 V"),
        ({"external_torque": None, "angle": np.zeros(12000)}, "angle moves by 0.00 deg only"),
    ],
    ids=["no angle", "valves move", "still"],
)
def test_a_recording_that_tells_nothing_is_refused(recorded, joint, change, words) -> None:
    with pytest.raises(BadInput, match=words):
        diagnosed(dataclasses.replace(recorded({}, seconds=12.0), **change), joint)


def test_a_short_recording_is_refused(recorded, joint) -> None:
    with pytest.raises(BadInput, match="too short"):
        diagnosed(recorded({}, seconds=8.0), joint)


def test_without_a_torque_the_air_alone_is_judged(recorded, joint) -> None:
    recording = dataclasses.replace(recorded({"leak": {"area_1": 2e-11, "area_2": 2e-11}}), external_torque=None)
    found = diagnosed(recording, joint)
    assert [effect.name for effect in found.effects] == ["leak"]
    assert found.effects[0].muscle is None
    assert found.errors.extended.torque is None
    assert any("No torque from outside was recorded" in text for text in found.unseen)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    mapping = load_map("sealed_joint")
    bag = tmp_path_factory.mktemp("sealed") / "bag"
    write_bag(bag, read_csv(FILE, mapping))
    write_notes(bag, notes(FILE, mapping))
    return bag


@measured_only
@pytest.mark.slow(10)
def test_the_measured_joint(measured: Path, tmp_path: Path, capsys) -> None:
    """Fitted on the first two thirds of a real recording, judged on the rest."""
    out = tmp_path / "found"
    assert close_loop([str(measured), "--rig", "sealed_joint", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["verdict"] == "effect"
    assert [effect["name"] for effect in report["effects"]] == ["friction", "leak"]
    assert all(effect["delta_bic"] > 6.0 for effect in report["effects"])
    assert report["effects"][0]["parameters"]["coulomb"]["value"] == pytest.approx(0.28, abs=0.04)
    assert report["effects"][1]["muscle"] is None, "both lose air"
    assert set(report["ambiguous_with"]) == {"hysteresis", "thermal"}
    assert set(report["experiments"]) == {"hysteresis", "thermal"}
    loop = next(item for item in report["ambiguities"] if item["other"] == "hysteresis")
    assert loop["size"] == pytest.approx(0.3, abs=0.03), "as identify finds it, where the joint slides"
    errors = report["errors"]
    assert report["reference"]["angle_and_pressures"] == pytest.approx(0.24, abs=0.01)
    assert errors["recalibrated"]["torque"]["rmse_nm"] > 0.23
    assert errors["extended"]["torque"]["rmse_nm"] <= 0.15
    assert errors["extended"]["pressure"]["mean_rmse_pa"] < 0.6 * errors["recalibrated"]["pressure"]["mean_rmse_pa"]
    (part,) = report["recordings"]
    assert part["held_out_from_s"] == pytest.approx(12.5, abs=0.1)
    assert part["ukf"]["extended"]["torque"]["rmse_nm"] < 0.7 * part["ukf"]["recalibrated"]["torque"]["rmse_nm"]
    assert part["ukf"]["extended"]["torque"]["rmse_nm"] < part["ukf"]["as_configured"]["torque"]["rmse_nm"]
    assert part["ukf"]["extended"]["angle"]["rmse_deg"] <= 0.2
    assert "do not exclude another explanation" in " ".join(said.split())
    page = (out / "report.html").read_text(encoding="utf-8")
    for words in ("Found: friction, leak", "while it sticks", "cannot be seen"):
        assert words in page, words
    extended = load_rig(str(out / "rig_extended.yaml"))
    assert extended.valves.sealed
    again = replay(read_bag(measured), extended)
    assert again.report.ukf.external_torque.rmse < 0.16


@measured_only
def test_no_fit_sees_the_last_third(measured: Path, joint: Rig) -> None:
    recording = read_bag(measured)
    assert recording.external_torque is not None
    late = np.arange(len(recording.stamp_ns)) >= 12500
    other = dataclasses.replace(
        recording,
        external_torque=np.where(late, -recording.external_torque, recording.external_torque),
        pressure=recording.pressure + np.where(late, 5e3, 0.0)[:, None],
    )
    fitted = []
    for each in (recording, other):
        rig = base_without_friction([(each, "bag")], joint, 1 / 3, lambda text: None)
        trial = driven_trial(each, joint, "auto", 1 / 3)
        for part in (AIR, BALANCE):
            driven = AngleDriven(rig, trial, cut(trial, 1 / 3), part=part)
            theta = refit(driven, driven.origin, (), rounds=3).point.theta
            fitted.append((rig.joint.stiffness, rig.valves.charge_1, *theta))
    assert fitted[:2] == fitted[2:]


@measured_only
@pytest.mark.slow(4)
def test_the_measured_joint_has_one_answer_wherever_it_is_split(measured: Path, joint: Rig) -> None:
    """What is held out at the end judges a report's errors; all splits together judge what was found."""
    share = 0.5
    found = diagnose([read_bag(measured)], joint, holdout=share, jobs=1, profiles=False, estimator=False)
    agree = [(effect.name, effect.muscle, effect.splits.agree, effect.splits.of) for effect in found.effects]
    assert agree == [("friction", None, 5, 5), ("leak", None, 5, 5)]
    assert found.by_recording[0].held_out_from_s == pytest.approx(18.7 * (1.0 - share), abs=0.1)
