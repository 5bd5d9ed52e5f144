"""Fresh rigs judge identify: what is counted, and by which interval; the frozen answers: what differs is said."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist import BadInput, diagnose
from pam_antagonist.identification import joint_stage
from pam_antagonist.identification.runs import runs_of
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from validation import frozen, oracle
from validation.rigs import days, fresh


def test_only_values_that_are_called_determined_are_compared_with_the_true_ones() -> None:
    unknown = tuple(Unknown(name, (name,), 2.0, 0.5, low=-1.0) for name in ("known", "wide", "bound", "untrue"))
    amounts = np.array([1.0, 0.5, -5.0, 1.0])
    fit = Fit(unknown, amounts, np.diag([0.01, 0.9, 0.01, 0.01]), 0.0)
    truth = {"known": 2.4, "wide": 2.0, "bound": -1.0}
    assert fresh.compared(fit, truth) == {"known": pytest.approx(-2.0)}


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Laboratories that record a second only."""
    monkeypatch.setattr(fresh, "sets", lambda recorded, trials, seconds=None: ([recorded(1.0, 0)], []))


@pytest.mark.usefixtures("short")
def test_a_fresh_rig_has_true_values_that_its_file_does_not_know() -> None:
    lab = fresh.laboratory(202, declared=True)
    again = fresh.laboratory(202, declared=True)
    assert lab.truth == again.truth
    assert np.array_equal(lab.fit[0].pressure, again.fit[0].pressure)
    assert lab.truth["joint.inertia"] != lab.typed.joint.inertia
    assert all(math.isfinite(value) for value in lab.truth.values())
    assert "hysteresis" not in lab.name


