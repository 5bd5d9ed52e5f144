"""Errors of an estimate or a model against the measured values, with the keys of every ``report.json``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import metrics
from pam_antagonist.rig import Reading

FloatArray = NDArray[np.float64]


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
class ModelErrors:
    """Errors of the model alone; None where a channel was not measured."""

    angle: ChannelErrors | None
    torque: ChannelErrors | None
    pressure: PressureErrors


@dataclass(frozen=True)
class FilterErrors(ModelErrors):
    """Errors of the filter, which may estimate the external torque as well."""

    external_torque: ChannelErrors | None


def channel_errors(
    measured: FloatArray | None,
    value: FloatArray,
    unit: Literal["deg", "nm"],
    variance: FloatArray | None = None,
    reading: Reading = metrics.EXACT,
) -> ChannelErrors | None:
    """Errors of an angle [rad] or torque [N m]; None where it was not measured.

    `measured`: (N,), NaN where there is no value. `value`: of the estimate or the model (N,). `variance`: of the
    estimate (N,), to check its 95 % interval.
    """
    if measured is None or not np.isfinite(measured).any():
        return None
    if variance is None and not np.isfinite(value).all():
        return ChannelErrors(unit, math.inf, math.inf, math.inf)  # a model that diverged has no error that is a number
    error, scale = value - measured, math.degrees(1.0) if unit == "deg" else 1.0
    rmse, coverage, width = metrics.rmse(error), None, None
    if variance is not None:
        coverage = metrics.coverage(error, variance, reading)
        width = metrics.rmse(metrics.interval_half_width(variance, reading)) / rmse if rmse > 0.0 else None
    largest, ratio = metrics.max_error(error) * scale, metrics.estimation_ratio(error, measured)
    return ChannelErrors(unit, rmse * scale, largest, ratio, coverage, width)


def pressure_errors(measured: FloatArray, value: FloatArray) -> PressureErrors:
    """Errors of both pressures, measured and estimated (N, 2) [Pa]."""
    if not np.isfinite(value).all():
        return PressureErrors(*((math.inf, math.inf),) * 3)
    error = value - measured
    return PressureErrors(
        (metrics.rmse(error[:, 0]), metrics.rmse(error[:, 1])),
        (metrics.max_error(error[:, 0]), metrics.max_error(error[:, 1])),
        (
            metrics.estimation_ratio(error[:, 0], measured[:, 0]),
            metrics.estimation_ratio(error[:, 1], measured[:, 1]),
        ),
    )
