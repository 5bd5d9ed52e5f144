"""When an effect is taken, when effects are the explanation, and what the user is told beside the verdict."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pam_antagonist import diagnose
from pam_antagonist.api.diagnose import DiagnoseResult
from pam_antagonist.diagnosis import judgement, models, verdicts, warnings
from pam_antagonist.diagnosis.ambiguity import distinguishing_experiments
from pam_antagonist.diagnosis.hypotheses import Kept, Ranking, ResumeFolder, TriedCandidate
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.estimation.metrics import ChannelErrors
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.unknown import of_effect
from pam_antagonist.model.effects import CATALOGUE

NO_MODEL = Model()


def tried(number: int, bic: float, held: float, held_out: float = 20.0, share: float | None = None) -> TriedCandidate:
    share = held if share is None else share
    return TriedCandidate("leak", number, bic, bic, held_out, (held, held), NO_MODEL, None, share)


def leader(candidates: list[TriedCandidate]) -> TriedCandidate | None:
    return Ranking(NO_MODEL, NO_MODEL, tuple(candidates)).leader


@pytest.mark.parametrize(
    ("candidate", "worth"),
    [
        # Evidence without a gain on held-out data is not enough.
        (tried(1, 50.0, 0.8), True), (tried(1, 50.0, 0.04), False), (tried(1, 50.0, 0.8, held_out=1.0), False),
        (tried(1, 1.0, 0.8), False), (TriedCandidate("leak", 1, 50.0), False),
        # What hardly pays where it was fitted needs more held-out evidence.
        (tried(1, 4.0, 0.8, held_out=8.0), True), (tried(1, 4.0, 0.8, held_out=7.0), False),
        (tried(1, 9.0, 0.8, held_out=4.0), False),
        # A second effect may be small beside the first, but must be certain.
        (tried(2, 9.0, 0.25), True), (tried(2, 9.0, 0.25, held_out=-4.0), False), (tried(2, 1.0, 0.9), False),
        (tried(2, 9.0, 0.1), False),
        # What has little held-out evidence must be the more certain.
        (tried(1, 30.0, 0.4, held_out=4.0), True), (tried(1, 19.0, 0.4, held_out=4.0), False),
        (tried(1, 90.0, 0.4, held_out=1.0), False),
        # A further effect is judged by both parts together.
        (tried(2, 24.0, -0.1, held_out=10.0, share=0.3), True), (tried(2, 24.0, 0.3, held_out=10.0, share=0.1), False),
        (tried(1, 24.0, -0.1, held_out=10.0, share=0.3), False),
    ],
)  # fmt: skip
def test_what_is_taken_is_certain_and_removes_enough(candidate: TriedCandidate, worth: bool) -> None:
    assert candidate.is_worth_taking is worth


@pytest.mark.parametrize(
    ("share", "quiet", "explains", "in_part"),
    [
        (0.9, False, True, False), (0.5, False, True, True), (0.3, False, False, True), (-0.5, False, False, True),
        (0.3, True, True, False),
    ],
)  # fmt: skip
def test_effects_are_the_explanation_of_what_they_take_away(monkeypatch, share, quiet, explains, in_part) -> None:
    monkeypatch.setattr(models, "share_of_all", lambda base, model: share)
    monkeypatch.setattr(Model, "is_at_noise", quiet)
    assert models.explains(NO_MODEL, Model(effects=("friction",))) is explains
    assert models.explains_in_part(NO_MODEL, Model(effects=("friction",))) is in_part
    assert not models.explains(NO_MODEL, NO_MODEL)


def test_one_effect_that_leaves_much_leads_where_all_others_are_far_behind() -> None:
    best = tried(1, 40.0, 0.3, held_out=30.0)
    assert leader([tried(1, 20.0, 0.1, held_out=10.0), best, tried(2, 99.0, 0.9)]) is best
    assert leader([best, tried(1, 30.0, 0.1, held_out=10.0)]) is None
    assert leader([tried(1, 40.0, 0.1, held_out=30.0)]) is None
    assert leader([tried(1, 60.0, 0.3, held_out=4.0)]) is None
    assert leader([tried(1, 10.0, 0.3, held_out=8.0)]) is None
    assert leader([]) is None


def test_an_experiment_that_tells_is_named() -> None:
    said = distinguishing_experiments(("leak",), ("valve_offset",), {"free"})
    assert "close the valves" in said["valve_offset"]
    assert "locked" in said["valve_offset"]


RECORDED: Any = SimpleNamespace(trial=SimpleNamespace(name="free"))


def ended(values: dict[str, float], effect: str) -> Model:
    """A recording's model whose fit ended at some values of an effect."""
    items = {item.name: item for item in CATALOGUE[effect].parameters}
    free = tuple(of_effect((f"effects.{effect}.{name}",), items[name]) for name in values)
    point = Point(np.zeros(0), {f"effects.{effect}.{name}": value for name, value in values.items()})
    fitted: Any = SimpleNamespace(point=point, free=free)
    return Model((RECORDED,), (fitted,), (effect,))