@pytest.mark.usefixtures("short")
def test_the_command_counts_a_rig_that_is_refused(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(fresh, "judged", lambda lab: {"refused": "it moves too little"})
    assert fresh.main(["--out", str(tmp_path / "out.json"), "--first", "202", "--count", "1", "--declared"]) == 0
    assert json.loads((tmp_path / "out.json").read_text())[0]["refused"] == "it moves too little"
    assert "0 rigs of 1" in capsys.readouterr().out


def test_days_are_pooled_and_a_rig_that_is_refused_is_said(tmp_path: Path, monkeypatch, capsys) -> None:
    def followed(seed: int, count: int, seconds: float) -> dict[str, Any]:
        if seed == 2:
            raise BadInput("it moves too little")
        rows = [{"kept": (0.3, 0.5), "adapted": (0.1 * seed, 0.9), "anew": (0.2, 0.95)}] * count
        return {"name": f"days_{seed}", "days": rows, "said": ["day 1: kept"]}

    monkeypatch.setattr(days, "followed", followed)
    words = ["--out", str(tmp_path / "out.json"), "--first", "1", "--count", "4", "--days", "3"]
    assert days.main(words) == 0
    said = capsys.readouterr().out
    assert "days_1: kept 0.300 deg (50%), adapted 0.100 deg (90%), anew 0.200 deg (95%); day 1: kept" in said
    assert "2: refused: it moves too little" in said
    assert "3 rigs: adapted 1.50 times the error of anew (median), kept 1.50" in said
    assert "adapted at most 1.2 times anew: 1; worse than kept: 1" in said
    assert len(json.loads((tmp_path / "out.json").read_text())) == 3


@pytest.mark.thorough(60)
def test_a_rig_that_is_adapted_errs_less_than_one_that_is_kept() -> None:
    one = days.followed(1403, 2, 20.0)
    for day in one["days"]:
        assert day["adapted"][0] < 0.5 * day["kept"][0]
        assert day["adapted"][1] > 0.85


@pytest.mark.thorough(14)
def test_a_fit_that_begins_far_off_leaves_a_false_minimum_by_the_balance_of_torques(monkeypatch) -> None:
    """From the values of this rig file alone the angle errs by 1.5 to 7.9 deg of 53 (by processor), else by 0.085."""
    monkeypatch.setattr(fresh, "sets", lambda recorded, trials, seconds=None: ([recorded(15.0, 0)], []))
    monkeypatch.setattr(joint_stage, "_HOPS", 0)
    lab = fresh.laboratory(307, declared=True)
    runs = runs_of(lab.fit[0], JointCondition("free", 0.0, "given"), "one")
    alone, both = (joint_stage.fit_joint(lab.typed, runs, 12, starts) for starts in (1, 2))
    errors = {
        name: math.degrees(np.sqrt(np.mean(left**2)))
        for name, values in (("alone", alone.values), ("both", both.values))
        for _, _, left in joint_stage.errors_of(lab.typed, runs, both.unknowns, [values])[0]
    }
    assert not both.lost
    assert errors["both"] < 0.15
    assert errors["alone"] > 10.0 * errors["both"]


@pytest.mark.thorough(14)
def test_a_fit_that_explains_little_begins_again_near_its_best(monkeypatch) -> None:
    """Two starts of this joint end at more than 2 % of the range, which is the mark of a fit that found nothing."""
    lab = fresh.laboratory(743, seconds=60.0)
    runs = [run for k in (0, 1, 3, 4) for run in runs_of(lab.fit[k], JointCondition("free", 0.0, "given"), f"fit_{k}")]

    def error(fit: Fit) -> float:
        (errors,) = joint_stage.errors_of(lab.typed, runs, fit.unknowns, [fit.values])
        return math.degrees(np.sqrt(np.mean(np.concatenate([left for _, _, left in errors]) ** 2)))

    found = joint_stage.fit_joint(lab.typed, runs, 20, 2)
    monkeypatch.setattr(joint_stage, "_HOPS", 0)
    before = joint_stage.fit_joint(lab.typed, runs, 20, 2)
    assert before.lost and not found.lost
    assert error(found) < 0.4 * error(before)


@pytest.mark.thorough(60)
def test_an_effect_of_the_air_that_the_whole_joint_contradicts_is_not_named() -> None:
    """A line so narrow that the chambers hardly breathe explains the pressures of this rig, and no angle."""
    lab = fresh.laboratory(742, seconds=60.0)
    found = diagnose(list(lab.fit), lab.typed)
    assert found.verdict == "none" and found.effects == ()
    assert found.choice.proposed is not None
    filtered = found.of_one_rig["recalibrated"].ukf
    assert filtered is not None and filtered.angle is not None and filtered.angle.rmse < 0.1


LEAK: dict[str, Any] = {
    "case": "battery/000 leak 1", "truth": {"effects": [["leak", 1]]}, "verdict": "effect",
    "effects": [{"name": "leak", "muscle": 1, "parameters": {"area_1": {"value": 1e-9, "std": 1e-11, "unit": "m2"}}}],
    "calibration": [], "errors": {"extended": {"angle": {"rmse_deg": 0.01}, "torque": None}},
    "cpu_s": 20.0,
}  # fmt: skip
NOTHING = {**LEAK, "case": "battery/003 none", "truth": {"effects": []}, "verdict": "none", "effects": []}
UNKNOWN = {**LEAK, "case": "measured/x", "truth": None, "verdict": "unexplained", "effects": []}
FOREIGN = {**UNKNOWN, "truth": {"effects": [["exchange", None]]}}


def changed(entry: dict[str, Any], **others: Any) -> dict[str, Any]:
    return {**copy.deepcopy(entry), **others}


def effect(name: str, muscle: int | None = None, value: float = 1e-9) -> dict[str, Any]:
    return {"name": name, "muscle": muscle, "parameters": {"area_1": {"value": value, "std": 1e-11, "unit": "m2"}}}


@pytest.mark.parametrize(
    ("old", "others", "said"),
    [
        (LEAK, {}, []),
        (LEAK, {"verdict": "none", "effects": []}, ["worse: effect leak 1 is gone", "worse: verdict effect -> none"]),
        (LEAK, {"effects": [effect("leak", 1, 1.02e-9)]}, []),
        (LEAK, {"effects": [effect("leak", 1, 1.1e-9)]}, ["worse: leak 1 area_1 1e-09 +- 1e-11 -> 1.1e-09 +- 1e-11"]),
        (LEAK, {"effects": [*LEAK["effects"], effect("creep")]}, ["worse: effect creep is new"]),
        (LEAK, {"errors": {"extended": {"angle": {"rmse_deg": 0.02}}}},
         ["worse: held-out angle rmse_deg 0.01 -> 0.02"]),
        (LEAK, {"errors": {"extended": {"angle": {"rmse_deg": 0.001}}}},
         ["better: held-out angle rmse_deg 0.01 -> 0.001"]),
        (LEAK, {"cpu_s": 60.0}, ["worse: processor time 20 -> 60 s"]),
        (NOTHING, {"verdict": "unexplained"}, ["worse: verdict none -> unexplained"]),
        (NOTHING, {"calibration": [{"name": "angle_zero", "value": 1.0, "std": 0.1}]},
         ["worse: calibration angle_zero is new"]),
        (UNKNOWN, {"verdict": "none"}, ["worse: verdict unexplained -> none"]),
        (FOREIGN, {"verdict": "effect", "effects": [effect("learned")]},
         ["other: effect learned is new", "other: verdict unexplained -> effect"]),
        (FOREIGN, {"verdict": "effect", "effects": [effect("leak", 1)]},
         ["worse: effect leak 1 is new", "worse: verdict unexplained -> effect"]),
        (changed(LEAK, verdict="unexplained", effects=[]), {"verdict": "effect", "effects": LEAK["effects"]},
         ["better: effect leak 1 is new", "better: verdict unexplained -> effect"]),
    ],
)  # fmt: skip
def test_what_differs_is_said(
    old: dict[str, Any], others: dict[str, Any], said: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, entry in (("old", old), ("new", changed(old, **others))):
        (tmp_path / name).write_text(json.dumps(entry) + "\n")
    status = oracle.main([str(tmp_path / "new"), "--against", str(tmp_path / "old"), "--compare-only"])
    lines = capsys.readouterr().out.splitlines()
    worse = sum(line.startswith("worse") for line in said)
    assert status == (1 if worse else 0)
    assert [line.replace(f"{old['case']}: ", "") for line in lines[:-1]] == said
    assert lines[-1] == f"1 of 1 cases compared: {worse} things are worse"


def test_the_frozen_answers_are_whole_and_their_joints_can_be_made_again(capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(__file__).parents[1] / "diagnosis" / "oracle.jsonl"
    entries = oracle.read(path)
    assert set(entries) <= set(frozen.joints(Path("data"), entries))
    assert {frozen.kind_of(name) for name in entries} == set(frozen.KINDS)
    battery = [name for name in entries if name.startswith("battery/")]
    assert len(battery) == 60 and sum(name.endswith("none") for name in battery) == 20
    assert oracle.main([str(path), "--against", str(path), "--compare-only"]) == 0
    assert capsys.readouterr().out == f"{len(entries)} of {len(entries)} cases compared: 0 things are worse\n"


@pytest.mark.usefixtures("short")
def test_the_joints_are_the_same_each_time_and_have_in_them_what_is_said() -> None:
    joints = frozen.joints(None, {})
    for kind in ("sealed", "guessed", "trials", "regulators"):
        made = next(made for name, made in joints.items() if frozen.kind_of(name) == kind)
        with made() as one, made() as again:
            assert np.array_equal(one.recordings[0].pressure, again.recordings[0].pressure)
            assert one.truth == again.truth
    with joints["sealed/1"]() as leaky, joints["sealed/0"]() as tight:
        assert leaky.truth == {"effects": [("friction", None), ("leak", None)]}
        assert tight.truth == {"effects": [("friction", None)]}


def test_a_kind_that_nobody_knows_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert oracle.main([str(tmp_path / "new"), "--only", "hexapods"]) == 2
    assert "--only hexapods: no such case; expected a part of a name, or a kind: at hand" in capsys.readouterr().err


def test_less_that_is_fitted_is_the_begin_of_more() -> None:
    asked: list[tuple[float, int]] = []

    def recorded(seconds: float, number: int) -> Recording:
        asked.append((seconds, number))
        return Recording(Path(str(number)), np.arange(2), np.zeros((2, 2)), np.zeros((2, 2)))

    for trials, seconds in ((True, 20.0), (True, None), (False, 20.0)):
        fitted, held = fresh.sets(recorded, trials, seconds)
        assert not {str(one.path) for one in fitted} & {str(one.path) for one in held}
    short, usual, long = asked[:5], asked[5:17], asked[17:]
    assert short[:2] == usual[:2] == [(10.0, 0), (10.0, 1)] and len(usual) == 12
    assert long[0] == (20.0, 0) and short[2:] == usual[9:]
