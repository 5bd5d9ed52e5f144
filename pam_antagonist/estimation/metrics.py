"""Figures of merit of an estimate or a model: its errors as report.json has them, and whether its covariance fits them.

The three figures of Shin, Ibayashi and Kogiso (2022), section "Model Validation", are

    I(z) = sqrt(sum z^2 / N)          root mean square error,
    M(z) = max |z|                    largest error,
    Q(z, xi) = M(z) / (max xi - min xi)   largest error over the range of the measured signal.

The paper sums N + 1 samples and divides by N; here the sum is divided by the number of samples.
The rest judges the filter's own covariance: the coverage of its intervals, the normalised innovation
squared (NIS) against its chi-square law, and the whiteness of the innovations.

Samples that are not finite (nothing was measured, or nothing was used) are left out throughout. If none is left, the
result is NaN.

`error` is the estimate minus the measurement (N,), `variance` that of the estimate (N,), `reference` has the errors of
the reference sensor, all in one unit. `level` is the probability of an interval. `series` is (N, m), one row a sample
at a constant step; rows with NaN are left out.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincc, gammaincinv, ndtr, ndtri

from pam_antagonist.estimation.divergence import has_diverged
from pam_antagonist.rig import Reading

FloatArray = NDArray[np.float64]

EXACT = Reading()
"""A reference without error."""
_FEWEST = 10.0
"""Independent values that any series has."""
_EVEN = 200.0
"""If half a step of a converter exceeds so many standard deviations of the normal error, only the step counts."""


def _finite(values: ArrayLike) -> FloatArray:
    array = np.asarray(values, dtype=np.float64).ravel()
    return array[np.isfinite(array)]


def _complete(series: FloatArray) -> NDArray[np.bool_]:
    """Rows (N, m) in which everything is finite, (N,)."""
    return np.asarray(np.isfinite(series).all(axis=1))


def rmse(error: ArrayLike) -> float:
    """Root mean square of an error: the paper's I, divided by the number of samples."""
    z = _finite(error)
    return float(np.sqrt(np.mean(z * z))) if z.size else float("nan")


def max_error(error: ArrayLike) -> float:
    """Largest absolute error: the paper's M. `error`: estimate minus measurement, (N,), in any unit."""
    z = _finite(error)
    return float(np.max(np.abs(z))) if z.size else float("nan")


def estimation_ratio(error: ArrayLike, signal: ArrayLike) -> float:
    """Largest error over the range of the measured signal: the paper's Q, as a fraction.

    `signal`: the measured signal, (N,), in the unit of `error`.
    """
    measured = _finite(signal)
    span = float(np.ptp(measured)) if measured.size else 0.0
    return max_error(error) / span if span > 0.0 else float("nan")


@functools.lru_cache(maxsize=8)
def _quantiles(level: float) -> tuple[FloatArray, FloatArray]:
    """Two-sided quantile of a standard normal error plus a uniform one from -r to r, as a table over r; both (K,)."""
    ratio = np.concatenate(([0.0], np.geomspace(0.01, _EVEN, 600)))

    def integral(x: FloatArray) -> FloatArray:  # of the normal distribution function
        return np.asarray(x * ndtr(x) + np.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi))

    low, high = np.zeros_like(ratio), float(ndtri(0.5 * (1.0 + level))) + ratio
    for _ in range(60):
        middle = 0.5 * (low + high)
        with np.errstate(invalid="ignore"):
            below = (integral(middle + ratio) - integral(middle - ratio)) / (2.0 * ratio)
        below[0] = ndtr(middle[0])
        enough = 2.0 * below - 1.0 >= level
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return ratio, 0.5 * (low + high)


LONGEST_DELAY = 0.2
"""[s] Largest delay of the search."""


def delay(signal: ArrayLike, estimate: ArrayLike, period: float) -> float:
    """Delay of an estimate: the shift with the least mean square error against the signal.

    `signal`: true values (N,), in any unit. `estimate`: of the signal (N,), in the same unit. `period`: between two
    values [s]. Returns 0 to ``LONGEST_DELAY`` [s], NaN where the signal never changes.
    """
    true, seen = np.asarray(signal, dtype=np.float64), np.asarray(estimate, dtype=np.float64)
    known = true[np.isfinite(true)]
    if known.size == 0 or not np.ptp(known) > 0.0:
        return float("nan")
    lags = range(min(round(LONGEST_DELAY / period) + 1, len(true)))
    apart = [_finite(seen[lag:] - true[: len(true) - lag]) for lag in lags]
    return int(np.argmin([float(np.mean(z * z)) if z.size else math.inf for z in apart])) * period