def test_a_number_that_ends_at_its_bound_is_named() -> None:
    items = {item.name: item for item in CATALOGUE["creep"].parameters}
    values = {"time": items["time"].high, "share_1": items["share_1"].low, "share_2": 0.0, "stiffness": 700.0}
    size, time = sorted(warnings.at_bounds(ended(values, "creep")))
    assert size.startswith("creep.share_1 ends at its bound") and "in free" in size
    assert time.startswith(f"creep.time ends at its bound, {values['time']:g} s") and "how much further" in time


def test_a_small_leak_is_not_at_its_bound() -> None:
    assert warnings.at_bounds(ended({"area_1": 1e-9}, "leak")) == []


def estimated(angle: float | None, torque: float) -> SimpleNamespace:
    return SimpleNamespace(
        angle=None if angle is None else ChannelErrors("deg", angle, angle, 0.1, None),
        torque=ChannelErrors("nm", torque, torque, 0.1, None),
    )


def recording(name: str, before: SimpleNamespace, after: SimpleNamespace) -> Any:
    """The entry of a recording with the estimator's errors as configured and extended."""
    return SimpleNamespace(recording=name, ukf=SimpleNamespace(as_configured=before, extended=after))


def test_an_estimator_that_got_worse_is_told_with_its_numbers() -> None:
    worse = recording("free", estimated(0.07, 0.01), estimated(0.41, 0.011))
    (said,) = warnings.estimator_worse([worse])
    assert "0.41°" in said and "0.07°" in said and "free" in said
    locked = recording("held", estimated(None, 0.02), estimated(None, 0.05))
    assert "torque 0.05 N m" in warnings.estimator_worse([locked])[0]
    better = recording("free", estimated(0.4, 0.03), estimated(0.01, 0.01))
    fitted: Any = SimpleNamespace(recording="fitted", ukf=None)
    assert warnings.estimator_worse([better, fitted]) == []


def test_a_finished_candidate_is_found_again(tmp_path: Path) -> None:
    checkpoint = ResumeFolder(tmp_path / "kept")
    point = Point(np.array([0.1, -0.2]), {"effects.leak.area_1": 1e-9})
    checkpoint.save("a", Kept(point, 50.0, 12.5))
    found = checkpoint.load("a")
    assert found is not None
    assert found.point.theta.tolist() == [0.1, -0.2]
    assert found.point.effects == point.effects
    assert (found.blocks_per_error, found.gain) == (50.0, 12.5)
    assert checkpoint.load("b") is None


@pytest.mark.parametrize("text", ["", "{", "{}", "[1]", '{"theta": [1], "effects": {}, "blocks_per_error": 1}'])
def test_a_damaged_file_is_worked_out_anew(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.json").write_text(text)
    assert ResumeFolder(tmp_path).load("a") is None


def test_nothing_is_kept_without_a_folder() -> None:
    ResumeFolder().save("a", Kept(Point(np.zeros(1)), 1.0, 0.0))
    assert ResumeFolder().load("a") is None


@pytest.mark.slow(10)
def test_a_verdict_of_ones_own_is_a_line_and_the_rule_that_gives_it(recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    """`verdicts.py` has the line, the table of rules in `judgement.py` the rule; page and report.json follow."""
    own = judgement.Rule(None, lambda case: case.judged("doubtful", None), "two people saw it otherwise")
    monkeypatch.setattr(judgement, "RULES", (own, *judgement.RULES))
    monkeypatch.setitem(verdicts.TITLES, "doubtful", "Nobody knows")
    found = diagnose(recorded(seconds=20.0), "shin2022", profiles=False, estimator=False)
    assert isinstance(found, DiagnoseResult)
    assert found.verdict == "doubtful" and found.to_json()["verdict"] == "doubtful"
    assert verdicts.overall(["none", "doubtful"]) == "none"
    assert found.document(figures=False).title == "Nobody knows"
