"""Experiments that tell two effects apart, and what they promise."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.cli import excite
from pam_antagonist.design import Limits, Plan
from pam_antagonist.design.apart import SHORTEST, Distinction, chance, imitation, told_apart
from pam_antagonist.design.information import STEP
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.simulation import excitation


@pytest.fixture(scope="module")
def rig() -> Rig:
    """A joint whose first muscle leaks."""
    return load_rig("shin2022").replaced(effects={"leak": {"area_1": 2e-9}})


def distance(rig: Rig, rival: str, voltage: np.ndarray, plan: Plan) -> float:
    question = Distinction(rig, "leak", rival, plan, (0, 1, 2, 3))
    question.take(question.course(voltage))
    return question.distance


@pytest.mark.thorough(9)
def test_a_design_tells_more_than_steps_of_the_same_length(rig: Rig) -> None:
    found = told_apart(rig, "leak", ["pressure_sensor"], Limits.of(rig))
    plan = found.plan
    rows = plan.voltage[:: round(STEP / plan.period)]
    steps = excitation.profile("steps", len(rows) * STEP, STEP, 3)
    mine, theirs = (distance(rig, "pressure_sensor", v, plan) for v in (rows, steps))
    assert mine > theirs
    # A recording that close_loop refuses decides nothing.
    assert SHORTEST - 2.0 <= plan.duration <= 60.0
    assert 0.0 < found.chance == found.by_rival["pressure_sensor"] <= 1.0


def test_more_evidence_decides_more_surely() -> None:
    assert chance(0.0) < 1e-6 < chance(3.0) < 0.5 == chance(6.0) < chance(30.0) < 1.0


def test_a_rival_imitates_the_effect_in_its_steady_pressures(rig: Rig) -> None:
    other = imitation(rig, "leak", "valve_offset")
    assert set(other.effects) == {"valve_offset"}
    assert any(abs(value) > 1e-3 for value in other.effects["valve_offset"].values())


@pytest.mark.slow(4)
def test_a_rival_that_can_do_nothing_of_an_effect_is_still_a_question() -> None:
    slow = load_rig("shin2022").replaced(effects={"valve_lag": {"time_1": 0.02, "time_2": 0.02}})
    other = imitation(slow, "valve_lag", "line_resistance")
    assert set(other.effects) == {"line_resistance"}
    assert any(value > 0.0 for value in other.effects["line_resistance"].values())


def test_what_cannot_show_promises_nothing(rig: Rig) -> None:
    plan = Plan.at_rest(rig, Limits.of(rig))
    still = np.tile(plan.rest, (500, 1))
    assert chance(distance(rig, "valve_offset", still, plan)) < 0.2


def test_the_report_of_close_loop_says_what_is_undecided(rig: Rig, tmp_path: Path) -> None:
    write_rig(rig, tmp_path / "rig_extended.yaml", [])
    report = {"effects": [{"name": "leak"}], "ambiguous_with": ["valve_offset", "delay_angle"]}
    (tmp_path / "report.json").write_text(json.dumps(report))
    found, effect, rivals = excite.undecided(tmp_path)
    assert (effect, rivals) == ("leak", ["valve_offset"]) and found.effects["leak"]["area_1"] == 2e-9
    for changes, words in (
        ({"effects": []}, "found no effect"),
        ({"ambiguous_with": []}, "leak is decided"),
        ({"effects": 3}, "expected a folder of close_loop"),
    ):
        (tmp_path / "report.json").write_text(json.dumps({**report, **changes}))
        with pytest.raises(BadInput, match=words):
            excite.undecided(tmp_path)


@pytest.mark.thorough(9)
def test_where_no_motion_tells_it_says_which_sensor_would(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """A small leak within narrow limits looks like a wrong sensor, until a gauge shows the pressure itself."""
    small = load_rig("shin2022").replaced(effects={"leak": {"area_1": 7e-11}})
    write_rig(small, tmp_path / "rig_extended.yaml", [])
    report = {"effects": [{"name": "leak"}], "ambiguous_with": ["pressure_sensor"]}
    (tmp_path / "report.json").write_text(json.dumps(report))
    words = ["--rig", "shin2022", "--out", str(tmp_path / "apart"), "--tell-apart", str(tmp_path), "--plan-only"]
    narrow = ["--min-pressure", "300", "--max-pressure", "400", "--duration", "26"]
    assert excite.main([*words, *narrow, "--without", "angle", "--without", "torque"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "No motion within the limits distinguishes them; this would: " in said
    assert "a third pressure sensor at muscle 1 (" in said
    # A gauge at the other muscle, or at the tank, sees nothing of it.
    assert "muscle 2" not in said and "tank" not in said
