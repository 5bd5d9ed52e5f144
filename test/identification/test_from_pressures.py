"""A rig is identified from its measured pressures, from what a ruler tells, or the command says why it is not."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from other_rigs import HANGING, LATE_S, WEIGHT, ZERO_ERROR, described, drawn, recorded

from pam_antagonist import identify, read_bag
from pam_antagonist import replay as replayed
from pam_antagonist.cli import identify as command
from pam_antagonist.cli import import_csv, new_rig, replay
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.from_pressures import FromPressures
from pam_antagonist.identification.joint_stage import DELAY, WEIGHT_COS, WEIGHT_SIN, ZERO
from pam_antagonist.identification.result import HeldRecording
from pam_antagonist.recording import Recording, recording_hash, write_bag
from pam_antagonist.report.identify import IdentifyResult
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import write_rig

STRANGERS = Path(__file__).resolve().parents[3] / "shared" / "data" / "strangers"
RIG = described(0.01)
TRUE = drawn(RIG, 3)
EXACT = {
    ZERO: ZERO_ERROR, DELAY: -LATE_S, WEIGHT_COS: WEIGHT * math.sin(HANGING), WEIGHT_SIN: -WEIGHT * math.cos(HANGING),
}  # fmt: skip


def found_in(recordings: Sequence[Recording], rig: Rig = RIG) -> FromPressures:
    return identify(recordings, rig).found  # type: ignore[union-attr,return-value]


@pytest.fixture(scope="module")
def trials() -> list[Recording]:
    return [recorded(TRUE, 8.0, seed) for seed in range(6)]


@pytest.fixture(scope="module")
def result(trials: list[Recording]) -> IdentifyResult:
    return identify(trials, RIG)


@pytest.fixture(scope="module")
def found(result: IdentifyResult) -> FromPressures:
    return result.found  # type: ignore[return-value]


def run(folder: Path, names: Sequence[str], out: Path) -> int:
    bags = [str(folder / name) for name in names]
    return command.main([*bags, "--rig", str(folder / "rig.yaml"), "--out", str(out), "--no-figures"])


@pytest.mark.slow(12)
def test_short_trials_of_a_joint_that_a_ruler_knows_give_its_angle(found: FromPressures) -> None:
    assert found.rejected == ""
    assert found.pooled("identified") < 0.3
    assert found.pooled("identified") < 0.05 * found.pooled("as_configured")
    assert found.pooled("identified") < 0.2 * found.pooled("linear")
    assert 0.85 < found.coverage <= 1.0
    assert [held.from_s for held in found.held] == [0.0, 0.0]


def test_what_is_found_is_true_within_its_errors(found: FromPressures) -> None:
    for name, value in found.joint.values.items():
        true = EXACT[name] if name in EXACT else TRUE.value(name)
        assert abs(value - true) < 4.0 * found.joint.stds[name], name
    assert found.joint.stds[DELAY] < 0.5 * LATE_S
    assert found.air is not None
    assert found.air.values["valve_1.overlap"] == pytest.approx(0.52, abs=0.005)


def test_the_file_has_what_all_of_the_data_determine(found: FromPressures) -> None:
    joint, _ = found.final
    assert found.rig.value("joint.inertia") == joint.values["joint.inertia"] != found.joint.values["joint.inertia"]
    assert np.trace(joint.covariance) < np.trace(found.joint.covariance)
    assert abs(joint.values[DELAY] + LATE_S) < 2e-3
    late = joint.values[DELAY] < -5.0 * joint.stds[DELAY]
    assert any("The angle is late" in note for note in found.notes) == late


def test_a_cause_is_named_only_where_the_recordings_show_it(found: FromPressures) -> None:
    def worse(item: HeldRecording, linear: float, sign: float) -> HeldRecording:
        """A held-out part on which the rig file is better than what was identified."""
        whole = item.replays["as_configured"]
        rows = whole.run.rows.copy()
        rows["angle"] *= sign
        replays = {**item.replays, "as_configured": replace(whole, run=replace(whole.run, rows=rows))}
        reports = {"identified": item.reports["as_configured"], "as_configured": item.reports["identified"]}
        return replace(item, replays=replays, reports={**item.reports, **reports}, linear=linear)

    def said(linear: float, sign: float = 1.0, notes: tuple[str, ...] = ()) -> str:
        return replace(found, held=tuple(worse(item, linear, sign) for item in found.held), notes=notes).rejected

    alone = said(1e3)
    assert "The held-out part is unlike the fitted one, or the model lacks something" in alone
    assert not any(word in alone for word in ("two muscles", "exchanged", "rarely"))
    assert "do not fit two muscles on one joint" in said(0.01) and "exchanged" not in said(0.01)
    assert "the estimated angle goes against the measured one: channels are exchanged" in said(1e3, -1.0)
    assert "read too rarely" in said(1e3, notes=("The pressures of a swing from row to row: what",))


def test_the_report_has_the_numbers_and_the_rig_is_one_that_replay_takes(
    result: IdentifyResult, found: FromPressures, trials: list[Recording], tmp_path: Path
) -> None:
    out = result.save(tmp_path / "out")
    assert "Errors of the filter with the identified rig on held-out data" in result.summary()
    numbers = json.loads((out / "report.json").read_text())
    assert numbers["errors_deg"]["identified"] == pytest.approx(found.pooled("identified"))
    values = {entry["name"]: entry["value"] for entry in numbers["parameters"]}
    joint, air = found.final
    assert air is not None
    assert values == {**joint.values, **air.values}
    rig = load_rig(str(out / "rig.yaml"))
    assert rig.identified
    # Whoever reads the file knows which errors are not those on new data.
    assert dict(rig.fitted) == {recording_hash(one): one.duration_s for one in trials}
    (issue,) = replayed(trials[0], rig).report.recording.issues
    assert "was fitted to all of it: errors of this rig there are not those on new data" in issue
    assert rig.calibration.delay_angle == pytest.approx(values["calibration.delay_angle"], rel=1e-3)
    write_bag(tmp_path / "free_2", trials[2])
    # The rig file's calibration is removed from a recording as from its bag.
    bag = tmp_path / "free_2"
    errors = [replayed(one, rig).report.ukf.angle for one in (bag, read_bag(bag))]
    assert errors[0] is not None and errors[0] == errors[1] and rig.calibration.encoder_zero != 0.0
    words = [str(tmp_path / "free_2"), "--rig", str(out / "rig.yaml"), "--out", str(tmp_path / "again"), "--no-figures"]
    assert replay.main(words) == 0
    again = json.loads((tmp_path / "again" / "report.json").read_text())
    assert again["ukf"]["angle"]["rmse_deg"] < 1.2 * numbers["held_out"][0]["errors_deg"]["identified"]


@pytest.mark.thorough(7)
def test_a_start_far_away_comes_to_the_same_error(trials: list[Recording]) -> None:
    force = RIG.muscle_1.force
    far = RIG.replaced(
        muscle_1=RIG.muscle_1.replaced(force=force.replaced(c1=170.0, c3=450.0, c6=0.257)),
        muscle_2=RIG.muscle_2.replaced(force=force.replaced(c1=340.0, c2=2.7, c6=0.243)),
        geometry=RIG.geometry.replaced(radius=0.033),
    )
    assert found_in(trials[:2], far).pooled("identified") < 0.1


@pytest.mark.thorough(11)
def test_regulators_whose_sensors_are_slower_than_the_log() -> None:
    rig = described(0.02, regulators=True)
    true = drawn(rig, 5)
    trials = []
    for seed in range(4):
        trial = recorded(true, 8.0, seed)
        pressure = trial.pressure.copy()
        pressure[1::2] = pressure[: 2 * (len(pressure) // 2) : 2]
        trials.append(replace(trial, pressure=pressure))
    result = found_in(trials, rig)
    assert result.rejected == ""
    assert result.pooled("identified") < 0.1 * result.pooled("as_configured")
    assert 0.85 < result.coverage <= 1.0
    assert any("the sensor is slower than the log" in note for note in result.notes)


@pytest.mark.thorough(20)
def test_a_long_recording_and_a_locked_joint_whose_torque_is_measured() -> None:
    free, locked = recorded(TRUE, 30.0, 1), recorded(TRUE, 8.0, 2, "locked")
    result = found_in([free, locked])
    assert result.rejected == ""
    assert result.pooled("identified") < 0.5
    assert [held.name.split("/")[-1] for held in result.held if held.rows] == ["free_1"]
    gain = "muscle_1.force.c1"
    assert result.joint.stds[gain] < found_in([free]).joint.stds[gain]


@pytest.mark.thorough(12)
def test_gaps_of_every_signal_are_left_out(trials: list[Recording]) -> None:
    damaged = []
    for trial in trials[:4]:
        arrays = {name: getattr(trial, name).copy() for name in ("pressure", "voltage", "angle")}
        arrays["pressure"][100:103] = np.nan
        arrays["voltage"][300] = np.nan
        arrays["angle"][400:480] = np.nan
        keep = np.ones(len(trial), bool)
        keep[550:555] = False
        kept = {name: array[keep] for name, array in arrays.items()}
        damaged.append(replace(trial, stamp_ns=trial.stamp_ns[keep], **kept))
    result = found_in(damaged)
    assert result.rejected == ""
    assert result.air is not None
    assert result.pooled("identified") < 0.3


@pytest.mark.thorough(14)
def test_a_log_of_20_hz() -> None:
    coarse = described(0.05)
    result = found_in([recorded(drawn(coarse, 3), 10.0, seed, fine=5) for seed in range(4)], coarse)
    assert result.rejected == ""
    assert result.pooled("identified") < 0.5
    assert result.coverage > 0.8


def _cylinder(trial: Recording) -> Recording:
    """A double-acting cylinder: its speed goes by the difference of the pressures, between two stops."""
    apart = (trial.pressure[:, 0] - trial.pressure[:, 1]) / 1e5
    angle = np.zeros(len(trial))
    for k in range(1, len(trial)):
        angle[k] = np.clip(angle[k - 1] - 0.02 * apart[k - 1], -0.6, 0.6)
    return replace(trial, angle=angle)


def _exchanged_voltages(trial: Recording) -> Recording:
    return replace(trial, voltage=trial.voltage[:, ::-1].copy())


@pytest.mark.slow(9)
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_cylinder, "do not fit two muscles on one joint"),
        pytest.param(_exchanged_voltages, "the commands do not explain the pressures", marks=pytest.mark.thorough(7)),
    ],
    ids=["cylinder", "exchanged voltages"],
)
def test_what_is_no_pair_of_muscles_ends_in_one_sentence(
    change: Callable[[Recording], Recording],
    words: str,
    trials: list[Recording],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for trial in trials[:2]:
        write_bag(tmp_path / trial.path.name, change(trial))
    write_rig(RIG, tmp_path / "rig.yaml", [])
    assert run(tmp_path, ["free_0", "free_1"], tmp_path / "out") == 1
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("Do not use this rig: ")
    assert words in said
    written = {file.name for file in (tmp_path / "out").glob("*.yaml")}
    assert written == {"rig_rejected.yaml"}


def _still(trial: Recording) -> Recording:
    return replace(trial, angle=np.full(len(trial), 0.1))


def _angle_in_the_first_half(trial: Recording) -> Recording:
    return replace(trial, angle=np.where(trial.time_s > 4.0, np.nan, trial.angle))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda trial: replace(trial, angle=None), "a measured angle"),
        (lambda trial: replace(trial, angle=np.full(len(trial), np.nan)), "a measured angle"),
        (lambda trial: replace(trial, voltage=np.full_like(trial.voltage, np.nan)), "has commands: expected"),
        (_still, "the joint moves by 0° in the data to be fitted"),
        (_angle_in_the_first_half, "the part that is held out has no second with pressures and angle"),
        (lambda trial: trial.slice(0.0, 2.0), "expected a longer recording"),
    ],
)
def test_too_little_is_refused_at_once(
    change: Callable[[Recording], Recording], words: str, trials: list[Recording]
) -> None:
    with pytest.raises(BadInput, match=words):
        identify(change(trials[0]), RIG, joint="free")


@pytest.mark.thorough(10)
def test_trials_without_commands_help_with_the_joint(trials: list[Recording]) -> None:
    silent = [replace(trial, voltage=np.full_like(trial.voltage, np.nan)) for trial in trials[:3]]
    result = found_in([*silent, trials[3]])
    assert result.rejected == ""
    assert [held.name.split("/")[-1] for held in result.held] == ["free_3"]
    assert result.pooled("identified") < 0.1 * result.pooled("as_configured")


@pytest.mark.slow(4)
def test_what_is_frozen_stays_and_what_is_freed_moves(trials: list[Recording]) -> None:
    result = identify(trials[:2], RIG, free=["joint.shaft_radius"], freeze=["geometry", "valve_1"])
    names = {item.name for fit in result.found.fits for item in fit.unknowns}  # type: ignore[union-attr]
    assert "joint.shaft_radius" in names and "muscle_1.force.c1" in names
    assert result.rig.geometry.radius == RIG.geometry.radius
    assert result.rig.valve_1.inflow_area == RIG.valve_1.inflow_area
    assert result.rig.valve_1.overlap == RIG.valve_1.overlap
    assert result.rig.joint.shaft_radius != RIG.joint.shaft_radius


@pytest.mark.thorough(30)
@pytest.mark.parametrize(("lab", "most"), [("elbow", 0.4), ("wrist", 1.0)])
def test_recordings_of_other_laboratories(
    lab: str, most: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Their simulators share nothing with this package. The held-out recordings were not given to the command."""
    if not STRANGERS.is_dir():
        pytest.skip("the recordings of other laboratories are not part of this repository")
    known = yaml.safe_load((STRANGERS / lab / "knows.yaml").read_text())
    assert new_rig.main(["--out", str(tmp_path / "rig.yaml"), *map(str, known["new_rig"])]) == 0
    use: dict[str, list[str]] = {"fit": [], "held_out": [], "extra": []}
    for name, about in known["recordings"].items():
        bag = name.split(".")[0]
        use[about["use"]].append(bag)
        if about["use"] != "extra":
            arguments = [str(STRANGERS / lab / name), "--map", str(STRANGERS / lab / about["map"])]
            assert import_csv.main([*arguments, "--out", str(tmp_path / bag)]) == 0
    assert run(tmp_path, use["fit"], tmp_path / "out") == 0
    errors, covered = [], []
    for bag in use["held_out"]:
        out = tmp_path / f"{bag}_replay"
        words = [str(tmp_path / bag), "--rig", str(tmp_path / "out" / "rig.yaml"), "--out", str(out), "--no-figures"]
        assert replay.main(words) == 0
        angle = json.loads((out / "report.json").read_text())["ukf"]["angle"]
        errors.append(angle["rmse_deg"])
        covered.append(angle["coverage95"])
    capsys.readouterr()
    assert math.sqrt(np.mean(np.square(errors))) < most
    assert 0.85 <= np.mean(covered) <= 0.999
