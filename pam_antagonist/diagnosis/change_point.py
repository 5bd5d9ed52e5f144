"""Where a recording is above noise: stretches of a channel, and the part in which something begins and ends.

To find a part, a model is fitted to pieces of the recording. The one that explains most of the rest as well is at the
noise where nothing has begun. The part above noise is then found by its likelihood: noise before and after it, another
variance of each channel within. The model is fitted again to what is outside of it, which shows the part more clearly.
There are several such parts if several things begin and end.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.models import in_threads
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, effect_jacobian, refit
from pam_antagonist.inference.likelihood import LinearProblem
from pam_antagonist.inference.point import Point, Span
from pam_antagonist.inference.trial import Mask, Split
from pam_antagonist.inference.unknown import Unknown

Floats = NDArray[np.float64]

_PARTS = (4, 8)
"""An undisturbed model is searched for in quarters of a recording, and in eighths."""
_LEAST_PART = 5.0
"""[s] Shortest part that is fitted by itself: a few independent errors."""
_WINDOW = 1.0
"""[s] Window in which a model is at its noise or not: one independent error."""
_GROWTHS = 12
_MOST_PARTS = 3
"""Most parts above noise. If there are more, the model is wrong in another way."""
_BUFFER = 1.0
"""[s] Time next to the part above noise that is not fitted: one independent error."""
_LEAST_REST = 0.2
"""Least share of a recording at its noise: the base parameters are fitted to it."""
_ROUNDS = 4
_LAST_ROUNDS = 6
"""Rounds of a fit that starts near its end."""


@dataclass(frozen=True)
class Stretch:
    """A stretch of one channel that is above noise."""

    recording: str
    channel: str
    begin_s: float  # [s]
    end_s: float  # [s]
    times_noise: float  # root mean square of the residual there, over its noise
    evidence: float  # against noise, with the price of all stretches that were looked at


def stretches_above_noise(pairs: Iterable[tuple[Experiment, Point]], jobs: int) -> tuple[Stretch, ...]:
    """The clearest stretch above noise of every recording that has one even with the base fitted to all of it.

    The verdict `none` is about all data, so the base parameters are fitted to the whole recording before it is tested.
    The stretch is taken from the model as it is: the base fitted to all data may hide what is wrong. The second after
    the joint hit its stop does not count: small errors of its speed grow as it bounces.
    """

    def one(experiment: Experiment, point: Point) -> Stretch | None:
        counts = ~_bounces(experiment, point)

        def above(model: Point) -> Stretch | None:
            left = replace(experiment, judged=()).residual(model, whole=True)
            return clearest(experiment, counts[:, None] * left)

        found = above(point)
        return found if found is not None and above(_as_right(_on(experiment, counts), point).point) else None

    return tuple(stretch for stretch in in_threads(one, pairs, jobs) if stretch is not None)


def _bounces(experiment: Experiment, point: Point) -> Mask:
    """Blocks (B,) in the second after a model hit its stop."""
    trial, stop = experiment.trial, experiment.rig.joint.stop
    blocks = np.zeros(trial.whole_blocks(len(trial)) // trial.block, dtype=bool)
    if stop is None:
        return blocks
    angle, velocity = experiment.states(point)[0][:, :2].T
    leans = np.abs(angle) + np.abs(velocity) * trial.dt >= stop  # it may be there between two rows
    for hit in np.flatnonzero(np.diff(leans, prepend=False) & leans) // trial.block:
        blocks[hit : hit + round(_WINDOW / trial.block_s)] = True
    return blocks


def fitted_to_all(experiment: Experiment, point: Point, free: Sequence[Unknown] = ()) -> Fitted:
    """A model fitted to all of a recording, held out or not, as a model that is right."""
    alone = replace(experiment, fitted=experiment.trial.whole_blocks(len(experiment.trial)), split=None, judged=())
    return _as_right(alone, point, free)


def _as_right(experiment: Experiment, point: Point, free: Sequence[Unknown] = ()) -> Fitted:
    """A model fitted as one that is right: every block counts."""
    return refit(experiment, point, free, rounds=_LAST_ROUNDS, renewals=2, blocks_per_error=1.0, careful=2)


def clearest(experiment: Experiment, residual: Floats) -> Stretch | None:
    """The stretch with the strongest evidence against noise; None where there is none with strong evidence.

    Twice the log likelihood ratio of a stretch with n independent values of noise is n (m − 1 − log m). m is its mean
    square over that of the noise, the latter taken as large as it may be, also where the joint rests. Begin, length and
    channel are chosen, so twice the logarithm of the number of choices is the price (Bonferroni).

    `residual`: of all of it (B, C).
    """
    seconds = 1.0 / experiment.trial.block_s
    lengths = [round(length * seconds) for length in thresholds.STRETCHES if round(length * seconds) < len(residual)]
    lengths.append(len(residual))
    squares = np.vstack([np.zeros(residual.shape[1]), np.cumsum((residual / experiment.tolerated) ** 2, axis=0)])
    best: tuple[float, int, int, int, float] = (0.0, 0, 0, 0, 0.0)
    looks = 0
    for length in lengths:
        begin = np.unique(np.append(np.arange(0, len(residual) - length, max(length // 2, 1)), len(residual) - length))
        mean = (squares[begin + length] - squares[begin]) / length
        ratio = _above_largest(experiment, mean, experiment.tolerated)
        gain = length / experiment.noise_memory * (ratio - 1.0 - np.log(ratio))
        looks += gain.size
        row, channel = divmod(int(np.argmax(gain)), gain.shape[1])
        if gain[row, channel] > best[0]:
            best = float(gain[row, channel]), int(begin[row]), length, int(channel), float(mean[row, channel])
    most, begin_block, length, channel, mean_square = best
    evidence = most - 2.0 * float(np.log(looks))
    if evidence < thresholds.STRONG:
        return None
    return Stretch(
        experiment.trial.name, experiment.titles[channel].title, begin_block / seconds,
        (begin_block + length) / seconds, float(np.sqrt(mean_square)), evidence,
    )  # fmt: skip


def _above_largest(experiment: Experiment, mean: Floats, unit: Floats) -> Floats:
    """Mean squares of stretches (S, C), in squares of `unit` (C,), over the largest of noise alone; at least 1."""
    largest = thresholds.AT_NOISE * np.maximum(experiment.noise_at_rest / unit, 1.0)
    return np.asarray(np.maximum(mean / largest**2, 1.0))


class Excursion(NamedTuple):
    """A part of a recording in which a model leaves more than noise."""

    span: Span
    point: Point


def is_noise(experiment: Experiment, residual: Floats) -> bool:
    """Whether no stretch of a residual (B, C) is above noise."""
    return clearest(experiment, residual) is None


def first_change(experiment: Experiment, fitted: Fitted) -> Excursion | None:
    """Where a recording is above noise; None if a fit to all data leaves only noise, or if no part is at its noise.

    `fitted`: its model, whose base and effects are fitted again to parts of it.
    """
    residual = experiment.residual(fitted.point, whole=True)
    if is_noise(experiment, residual):
        return None
    if is_noise(experiment, fitted_to_all(experiment, fitted.point, fitted.free).residual):
        return None
    quiet = _undisturbed(experiment, fitted, residual)
    if quiet is None:
        return None
    point = quiet[0]
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
    return Excursion(span, point) if np.max(left) < thresholds.AT_NOISE else None


def above_noise(residual: Floats, noise: Floats) -> tuple[int, int]:
    """First block of the most likely part of a residual above noise, and the first one behind it.

    Outside of it the residual is noise; within, its variance is each channel's own. Begin and end are found in turn,
    each with the other one held. An edge within the recording has a price for the search.

    `residual`: (B, C). `noise`: standard deviation of each channel (C,).
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


