"""Coefficients of a muscle's force map from a table of length, pressure and force.

:func:`pam_antagonist.model.muscle.force` computes the forms. This module only has the names of their coefficients, and
which of them are not linear.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar

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
    "braided": ("c1", "c2", "c3", "c4", "c5", "c6", "c7"),
}
"""Names under ``muscle_i.force`` of the coefficients of each form in ``parameters.FORCE_FORMS``."""
_EXPONENT = {"sarosi": 2}
"""Index of the coefficient in which the force is not linear."""
_FREE = slice(5)
"""Of ``braided``: a, k, b, s and ε_0 are fitted, L_n and w held. The force is linear in none of them."""
_RUBBER, _BENT, _REST, _BEND = 0.19, 18.5, 0.007, 0.005
"""b as a share of the largest force, s/k, ε_0, and w as a share of the largest force, as in a rig of a data sheet."""
_MOST, _BENT_PRIOR, _REST_PRIOR = 10.0, 0.5, 0.01
"""Largest factor between start and solution; standard deviations of ln s and ε_0 between muscles. They only count where
no length is near the nominal one, and the table does not show how soon the rubber pulls."""
_FEWEST_LENGTHS = 3
"""At two lengths a force has two slopes and two offsets: fewer numbers than ``braided``."""
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
        form: one of ``parameters.FORCE_FORMS``.
        names: of the coefficients, as under ``muscle_i.force`` in a rig file.
        coefficients: (K,), pressures absolute.
        covariance: (K, K); values at one length count as dependent on each other.
        freedom: measured forces minus coefficients.
        scale: standard deviation of the residuals [N], or its ratio to the declared deviations.
        rest_length: L_0 [m] that the contraction counts from; of ``braided`` L_n.
        atmosphere: absolute pressure of the surroundings [Pa].
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
    atmosphere: float
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
        return map_force(self.form, self.coefficients, length, pressure, self.rest_length, self.atmosphere)

    def force_std(self, length: Floats, pressure: Floats) -> Floats:
        """Standard deviation (N,) [N] of :meth:`force`, by the coefficients' covariance."""
        slopes = _slopes(self.form, self.coefficients, length, pressure, self.rest_length, self.atmosphere)
        return np.asarray(np.sqrt(np.einsum("nk,kl,nl->n", slopes, self.covariance, slopes)))


def map_force(
    form: str, coefficients: Floats, length: Floats, pressure: Floats, rest_length: float, atmosphere: float
) -> Floats:
    """Force of a map by the model's own function.

    Args:
        form: one of ``parameters.FORCE_FORMS``.
        coefficients: (K,), in the order of ``COEFFICIENTS``.
        length: (N,) [m].
        pressure: absolute (N,) [Pa].
        rest_length: L_0 [m].
        atmosphere: absolute pressure of the surroundings [Pa].

    Returns:
        Contraction force (N,) [N].
    """
    p = np.zeros(par.SIZE)
    p[par.LENGTH], p[par.ATMOSPHERE] = rest_length, atmosphere
    p[par.FORCE_FORM] = float(par.FORCE_FORMS.index(form))
    for name, value in zip(COEFFICIENTS[form], coefficients, strict=True):
        p[par.INDEX[f"muscle_1.force.{name}"]] = value
    return np.array([muscle.force(0, at, held, p) for at, held in zip(length, pressure, strict=True)])


