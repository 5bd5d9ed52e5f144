"""Regression on static data, some of which only say that the value lies below a limit.

A slack muscle shows no force, whatever its map would say: the measured 0 N means "0 N or less". Least squares that
takes it for a measured 0 N bends the whole map towards 0. Here such a point counts by the probability of a value below
the limit (Tobin, "Estimation of relationships for limited dependent variables", Econometrica 1958), with the
parametrisation in which the likelihood has one maximum (Olsen, "Note on the uniqueness of the maximum likelihood
estimator for the Tobit model", Econometrica 1978). Without such points it is weighted least squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, log_ndtr, stdtrit

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_ROUNDS = 100
_TOLERANCE = 1e-12
_EXACT = 1e-7
"""Share of the largest value below which residuals are rounding. It keeps the likelihood of an exact fit finite."""
_SINGULAR = 1e-8
"""Least share of a column that does not depend on the columns before it."""


class Undetermined(Exception):
    """The data do not determine the coefficients; the message says why, as the end of a sentence."""


@dataclass(frozen=True, eq=False)
class Observations:
    """What was measured, N values.

    Attributes:
        value: measured values (N,); where censored, the limit below which the true value lies.
        censored: which are known only to lie below (N,).
        spread: standard deviation of each, or its ratio to the others' (N,).
        declared: whether ``spread`` is known in the unit of the values; else its scale is estimated.
    """

    value: Floats
    censored: Bools
    spread: Floats
    declared: bool

    def part(self, keep: Bools) -> Observations:
        """Those of a mask (N,)."""
        return Observations(self.value[keep], self.censored[keep], self.spread[keep], self.declared)


@dataclass(frozen=True, eq=False)
class Solution:
    """Coefficients K of a regression.

    Attributes:
        coefficients: (K,).
        scale: standard deviation of the residuals over ``spread``; NaN where no degree of freedom is left.
        covariance: of the coefficients (K, K) for errors that do not depend on each other; NaN as ``scale``.
        freedom: measured values (not censored) minus coefficients.
        cost: negative logarithm of the likelihood, but for a constant.
    """

    coefficients: Floats
    scale: float
    covariance: Floats
    freedom: int
    cost: float


def solve(design: Floats, seen: Observations, others: int = 0) -> Solution:
    """Most likely coefficients of value = design · coefficients + error.

    Args:
        design: (N, K).
        seen: the values (N,).
        others: coefficients that were fitted outside, which take degrees of freedom too.

    Returns:
        The coefficients; the scale is that of unbiased least squares, which counts the coefficients.

    Raises:
        Undetermined: fewer measured values than coefficients, or columns that these cannot tell apart.
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
    basis, target = rows @ to_plain, values / unit
    try:
        delta, gamma, information, cost = _maximise(basis, target, seen.censored)
    except np.linalg.LinAlgError:
        raise Undetermined("the measured values cannot tell its coefficients apart") from None
    coefficients = to_plain @ (delta / gamma) * unit
    freedom = count - size - others
    if freedom == 0 and not seen.declared:
        return Solution(coefficients, np.nan, np.full((size, size), np.nan), 0, np.inf)
    scale = unit / gamma * (np.sqrt(count / freedom) if freedom else 1.0)
    jacobian = np.column_stack([np.eye(size) / gamma, -delta / gamma**2])
    covariance = jacobian @ np.linalg.solve(information, jacobian.T) * unit**2
    # The scale by the likelihood leaves out that the coefficients were fitted to the same values. Where the sensor's
    # own deviation is declared, a smaller scale is luck.
    wanted = max(scale, 1.0) if seen.declared else scale
    covariance *= (wanted * gamma / unit) ** 2
    covariance = to_plain @ covariance @ to_plain.T
    return Solution(
        coefficients, float(wanted), 0.5 * (covariance + covariance.T), freedom, cost + count * np.log(unit)
    )


