"""Likelihood of residuals of unknown size, and the linear problem behind score tests and refits.

The error of each channel is taken for Gaussian with an unknown variance that is at least the sensor's. Its
autocorrelation says how many independent values a series of residuals is worth; the evidence counts those, not samples.
How much of a residual is beyond the sensors' noise, and how much of that is gone with another model, is its excess.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.metrics import correlation_length

Floats = NDArray[np.float64]

ERROR_S = 1.0
"""[s] What a model lacks moves with the commands: a fit counts one independent error a second and channel."""
BLOCKS_PER_ERROR = 50.0
"""[blocks] The same in blocks of 20 ms."""
_QUIET = 1.5
"""The mean square of a stretch of noise alone, over its variance, is hardly ever more."""
_FULL = 20.0
"""[dB] A stretch is explained where the error falls to a tenth: no law has quite the form of what is there."""


@dataclass(frozen=True, eq=False)
class Scale:
    """How residuals are judged."""

    noise: Floats  # least standard deviation of each channel's block means (C,)
    length: Floats  # of an independent value of each channel (C,) [blocks]; 1 where a channel is at its noise
    blocks_per_error: float = BLOCKS_PER_ERROR
    fewest: float = BLOCKS_PER_ERROR

    @classmethod
    def of(
        cls,
        residual: Floats,
        noise: Floats,
        blocks_per_error: float = BLOCKS_PER_ERROR,
        fewest: float = BLOCKS_PER_ERROR,
    ) -> Scale:
        """With the correlation lengths of a residual.

        `residual`: (B, C). `noise`: least standard deviation of each channel's block means (C,).
        """
        quiet = np.mean(residual**2, axis=0) <= noise**2
        lengths = [1.0 if still else correlation_length(r) for still, r in zip(quiet, residual.T, strict=True)]
        return cls(noise, np.array(lengths), blocks_per_error, fewest)

    @property
    def counted(self) -> float:
        """Blocks per value that the evidence counts: the longest memory of any channel, for all of them.

        What is wrong in one channel and what a model of another form leaves in the next have one cause and one pace. A
        channel that counts more than the others because it is white now would forbid everything to such a model.
        """
        return float(max(self.length.max(), self.fewest))

    @property
    def share(self) -> float:
        """What a gain that a fit counts is worth as evidence."""
        return self.blocks_per_error / self.counted

    def variances(self, residual: Floats) -> Floats:
        """Error variance of each channel (C,): its mean square, at least the noise's."""
        return self.variances_of(np.mean(residual**2, axis=0))

    def variances_of(self, squares: Floats) -> Floats:
        """Error variance of each channel (C,) by its mean square (C,)."""
        return np.maximum(squares, self.noise**2)

    def misfits(self, residual: Floats) -> Floats:
        """−2 log likelihood of each channel (C,) with its variance at its best, as a fit counts, up to a constant."""
        if not len(residual):
            return np.zeros(residual.shape[1])
        return self.misfits_of(np.mean(residual**2, axis=0), len(residual))

    def misfits_of(self, squares: Floats, count: int) -> Floats:
        """:meth:`misfits` by the mean squares of the channels (C,). `squares`: these (C,)."""
        variances = self.variances_of(squares)
        return np.asarray(count / self.blocks_per_error * (np.log(variances / self.noise**2) + squares / variances))

    def values(self, residual: Floats) -> float:
        """Independent values in all channels."""
        return residual.size / self.counted


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of a linear problem."""

    theta: Floats  # change of the base coordinates (K + S,)
    effect: Floats  # change of the effects' coordinates (m,)
    squares: Floats  # mean squares of what the linear model leaves (C,)
    information: Floats
    keep: NDArray[np.intp]
    equations: LinearProblem

    @property
    def residual(self) -> Floats:
        """What the linear model leaves (B, C)."""
        of = self.equations
        return np.asarray(of.residual + of.base @ self.theta + of.effect @ self.effect)

    @property
    def covariance(self) -> Floats:
        """Of all coordinates, the base first (K + S + m, K + S + m)."""
        count = len(self.theta) + len(self.effect)
        covariance = np.zeros((count, count))
        covariance[np.ix_(self.keep, self.keep)] = _solved(self.information, np.eye(len(self.keep)))
        return covariance


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """A linear problem, and the sums over its blocks that any weights of the channels need."""

    residual: Floats  # measured minus simulated (B, C)
    base: Floats  # its derivatives by the base coordinates (B, C, K + S)
    effect: Floats  # its derivatives by the effects' coordinates (B, C, m)
    gram: Floats  # sums of products of all derivatives, the base first (C, K + S + m, K + S + m)
    slope: Floats  # sums of their products with the residual (C, K + S + m)
    squares: Floats  # sums of the residual's squares (C,)

    @classmethod
    def of(cls, residual: Floats, base: Floats, effect: Floats) -> LinearProblem:
        """The problem of a residual with its derivatives.

        Args:
            residual: measured minus simulated (B, C).
            base: its derivatives by the base coordinates (B, C, K + S).
            effect: its derivatives by the effects' coordinates (B, C, m).
        """
        channels, n, count = residual.shape[1], base.shape[2], base.shape[2] + effect.shape[2]
        gram, slope = np.empty((channels, count, count)), np.empty((channels, count))
        columns = np.empty((count, len(residual)))
        for c in range(channels):
            columns[:n], columns[n:] = base[:, c].T, effect[:, c].T
            gram[c], slope[c] = columns @ columns.T, columns @ residual[:, c]
        return cls(residual, base, effect, gram, slope, np.asarray(np.sum(residual**2, axis=0)))

    def among(self, effects: Sequence[int]) -> LinearProblem:
        """The problem with some of the effects' coordinates only."""
        n = self.base.shape[2]
        keep = np.array([*range(n), *(n + k for k in effects)], dtype=int)
        gram, slope = self.gram[:, keep[:, None], keep], self.slope[:, keep]
        return LinearProblem(self.residual, self.base, self.effect[:, :, list(effects)], gram, slope, self.squares)

    def solved(
        self,
        scale: Scale,
        prior: Floats,
        theta: Floats,
        rounds: int = 3,
        held: Collection[int] = (),
        first: Floats | None = None,
        length: Floats | None = None,
        damping: float = 0.0,
    ) -> Solution:
        """Most probable step, with the channels' variances estimated anew in every round.

        Args:
            prior: precision of each base coordinate (K + S,).
            theta: the base coordinates now (K + S,), which the prior pulls to 0.
            first: variances (C,) of the first round; default: those of the residual.
            length: of an independent value (C,) [blocks]; default: as fits count.
            damping: share by which the diagonal of the information grows (Marquardt 1963), for shorter steps.
        """
        counted = np.full(len(scale.noise), scale.blocks_per_error) if length is None else length
        n, count, blocks = self.base.shape[2], self.slope.shape[1], len(self.residual)
        keep = np.array([k for k in range(count) if k - n not in held])
        kept = np.ix_(keep, keep)
        step, squares = np.zeros(count), self.squares / blocks
        information = np.diag(np.concatenate([prior, np.zeros(count - n)]))
        for number in range(rounds):
            variances = first if first is not None and number == 0 else scale.variances_of(squares)
            weights = 1.0 / (variances * counted)
            information = np.tensordot(weights, self.gram, 1)
            information[np.arange(n), np.arange(n)] += prior
            right = weights @ self.slope
            right[:n] += prior * theta
            step = np.zeros(count)
            damped = information + damping * np.diag(np.diag(information)) if damping else information
            step[keep] = -_solved(damped[kept], right[keep])
            # What the step leaves, by the same sums: no block is looked at again.
            squares = np.maximum(self.squares + (2.0 * self.slope + self.gram @ step) @ step, 0.0) / blocks
        return Solution(step[:n], step[n:], squares, information[kept], keep, self)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solution with the coordinates scaled to a diagonal of 1, and those without influence left where they are."""
    dead = np.diag(matrix) <= 0.0
    diagonal = np.where(dead, 1.0, np.sqrt(np.where(dead, 1.0, np.diag(matrix))))
    scaled = matrix / np.outer(diagonal, diagonal) + (1e-10 + dead) * np.eye(len(matrix))
    across = diagonal if right.ndim == 1 else diagonal[:, None]
    return np.asarray(np.linalg.solve(scaled, right / across) / across)


def in_decibels(before: Floats, after: Floats, noise: Floats, stretch: int) -> tuple[float, float]:
    """What of the excess over noise is gone with another model, in decibels.

    Each second counts by itself, down to the noise or down to a tenth.

    A model that is wrong for a second has that second against it, however wrong it was. Where a joint sticks at another
    angle than the model's, squares would count nothing else.

    Args:
        before: residual of a model (B, C).
        after: of another one (B, C).
        noise: standard deviation of each channel's noise (C,).
        stretch: blocks of a second; in each of them a model is right or wrong once.
    """
    old, new = _levels(before, noise, stretch), _levels(after, noise, stretch)
    there = np.minimum(old, _FULL)
    return float(np.sum(np.clip(old - new, -_FULL, there))), float(np.sum(there))


def in_mean_squares(before: Floats, after: Floats, noise: Floats) -> tuple[float, float]:
    """The same by the mean square of each channel.

    Args:
        before: residual of a model (B, C).
        after: of another one (B, C).
        noise: standard deviation of each channel's noise (C,).
    """
    old, new = (_squares(residual, noise) for residual in (before, after))
    return float(np.sum(old - new)), float(np.sum(old))


def _levels(residual: Floats, noise: Floats, stretch: int) -> Floats:
    """How far each stretch of each channel is above its noise [dB] (S, C)."""
    if not len(residual):
        return np.zeros((0, residual.shape[1]))
    # A rest of less than half a stretch belongs to the last one.
    begin = np.arange(0, max(len(residual) - stretch // 2, 1), stretch)
    lengths = np.diff(np.append(begin, len(residual)))
    squares = np.add.reduceat((residual / noise) ** 2, begin, axis=0) / lengths[:, None]
    return np.asarray(10.0 * np.log10(np.maximum(squares / _QUIET, 1.0)))


def _squares(residual: Floats, noise: Floats) -> Floats:
    if not len(residual):
        return np.zeros(residual.shape[1])
    return np.asarray(np.maximum(np.mean((residual / noise) ** 2, axis=0) - 1.0, 0.0))
