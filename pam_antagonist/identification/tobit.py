"""Regression on values, some of which are only known to lie below a limit.

A slack muscle shows no force, whatever its map would say: the measured 0 N means "0 N or less". Least squares that
takes it for a measured 0 N bends the whole map towards 0. Here such a point counts by the probability of a value below
the limit (Tobin, "Estimation of relationships for limited dependent variables", Econometrica 1958), with the
parametrisation in which the likelihood has one maximum (Olsen, "Note on the uniqueness of the maximum likelihood
estimator for the Tobit model", Econometrica 1978). Without such points it is weighted least squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.special import erfcx, log_ndtr

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_ROUNDS, _TOLERANCE = 100, 1e-12
_EXACT = 1e-7
"""Share of the largest value below which residuals are rounding. It keeps the likelihood of an exact fit finite."""
_SINGULAR = 1e-8
"""Least share of a column that does not depend on the columns before it."""


class Undetermined(Exception):
    """The data do not determine the coefficients; the message says why, as the end of a sentence."""


class Observations(NamedTuple):
    """What was measured, N values."""

    value: Floats  # measured values (N,); where censored, the limit below which the true value lies
    censored: Bools  # which are known only to lie below (N,)
    spread: Floats  # standard deviation of each, or its ratio to the others' (N,)
    declared: bool  # whether ``spread`` is known in the unit of the values; else its scale is estimated


class Solution(NamedTuple):
    """Coefficients of a regression."""

    coefficients: Floats  # (K,)
    covariance: Floats  # (K, K) for errors that do not depend on each other; NaN where no degree of freedom is left
    freedom: int
    scale: float  # standard deviation of the residuals over ``spread``; NaN likewise
    cost: float  # negative logarithm of the likelihood, but for a constant


def solve(design: Floats, seen: Observations, others: int = 0) -> Solution:
    """Most likely coefficients of value = design · coefficients + error.

    `design`: (N, K). `others`: coefficients that were fitted outside, which take degrees of freedom too.
    """
    measured = ~seen.censored
    rows, values = design / seen.spread[:, None], seen.value / seen.spread
    count, size = int(measured.sum()), design.shape[1]
    if count < size + others:
        raise Undetermined(f"{count} measured values, expected at least {size + others}")
    norm = np.linalg.norm(rows[measured], axis=0)
    if np.any(norm == 0.0):
        raise Undetermined("a coefficient has no effect on any measured value")
    triangle = np.linalg.qr(rows[measured] / norm, mode="r")
    if np.min(np.abs(np.diag(triangle))) < _SINGULAR:
        raise Undetermined("the measured values cannot tell its coefficients apart")
    # Columns orthonormal over the measured rows and values of size 1 give the iteration the same scale for every rig.
    to_plain = np.linalg.inv(triangle) / norm[:, None]
    unit = float(np.max(np.abs(values[measured]))) or 1.0
    try:
        x, information, cost = _maximise(rows @ to_plain, values / unit, seen.censored)
    except np.linalg.LinAlgError:
        raise Undetermined("the measured values cannot tell its coefficients apart") from None
    delta, gamma = x[:-1], float(x[-1])
    coefficients, freedom = to_plain @ (delta / gamma) * unit, count - size - others
    if freedom == 0 and not seen.declared:
        return Solution(coefficients, np.full((size, size), np.nan), 0, np.nan, np.inf)
    # The scale by the likelihood leaves out that the coefficients were fitted to the same values: this is that of
    # unbiased least squares. Where the sensor's own deviation is declared, a smaller scale is luck.
    scale = unit / gamma * (np.sqrt(count / freedom) if freedom else 1.0)
    scale = float(max(scale, 1.0) if seen.declared else scale)
    jacobian = to_plain @ np.column_stack([np.eye(size), -delta / gamma]) * scale
    covariance = jacobian @ np.linalg.solve(information, jacobian.T)
    return Solution(coefficients, 0.5 * (covariance + covariance.T), freedom, scale, cost + count * np.log(unit))


def _maximise(basis: Floats, target: Floats, censored: Bools) -> tuple[Floats, Floats, float]:
    """Newton's method on Olsen's x = δ = coefficients/σ and γ = 1/σ, in which the likelihood is concave.

    Returns x (K + 1,), the information matrix (K + 1, K + 1), −ln likelihood.
    """
    # γ value − row δ is a measured value's error, and a censored one's margin.
    apart = np.column_stack([-basis, target])
    seen, below, count = apart[~censored], apart[censored], int(np.sum(~censored))
    rounding = np.zeros(apart.shape[1])
    rounding[-1] = count * _EXACT**2

    def cost(x: Floats) -> float:
        if x[-1] <= 0.0:
            return np.inf
        error = seen @ x
        return float(0.5 * (error @ error + rounding @ x**2) - count * np.log(x[-1]) - log_ndtr(below @ x).sum())

    def slopes(x: Floats) -> tuple[Floats, Floats]:
        margin = below @ x
        # φ/Φ, the pull of a censored value, by erfcx: both vanish where the prediction is far above the limit.
        pull = np.sqrt(2.0 / np.pi) / erfcx(-margin / np.sqrt(2.0))
        weight = np.clip(pull * (margin + pull), 0.0, 1.0)
        gradient = seen.T @ (seen @ x) + rounding * x - below.T @ pull
        information = seen.T @ seen + np.diag(rounding) + below.T @ (weight[:, None] * below)
        gradient[-1] -= count / x[-1]
        information[-1, -1] += count / x[-1] ** 2
        return gradient, information

    plain = np.append(-(seen[:, :-1].T @ seen[:, -1]), 1.0)
    x = plain / np.sqrt(np.mean((seen @ plain) ** 2) + _EXACT**2)
    now = cost(x)
    for _ in range(_ROUNDS):
        gradient, information = slopes(x)
        step = -np.linalg.solve(information, gradient)
        gain = -float(gradient @ step)
        if gain < _TOLERANCE * count:
            break
        length = 1.0
        while (trial := cost(x + length * step)) > now - 0.1 * length * gain and length > 1e-10:
            length *= 0.5
        if trial >= now:
            break
        x, now = x + length * step, trial
    return x, slopes(x)[1], now


def jackknife(parts: Floats) -> Floats:
    """Covariance (K, K) from coefficients (G, K), each fitted without one of G groups, whose values count as one.

    Values at one length have similar errors where a map's form is not quite right. :func:`solve` counts each of them.
    """
    groups, apart = len(parts), parts - parts.mean(axis=0)
    return np.asarray((groups - 1) / groups * apart.T @ apart)


def larger(first: Floats, second: Floats) -> Floats:
    """The least covariance that is below neither of two in any direction.

    `first`: (K, K); a coefficient that is held has zeros, and keeps them. `second`: (K, K).
    """
    free = np.flatnonzero(np.diag(first) > 0.0)
    inside = np.ix_(free, free)
    std = np.sqrt(np.diag(first)[free])
    scale = np.outer(std, std)
    own = first[inside] / scale + 1e-12 * np.eye(len(free))
    # In the coordinates in which the first is the unit matrix and the second is diagonal.
    values, vectors = eigh(second[inside] / scale, own)
    spread = own @ (vectors * np.sqrt(np.maximum(values, 1.0)))
    out = np.zeros_like(first)
    out[inside] = spread @ spread.T * scale
    return out
