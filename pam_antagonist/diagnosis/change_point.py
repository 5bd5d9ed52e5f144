"""The part of a recording in which a model leaves more than noise: when something begins, and when it ends.

A model is first fitted to a part of the recording that it can explain. The part that is above noise is then the most
likely one: noise before and after it, another variance of each channel within. What is outside of it is fitted once
more, which shows the part more clearly.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.stretches import clearest, fitted_to_all
from pam_antagonist.inference.experiment import Experiment, Point, Span
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.trial import Mask, Split

Floats = NDArray[np.float64]

_QUARTERS = (0, 3, 1, 2)
"""Quarters of a recording on which a model is tried that nothing has bent yet, in this order."""
_BUFFER = 1.0
"""[s] Next to the part above noise that is not fitted: one independent error."""
_LEAST_REST = 0.2
"""Share of a recording that is at its noise, at least: the base parameters are fitted to it."""
_ROUNDS = 4


class Change(NamedTuple):
    """A part of a recording in which a model leaves more than noise.

    Attributes:
        span: begin and end.
        point: the model, fitted to the rest.
    """

    span: Span
    point: Point


def is_noise(experiment: Experiment, residual: Floats) -> bool:
    """Whether no stretch of a residual (B, C) is above noise."""
    return clearest(experiment, residual) is None


def first_change(experiment: Experiment, fitted: Fitted) -> Change | None:
    """Where a recording is above noise; None where it need not be, or where no quarter of it is at its noise.

    Args:
        experiment: the recording.
        fitted: its model, whose base and effects are fitted again to parts of it.
    """
    residual = experiment.residual(fitted.point, whole=True)
    if is_noise(experiment, residual):
        return None
    if is_noise(experiment, fitted_to_all(experiment, fitted.point, fitted.free).residual):
        return None
    point = _undisturbed(experiment, fitted, residual)
    if point is None:
        return None
    trial, span, rest = experiment.trial, Span(), np.zeros(len(residual), dtype=bool)
    for _ in range(_ROUNDS):
        begin, end = above_noise(experiment.residual(point, whole=True), experiment.noise)
        found = Span(
            begin * trial.block_s if begin else -np.inf, end * trial.block_s if end < len(residual) else np.inf
        )
        if found == span or not found.edges:
            break
        span, block = found, np.arange(len(residual))
        buffer = round(_BUFFER / trial.block_s)
        rest = (block < begin - buffer) | (block >= end + buffer)
        if np.mean(rest) < _LEAST_REST:
            return None
        again = refit(_on(experiment, rest), point, fitted.free, rounds=_ROUNDS, renewals=2, blocks_per_error=1.0)
        point = again.point
    if not span.edges:
        return None
    # What a chamber lost comes back in seconds: next to the part, a little is left of what was in it.
    left = experiment.times_noise(experiment.residual(point, whole=True)[rest])
    return Change(span, point) if np.max(left) < thresholds.AT_NOISE else None


def above_noise(residual: Floats, noise: Floats) -> tuple[int, int]:
    """First block of the part of a residual that is most likely more than noise, and the first one behind it.

    Outside of it the residual is noise; within, its variance is each channel's own. Begin and end are each found with
    the other one held, in turn. An edge within the recording has to pay for having been looked for.

    Args:
        residual: (B, C).
        noise: standard deviation of each channel (C,).
    """
    squares = np.vstack([np.zeros(len(noise)), np.cumsum((residual / noise) ** 2, axis=0)])
    count = len(residual)

    def cost(begin: int | NDArray[np.int64], end: int | NDArray[np.int64]) -> Floats:
        inside, length = squares[end] - squares[begin], np.reshape(end - np.asarray(begin), (-1, 1))
        variances = np.maximum(inside / length, 1.0)
        within = length * np.log(variances) + inside / variances
        return np.asarray((squares[-1] - inside + within).sum(axis=1))

    price = thresholds.STRONG + 2.0 * float(np.log(count))
    begin, end = 0, count
    for _ in range(_ROUNDS):
        before = begin, end
        costs = cost(np.arange(end), end)
        begin = int(np.argmin(costs)) if costs.min() < costs[0] - price else 0
        costs = cost(begin, np.arange(begin + 1, count + 1))
        end = begin + 1 + int(np.argmin(costs)) if costs.min() < costs[-1] - price else count
        if before == (begin, end):
            break
    return begin, end


def _undisturbed(experiment: Experiment, fitted: Fitted, residual: Floats) -> Point | None:
    """A model that is at the noise of a part of a recording: of the fitted one, or of a quarter; else None."""
    parts = [np.arange(len(residual)) < experiment.errors_from // experiment.trial.block]
    if is_noise(experiment, residual[parts[0]]):
        return fitted.point
    quarter = np.arange(len(residual)) * 4 // len(residual)
    whole = _on(experiment, np.ones(len(residual), dtype=bool))
    base = whole.jacobian(fitted.point, residual)
    for number in _QUARTERS:
        part = quarter == number
        near = refit(
            _on(experiment, part), fitted.point, fitted.free, base[part], _ROUNDS, 0, blocks_per_error=1.0, careful=0
        )
        if is_noise(experiment, near.residual):
            return near.point
    return None


def _on(experiment: Experiment, part: Mask) -> Experiment:
    """The recording with a part of its blocks to be fitted."""
    whole = experiment.trial.whole_blocks(len(experiment.trial))
    return replace(experiment, fitted=whole, split=Split(part, ~part, whole), judged=())
