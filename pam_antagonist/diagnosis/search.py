"""The search: ask every hypothesis, take the best answer that is worth it, and ask again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import entry_points

from pam_antagonist.diagnosis import calibrations, thresholds
from pam_antagonist.diagnosis.calibrations import Calibration
from pam_antagonist.diagnosis.catalogue_effects import CatalogueEffect
from pam_antagonist.diagnosis.hypotheses import Hypothesis, Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import Model

EFFECTS: tuple[Hypothesis, ...] = (CatalogueEffect(),)
"""What is looked for where calibrations are known already."""
GROUP = "pam_antagonist.hypotheses"


def hypotheses() -> tuple[Hypothesis, ...]:
    """What is looked for in recordings as they were made; of equals the first one is taken."""
    return (*EFFECTS, Calibration(), *(point.load()() for point in entry_points(group=GROUP)))


def about(name: str) -> Hypothesis:
    """The hypothesis that speaks for an effect or a calibration."""
    return next(one for one in hypotheses() if one.knows(name))


def search(
    base: Model,
    work: Work,
    asked: Sequence[Hypothesis] = EFFECTS,
    first: Model | None = None,
    most: int = thresholds.MOST_EFFECTS,
) -> Ranking:
    """Add effects, and calibrations of the recordings, while one is worth taking.

    Args:
        base: the recalibrated model, or one with effects that stay in it.
        asked: hypotheses, in order.
        first: the model before an effect that the recordings already contain, which then counts as the first one;
            default: the base model.
        most: effects at most, with those that are in the model already.
    """
    # Recordings may have an effect in them already; a model may as well.
    begin = 2 if first is not None and not base.effects else 1
    now, finished = Ranking(base, base, start=first), False
    while (number := len(now.model.effects) + begin) <= most:
        found = {hypothesis: hypothesis.propose(now, number, work) for hypothesis in asked}
        worth = [(one, by) for by, each in found.items() for one in each if by.is_worth_taking(one)]
        best, by = max(worth, key=lambda pair: pair[0].standing, default=(None, None))
        now = _noted(now, found, best)
        if best is None or by is None:
            break
        # Of an effect, other effects that do as well stand in the ranking.
        others = [one for other, each in found.items() for one in each if not (by.is_effect and other is by)]
        finished, (without, model) = best.base is not None, by.take(now, best)
        now = replace(now, base=without, model=model, rivals={**now.rivals, best.effect: best.near(others)})
        work.progress(f"{best.effect} added")
    if finished or (now.model is base and first is None):
        return now
    base, model = calibrations.without_needless(now.base, now.model)
    known = {each: calibrations.converged(each) for each in (base, model)}
    return replace(now, base=known[base], model=known[model])


def _noted(now: Ranking, found: dict[Hypothesis, list[TriedCandidate]], best: TriedCandidate | None) -> Ranking:
    """A ranking with what a round has tried."""
    tried, weighed = now.tried, now.calibrations
    for hypothesis, each in found.items():
        if not hypothesis.is_effect:
            weighed += tuple(replace(one, taken=one is best) for one in each)
        elif each:
            # Where a calibration was taken, its round was without it.
            tried = (*(one for one in tried if one.round != each[0].round), *each)
    return replace(now, tried=tried, calibrations=weighed)
