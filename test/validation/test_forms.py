"""Forms of the literature: each has its place and does something; a third recording judges what was learned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist.model.effects import CATALOGUE
from validation.battery import carry, places
from validation.battery.carry import FREE_ONLY, LATER, NOTHING, PAIR, SINGLE, cases, judged, tables
from validation.battery.form import Form
from validation.battery.forms import FOREIGN, UNCATALOGUED
from validation.battery.forms import SINGLE as BATTERY
from validation.battery.forms_literature import FORMS, KIND, KINDS
from validation.battery.places import Found
from validation.battery.plants import Case

ROPE, HEAT = ("rope", 1), ("heat", 2)


def test_every_form_has_a_kind_a_source_a_place_and_a_name_of_its_own() -> None:
    every = (*BATTERY, *FOREIGN, *UNCATALOGUED, *FORMS)
    assert len({form.name for form in every}) == len(every)
    effects = [form.effect for form in FORMS]
    assert len(set(effects)) == len(effects) and set(effects) == set(places.LITERATURE)
    assert not set(effects) & {*CATALOGUE, *places.PLACES}
    assert len(FORMS) >= 24 and set(KIND.values()) == set(KINDS) and all(form.source for form in FORMS)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_a_form_moves_a_channel_and_leaves_the_other_muscle_alone(form: Form) -> None:
    effect = (form.effect, 2 if form.by_muscle else None)
    case = Case(form.name, "single", (effect,), (form.name,), 21, (8.0,))
    moved = case.moved(30.0)
    assert all(np.isfinite(list(moved.values()))) and max(moved.values()) > 1.0
    assert moved["locked angle"] == 0.0
    if form.by_muscle:
        assert moved["locked pressure_1"] == 0.0


def test_a_longer_study_begins_with_the_shorter_and_every_form_comes() -> None:
    long = cases(1, len(FORMS), 20, 4, 4)
    by_kind = {kind: [one for one in long if one[1].kind == kind] for kind in (SINGLE, PAIR, FREE_ONLY, NOTHING)}
    assert cases(1, 3, 2, 0, 0) == [*by_kind[SINGLE][:3], *by_kind[PAIR][:2]]
    assert {one.form[0] for _, one in by_kind[SINGLE]} == set(KIND)
    assert all(len({KIND[name] for name in one.form}) == 2 for _, one in by_kind[PAIR])
    assert [one.far for _, one in by_kind[NOTHING]] == [False, True, False, True]
    assert all(4.5 <= size <= 14.0 for _, one in long for size in one.sizes)
    # Without a torque meter, its loop is nothing.
    assert "loop of the torque meter" not in {one.form[0] for _, one in cases(1, 0, 0, 60, 0)}


def test_a_third_recording_is_of_the_same_joint_under_other_voltages() -> None:
    joint = cases(1, 0, 0, 0, 2)[1][1]
    free, locked, later = (joint.parameters(name) for name in ("free", "locked", LATER))
    assert np.array_equal(free, later) and 0 < (free != locked).sum() <= 3
    assert not np.array_equal(joint.voltage("free", 5.0), joint.voltage(LATER, 5.0))
    assert joint.recording(LATER, 5.0).torque is not None
    alone = cases(1, 0, 0, 1, 0)[0][1]
    assert alone.given == ("free",) and alone.recording("free", 5.0).torque is None


def outcome(kind: str, effects: list[Any], *where: Found, verdict: str = "effect", **excess: float) -> dict[str, Any]:
    given = {"configured": 20.0, "recalibrated": 10.0, "proposed": 1.0, "own": 1.0, **excess}
    forms = [next(form.name for form in FORMS if form.effect == name) for name, _ in effects]
    return {
        "name": "0000", "kind": kind, "far": False, "effects": effects, "forms": forms, "reached": [8.0] * len(forms),
        "verdict": verdict, "found": [("learned", one.muscle) for one in where], "where": where, "calibrations": [],
        "seconds": 1.0, **{name: {"excess": value, "coverage": 0.95} for name, value in given.items()},
    }  # fmt: skip


FRICTION, TORQUE = (Found((place,), None, ("speed",)) for place in ("friction", "torque"))
FORCE = Found(("force",), 2, ("time",))


@pytest.mark.parametrize(
    ("item", "right", "false"),
    [
        (outcome(SINGLE, [ROPE], FRICTION), True, False),
        (outcome(SINGLE, [ROPE], FORCE, FRICTION), False, True),
        (outcome(SINGLE, [ROPE], FRICTION, FORCE), True, True),
        (outcome(SINGLE, [("heat", 1)], FORCE), False, True),
        (outcome(SINGLE, [ROPE], verdict="unexplained"), False, False),
        (outcome(PAIR, [ROPE, HEAT], FORCE, FRICTION), True, False),
        (outcome(PAIR, [ROPE, HEAT], FRICTION), False, False),
        (outcome(SINGLE, [("meter_loop", None)], verdict="unexplained"), False, False),
        (outcome(SINGLE, [("meter_loop", None)], Found(("meter",), None, ("torque",))), True, False),
        (outcome(SINGLE, [("meter_loop", None)], TORQUE), False, True),
        (outcome(NOTHING, [], verdict="none"), True, False),
        (outcome(NOTHING, [], verdict="unexplained"), False, False),
        (outcome(NOTHING, [], FRICTION), False, True),
    ],
)
def test_what_is_right_and_what_is_false(item: dict[str, Any], right: bool, false: bool) -> None:
    row = judged(item)
    assert (row["right"], row["false"]) == (right, false)


@pytest.mark.parametrize(("name", "false"), [("leak", True), ("valve_offset", False), ("friction", True)])
def test_an_effect_of_the_catalogue_needs_an_argument_of_the_true_one(name: str, false: bool) -> None:
    known = places.PLACES[name]
    item = outcome(SINGLE, [("crossover", 1)], Found(tuple(known.places), 1, tuple(known.arguments)))
    assert judged({**item, "found": [(name, 1)]})["false"] is false


@pytest.mark.parametrize(
    ("configured", "left", "carries", "worse"),
    [(20.0, 3.9, True, False), (20.0, 4.1, False, False), (20.0, 23.0, False, True), (1.0, 0.4, True, False)],
)
def test_what_carries_over(configured: float, left: float, carries: bool, worse: bool) -> None:
    row = judged(outcome(SINGLE, [ROPE], FRICTION, configured=configured, proposed=left))
    assert (row["seen"], row["carries"], row["worse"]) == (True, carries, worse)


def test_it_goes_on_where_it_was_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    asked: list[str] = []

    def judge(joint: carry.Joint, duration: float, jobs: int) -> dict[str, Any]:
        asked.append(joint.name)
        done = outcome(joint.kind, list(joint.effects), FRICTION)
        return {**done, "name": joint.name, "seed": joint.seed, "duration": duration, "code": "abc"}

    def run(*arguments: object) -> int:
        return carry.main([str(item) for item in ("--out", tmp_path, "--count", 4, "--pairs", 2, *arguments)])

    monkeypatch.setattr(carry, "judge", judge)
    assert run("--shard", "1/2") == 0 and len(asked) == 3
    assert "3 of 6 cases are finished" in capsys.readouterr().out
    assert run() == 0 and len(asked) == 6 and "all singles" in capsys.readouterr().out
    assert run("--seed", 2) == 2 and "other cases" in capsys.readouterr().err
    assert len(tables([outcome(SINGLE, [ROPE], FRICTION)])) == 3
