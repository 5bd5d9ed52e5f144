"""Scores, files and tables of the battery, with a diagnosis that says what it is told to."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from battery_outcomes import CREEP, DROOP, LEAK, outcome

from pam_antagonist.diagnosis.errors import Errors, ModelErrors
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.errors import ChannelErrors
from validation.battery import command, outcomes, places, remainders, scores
from validation.battery.draw import NOTHING_FROM, cases
from validation.battery.plants import JOINTS, Case


def errors(angle: float, torque: float, pressure: tuple[float, float]) -> Errors:
    return Errors(ChannelErrors("deg", angle, 1.0, 1.0), ChannelErrors("nm", torque, 1.0, 1.0), pressure)


def said(verdict: str, *effects: tuple[str, int | None], ambiguous=(), before=None, after=None):
    return SimpleNamespace(
        verdict=verdict,
        effects=[SimpleNamespace(name=name, muscle=muscle) for name, muscle in effects],
        ambiguous_with=list(ambiguous),
        ranking=[
            SimpleNamespace(effect=n, round=1, delta_bic=30.0, held_out_evidence=8.0, shares=(0.9, 0.8))
            for n, _ in effects
        ],
        calibrations=[],
        errors=ModelErrors(*(one or errors(1, 1, (1e4, 1e4)) for one in (None, before, after))),
    )


@pytest.mark.parametrize(
    ("item", "right"),
    [
        (outcome("single", [LEAK], "effect", [LEAK]), True),
        (outcome("single", [LEAK], "effect", [LEAK, CREEP]), True),
        (outcome("single", [LEAK], "effect", [CREEP, LEAK]), False),
        (outcome("single", [LEAK], "unexplained", [LEAK]), False),
        (outcome("single", [LEAK], "none"), False),
        (outcome("pair", [LEAK, CREEP], "effect", [CREEP, LEAK]), True),
        (outcome("pair", [LEAK, CREEP], "effect", [CREEP]), False),
        (outcome("pair", [LEAK, CREEP], "effect", [CREEP, DROOP, LEAK]), True),
        (outcome("none", [], "none"), True),
        (outcome("none", [], "effect", [LEAK]), False),
        (outcome("none", [], "unexplained"), False),
        (outcome("foreign", [("exchange", None)], "unexplained"), True),
        (outcome("foreign", [("exchange", None)], "effect", [LEAK]), False),
        (outcome("foreign", [("exchange", None)], "none"), False),
        (outcome("calibration", [], "none", form=("torque_zero",), calibrations=("torque_zero",)), True),
        (outcome("calibration", [], "none", form=("torque_zero",), calibrations=("torque_zero", "delay_angle")), False),
        (outcome("calibration", [], "none", form=("torque_zero",)), False),
        (outcome("calibration", [], "effect", [LEAK], form=("torque_zero",), calibrations=("torque_zero",)), False),
    ],
)
def test_what_is_right(item: outcomes.Outcome, right: bool) -> None:
    assert item.right is right


@pytest.mark.parametrize(
    ("effect", "says", "place", "arguments"),
    [
        (("relief", 2), {"place": "flow_2", "arguments": ["pressure_2"]}, True, True),
        (("relief", 2), {"place": "leak", "muscle": 2, "arguments": ["pressure"]}, True, True),
        (("relief", 2), {"place": "flow_1", "arguments": ["pressure_1"]}, False, False),
        (("relief", 2), {"place": "flow_2", "arguments": ["angle"]}, True, False),
        (("relief", 2), {"place": "flow_2", "arguments": ["pressure", "angle"]}, True, False),
        (("relief", 2), {"place": "flow_2", "arguments": []}, True, False),
        (("check", None), {"place": "exchange", "arguments": ["pressure_difference"]}, True, True),
        (("relief", 2), {"name": "leak", "muscle": 2}, True, True),
        (("relief", 2), {"name": "leak", "muscle": 1}, False, False),
        (("relief", 2), {"name": "of a package"}, False, False),
    ],
)
def test_the_place_and_the_arguments_of_a_law(
    effect: tuple[str, int | None], says: dict, place: bool, arguments: bool
) -> None:
    one = places.found(SimpleNamespace(**{"name": "learned", "muscle": None, **says}))
    name = says.get("name", "learned")
    item = outcome("foreign", [effect], "effect", [(name, None)], where=(one,))
    assert (item.places_right, item.arguments_right) == (place, arguments)
    assert item.right is (place and name == "learned")
    assert not outcome("foreign", [effect], "unexplained", [(name, None)], where=(one,)).places_right
    both = outcome("pair", [effect, CREEP], "effect", [(name, None), CREEP], where=(one, places.Found((), None, ())))
    assert both.places_right is False


def test_muscles_are_counted_apart() -> None:
    assert outcome("single", [LEAK], "effect", [("leak", 1)]).right_muscle is True
    assert outcome("single", [LEAK], "effect", [("leak", 2)]).right_muscle is False
    assert outcome("single", [LEAK], "effect", [("leak", 2)]).right is True
    assert outcome("single", [CREEP], "effect", [("creep", 2)]).right_muscle is None


def a_case(effect: str, form: str, muscle: int | None) -> Case:
    return Case(form, "single", ((effect, muscle),), (form,), 21, (10.0,))


def test_a_case_is_judged_on_the_channel_that_it_moves() -> None:
    case = a_case("leak", "seeping", 1)
    before, after = errors(1.0, 0.1, (9000.0, 700.0)), errors(1.0, 0.1, (1200.0, 700.0))
    seen = []

    def diagnose(recordings):
        seen.extend(recordings)
        return said("effect", ("leak", 1), before=before, after=after)

    result = outcomes.judge(case, diagnose, 12.0)
    assert [len(recording) for recording in seen] == [12_000, 12_000]
    assert result.channel == "pressure_1"
    assert result.errors["recalibrated"] == 9000.0 and result.errors["extended"] == 1200.0
    # A model that is right in everything leaves the sensor's noise and rounding.
    assert result.errors["true"] == pytest.approx(np.hypot(600.0, 244.0 / 12**0.5), rel=0.03)
    assert 0.9 < result.reduction < 1.0
    assert result.right and result.right_muscle


def test_recordings_that_are_refused_are_a_wrong_answer() -> None:
    def refuse(recordings):
        raise BadInput("too quiet")

    result = outcomes.judge(a_case("leak", "seeping", 1), refuse, 12.0)
    assert result.verdict == "refused" and not result.right
    assert scores.confusion([result])[1] == (("leak", "1"),)
    assert scores.confusion([result])[0][1:] == ("refused",)


def test_the_file_of_another_battery_is_refused(tmp_path: Path) -> None:
    case = cases(3, 1)[0][1]
    outcomes.save(tmp_path, 0, outcomes.judge(case, lambda recordings: said("none"), 10.0))
    for wanted, duration in ((cases(4, 1)[0][1], 10.0), (case, 20.0), (dataclasses.replace(case, sizes=(9.0,)), 10.0)):
        with pytest.raises(BadInput, match="another battery"):
            outcomes.load(tmp_path, 0, wanted, duration)
    (tmp_path / "case_000.json").write_text("{}", encoding="utf-8")
    with pytest.raises(BadInput, match="no outcome"):
        outcomes.load(tmp_path, 0, case, 10.0)


# The command


@pytest.fixture
def oracle(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A diagnosis that knows the truth, but for supply_droop; and the names of the cases that it was asked about."""
    asked: list[str] = []

    def diagnosis(case: Case, jobs: int):
        def run(recordings):
            assert len(recordings) == len(JOINTS)
            asked.append(case.name)
            if case.kind in ("none", "foreign"):
                return said({"none": "none", "foreign": "unexplained"}[case.kind])
            return said("effect", *((name, m) for name, m in case.effects if name != "supply_droop"))

        return run

    monkeypatch.setattr(command, "_diagnosis", diagnosis)
    return asked