def fit_force(table: ForceMap, form: str, rest_length: float, nominal: float = 0.0) -> ForceFit:
    """Fit a form to a table, to all of it and without each of its lengths.

    Args:
        table: the measured map.
        form: one of ``parameters.FORCE_FORMS``.
        rest_length: L_0 of the rig [m], from which the contraction k = 1 − l/L_0 counts.
        nominal: length of the muscle without pressure and load [m], from which that of ``braided`` counts; 0: the
            longest of the table. Inside the table it changes nothing, beyond its longest length much.

    Raises:
        Undetermined: the table does not determine the form's coefficients.
    """
    held: tuple[float, ...] = ()
    if form == "braided":
        # The same for all parts of the table.
        rest_length = nominal or float(table.length.max())
        held = (rest_length, _BEND * float(table.force.max()))
    whole, notes = _fitted(table, form, rest_length, held)
    if not np.all(np.isfinite(whole.covariance)):
        raise Undetermined(f"{len(table) - int(table.slack.sum())} measured forces, expected more than coefficients")
    left_out, parts = _without_each(table, form, rest_length, held)
    covariance = whole.covariance
    if len(parts) == table.lengths:
        covariance = larger(covariance, jackknife(np.array(parts)))
    else:
        notes.append(
            "if one length is left out, the map does not determine this form: so the standard deviations treat all "
            "forces as independent, and are too small"
        )
    error = (
        map_force(form, whole.coefficients, table.length, table.pressure, rest_length, table.atmosphere) - table.force
    )
    error = error[~table.slack]
    return ForceFit(
        form, COEFFICIENTS[form], whole.coefficients, covariance, whole.freedom, whole.scale, rest_length,
        table.atmosphere, _rms(error), float(np.max(np.abs(error))), tuple(left_out), tuple(notes),
    )  # fmt: skip


def compare_forms(
    table: ForceMap, rest_length: float, forms: Sequence[str] = par.FORCE_FORMS, nominal: float = 0.0
) -> dict[str, ForceFit | Undetermined]:
    """Every form fitted to the same table, or the reason why the table does not determine it.

    Args:
        table: the measured forces.
        rest_length: L_0 of the rig [m], from which the contraction k = 1 − l/L_0 counts.
        forms: names of the forms.
        nominal: length of the muscle without pressure and load [m], 0: not known.
    """
    out: dict[str, ForceFit | Undetermined] = {}
    for form in forms:
        try:
            out[form] = fit_force(table, form, rest_length, nominal)
        except Undetermined as reason:
            out[form] = reason
    return out


def _without_each(
    table: ForceMap, form: str, rest_length: float, held: tuple[float, ...]
) -> tuple[list[LeftOut], list[Floats]]:
    """Errors at each length of a fit without it, and the coefficients of the fits that succeed."""
    found, parts = [], []
    for group in range(table.lengths):
        inside = table.group == group
        there = table.part(inside)
        try:
            fit, _ = _fitted(table.part(~inside), form, rest_length, held)
            predicted = map_force(form, fit.coefficients, there.length, there.pressure, rest_length, table.atmosphere)
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


def _fitted(table: ForceMap, form: str, rest_length: float, fixed: tuple[float, ...]) -> tuple[Solution, list[str]]:
    """Coefficients of a form, those at its end held, and what is odd about them."""
    seen = Observations(np.where(table.slack, table.limit, table.force), table.slack, table.spread, table.declared)
    size = len(COEFFICIENTS[form])
    curved = _EXPONENT.get(form)
    if fixed:
        return _braided(table, seen, rest_length, fixed)
    if curved is None:
        return solve(
            _slopes(form, np.zeros(size), table.length, table.pressure, rest_length, table.atmosphere), seen
        ), []
    straight = [k for k in range(size) if k != curved]

    def with_exponent(exponent: float) -> Solution:
        held = np.zeros(size)
        held[curved] = exponent
        design = _slopes(form, held, table.length, table.pressure, rest_length, table.atmosphere)[:, straight]
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
    # The exponent's error is correlated with the others'.
    around = _linearised(table, form, seen, rest_length, coefficients, slice(size))
    return replace(around, coefficients=coefficients, cost=inner.cost), []


def _linearised(
    table: ForceMap, form: str, seen: Observations, rest_length: float, coefficients: Floats, free: slice
) -> Solution:
    """Regression on the slopes at a solution: its covariance is that of all free coefficients."""
    slopes = _slopes(form, coefficients, table.length, table.pressure, rest_length, table.atmosphere)[:, free]
    there = map_force(form, coefficients, table.length, table.pressure, rest_length, table.atmosphere)
    offset = there - slopes @ coefficients[free]
    return solve(slopes, Observations(seen.value - offset, seen.censored, seen.spread, seen.declared))