def interval_half_width(variance: ArrayLike, reference: Reading = EXACT, level: float = 0.95) -> FloatArray:
    """Half width of the interval in which a *measured* value is expected around the estimate.

    The interval includes the errors of the reference sensor. Its noise adds to the variance of the estimate, and its
    converter rounds by half a step at most.

    Returns the quantile of a normal error plus a uniform one of a converter's step, (N,): for 95 %, this is 1.96
    sqrt(variance + std^2) without a step, and 0.475 step with nothing but a step.
    """
    std = np.sqrt(np.asarray(variance, dtype=np.float64) + reference.std**2)
    if reference.step == 0.0:
        return np.asarray(float(ndtri(0.5 * (1.0 + level))) * std)
    half = 0.5 * reference.step
    ratio, quantile = _quantiles(level)
    with np.errstate(divide="ignore"):
        relative = half / std
    # Far beyond the table the normal part is too small to matter.
    return np.asarray(np.where(relative < _EVEN, std * np.interp(relative, ratio, quantile), level * half))


def coverage(error: ArrayLike, variance: ArrayLike, reference: Reading = EXACT, level: float = 0.95) -> float:
    """Share of the samples whose measured value lies inside the estimate's interval.

    Returns a share between 0 and 1 (`level` if the covariance is right), NaN if no sample is finite.
    """
    z = np.asarray(error, dtype=np.float64)
    half = interval_half_width(variance, reference, level)
    known = np.isfinite(z) & np.isfinite(half)
    return float(np.mean(np.abs(z[known]) <= half[known])) if known.any() else float("nan")


def nees(error: ArrayLike, variance: ArrayLike, reference: Reading = EXACT) -> float:
    """Normalised estimation error squared of one quantity, the mean over the samples.

    The NIS tests the pressures. The NEES tests an estimated quantity that was measured as well (Bar-Shalom, Li and
    Kirubarajan 2001, section 5.4). The variance of the reference sensor adds to that of the estimate.

    Returns 1 where the covariance is right, more where it is too small; NaN if no sample is finite.
    """
    z = np.asarray(error, dtype=np.float64)
    total = np.asarray(variance, dtype=np.float64) + reference.error**2
    known = np.isfinite(z) & np.isfinite(total) & (total > 0.0)
    return float(np.mean(z[known] ** 2 / total[known])) if known.any() else float("nan")


def chi_square_bounds(dof: int, level: float = 0.95) -> tuple[float, float]:
    """Two-sided bounds of a chi-square variable, the same probability left out on either side.

    Returns (lower, upper); for two degrees of freedom and 95 %: (0.0506, 7.378).
    """
    tail = 0.5 * (1.0 - level)
    return 2.0 * float(gammaincinv(0.5 * dof, tail)), 2.0 * float(gammaincinv(0.5 * dof, 1.0 - tail))


@dataclass(frozen=True)
class NisConsistency:
    """How the normalised innovation squared compares with its chi-square law."""

    mean: float  # mean over the samples that used both pressures; 2 where the covariance is right
    in_95: float  # share of all samples inside the two-sided 95 % bounds for their number of pressures; 0.95 is right
    samples: int


def nis_consistency(nis: ArrayLike, innovation: ArrayLike) -> NisConsistency:
    """Compare the normalised innovations squared with the chi-square law that a consistent filter obeys.

    Values below the lower bound count as outside: a filter whose covariance is far too large is inconsistent as well
    (Bar-Shalom, Li and Kirubarajan 2001, section 5.4).

    `nis`: normalised innovation squared, (N,), NaN where nothing was used. `innovation`: innovations, (N, m), NaN where
    that measurement was not used. Returns mean, share within the 95 % bounds and number of samples.
    """
    value = np.asarray(nis, dtype=np.float64)
    used = np.isfinite(np.asarray(innovation, dtype=np.float64))
    full = used.shape[1]
    dof = used.sum(axis=1)
    judged = np.isfinite(value) & (dof > 0)
    inside = np.zeros(value.shape, dtype=bool)
    for count in range(1, full + 1):
        lower, upper = chi_square_bounds(count)
        inside |= (dof == count) & (value >= lower) & (value <= upper)
    complete = value[judged & (dof == full)]
    return NisConsistency(
        mean=float(complete.mean()) if complete.size else float("nan"),
        in_95=float(inside[judged].mean()) if judged.any() else float("nan"),
        samples=int(judged.sum()),
    )