def run(*arguments: object) -> int:
    return command.main([str(item) for item in arguments])


def test_goes_on_where_it_was_interrupted(tmp_path: Path, oracle, capsys) -> None:
    out = tmp_path / "result"
    assert run("--out", out, "--count", 6, "--duration", 10, "--shard", "2/2", "--jobs", 2) == 0
    assert "3 of 6 cases are finished" in capsys.readouterr().out
    assert len(oracle) == 3
    assert run("--out", out, "--count", 6, "--duration", 10, "--jobs", 2) == 0
    assert len(oracle) == 6 == len(set(oracle))
    (out / "case_004.json").unlink()
    arguments = ("--out", out, "--count", 6, "--duration", 10, "--jobs", 1, "--docs", tmp_path / "battery.md")
    assert run(*arguments) == 0
    assert len(oracle) == 7 and oracle[-1] == cases(1, 6)[4][1].name
    text = capsys.readouterr().out
    assert "6 of 6 cases are finished" in text and "single effect: the right one first" in text
    page = (tmp_path / "battery.md").read_text(encoding="utf-8")
    assert "./run battery --out DIR --count 6 --seed 1 --duration 10" in page
    assert "s at most, with 1 to 2 threads" in page
    for part in page.split("\n\n"):
        if part.startswith("|"):
            assert len({line.count("|") for line in part.splitlines()}) == 1
    assert (tmp_path / "battery" / "detection.png").read_bytes().startswith(b"\x89PNG")
    assert "(battery/detection.png)" in page and "All cases were diagnosed by the same code" in page
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["scores"][0]["what"] == "single effect: the right one first"
    shares = [score for score in summary["scores"] if score["count"] and "median" not in score["what"]]
    assert shares and all(low <= score["value"] <= high for score in shares for low, high in [score["interval"]])
    assert summary["finished"] == 6 and summary["seed"] == 1


