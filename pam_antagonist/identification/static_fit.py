"""A muscle's force map or volume fitted to a static table, to all of it and without each of its lengths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar
from scipy.special import stdtrit

from pam_antagonist.identification.static_table import StaticTable
from pam_antagonist.identification.tobit import Floats, Undetermined, larger, solve
from pam_antagonist.model import muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.model.force_forms import FORMS

VOLUME = "volume"
"""The form of volumes: the parabola of equation (3)."""
UNITS: dict[str, Mapping[str, str]] = {
    VOLUME: {"d1": "m", "d2": "m²", "d3": "m³"},
    **{name: form.units for name, form in FORMS.items()},
}
"""Form -> unit of each coefficient, by its name under ``muscle_i.volume`` or ``muscle_i.force`` in a rig file."""
_FEWEST_LENGTHS = {VOLUME: 3, **{name: form.fewest_lengths for name, form in FORMS.items()}}
_EXPONENT = 2
"""Index of the coefficient of ``sarosi`` in which the force is not linear."""
_FLATTEST, _STEEPEST, _TRIED = 0.02, 20.0, 16
"""Exponents that are tried, relative to the map's range of contractions: from nearly straight to a step."""
_RUBBER, _BENT, _REST, _BEND = 0.19, 18.5, 0.007, 0.005
"""Of ``braided``: b as a share of the largest force, s/k, ε_0, and w as a share of the largest force, as in a rig of a
data sheet."""
_FREE = np.arange(5)
"""Of ``braided``: a, k, b, s and ε_0 are fitted, L_n and w held. The force is linear in none of them."""
_PRIOR = np.array([0.5, 0.01])
"""Standard deviations of ln s and ε_0 between muscles. They only count where no length is near the nominal one, and the
table does not show how soon the rubber pulls."""
_MOST, _STEPS = 10.0, (0.2, 0.2, 0.3, 0.5, 0.01)
"""Largest factor between start and solution, and usual steps of the five."""


class TableForm(NamedTuple):
    """A form of the force map, or that of the volume, by the model's own functions."""

    name: str  # a key of ``UNITS``
    rest_length: float = 0.2  # L_0 [m] that the contraction k = 1 − l/L_0 counts from; of ``braided`` L_n
    atmosphere: float = 0.0  # absolute pressure of the surroundings [Pa]

    def value(self, coefficients: Sequence[float] | Floats, length: Floats, pressure: Floats | float = 0.0) -> Floats:
        """Contraction forces (N,) [N] or volumes (N,) [m³] at lengths (N,) [m] and absolute pressures (N,) [Pa]."""
        p = np.zeros(par.SIZE)
        p[par.LENGTH], p[par.ATMOSPHERE] = self.rest_length, self.atmosphere
        part = VOLUME if self.name == VOLUME else "force"
        for name, value in zip(UNITS[self.name], coefficients, strict=True):
            p[par.INDEX[f"muscle_1.{part}.{name}"]] = value
        if part == VOLUME:
            return np.array([muscle.volume(0, at, p)[0] for at in length])
        p[par.FORCE_FORM] = float(par.FORCE_FORMS.index(self.name))
        return np.array([muscle.force(0, at, held, p) for at, held in np.broadcast(length, pressure)])

    def slopes(self, coefficients: Floats, length: Floats, pressure: Floats | float = 0.0) -> Floats:
        """∂value/∂coefficient (N, K)."""
        columns = []
        bent = () if self.name == VOLUME else FORMS[self.name].bent
        for k, (name, unit) in enumerate(zip(UNITS[self.name], np.eye(len(coefficients)), strict=True)):
            if name in bent:
                step = 1e-4 * max(abs(coefficients[k]), 1.0)
                up, down = (self.value(coefficients + way * unit, length, pressure) for way in (step, -step))
                columns.append((up - down) / (2.0 * step))
                continue
            # The other coefficients are linear: the value is homogeneous in them.
            if self.name == "sarosi":
                unit[_EXPONENT] = coefficients[_EXPONENT]
            columns.append(self.value(unit, length, pressure))
        return np.column_stack(columns)