def normalised_innovation(innovation: ArrayLike, covariance: ArrayLike) -> FloatArray:
    """Innovations in units of their own standard deviation: L^-1 nu with S = L L^T.

    `innovation`: (N, 2), NaN where a measurement was not used. `covariance`: innovation covariance S, (N, 2, 2).
    Returns (N, 2), NaN in both columns where either measurement was not used.
    """
    nu = np.asarray(innovation, dtype=np.float64)
    s = np.asarray(covariance, dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        l11 = np.sqrt(s[:, 0, 0])
        l21 = s[:, 1, 0] / l11
        l22 = np.sqrt(s[:, 1, 1] - l21 * l21)
        first = nu[:, 0] / l11
        second = (nu[:, 1] - l21 * first) / l22
    out = np.column_stack((first, second))
    out[~_complete(out)] = np.nan
    return out


def autocorrelation(series: ArrayLike, lags: int) -> FloatArray:
    """Autocorrelation matrices of a series about zero, over the pairs of samples that are both present.

    The mean is not removed: innovations of a right model have mean 0, and an offset is a correlation at every lag.

    Returns (lags + 1, m, m): mean of e(t) e(t - k)^T for k = 0..lags, NaN without a pair.
    """
    e = np.asarray(series, dtype=np.float64)
    present = _complete(e)
    e = np.where(present[:, None], e, 0.0)
    out = np.full((lags + 1, e.shape[1], e.shape[1]), np.nan)
    for k in range(min(lags, len(e) - 1) + 1):
        pairs = int(np.count_nonzero(present[k:] & present[: len(e) - k]))
        if pairs:
            out[k] = e[k:].T @ e[: len(e) - k] / pairs
    return out


def correlation_length(residual: FloatArray, fewest: float = _FEWEST) -> float:
    """Values of a series per independent one: 1 + 2 Σ ρ_k over the initial positive pairs (Geyer 1992).

    `residual`: (N,), NaN where there is nothing. `fewest`: independent values that any series has. Returns at least 1.
    """
    known = np.isfinite(residual)
    rho = _lagged(np.where(known, residual, 0.0))
    if rho[0] <= 0.0:
        return 1.0
    if not known.all():
        # Each lag as if all its pairs were there.
        whole = np.arange(len(rho), 0, -1) / len(rho)
        rho = rho * whole / np.maximum(_lagged(known.astype(float)) / known.sum(), 0.5 / known.sum())
    pairs = (rho[1:-1:2] + rho[2::2][: len(rho[1:-1:2])]) / rho[0]
    ends = np.flatnonzero(pairs <= 0.0)
    total = float(pairs[: ends[0] if len(ends) else len(pairs)].sum())
    return float(np.clip(1.0 + 2.0 * total, 1.0, max(1.0, len(residual) / fewest)))


def _lagged(series: FloatArray) -> FloatArray:
    """Sums of products of a series (N,) with itself, by lag (N,)."""
    power = np.abs(np.fft.rfft(series, 2 * len(series))) ** 2
    return np.asarray(np.fft.irfft(power)[: len(series)])


def largest_autocorrelation(series: ArrayLike, lags: int = 20) -> float:
    """Largest autocorrelation of any column over the lags, with its sign.

    It measures the size of the correlation, while :func:`whiteness_p` tests whether there is one.

    Returns between -1 and 1; NaN where there are not enough samples.
    """
    gamma = np.diagonal(autocorrelation(series, lags), axis1=1, axis2=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        rho = (gamma[1:] / gamma[0]).ravel()
    rho = rho[np.isfinite(rho)]
    return float(rho[np.argmax(np.abs(rho))]) if rho.size else float("nan")


def whiteness_p(series: ArrayLike, lags: int = 20) -> float:
    """p-value of the hypothesis that a series is white: a multivariate portmanteau test.

    Hosking's statistic (J. Am. Stat. Assoc. 75, 1980) sum_k n_k tr(G_k^T G_0^-1 G_k G_0^-1), with G_k the
    autocorrelation at lag k over its n_k pairs, is chi-square with m^2 `lags` degrees of freedom for a white series.
    Tens of thousands of samples make it sensitive: a p-value of 0 says that a correlation is certain, not that it is
    large.

    `series`: (N, m), one row a sample at a constant step, e.g. normalised innovations; rows with NaN are left out.
    Returns p-value between 0 and 1, NaN for fewer than 5 x `lags` samples or a series that does not vary.
    """
    e = np.asarray(series, dtype=np.float64)
    present = _complete(e)
    if int(present.sum()) < 5 * lags:
        return float("nan")
    gamma = autocorrelation(e, lags)
    if not np.linalg.matrix_rank(gamma[0]) == e.shape[1]:
        return float("nan")
    inverse = np.linalg.inv(gamma[0])
    statistic, dof = 0.0, 0
    for k in range(1, lags + 1):
        pairs = int(np.count_nonzero(present[k:] & present[: len(e) - k]))
        if pairs:
            statistic += pairs * float(np.trace(gamma[k].T @ inverse @ gamma[k] @ inverse))
            dof += e.shape[1] ** 2
    return float(gammaincc(0.5 * dof, 0.5 * statistic)) if dof else float("nan")


@dataclass(frozen=True)
class ChannelErrors:
    """Errors of an angle or a torque."""

    unit: Literal["deg", "nm"]
    rmse: float
    largest: float
    ratio: float
    # share of the measured values in the filter's 95 % interval; None for a model without one.
    coverage95: float | None = None
    # half width of that interval (root mean square) over `rmse`, 1.96 where it is right; None likewise.
    width: float | None = None
    delay_s: float | None = None  # delay of the estimated external torque [s]; None for other channels
    mean: float | None = None  # mean error, in the unit; not in ``report.json``
    # independent values among those that the coverage counts; None likewise.
    independent: float | None = None

    def to_json(self) -> dict[str, float]:
        """``rmse_deg`` or ``rmse_nm``, and so on."""
        out = {f"rmse_{self.unit}": self.rmse, f"max_{self.unit}": self.largest, "q": self.ratio}
        shown = {"coverage95": self.coverage95, "interval_over_rmse": self.width, "delay_s": self.delay_s}
        return out | {name: value for name, value in shown.items() if value is not None}


@dataclass(frozen=True)
class PressureErrors:
    """Errors of both muscles' pressures, as :class:`ChannelErrors` has them."""

    rmse_pa: tuple[float, float]  # root mean square error (2,) [Pa]
    max_pa: tuple[float, float]  # largest error (2,) [Pa]
    q: tuple[float, float]  # largest error over the range of the measured pressure (2,) [-]


@dataclass(frozen=True)
class ModelAloneErrors:
    """Errors of the model alone; None where a channel was not measured."""

    angle: ChannelErrors | None
    torque: ChannelErrors | None
    pressure: PressureErrors


@dataclass(frozen=True)
class FilterErrors(ModelAloneErrors):
    """Errors of the filter, which may estimate the external torque as well."""

    external_torque: ChannelErrors | None


def channel_errors(
    measured: FloatArray | None,
    value: FloatArray,
    unit: Literal["deg", "nm"],
    variance: FloatArray | None = None,
    reading: Reading = EXACT,
) -> ChannelErrors | None:
    """Errors of an angle [rad] or torque [N m]; None where it was not measured.

    Rows in which either has no value are left out.

    `measured`: (N,), NaN where there is no value. `value`: of the estimate or the model (N,), likewise. `variance`: of
    the estimate (N,), to check its 95 % interval.
    """
    known = None if measured is None else np.isfinite(measured)
    if measured is None or known is None or not known.any():
        return None
    if variance is None and np.isnan(value[known]).all():
        return None
    if variance is None and has_diverged(value):
        return ChannelErrors(unit, math.inf, math.inf, math.inf)  # a model that diverged has no error that is a number
    error, scale = value - measured, math.degrees(1.0) if unit == "deg" else 1.0
    size, covered, width, independent = rmse(error), None, None, None
    if variance is not None:
        half = interval_half_width(variance, reading)
        covered = coverage(error, variance, reading)
        width = rmse(half) / size if size > 0.0 else None
        inside = np.where(np.isfinite(error) & np.isfinite(half), np.abs(error) <= half, np.nan)
        independent = _independent(inside)
    largest, ratio = max_error(error) * scale, estimation_ratio(error, measured)
    mean = None if math.isnan(size) else float(np.mean(_finite(error))) * scale
    return ChannelErrors(unit, size * scale, largest, ratio, covered, width, mean=mean, independent=independent)


def _independent(inside: FloatArray) -> float:
    """How many independent values a series (N,) has: 1 inside of the interval, 0 outside, NaN where nothing is."""
    known = np.isfinite(inside)
    count = int(known.sum())
    return count / correlation_length(inside - inside[known].mean()) if count else 0.0


def pressure_errors(measured: FloatArray, value: FloatArray) -> PressureErrors:
    """Errors of both pressures, measured and estimated (N, 2) [Pa]."""
    if has_diverged(value):
        return PressureErrors(*((math.inf, math.inf),) * 3)
    error = value - measured
    return PressureErrors(
        (rmse(error[:, 0]), rmse(error[:, 1])),
        (max_error(error[:, 0]), max_error(error[:, 1])),
        (
            estimation_ratio(error[:, 0], measured[:, 0]),
            estimation_ratio(error[:, 1], measured[:, 1]),
        ),
    )