def _braided(
    table: ForceMap, seen: Observations, rest_length: float, fixed: tuple[float, ...]
) -> tuple[Solution, list[str]]:
    """Least squares for ``braided``. The map itself is 0 where the muscle is slack, and a, k, b and s are positive."""
    measured = ~table.slack
    if len(np.unique(table.group[measured])) < _FEWEST_LENGTHS:
        raise Undetermined(f"forces at fewer than {_FEWEST_LENGTHS} lengths")
    top, shortest = int(np.argmax(table.force)), float(table.length[measured].min())
    largest, closing = float(table.force[top]), 0.8 / max(1.0 - shortest / rest_length, 0.05)
    area = largest / max(table.pressure[top] - table.atmosphere, 1e3) * 1e5
    start = np.array([area, closing, _RUBBER * largest, _BENT * closing])

    def coefficients(z: Floats) -> Floats:
        return np.array([*(start * np.exp(z[:-1])), _REST + z[-1], *fixed])

    def residual(z: Floats, noise: float) -> Floats:
        there = map_force("braided", coefficients(z), table.length, table.pressure, rest_length, table.atmosphere)
        left = there - seen.value
        left = np.where(seen.censored, np.maximum(left, 0.0), left) / seen.spread
        return np.array([*left, noise * z[3] / _BENT_PRIOR, noise * z[4] / _REST_PRIOR])

    reach = np.array([*(4 * [np.log(_MOST)]), 0.1])
    z = np.zeros(5)
    noise = 0.0
    for _ in range(2):
        found = least_squares(
            residual, z, args=(noise,), bounds=(-reach, reach), x_scale=[0.2, 0.2, 0.3, 0.5, 0.01], max_nfev=60
        )
        z, best = found.x, coefficients(found.x)
        around = _linearised(table, "braided", seen, rest_length, best, _FREE)
        noise = around.scale if np.isfinite(around.scale) else 0.0
    covariance = np.zeros((len(best), len(best)))
    known = np.diag([0.0, 0.0, 0.0, 1.0 / (_BENT_PRIOR * best[3]) ** 2, 1.0 / _REST_PRIOR**2])
    covariance[_FREE, _FREE] = np.linalg.inv(np.linalg.inv(around.covariance) + known)
    notes = []
    if np.sqrt(around.covariance[3, 3]) > _BENT_PRIOR * best[3]:
        notes = [
            "the measured lengths hardly tell how soon the rubber pulls: c4 and c5 are near those of usual muscles"
        ]
    return replace(around, coefficients=best, covariance=covariance, cost=float(found.cost)), notes


def _cost(solved: Callable[[float], Solution], exponent: float) -> float:
    try:
        return solved(exponent).cost
    except Undetermined:
        return np.inf


def _slopes(
    form: str, coefficients: Floats, length: Floats, pressure: Floats, rest_length: float, atmosphere: float
) -> Floats:
    """∂F/∂coefficient (N, K). But for ``braided``, the force is linear and homogeneous in all but the exponent."""
    size, curved = len(coefficients), _EXPONENT.get(form)
    columns = []
    for k in range(size):
        if k == curved or form == "braided":
            step = 1e-4 * max(abs(coefficients[k]), 1.0)
            ends = []
            for way in (step, -step):
                moved = coefficients.copy()
                moved[k] += way
                ends.append(map_force(form, moved, length, pressure, rest_length, atmosphere))
            columns.append((ends[0] - ends[1]) / (2.0 * step))
            continue
        only = np.zeros(size)
        only[k] = 1.0
        if curved is not None:
            only[curved] = coefficients[curved]
        columns.append(map_force(form, only, length, pressure, rest_length, atmosphere))
    return np.column_stack(columns)


def _rms(errors: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else np.nan
