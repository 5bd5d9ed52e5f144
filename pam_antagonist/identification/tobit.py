"""Regression on values, some of which are only known to lie below a limit.

A slack muscle shows no force, whatever its map would say: the measured 0 N means "0 N or less". Least squares that
takes it for a measured 0 N bends the whole map towards 0. Here such a point counts by the probability of a value below
the limit (Tobin, "Estimation of relationships for limited dependent variables", Econometrica 1958). Without such points
it is weighted least squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import minimize
from scipy.special import erfcx, log_ndtr

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

_SEARCH = {"gtol": 1e-6, "maxiter": 100, "initial_trust_radius": 1e3, "max_trust_radius": 1e9}
_ROUNDING = 1e-7
"""Share of the largest value below which residuals are rounding. It keeps the likelihood of an exact fit finite."""
_SINGULAR = 1e-8
"""Least share of a column that does not depend on the columns before it."""


class Undetermined(Exception):
    """The data do not determine the coefficients; the message says why, as the end of a sentence."""


class Solution(NamedTuple):
    """Coefficients of a regression."""

    coefficients: Floats  # (K,)
    covariance: Floats  # (K, K) for errors that do not depend on each other; NaN where no degree of freedom is left
    freedom: int
    scale: float  # standard deviation of the residuals over ``spread``; NaN likewise
    cost: float  # negative logarithm of the likelihood, but for a constant


def solve(design: Floats, value: Floats, censored: Bools, spread: Floats, declared: bool, parameters: int) -> Solution:
    """Most likely coefficients of value = design · coefficients + error.

    `design`: (N, K). `value`: measured values (N,); where censored, the limit below which the true value lies.
    `censored`: which are known only to lie below (N,). `spread`: standard deviation of each, or its ratio to the
    others' (N,). `declared`: whether ``spread`` is known in the unit of the values; else its scale is estimated.
    `parameters`: degrees of freedom that were taken, by the coefficients and by others that were fitted outside.
    """
    measured, rows, values = ~censored, design / spread[:, None], value / spread
    count = int(measured.sum())
    if count < parameters:
        raise Undetermined(f"{count} measured values, expected at least {parameters}")
    norm = np.linalg.norm(rows[measured], axis=0)
    triangle = np.linalg.qr(rows[measured] / np.where(norm > 0.0, norm, 1.0), mode="r")
    if np.min(np.abs(np.diag(triangle))) < _SINGULAR:
        raise Undetermined("the measured values cannot tell its coefficients apart")
    # Columns orthonormal over the measured rows and values of size 1 give the search the same scale for every rig.
    to_plain, unit = np.linalg.inv(triangle) / norm[:, None], float(np.max(np.abs(values[measured]))) or 1.0
    # In x = coefficients/σ and 1/σ the likelihood has one maximum (Olsen, "Note on the uniqueness of the maximum
    # likelihood estimator for the Tobit model", Econometrica 1978); a row times x is an error in standard deviations,
    # and of a slack value its distance below the limit.
    apart = np.column_stack([-rows @ to_plain, values / unit])
    near, below, rounding = apart[measured], apart[censored], np.zeros(apart.shape[1])
    rounding[-1] = count * _ROUNDING**2

    def cost(x: Floats) -> tuple[float, Floats]:
        if x[-1] <= 0.0:
            return np.inf, np.zeros(len(x))
        error, margin = near @ x, below @ x
        slope = near.T @ error + rounding * x - below.T @ _pull(margin)
        slope[-1] -= count / x[-1]
        value = 0.5 * (error @ error + rounding @ x**2) - count * np.log(x[-1]) - log_ndtr(margin).sum()
        return float(value), slope

    def information(x: Floats) -> Floats:
        margin = below @ x
        weight = np.clip(_pull(margin) * (margin + _pull(margin)), 0.0, 1.0)
        out = near.T @ near + np.diag(rounding) + below.T @ (weight[:, None] * below)
        out[-1, -1] += count / x[-1] ** 2
        return out

    x = np.append(-(near[:, :-1].T @ near[:, -1]), 1.0)
    x /= np.sqrt(np.mean((near @ x) ** 2) + _ROUNDING**2)
    x = minimize(cost, x, method="trust-exact", jac=True, hess=information, options=_SEARCH).x
    coefficients, freedom = to_plain @ (x[:-1] / x[-1]) * unit, count - parameters
    if freedom == 0 and not declared:
        return Solution(coefficients, np.full((design.shape[1],) * 2, np.nan), 0, np.nan, np.inf)
    # The scale by the likelihood leaves out that the coefficients were fitted to the same values: this is that of
    # unbiased least squares. Where the sensor's own deviation is declared, a smaller scale is luck.
    scale = unit / x[-1] * (np.sqrt(count / freedom) if freedom else 1.0)
    scale = float(max(scale, 1.0) if declared else scale)
    jacobian = to_plain @ np.column_stack([np.eye(len(x) - 1), -x[:-1] / x[-1]]) * scale
    covariance = jacobian @ np.linalg.solve(information(x), jacobian.T)
    return Solution(coefficients, 0.5 * (covariance + covariance.T), freedom, scale, cost(x)[0] + count * np.log(unit))


def _pull(margin: Floats) -> Floats:
    """φ/Φ of slack values, by erfcx: both vanish where the prediction is far above the limit."""
    return np.asarray(np.sqrt(2.0 / np.pi) / erfcx(-margin / np.sqrt(2.0)))


def larger(first: Floats, second: Floats) -> Floats:
    """The least covariance that is below neither of two (K, K); a coefficient with zeros in the first is held."""
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