def _maximise(basis: Floats, target: Floats, censored: Bools) -> tuple[Floats, float, Floats, float]:
    """Newton's method on Olsen's parameters δ = coefficients/σ and γ = 1/σ, where the likelihood is concave.

    Returns:
        δ (K,), γ, the information matrix (K + 1, K + 1) and the negative logarithm of the likelihood.
    """
    seen, values = basis[~censored], target[~censored]
    below, limit = basis[censored], target[censored]
    count = len(values)

    def cost(x: Floats) -> float:
        if x[-1] <= 0.0:
            return np.inf
        residual = x[-1] * values - seen @ x[:-1]
        margin = x[-1] * limit - below @ x[:-1]
        rounding = count * (_EXACT * x[-1]) ** 2
        return float(-count * np.log(x[-1]) + 0.5 * (residual @ residual + rounding) - log_ndtr(margin).sum())

    plain = seen.T @ values
    left = values - seen @ plain
    gamma = 1.0 / np.sqrt(np.mean(left**2) + _EXACT**2)
    x = np.append(plain * gamma, gamma)
    now = cost(x)
    for _ in range(_ROUNDS):
        gradient, information = _slopes(x, seen, values, below, limit)
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
    _, information = _slopes(x, seen, values, below, limit)
    return x[:-1], float(x[-1]), information, now


def _slopes(x: Floats, seen: Floats, values: Floats, below: Floats, limit: Floats) -> tuple[Floats, Floats]:
    """Gradient (K + 1,) and curvature (K + 1, K + 1) of the negative logarithm of the likelihood."""
    delta, gamma, count = x[:-1], x[-1], len(values)
    residual = gamma * values - seen @ delta
    margin = gamma * limit - below @ delta
    # φ/Φ, the pull of a censored value, by erfcx: both vanish where the prediction is far above the limit.
    pull = np.sqrt(2.0 / np.pi) / erfcx(-margin / np.sqrt(2.0))
    weight = np.clip(pull * (margin + pull), 0.0, 1.0)
    rounding = count * _EXACT**2
    gradient = np.append(
        -seen.T @ residual + below.T @ pull,
        -count / gamma + residual @ values + rounding * gamma - pull @ limit,
    )
    mixed = -(seen.T @ values) - below.T @ (weight * limit)
    corner = count / gamma**2 + values @ values + rounding + weight @ limit**2
    top = seen.T @ seen + below.T @ (weight[:, None] * below)
    return gradient, np.block([[top, mixed[:, None]], [mixed[None, :], np.array([[corner]])]])


def quantile(freedom: int) -> float:
    """Half width of a 95 % interval in standard deviations, by Student's t with so many degrees of freedom."""
    return float(stdtrit(freedom, 0.975)) if freedom > 0 else float("nan")


def jackknife(parts: Floats) -> Floats:
    """Covariance (K, K) from coefficients (G, K), each fitted without one of G groups.

    Values at one length have similar errors where the map's form is not quite right. The jackknife counts them as one;
    the covariance of :func:`solve` counts each of them.
    """
    groups, apart = len(parts), parts - parts.mean(axis=0)
    return np.asarray((groups - 1) / groups * apart.T @ apart)


def larger(first: Floats, second: Floats) -> Floats:
    """The least covariance (K, K) that is below neither of two in any direction.

    Args:
        first: (K, K); a coefficient that is held has zeros, and keeps them.
        second: (K, K).
    """
    free = np.flatnonzero(np.diag(first) > 0.0)
    inside = np.ix_(free, free)
    std = np.sqrt(np.diag(first)[free])
    scale = np.outer(std, std)
    root = np.linalg.cholesky(first[inside] / scale + 1e-12 * np.eye(len(free)))
    inner = np.linalg.solve(root, np.linalg.solve(root, second[inside] / scale).T)
    values, vectors = np.linalg.eigh(0.5 * (inner + inner.T))
    spread = root @ (vectors * np.sqrt(np.maximum(values, 1.0)))
    out = np.zeros_like(first)
    out[inside] = spread @ spread.T * scale
    return out


def bands(values: Floats, most: int = 8) -> NDArray[np.int64]:
    """Group numbers (N,) of values, from the lowest on; values that were meant to be the same form a group.

    Values closer than 2 % of the range belong together. Where this chains different values (a sweep), the range is cut
    into ``most`` bands of equal width.
    """
    order = np.argsort(values, kind="stable")
    span = float(np.ptp(values))
    number = np.zeros(len(values), dtype=np.int64)
    if span == 0.0:
        return number
    number[order[1:]] = np.cumsum(np.diff(values[order]) > 0.02 * span)
    if max(np.ptp(values[number == group]) for group in range(number.max() + 1)) > 0.1 * span:
        number = np.minimum((values - values.min()) / span * most, most - 1).astype(np.int64)
        number = np.unique(number, return_inverse=True)[1].reshape(-1)
    return number
