"""When an effect is taken, and when effects are the explanation."""

from __future__ import annotations

import pytest

from pam_antagonist.diagnosis import models
from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate
from pam_antagonist.diagnosis.models import Model

NO_MODEL = Model()


def tried(number: int, bic: float, held: float, held_out: float = 20.0, share: float | None = None) -> TriedCandidate:
    share = held if share is None else share
    return TriedCandidate("leak", number, bic, bic, held_out, (held, held), NO_MODEL, None, share)


def leader(candidates: list[TriedCandidate]) -> TriedCandidate | None:
    return Ranking(NO_MODEL, NO_MODEL, tuple(candidates)).leader


def test_evidence_without_held_out_gain_is_not_enough() -> None:
    assert tried(1, 50.0, 0.8).is_worth_taking
    assert not tried(1, 50.0, 0.04).is_worth_taking
    assert not tried(1, 50.0, 0.8, held_out=1.0).is_worth_taking
    assert not tried(1, 1.0, 0.8).is_worth_taking
    assert not TriedCandidate("leak", 1, 50.0).is_worth_taking


def test_what_hardly_pays_where_it_was_fitted_needs_more_held_out_evidence() -> None:
    assert tried(1, 4.0, 0.8, held_out=8.0).is_worth_taking
    assert not tried(1, 4.0, 0.8, held_out=7.0).is_worth_taking
    assert not tried(1, 9.0, 0.8, held_out=4.0).is_worth_taking


def test_a_second_effect_may_be_small_beside_the_first_but_must_be_certain() -> None:
    assert tried(2, 9.0, 0.25).is_worth_taking
    assert not tried(2, 9.0, 0.25, held_out=-4.0).is_worth_taking
    assert not tried(2, 1.0, 0.9).is_worth_taking
    assert not tried(2, 9.0, 0.1).is_worth_taking


def test_what_has_little_held_out_evidence_must_be_the_more_certain() -> None:
    assert tried(1, 30.0, 0.4, held_out=4.0).is_worth_taking
    assert not tried(1, 19.0, 0.4, held_out=4.0).is_worth_taking
    assert not tried(1, 90.0, 0.4, held_out=1.0).is_worth_taking


def test_a_further_effect_is_judged_by_both_parts_together() -> None:
    assert tried(2, 24.0, -0.1, held_out=10.0, share=0.3).is_worth_taking
    assert not tried(2, 24.0, 0.3, held_out=10.0, share=0.1).is_worth_taking
    assert not tried(1, 24.0, -0.1, held_out=10.0, share=0.3).is_worth_taking


@pytest.mark.parametrize(
    ("share", "quiet", "explains", "in_part"),
    [
        (0.9, False, True, False),
        (0.5, False, True, True),
        (0.3, False, False, True),
        (-0.5, False, False, True),
        (0.3, True, True, False),
    ],
)
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
