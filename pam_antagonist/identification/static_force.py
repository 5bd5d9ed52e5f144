"""Coefficients of a muscle's force map from a table of length, pressure and force.

:func:`pam_antagonist.model.muscle.force` computes the forms. This module only has the names of their coefficients, and
which of them is not linear.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pam_antagonist.identification.static_regression import (
    Observations,
    Solution,
    Undetermined,
    jackknife,
    larger,
    quantile,
    solve,
)
from pam_antagonist.identification.static_table import ForceMap
from pam_antagonist.model import muscle
from pam_antagonist.model import parameters as par

Floats = NDArray[np.float64]

COEFFICIENTS = {
    "linear": ("v1", "v2", "w1", "w2"),
    "hildebrandt": ("c1", "c2", "c3", "c4", "c5", "c6", "c7"),
    "sarosi": ("c1", "c2", "c3", "c4", "c5", "c6"),
    "polynomial": ("c1", "c2", "c3", "c4", "c5", "c6"),
}
"""Names under ``muscle_i.force`` of the coefficients of each form that a table is fitted by."""
FORMS = tuple(COEFFICIENTS)
_EXPONENT = {"sarosi": 2}
"""Index of the coefficient in which the force is not linear."""
_FLATTEST, _STEEPEST, _TRIED = 0.02, 20.0, 16
"""Exponents that are tried, relative to the map's range of contractions: from nearly straight to a step."""


@dataclass(frozen=True)
class LeftOut:
    """What a fit without one length predicts there.

    Attributes:
        length: mean of the length [m].
        measured: forces that were measured at it.
        slack: points at it where the muscle was slack or nothing was measured.
        rmse: of the measured forces [N], NaN where there are none or the others do not determine the form.
        largest: largest error of them [N].
        overshoot: largest force predicted above 0 where the muscle was slack [N].
        errors: prediction minus measured force [N], one a measured force.
    """

    length: float
    measured: int
    slack: int
    rmse: float
    largest: float
    overshoot: float
    errors: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ForceFit:
    """A force map fitted to a table.

    Attributes:
        form: one of ``FORMS``.
        names: of the coefficients, as under ``muscle_i.force`` in a rig file.
        coefficients: (K,), pressures absolute.
        covariance: (K, K); values at one length count as dependent on each other.
        freedom: measured forces minus coefficients.
        scale: standard deviation of the residuals [N], or its ratio to the declared deviations.
        rest_length: L_0 [m] that the contraction counts from.
        fitted_rmse: of the measured forces it was fitted to [N]; says little about others.
        fitted_largest: largest error of them [N].
        left_out: for each length, what the fit without it predicts there.
        notes: sentences about what is odd.
    """

    form: str
    names: tuple[str, ...]
    coefficients: Floats
    covariance: Floats
    freedom: int
    scale: float
    rest_length: float
    fitted_rmse: float
    fitted_largest: float
    left_out: tuple[LeftOut, ...]
    notes: tuple[str, ...]

    @property
    def std(self) -> Floats:
        """Standard deviations of the coefficients (K,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def reach95(self) -> float:
        """Half width of a coefficient's 95 % interval in standard deviations."""
        return quantile(self.freedom)

    @property
    def left_out_rmse(self) -> float:
        """Root mean square [N] of all errors at lengths that were left out; NaN if one of them has no prediction."""
        return _rms(self._left_out_errors())

    @property
    def inner_rmse(self) -> float:
        """``left_out_rmse`` [N] without the shortest and the longest measured length: no extrapolation."""
        known = [item for item in self.left_out if item.measured]
        errors = [np.array(item.errors) for item in known[1:-1]]
        return _rms(np.concatenate(errors)) if errors else np.nan

    @property
    def left_out_largest(self) -> float:
        """Largest error at the lengths that were left out [N]."""
        errors = self._left_out_errors()
        return float(np.max(np.abs(errors))) if len(errors) else np.nan

    @property
    def overshoot(self) -> float:
        """Largest force [N] predicted where the muscle was slack, at lengths that were left out."""
        known = [item.overshoot for item in self.left_out if np.isfinite(item.overshoot)]
        return max(known, default=np.nan)

    def _left_out_errors(self) -> Floats:
        if any(item.measured and not np.isfinite(item.rmse) for item in self.left_out):
            return np.array([np.nan])
        return np.concatenate([np.array(item.errors) for item in self.left_out])

    def force(self, length: Floats, pressure: Floats) -> Floats:
        """Contraction force (N,) [N] at lengths (N,) [m] and absolute pressures (N,) [Pa]."""
        return map_force(self.form, self.coefficients, length, pressure, self.rest_length)

    def force_std(self, length: Floats, pressure: Floats) -> Floats:
        """Standard deviation (N,) [N] of :meth:`force`, by the coefficients' covariance."""
        slopes = _slopes(self.form, self.coefficients, length, pressure, self.rest_length)
        return np.asarray(np.sqrt(np.einsum("nk,kl,nl->n", slopes, self.covariance, slopes)))


