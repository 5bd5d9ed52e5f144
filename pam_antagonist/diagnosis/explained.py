"""How much of the excess over noise a model explains, and the decisions that rest on it.

The *excess* of a residual is what is above the sensors' noise; each experiment says how it is measured
(:meth:`~pam_antagonist.inference.experiment.Experiment.excess_removed`). The *share* of it that another model removes
is negative where the excess has grown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.candidates import Model, TriedCandidate, evidence, held_out_evidence, price
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, held_residual

Floats = NDArray[np.float64]


class Residuals(NamedTuple):
    """What a model leaves of a recording.

    Attributes:
        held: residual of the held-out part (B, C).
        fitted: of the fitted part (B, C).
    """

    held: Floats
    fitted: Floats


def remaining_residuals(experiments: Sequence[Experiment], fits: Sequence[Fitted]) -> list[Residuals]:
    """What the models of all recordings leave."""
    return [Residuals(held_residual(e, f), f.residual) for e, f in zip(experiments, fits, strict=True)]


def held_share(experiments: Sequence[Experiment], before: Sequence[Residuals], after: Sequence[Residuals]) -> float:
    """Share of the held-out excess that is gone."""
    return further_share(experiments, before, before, after, fitted=False)


def fitted_share(experiments: Sequence[Experiment], before: Sequence[Residuals], after: Sequence[Residuals]) -> float:
    """Share of the fitted part's excess that is gone."""
    return share_of([e.excess_removed(b.fitted, a.fitted) for e, b, a in zip(experiments, before, after, strict=True)])


def whole_share(experiments: Sequence[Experiment], before: Sequence[Residuals], after: Sequence[Residuals]) -> float:
    """Share of the excess of both parts together that is gone."""
    return further_share(experiments, before, before, after)


def further_share(
    experiments: Sequence[Experiment],
    base: Sequence[Residuals],
    before: Sequence[Residuals],
    after: Sequence[Residuals],
    fitted: bool = True,
) -> float:
    """Share of the base model's excess that goes with one effect among others.

    Args:
        fitted: whether the fitted parts count as well as the held-out ones.
    """
    parts = []
    for experiment, first, old, new in zip(experiments, base, before, after, strict=True):
        for b, w, a in list(zip(first, old, new, strict=True))[: 2 if fitted else 1]:
            parts.append((experiment.excess_removed(w, a)[0], experiment.excess_removed(b, b)[1]))
    return share_of(parts)


def share_of(parts: Sequence[tuple[float, float]]) -> float:
    """Share of the excess that is gone, from the removed and the original excess of each part."""
    gone, there = np.sum(parts, axis=0)
    return float(gone) / float(there) if there > 0.0 else 0.0


def with_fits(
    candidate: TriedCandidate,
    experiments: Sequence[Experiment],
    first: Sequence[Residuals],
    before: Sequence[Residuals],
    model: Model,
    effects: tuple[str, ...],
    fits: Sequence[Fitted | None],
) -> TriedCandidate:
    """A candidate with the results of its fits. A recording without positive evidence for it keeps its model.

    Args:
        fits: of that model, None for a recording in which the candidate was not fitted.
    """
    chosen, total, held_out = [], 0.0, 0.0
    for (experiment, old), new in zip(zip(experiments, model.fits, strict=True), fits, strict=True):
        gain = evidence(experiment, old, new) if new is not None else 0.0
        gains = new is not None and gain > 0.0
        chosen.append(new if new is not None and gains else old)
        total += max(gain, 0.0)
        held_out += held_out_evidence(experiment, old, new) if new is not None and gains else 0.0
    extended = Model(effects, tuple(chosen))
    after = remaining_residuals(experiments, extended.fits)
    held = held_share(experiments, before, after)
    return replace(
        candidate,
        delta_bic=total,
        held_out_evidence=held_out,
        shares=(held, fitted_share(experiments, before, after)),
        model=extended,
        share=further_share(experiments, first, before, after),
    )


def is_worth_taking(tried: TriedCandidate) -> bool:
    """Whether a fitted candidate goes into the model.

    Its evidence is positive in the fitted part and in the held-out part, and strong enough in both together. It removes
    enough of the excess.
    """
    if tried.delta_bic is None or tried.held_out_evidence is None or tried.shares is None or tried.model is None:
        return False
    if min(tried.delta_bic, tried.held_out_evidence) < thresholds.POSITIVE:
        return False
    strong = tried.held_out_evidence >= thresholds.STRONG
    enough = thresholds.TAKEN if strong else thresholds.TAKEN_WITHOUT_STRONG_HELD_OUT
    if tried.round == 1:
        removes = tried.shares[0] >= thresholds.FIRST_SHARE
    else:
        removes = (tried.share or 0.0) >= thresholds.FURTHER_SHARE
    return tried.standing >= enough and removes