def parts_above_noise(experiment: Experiment, fitted: Fitted) -> tuple[Span, ...]:
    """All parts of a recording in which a model leaves more than noise, to a second or so.

    Returns begin and end of each [s]; none if the model is nowhere at the noise, or if there are too many parts to be
    """
    quiet = _undisturbed(experiment, fitted, experiment.residual(fitted.point, whole=True))
    if quiet is None:
        return ()
    # Between two parts something has to be fitted.
    not_fitted, count = ~_rest(experiment, quiet[1]), len(quiet[1])
    block_s, buffer = experiment.trial.block_s, round(_BUFFER / experiment.trial.block_s)
    spans = [
        Span((begin + buffer) * block_s if begin else -np.inf, (end - buffer) * block_s if end < count else np.inf)
        for begin, end in np.flatnonzero(np.diff(not_fitted, prepend=False, append=False)).reshape(-1, 2).tolist()
    ]
    return tuple(spans) if len(spans) <= _MOST_PARTS else ()


def _undisturbed(experiment: Experiment, fitted: Fitted, residual: Floats) -> tuple[Point, Mask] | None:
    """A model at the noise of a part of a recording, and the blocks (B,) where it is not; None where there is none.

    The search begins with a short part. Blocks that its model leaves at the noise elsewhere are added, so the part
    grows. Of several first parts the one that grows most is used: a disturbed part explains nothing else.

    `residual`: of that model in all of the recording (B, C).
    """
    count = len(residual)
    whole = _on(experiment, np.ones(count, dtype=bool))
    base = whole.jacobian(fitted.point, residual)
    effect = effect_jacobian(whole, fitted.point, residual, fitted.free)
    scale = experiment.scale(blocks_per_error=1.0)

    def grown(rest: Mask) -> Mask:
        above = ~rest
        for _ in range(_GROWTHS):
            linear = residual[rest], base[rest], effect[rest]
            step = LinearProblem.of(*linear).solved(
                scale, experiment.prior, fitted.point.theta, rounds=1, first=experiment.noise**2
            )
            before, above = above, _above(experiment, residual + base @ step.theta + effect @ step.effect)
            rest = _rest(experiment, above)
            if np.array_equal(before, above) or not rest.any():
                break
        return rest

    rest = max((grown(part) for part in _first_parts(experiment, count)), key=np.mean)
    point, above = fitted.point, ~rest
    for _ in range(_ROUNDS):
        if np.mean(rest) < _LEAST_REST:
            return None
        again = refit(
            _on(experiment, rest), point, fitted.free, base[rest], rounds=_ROUNDS, renewals=1, blocks_per_error=1.0
        )
        point, left = again.point, experiment.residual(again.point, whole=True)
        before, above = above, _above(experiment, left)
        if np.array_equal(before, above):
            break
        rest = _rest(experiment, above)
    at_noise = np.max(experiment.times_noise(left[rest]), initial=0.0) < thresholds.AT_NOISE
    return (point, above) if at_noise and np.mean(rest) >= _LEAST_REST else None