def map_force(form: str, coefficients: Floats, length: Floats, pressure: Floats, rest_length: float) -> Floats:
    """Force of a map by the model's own function.

    Args:
        form: one of ``FORMS``.
        coefficients: (K,), in the order of ``COEFFICIENTS``.
        length: (N,) [m].
        pressure: absolute (N,) [Pa].
        rest_length: L_0 [m].

    Returns:
        Contraction force (N,) [N].
    """
    p = np.zeros(par.SIZE)
    p[par.LENGTH] = rest_length
    p[par.FORCE_FORM] = float(par.FORCE_FORMS.index(form))
    for name, value in zip(COEFFICIENTS[form], coefficients, strict=True):
        p[par.INDEX[f"muscle_1.force.{name}"]] = value
    return np.array([muscle.force(0, at, held, p) for at, held in zip(length, pressure, strict=True)])


def fit_force(table: ForceMap, form: str, rest_length: float) -> ForceFit:
    """Fit a form to a table, to all of it and without each of its lengths.

    Args:
        table: the measured map.
        form: one of ``FORMS``.
        rest_length: L_0 of the rig [m], from which the contraction k = 1 − l/L_0 counts.

    Raises:
        Undetermined: the table does not determine the form's coefficients.
    """
    whole, notes = _fitted(table, form, rest_length)
    if not np.all(np.isfinite(whole.covariance)):
        raise Undetermined(f"{len(table) - int(table.slack.sum())} measured forces, expected more than coefficients")
    left_out, parts = _without_each(table, form, rest_length)
    covariance = whole.covariance
    if len(parts) == table.lengths:
        covariance = larger(covariance, jackknife(np.array(parts)))
    else:
        notes.append(
            "if one length is left out, the map does not determine this form: so the standard deviations treat all "
            "forces as independent, and are too small"
        )
    error = map_force(form, whole.coefficients, table.length, table.pressure, rest_length) - table.force
    error = error[~table.slack]
    return ForceFit(
        form, COEFFICIENTS[form], whole.coefficients, covariance, whole.freedom, whole.scale, rest_length,
        _rms(error), float(np.max(np.abs(error))), tuple(left_out), tuple(notes),
    )  # fmt: skip


def compare_forms(
    table: ForceMap, rest_length: float, forms: Sequence[str] = FORMS
) -> dict[str, ForceFit | Undetermined]:
    """Every form fitted to the same table, or the reason why the table does not determine it.

    Args:
        table: the measured forces.
        rest_length: L_0 of the rig [m], from which the contraction k = 1 − l/L_0 counts.
        forms: names of the forms.
    """
    out: dict[str, ForceFit | Undetermined] = {}
    for form in forms:
        try:
            out[form] = fit_force(table, form, rest_length)
        except Undetermined as reason:
            out[form] = reason
    return out


