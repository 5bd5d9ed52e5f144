"""Coefficients of a muscle's volume, equation (3), from volumes measured at several lengths."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_regression import (
    Observations,
    Undetermined,
    jackknife,
    larger,
    quantile,
    solve,
)
from pam_antagonist.identification.static_table import VolumeTable
from pam_antagonist.model import muscle
from pam_antagonist.model import parameters as par

Floats = NDArray[np.float64]

COEFFICIENTS = ("d1", "d2", "d3")
"""Names under ``muscle_i.volume``."""


@dataclass(frozen=True, eq=False)
class VolumeFit:
    """A parabola fitted to a table.

    Attributes:
        coefficients: d1, d2 and d3 (3,) [m, m², m³].
        covariance: (3, 3); NaN where there are only three values and no declared deviation.
        freedom: values minus coefficients.
        scale: standard deviation of the residuals [m³], or its ratio to the declared deviations.
        fitted_rmse: of the values that it was fitted to [m³].
        lengths: mean of each length (G,) [m].
        left_out: error at each length of the fit without it (G,) [m³], root mean square where it has several values;
            NaN where the others do not determine a parabola.
    """

    coefficients: Floats
    covariance: Floats
    freedom: int
    scale: float
    fitted_rmse: float
    lengths: Floats
    left_out: Floats

    @property
    def std(self) -> Floats:
        """Standard deviations of the coefficients (3,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def left_out_rmse(self) -> float:
        """Root mean square of the errors at lengths left out [m³]; NaN if one has no prediction."""
        return float(np.sqrt(np.mean(self.left_out**2)))

    def volume(self, length: Floats) -> tuple[Floats, Floats]:
        """Volume (N,) [m³] and its derivative with respect to length (N,) [m²]."""
        return parabola(self.coefficients, length)

    def volume_std(self, length: Floats) -> Floats:
        """Standard deviation (N,) [m³] of the volume, by the coefficients' covariance."""
        slopes = _slopes(length)
        return np.asarray(np.sqrt(np.einsum("nk,kl,nl->n", slopes, self.covariance, slopes)))

    def interval(self, length: Floats) -> Floats:
        """Half width (N,) [m³] of the 95 % interval of the volume."""
        return self.volume_std(length) * self.reach95

    @property
    def reach95(self) -> float:
        """Half width of a 95 % interval in standard deviations."""
        return quantile(self.freedom) if self.freedom else quantile(10**6)


def parabola(coefficients: Floats, length: Floats) -> tuple[Floats, Floats]:
    """Equation (3) by the model's own function, which bounds volumes below.

    Args:
        coefficients: d1, d2 and d3 (3,) [m, m², m³].
        length: (N,) [m].

    Returns:
        Volumes (N,) [m³] and derivatives (N,) [m²].
    """
    p = np.zeros(par.SIZE)
    p[par.MUSCLE + par.D1 : par.MUSCLE + par.D3 + 1] = coefficients
    both = np.array([muscle.volume(0, at, p) for at in length])
    return both[:, 0], both[:, 1]


def fit_volume(table: VolumeTable) -> VolumeFit:
    """Fit the parabola to a table, and without each of its lengths.

    Raises:
        BadInput: the lengths do not determine a parabola.
    """
    seen = Observations(table.volume, np.zeros(len(table), dtype=bool), table.spread, table.declared)
    design = _slopes(table.length)
    try:
        whole = solve(design, seen)
    except Undetermined as reason:
        raise BadInput(f"{table.name}: {reason}; expected at least 3 lengths that are well apart") from None
    means, errors, parts = [], [], []
    for group in range(table.lengths):
        inside = table.group == group
        means.append(float(table.length[inside].mean()))
        try:
            if table.lengths <= len(COEFFICIENTS):
                raise Undetermined("as many lengths as coefficients")
            without = solve(design[~inside], seen.part(~inside))
        except Undetermined:
            errors.append(np.nan)
            continue
        parts.append(without.coefficients)
        errors.append(float(np.sqrt(np.mean((design[inside] @ without.coefficients - table.volume[inside]) ** 2))))
    covariance = whole.covariance
    # Values at one length have similar errors where the parabola is not quite right. Where each length has one value,
    # the residuals' scatter over the lengths shows that already.
    if len(table) > table.lengths and len(parts) == table.lengths and np.all(np.isfinite(covariance)):
        covariance = larger(covariance, jackknife(np.array(parts)))
    residual = design @ whole.coefficients - table.volume
    return VolumeFit(
        whole.coefficients, covariance, whole.freedom, whole.scale, float(np.sqrt(np.mean(residual**2))),
        np.array(means), np.array(errors),
    )  # fmt: skip


def _slopes(length: Floats) -> Floats:
    """∂V/∂coefficient (N, 3): the parabola is linear and homogeneous in its coefficients."""
    return np.column_stack([parabola(column, length)[0] for column in np.eye(len(COEFFICIENTS))])
