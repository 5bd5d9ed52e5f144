"""Stretches of a recording in which a model without effects leaves more than noise.

The verdict `none` is about all data: of the fitted and the held-out part, of every channel, of every stretch of
seconds. The base parameters are therefore fitted to the whole recording before it is tested. So the result does not
depend on where the recording was split.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.point import Point

Floats = NDArray[np.float64]

_ROUNDS = 6
"""Rounds of a fit that starts near its end."""


@dataclass(frozen=True)
class Stretch:
    """A stretch of one channel that is above noise.

    Attributes:
        begin_s: [s].
        end_s: [s].
        times_noise: root mean square of the residual there, over its noise.
        evidence: against noise, with the price of all stretches that were looked at.
    """

    recording: str
    channel: str
    begin_s: float
    end_s: float
    times_noise: float
    evidence: float


def above_noise(experiments: Sequence[Experiment], points: Sequence[Point], jobs: int) -> tuple[Stretch, ...]:
    """The clearest stretch above noise of every recording that has one even with the base fitted to all of it.

    The stretch is taken from the model as it is: the base fitted to all data may hide what is wrong.
    """

    def one(experiment: Experiment, point: Point) -> Stretch | None:
        found = clearest(experiment, replace(experiment, judged=()).residual(point, whole=True))
        if found is None:
            return None
        fitted = fitted_to_all(experiment, point)
        return found if clearest(experiment, fitted.residual) is not None else None

    found = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(one)(*pair) for pair in zip(experiments, points, strict=True)
    )
    return tuple(stretch for stretch in found if stretch is not None)


def fitted_to_all(experiment: Experiment, point: Point, free: Sequence[FreeEffectParameter] = ()) -> Fitted:
    """A model fitted to all of a recording, held out or not, as a model that is right: every block counts."""
    alone = replace(experiment, fitted=experiment.trial.whole_blocks(len(experiment.trial)), split=None, judged=())
    return refit(alone, point, free, rounds=_ROUNDS, renewals=2, blocks_per_error=1.0, careful=2)


def clearest(experiment: Experiment, residual: Floats) -> Stretch | None:
    """The stretch with the strongest evidence against noise; None where there is none with strong evidence.

    Twice the log likelihood ratio of a stretch with n independent values of noise is n (m − 1 − log m). m is its mean
    square over that of the noise, the latter taken as large as it may be. Begin, length and channel are chosen, so
    twice the logarithm of the number of choices is the price (Bonferroni).

    Args:
        residual: of all of it (B, C).
    """
    seconds = 1.0 / experiment.trial.block_s
    lengths = [round(length * seconds) for length in thresholds.STRETCHES if round(length * seconds) < len(residual)]
    lengths.append(len(residual))
    squares = np.vstack([np.zeros(residual.shape[1]), np.cumsum((residual / experiment.noise) ** 2, axis=0)])
    best: tuple[float, int, int, int, float] = (0.0, 0, 0, 0, 0.0)
    looks = 0
    for length in lengths:
        begin = np.unique(np.append(np.arange(0, len(residual) - length, max(length // 2, 1)), len(residual) - length))
        mean = (squares[begin + length] - squares[begin]) / length
        ratio = np.maximum(mean / thresholds.AT_NOISE**2, 1.0)
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
        experiment.trial.name,
        experiment.titles[channel].title,
        begin_block / seconds,
        (begin_block + length) / seconds,
        float(np.sqrt(mean_square)),
        evidence,
    )