def _without_each(table: ForceMap, form: str, rest_length: float) -> tuple[list[LeftOut], list[Floats]]:
    """Errors at each length of a fit without it, and the coefficients of the fits that succeed."""
    found, parts = [], []
    for group in range(table.lengths):
        inside = table.group == group
        there = table.part(inside)
        try:
            fit, _ = _fitted(table.part(~inside), form, rest_length)
            predicted = map_force(form, fit.coefficients, there.length, there.pressure, rest_length)
            parts.append(fit.coefficients)
        except Undetermined:
            predicted = np.full(len(there), np.nan)
        errors = (predicted - there.force)[~there.slack]
        above = np.maximum(predicted - there.limit, 0.0)[there.slack]
        largest = float(np.max(np.abs(errors))) if len(errors) else np.nan
        overshoot = float(np.max(above)) if len(above) else np.nan
        found.append(
            LeftOut(
                float(there.length.mean()), len(errors), len(above), _rms(errors), largest, overshoot, tuple(errors)
            )
        )
    return found, parts


def _fitted(table: ForceMap, form: str, rest_length: float) -> tuple[Solution, list[str]]:
    """Coefficients of a form, and what is odd about them."""
    seen = Observations(np.where(table.slack, table.limit, table.force), table.slack, table.spread, table.declared)
    size = len(COEFFICIENTS[form])
    curved = _EXPONENT.get(form)
    if curved is None:
        return solve(_slopes(form, np.zeros(size), table.length, table.pressure, rest_length), seen), []
    straight = [k for k in range(size) if k != curved]

    def with_exponent(exponent: float) -> Solution:
        held = np.zeros(size)
        held[curved] = exponent
        design = _slopes(form, held, table.length, table.pressure, rest_length)[:, straight]
        return solve(design, seen, others=1)

    # Variable projection: each exponent has one best set of the other coefficients, so the search has one dimension.
    reach = float(np.ptp(table.length[~table.slack])) / rest_length
    if reach == 0.0:
        raise Undetermined("the measured forces are all at one length")
    steps = np.geomspace(_FLATTEST, _STEEPEST, _TRIED) / reach
    tried = np.concatenate([-steps[::-1], steps])
    costs = [_cost(with_exponent, float(exponent)) for exponent in tried]
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        with_exponent(float(tried[best]))  # says why
    if best in (0, len(tried) - 1):
        # The likelihood rises to an end: the bend lies between two lengths, and the map does not show its sharpness.
        exponent = float(tried[best])
        held = with_exponent(exponent)
        covariance = np.insert(np.insert(held.covariance, curved, 0.0, axis=0), curved, 0.0, axis=1)
        name = COEFFICIENTS[form][curved]
        note = (
            f"the measured lengths do not determine the exponent {name}; it was held at {exponent:.3g}, the end of its "
            "range"
        )
        return replace(held, coefficients=np.insert(held.coefficients, curved, exponent), covariance=covariance), [note]
    low, high = tried[best - 1], tried[best + 1]
    exponent = float(minimize_scalar(lambda e: _cost(with_exponent, float(e)), bounds=(low, high), method="bounded").x)
    inner = with_exponent(exponent)
    coefficients = np.insert(inner.coefficients, curved, exponent)
    # The exponent's error is correlated with the others': the covariance of all, linearised at the solution.
    slopes = _slopes(form, coefficients, table.length, table.pressure, rest_length)
    offset = map_force(form, coefficients, table.length, table.pressure, rest_length) - slopes @ coefficients
    around = solve(slopes, Observations(seen.value - offset, seen.censored, seen.spread, seen.declared))
    return replace(around, coefficients=coefficients, cost=inner.cost), []


def _cost(solved: Callable[[float], Solution], exponent: float) -> float:
    try:
        return solved(exponent).cost
    except Undetermined:
        return np.inf


def _slopes(form: str, coefficients: Floats, length: Floats, pressure: Floats, rest_length: float) -> Floats:
    """∂F/∂coefficient (N, K). The force is linear and homogeneous in all but the exponent."""
    size, curved = len(coefficients), _EXPONENT.get(form)
    columns = []
    for k in range(size):
        if k == curved:
            step = 1e-4 * max(abs(coefficients[k]), 1.0)
            ends = []
            for way in (step, -step):
                moved = coefficients.copy()
                moved[k] += way
                ends.append(map_force(form, moved, length, pressure, rest_length))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
            continue
        only = np.zeros(size)
        only[k] = 1.0
        if curved is not None:
            only[curved] = coefficients[curved]
        columns.append(map_force(form, only, length, pressure, rest_length))
    return np.column_stack(columns)


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else np.nan