class LeftOut(NamedTuple):
    """What a fit without one length predicts there."""

    length: float  # mean of the length [m]
    errors: Floats  # prediction minus each measured value; NaN where the others do not determine the form
    slack: int  # points at it where the muscle was slack or nothing was measured
    overshoot: float  # largest force predicted above the limit where the muscle was slack [N]

    @property
    def measured(self) -> int:
        """Values that were measured at it."""
        return len(self.errors)


@dataclass(frozen=True, eq=False)
class StaticFit:
    """A form fitted to a table, in SI units."""

    form: TableForm
    coefficients: Floats  # (K,), pressures absolute
    # (K, K); values at one length count as dependent on each other. NaN where there are only as many volumes as
    # coefficients.
    covariance: Floats
    freedom: int
    scale: float  # standard deviation of the residuals, or its ratio to the declared deviations
    errors: Floats  # of the measured values it was fitted to (N,); they say little about others
    left_out: tuple[LeftOut, ...] = ()  # for each length, what the fit without it predicts there
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients."""
        return tuple(UNITS[self.form.name])

    @property
    def std(self) -> Floats:
        """Standard deviations of the coefficients (K,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def reach95(self) -> float:
        """Half width of a 95 % interval in standard deviations, by Student's t."""
        return float(stdtrit(self.freedom or 10**6, 0.975))

    @property
    def fitted_rmse(self) -> float:
        """Root mean square of the errors of the values it was fitted to."""
        return rms(self.errors)

    @property
    def left_out_errors(self) -> Floats:
        """All errors (N,) at lengths that were left out; NaN where there is no prediction."""
        return np.concatenate([item.errors for item in self.left_out])

    @property
    def left_out_rmse(self) -> float:
        """Root mean square of them."""
        return rms(self.left_out_errors)

    @property
    def inner_rmse(self) -> float:
        """The same without the shortest and the longest measured length: no extrapolation."""
        return rms([error for item in [item for item in self.left_out if item.measured][1:-1] for error in item.errors])

    @property
    def overshoot(self) -> float:
        """Largest force [N] predicted where the muscle was slack, at lengths that were left out."""
        return max((item.overshoot for item in self.left_out if np.isfinite(item.overshoot)), default=np.nan)

    def value(self, length: Floats, pressure: Floats | float = 0.0) -> Floats:
        """Fitted forces (N,) [N] or volumes (N,) [m³] at lengths (N,) [m] and absolute pressures (N,) [Pa]."""
        return self.form.value(self.coefficients, length, pressure)

    def value_std(self, length: Floats, pressure: Floats | float = 0.0) -> Floats:
        """Standard deviation (N,) of :meth:`value`, by the coefficients' covariance."""
        slopes = self.form.slopes(self.coefficients, length, pressure)
        return np.asarray(np.sqrt(np.einsum("nk,kl,nl->n", slopes, self.covariance, slopes)))

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        coefficients = {}
        for (name, unit), value, std in zip(UNITS[self.form.name].items(), self.coefficients, self.std, strict=True):
            half = self.reach95 * std
            coefficients[name] = {"value": value, "std": std, "unit": unit, "interval95": (value - half, value + half)}
        out: dict[str, Any] = {"coefficients": coefficients, "covariance": self.covariance}
        if self.form.name == VOLUME:
            lengths = [{"length_m": item.length, "rmse_m3": rms(item.errors)} for item in self.left_out]
            left_out: dict[str, Any] = {"rmse_m3": self.left_out_rmse, "by_length": lengths}
            return out | {"fitted": {"rmse_m3": self.fitted_rmse}, "left_out": left_out}
        lengths = [
            {"length_m": item.length, "measured": item.measured, "slack": item.slack, "rmse_n": rms(item.errors),
             "max_n": largest(item.errors), "slack_max_n": item.overshoot} for item in self.left_out
        ]  # fmt: skip
        left_out = {
            "rmse_n": self.left_out_rmse, "rmse_between_n": self.inner_rmse, "max_n": largest(self.left_out_errors),
            "slack_max_n": self.overshoot, "by_length": lengths,
        }  # fmt: skip
        return out | {
            "contraction_from_m": self.form.rest_length,
            "fitted": {"rmse_n": self.fitted_rmse, "max_n": largest(self.errors)},
            "left_out": left_out,
            "notes": self.notes,
        }


def largest(errors: Floats) -> float:
    """Largest size of an error; NaN without any."""
    return float(np.max(np.abs(errors))) if len(errors) else np.nan


def rms(errors: Sequence[float] | Floats) -> float:
    """Root mean square; NaN without any."""
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else np.nan


def fit(table: StaticTable, name: str, rest_length: float = 0.2, nominal: float = 0.0) -> StaticFit:
    """Fit a form to a table, to all of it and without each of its lengths.

    `name`: of the form, a key of ``UNITS``. `rest_length`: L_0 of the rig [m], from which the contraction k = 1 − l/L_0
    counts. `nominal`: length of the muscle without pressure and load [m], from which that of ``braided`` counts; 0: the
    longest of the table. Inside the table it changes nothing, beyond its longest length much.
    """
    if name != VOLUME and FORMS[name].nominal:
        rest_length = nominal or float(table.length.max())
    form, bend = TableForm(name, rest_length, table.atmosphere), _BEND * float(table.value.max())
    whole = _fitted(table, form, bend)
    if name != VOLUME and not np.all(np.isfinite(whole.covariance)):
        raise Undetermined(f"{int(np.sum(~table.slack))} measured forces, expected more than coefficients")
    left_out, parts = [], []
    for group in range(table.lengths):
        inside = table.group == group
        there = table.part(inside)
        try:
            parts.append(_fitted(table.part(~inside), form, bend).coefficients)
            predicted = form.value(parts[-1], there.length, there.pressure)
        except Undetermined:
            predicted = np.full(len(there), np.nan)
        above = np.maximum(predicted - there.limit, 0.0)[there.slack]
        overshoot = float(np.max(above)) if len(above) else np.nan
        errors = (predicted - there.value)[~there.slack]
        left_out.append(LeftOut(float(there.length.mean()), errors, len(above), overshoot))
    covariance, notes = whole.covariance, whole.notes
    # Values at one length have similar errors where the form is not quite right. Where each length has one volume, the
    # residuals' scatter over the lengths shows that already.
    if len(parts) == table.lengths and (name != VOLUME or len(table) > table.lengths):
        apart = np.array(parts) - np.mean(parts, axis=0)
        covariance = larger(covariance, (len(parts) - 1) / len(parts) * apart.T @ apart)
    elif name != VOLUME:
        notes += (
            "if one length is left out, the map does not determine this form: so the standard deviations treat all "
            "forces as independent, and are too small",
        )
    return StaticFit(
        form, whole.coefficients, covariance, whole.freedom, whole.scale, whole.errors, tuple(left_out), notes
    )


def compare_forms(
    table: StaticTable, rest_length: float, names: Sequence[str] = par.FORCE_FORMS, nominal: float = 0.0
) -> dict[str, StaticFit | Undetermined]:
    """Every form fitted to the same table as by :func:`fit`, or the reason why the table does not determine it."""
    out: dict[str, StaticFit | Undetermined] = {}
    for name in names:
        try:
            out[name] = fit(table, name, rest_length, nominal)
        except Undetermined as reason:
            out[name] = reason
    return out


def _fitted(table: StaticTable, form: TableForm, bend: float) -> StaticFit:
    """A form fitted to all of a table. `bend`: w of ``braided`` [N], the same for all parts of a table."""
    fewest = _FEWEST_LENGTHS.get(form.name, 0)
    if len(np.unique(table.group[~table.slack])) < fewest:
        raise Undetermined(f"{'volume' if form.name == VOLUME else 'force'}s at fewer than {fewest} lengths")
    if form.name == "braided":
        return _braided(table, form, bend)
    start = np.zeros(len(UNITS[form.name]))
    return _sarosi(table, form, start) if form.name == "sarosi" else _around(table, form, start, np.arange(len(start)))


def _sarosi(table: StaticTable, form: TableForm, start: Floats) -> StaticFit:
    """Each exponent has one best set of the other coefficients, so the search has one dimension."""
    linear = np.delete(np.arange(len(start)), _EXPONENT)
    known = table.length[~table.slack]
    reach = float(np.ptp(known)) / form.rest_length if len(known) else 0.0
    if reach == 0.0:
        raise Undetermined("the measured forces are all at one length")

    def cost(exponent: float) -> float:
        start[_EXPONENT] = exponent
        try:
            design = form.slopes(start, table.length, table.pressure)[:, linear]
            return solve(design, table.aim, table.slack, table.spread, table.declared, len(start)).cost
        except Undetermined:
            return np.inf

    steps = np.geomspace(_FLATTEST, _STEEPEST, _TRIED) / reach
    tried = np.concatenate([-steps[::-1], steps])
    costs = [cost(exponent) for exponent in tried]
    best = int(np.argmin(costs))
    at_end = best in (0, len(tried) - 1) or not np.isfinite(costs[best])
    if at_end:
        # The likelihood rises to an end: the bend lies between two lengths, and the map does not show its sharpness.
        start[_EXPONENT] = tried[best]
        held = f"it was held at {tried[best]:.3g}, the end of its range"
        note = f"the measured lengths do not determine the exponent c3; {held}"
        return replace(_around(table, form, start, linear), notes=(note,))
    start[_EXPONENT] = minimize_scalar(cost, bounds=(tried[best - 1], tried[best + 1]), method="bounded").x
    found = _around(table, form, start, linear)
    # The exponent's error is correlated with the others'.
    return _around(table, form, found.coefficients, np.arange(len(start)), held=True)


def _braided(table: StaticTable, form: TableForm, bend: float) -> StaticFit:
    """The map itself is 0 where the muscle is slack, and a, k, b and s are positive."""
    top, shortest = int(np.argmax(table.value)), float(table.length[~table.slack].min())
    most, closing = float(table.value[top]), 0.8 / max(1.0 - shortest / form.rest_length, 0.05)
    area = most / max(table.pressure[top] - table.atmosphere, 1e3) * 1e5
    usual = np.array([*np.log([area, closing, _RUBBER * most, _BENT * closing]), _REST])

    def coefficients(z: Floats) -> Floats:
        return np.array([*np.exp(z[:4]), z[4], form.rest_length, bend])

    def residual(z: Floats, noise: float) -> Floats:
        error = form.value(coefficients(z), table.length, table.pressure) - table.aim
        error = np.where(table.slack, np.maximum(error, 0.0), error) / table.spread
        return np.array([*error, *noise * (z - usual)[3:] / _PRIOR])

    z, noise, room = usual, 0.0, np.array([*(4 * [np.log(_MOST)]), 0.1])
    within = usual - room, usual + room
    for _ in range(2):
        z = least_squares(residual, z, args=(noise,), bounds=within, x_scale=_STEPS, max_nfev=60).x
        found = _around(table, form, coefficients(z), _FREE, held=True)
        noise = found.scale if np.isfinite(found.scale) else 0.0
    stds = _PRIOR * [found.coefficients[3], 1.0]
    if found.std[3] > stds[0]:
        note = "the measured lengths hardly tell how soon the rubber pulls: c4 and c5 are near those of usual muscles"
        found = replace(found, notes=(note,))
    covariance, inside = np.zeros_like(found.covariance), np.ix_(_FREE, _FREE)
    known = np.diag([0.0, 0.0, 0.0, *stds**-2])
    covariance[inside] = np.linalg.inv(np.linalg.inv(found.covariance[inside]) + known)
    return replace(found, covariance=covariance)


def _around(
    table: StaticTable, form: TableForm, start: Floats, free: NDArray[np.int64], held: bool = False
) -> StaticFit:
    """The most likely free coefficients by the slopes at a start; where ``held``, those of the start."""
    slopes = form.slopes(start, table.length, table.pressure)[:, free]
    offset = form.value(start, table.length, table.pressure) - slopes @ start[free] if held else 0.0
    taken = len(start) if form.name == "sarosi" else len(free)
    found = solve(slopes, table.aim - offset, table.slack, table.spread, table.declared, taken)
    coefficients, covariance = start.copy(), np.zeros((len(start), len(start)))
    coefficients[free] = start[free] if held else found.coefficients
    covariance[np.ix_(free, free)] = found.covariance
    errors = (form.value(coefficients, table.length, table.pressure) - table.value)[~table.slack]
    return StaticFit(form, coefficients, covariance, found.freedom, found.scale, errors)