def ends_at_noise(experiments: Sequence[Experiment], tried: TriedCandidate) -> bool:
    """Whether a fitted candidate has enough evidence, and with it the model is at the sensors' noise.

    Such a candidate may remove little of the excess, since the model has left little.
    """
    if tried.delta_bic is None or tried.held_out_evidence is None or tried.model is None:
        return False
    certain = min(tried.delta_bic, tried.held_out_evidence) >= thresholds.POSITIVE
    return certain and tried.standing >= thresholds.TAKEN and at_noise(experiments, tried.model)


def near(best: TriedCandidate, others: Sequence[TriedCandidate]) -> tuple[str, ...]:
    """Candidates that do as well as the best one, by evidence and on held-out data."""
    return tuple(
        other.effect for other in others if other is not best and other.shares is not None
        and best.standing - other.standing < thresholds.STRONG and other.shares[0] >= thresholds.FIRST_SHARE
    )  # fmt: skip


def evidence_of(experiments: Sequence[Experiment], without: Model, model: Model) -> float:
    """Evidence for a model against one without some of its effects, over all recordings."""
    return sum(
        evidence(experiment, old, new)
        for experiment, old, new in zip(experiments, without.fits, model.fits, strict=True)
        if new is not old
    )


def has_significant_excess(experiments: Sequence[Experiment], fits: Sequence[Fitted]) -> bool:
    """Whether an effect that explained all of the excess would pay for its parameters."""
    total = 0.0
    for experiment, fitted in zip(experiments, fits, strict=True):
        times_noise = experiment.times_noise(fitted.residual)
        if np.max(times_noise) < thresholds.AT_NOISE:
            continue
        gain = len(fitted.residual) / fitted.scale.counted * np.sum(np.maximum(np.log(times_noise**2), 0.0))
        total += max(float(gain) - price(fitted, thresholds.LEAST_PARAMETERS), 0.0)
    return total >= thresholds.STRONG


def explains(experiments: Sequence[Experiment], base: Model, model: Model) -> bool:
    """Whether a model with effects leaves so little of the excess that they are the explanation."""
    if not model.effects:
        return False
    enough = share_of_all(experiments, base, model) >= thresholds.EXPLAINED
    return enough or at_noise(experiments, model)


def leader(tried: Sequence[TriedCandidate]) -> TriedCandidate | None:
    """The effect of the first round that leads all others clearly, even if it leaves most of the excess; else None.

    Physics outside of the catalogue is imitated by several effects about equally well. An effect whose form differs
    from its law has no such rival.
    """
    first = [candidate for candidate in tried if candidate.round == 1]
    best = max(first, key=lambda candidate: candidate.standing, default=None)
    if best is None or best.shares is None or best.delta_bic is None or best.held_out_evidence is None:
        return None
    second = max((candidate.standing for candidate in first if candidate is not best), default=0.0)
    certain = min(best.delta_bic, best.held_out_evidence) >= thresholds.STRONG
    enough = best.standing >= max(thresholds.TAKEN_WITHOUT_STRONG_HELD_OUT, thresholds.LEADS * second)
    return best if certain and enough and min(best.shares) >= thresholds.EXPLAINED_BY_LEADER else None


def explains_in_part(experiments: Sequence[Experiment], base: Model, model: Model) -> bool:
    """Whether effects that are the explanation leave something that is worth a warning."""
    partly = share_of_all(experiments, base, model) < thresholds.EXPLAINED_WELL
    return partly and not at_noise(experiments, model)


def share_of_all(experiments: Sequence[Experiment], base: Model, model: Model) -> float:
    """Share of the excess, fitted and held out together, that a model removes."""
    return whole_share(experiments, *(remaining_residuals(experiments, m.fits) for m in (base, model)))


def at_noise(experiments: Sequence[Experiment], model: Model) -> bool:
    """Whether every residual is at the sensors' noise."""
    return all(
        float(np.max(experiment.times_noise(fitted.residual))) < thresholds.AT_NOISE
        for experiment, fitted in zip(experiments, model.fits, strict=True)
    )