def test_cases_with_nothing_wrong_by_number(tmp_path: Path, oracle, capsys) -> None:
    out = tmp_path / "result"
    assert run("--out", out, "--count", 0, "--nothing", 3, "--duration", 10) == 0
    text = capsys.readouterr().out
    assert "3 of 3 cases are finished" in text
    # None of three: up to 71 % of all joints may give a false alarm.
    assert "0.0 to 70.8 %" in text
    assert sorted(path.name for path in out.glob("case_*")) == [f"case_{NOTHING_FROM + k}.json" for k in range(3)]


def test_bags_with_their_truth(tmp_path: Path, capsys) -> None:
    assert run("--out", tmp_path / "out", "--bags", tmp_path / "bags", "--count", 2, "--duration", 10) == 0
    assert "2 cases" in capsys.readouterr().out
    for number, case in cases(1, 2):
        folder = tmp_path / "bags" / f"{number:03d}"
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        assert truth["name"] == case.name and truth["kind"] == case.kind
        assert [name for name, _ in truth["effects"]] == [name for name, _ in case.effects]
        assert {path.name for path in folder.iterdir()} == {"free", "locked", "truth.json"}
    assert run("--out", tmp_path / "out", "--bags", tmp_path / "bags", "--count", 2, "--duration", 10) == 2


def test_pages_of_changed_code_say_so(tmp_path: Path, oracle) -> None:
    arguments = ("--out", tmp_path / "result", "--count", 0, "--nothing", 2, "--duration", 10)
    assert run(*arguments) == 0
    path = tmp_path / "result" / f"case_{NOTHING_FROM}.json"
    path.write_text(path.read_text(encoding="utf-8").replace(outcomes.fingerprint(), "older"), encoding="utf-8")
    assert run(*arguments, "--docs", tmp_path / "battery.md") == 0
    assert "The code was changed in between" in (tmp_path / "battery.md").read_text(encoding="utf-8")


def test_remainders_are_worked_out_once(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def made(form) -> remainders.Remainder:
        asked.append(form.name)
        return remainders.Remainder(8.0, 10.0, 5.0, 1.5)

    monkeypatch.setattr(remainders, "remainder", made)
    assert run("--out", tmp_path, "--remainders") == 0
    assert asked == [form.name for form in remainders.with_law()]
    assert "15.0 %" in capsys.readouterr().out
    assert remainders.load(tmp_path / remainders.FILE)[asked[0]].share == pytest.approx(0.15)
    assert run("--out", tmp_path, "--remainders") == 0
    assert len(asked) == len(set(asked))
    (tmp_path / remainders.FILE).write_text("[]", encoding="utf-8")
    assert run("--out", tmp_path, "--remainders") == 2
    assert "no remainders" in capsys.readouterr().err