def _first_parts(experiment: Experiment, count: int) -> list[Mask]:
    """Parts of a recording of so many blocks on which a model is tried: what is fitted, quarters, eighths."""
    block, seconds = np.arange(count), count * experiment.trial.block_s
    parts = [block < experiment.errors_from // experiment.trial.block]
    for many in _PARTS:
        if seconds / many >= _LEAST_PART:
            parts += [block * many // count == k for k in range(many)]
    return parts


def _rest(experiment: Experiment, above: Mask) -> Mask:
    """Blocks (B,) that are not above noise, nor next to what is."""
    buffer = round(_BUFFER / experiment.trial.block_s)
    near = np.convolve(above, np.ones(2 * buffer + 1), mode="full")[buffer : buffer + len(above)]
    return np.asarray(near < 0.5)


def _above(experiment: Experiment, residual: Floats) -> Mask:
    """Which blocks (B,) of a residual (B, C) lie in a window with strong evidence against noise."""
    window = max(round(_WINDOW / experiment.trial.block_s), 1)
    begin = np.arange(0, max(len(residual) - window // 2, 1), window)
    lengths = np.diff(np.append(begin, len(residual)))
    mean = np.add.reduceat((residual / experiment.noise) ** 2, begin, axis=0) / lengths[:, None]
    ratio = _above_largest(experiment, mean, experiment.noise)
    gain = lengths[:, None] / experiment.noise_memory * (ratio - 1.0 - np.log(ratio))
    return np.asarray(np.repeat(np.max(gain, axis=1) >= thresholds.STRONG + 2.0 * np.log(gain.size), lengths))


def _on(experiment: Experiment, part: Mask) -> Experiment:
    """The recording with a part of its blocks to be fitted."""
    whole = experiment.trial.whole_blocks(len(experiment.trial))
    return replace(experiment, fitted=whole, split=Split(part, ~part, whole), judged=())
