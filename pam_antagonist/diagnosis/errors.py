"""Errors of the three models on held-out data, with the keys of ``report.json`` of ``close_loop``."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist import shown
from pam_antagonist.diagnosis.thresholds import AT_NOISE, ESTIMATOR_WORSE
from pam_antagonist.estimation import metrics
from pam_antagonist.estimation.metrics import ChannelErrors, channel_errors
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, block_noise

Floats = NDArray[np.float64]
_FILTER = "the filter's"
_FEWEST = 100
"""Readings from which the noise of a sensor is told."""


class Noise(NamedTuple):
    """Standard deviation of one reading of each sensor by its noise; 0 where it is not known."""

    angle: float = 0.0  # [deg]
    torque: float = 0.0  # [N m]
    pressure: float = 0.0  # of both sensors, root mean square [Pa]


class ErrorChange(NamedTuple):
    """One error with a rig file and with another one."""

    what: str
    unit: str
    before: float
    after: float
    noise: float

    @property
    def is_of_filter(self) -> bool:
        """Whether it is the filter's, and not that of the model alone."""
        return self.what.startswith(_FILTER)

    @property
    def ratio(self) -> float:
        """What is above the sensor's noise after, over what was above it before; 1 where both are at the noise.

        A reading has the noise of its sensor, which no rig file takes away. An error that is no number is larger than
        any other.
        """
        noise, after = self.noise, self.after
        if not math.isfinite(after):
            return 1.0 if math.isinf(after) and math.isinf(self.before) else math.inf
        least = max(noise * float(np.sqrt(AT_NOISE**2 - 1.0)), 1e-12)
        excess = (float(np.sqrt(max(rmse**2 - noise**2, 0.0))) for rmse in (after, self.before))
        now, was = (max(value, least) for value in excess)
        return max(now / was, 1e-12)

    def in_words(self, where: str = " ") -> str:
        """The error after and before."""
        after, before = (shown.error_in_words(value, self.unit, 3) for value in (self.after, self.before))
        return f"{self.what} error{where}{after}, before {before}"


@dataclass(frozen=True)
class Innovations:
    """Consistency of the estimator."""

    nis_mean: float  # mean normalised innovation squared; 2 is right
    whiteness_p: float  # probability of such an autocorrelation in white innovations
    largest_correlation: float


@dataclass(frozen=True)
class Sliding:
    """The torque's error of a driven joint while it slides and while it sticks."""

    rmse_sliding_nm: float | None  # while it slides [N m]; None where it never does
    rmse_sticking_nm: float | None  # while it sticks [N m]; None likewise
    sliding_share: float


@dataclass(frozen=True)
class Errors:
    """Errors of one model on held-out data."""

    angle: ChannelErrors | None
    torque: ChannelErrors | None
    rmse_pa: tuple[float, float]  # of both pressures [Pa]
    mean_rmse_pa: float | None = None  # of the mean of both pressures [Pa]; None where it was not judged
    sliding: Sliding | None = None  # of the torque; None where sliding and sticking were not separated
    innovation: Innovations | None = None
    along_pressures_deg: float | None = None  # of the angle where the measured pressures drive the joint; None likewise
    noise: Noise = Noise()  # of the readings that were compared

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        mean = {} if self.mean_rmse_pa is None else {"mean_rmse_pa": self.mean_rmse_pa}
        sliding = {} if self.sliding is None else vars(self.sliding)
        out: dict[str, Any] = {
            "angle": self.angle,
            "torque": None if self.torque is None else {**self.torque.to_json(), **sliding},
            "pressure": {"rmse_pa": self.rmse_pa, **mean},
        }
        further = {"along_pressures_deg": self.along_pressures_deg, "innovation": self.innovation}
        return {**out, **{name: value for name, value in further.items() if value is not None}}


@dataclass(frozen=True)
class ModelErrors:
    """Errors of the three models."""

    as_configured: Errors
    recalibrated: Errors
    extended: Errors

    @property
    def all(self) -> tuple[Errors, Errors, Errors]:
        """In the order of the table's columns."""
        return self.as_configured, self.recalibrated, self.extended


@dataclass(frozen=True)
class RigErrors:
    """Errors on held-out data with one rig file."""

    model: Errors
    ukf: Errors | None = None  # of the estimator over all recordings; None where it was not run
    each: tuple[Errors, ...] = ()

    @classmethod
    def total(cls, model: Errors, each: Sequence[tuple[Errors | None, int]]) -> RigErrors:
        """Errors over several recordings.

        `each`: of the estimator in each recording, and its samples; None where it was not run.
        """
        known = [(errors, samples) for errors, samples in each if errors is not None]
        if not known:
            return cls(model)
        errors, samples = zip(*known, strict=True)
        return cls(model, total_of(errors, samples), errors if len(errors) > 1 else ())

    def larger(self, now: RigErrors, share: float, of_model: float | None = None) -> tuple[str, ...]:
        """Errors with another file whose excess over noise is more than a share of that with this one, in words.

        `share`: largest ratio; in a single recording, chance may enlarge it. `of_model`: the same for errors of the
        model alone; default: share.
        """
        out = {
            one.what: one.in_words()
            for one in self.changes(now)
            if one.ratio > (share if of_model is None or one.is_of_filter else of_model)
        }
        for before, after in zip(self.each, now.each, strict=False):
            for one in _changes(_FILTER, before, after):
                if one.ratio > max(share, ESTIMATOR_WORSE):
                    out.setdefault(one.what, one.in_words(" in one recording "))
        return tuple(out.values())

    def outside(self, least: float) -> str:
        """Of which channels the filter's 95 % intervals hold less than a share of what was measured, in words."""
        each = () if self.ukf is None else (("angles", self.ukf.angle), ("torques", self.ukf.torque))
        shares = [(what, one.coverage95) for what, one in each if one is not None and one.coverage95 is not None]
        return shown.listed([f"{shown.percent(share)} of the {what}" for what, share in shares if share < least])

    def deciding(self, now: RigErrors) -> list[float]:
        """Ratios of the filter's errors with another file to those with this one; of the model's if it was not run."""
        changes = self.changes(now)
        return [one.ratio for one in changes if one.is_of_filter] or [one.ratio for one in changes]

    def in_words(self, now: RigErrors) -> str:
        """The error that decides and that changes most."""
        changes = self.changes(now)
        one = min([one for one in changes if one.is_of_filter] or changes, key=lambda one: one.ratio)
        after, before = (shown.error_in_words(value, one.unit, 3) for value in (one.after, one.before))
        return f"{one.what} error {after} instead of {before}"

    def changes(self, now: RigErrors) -> list[ErrorChange]:
        """Each error with this file and with another one, the filter's first."""
        out = [] if self.ukf is None or now.ukf is None else _changes(_FILTER, self.ukf, now.ukf)
        out += _changes("the model's", self.model, now.model)
        before, after = (float(np.sqrt(np.mean(np.square(one.rmse_pa)))) / 1e3 for one in (self.model, now.model))
        if math.isnan(before + after):  # no pressure was measured
            return out
        return [*out, ErrorChange("the model's pressure", " kPa", before, after, self.model.noise.pressure / 1e3)]


def _changes(whose: str, before: Errors, after: Errors) -> list[ErrorChange]:
    """The errors of angle and torque before and after, where they were measured."""
    named = ("angle", "°", before.angle, after.angle), ("torque", " N m", before.torque, after.torque)
    return [
        ErrorChange(f"{whose} {what}", unit, old.rmse, new.rmse, getattr(before.noise, what))
        for what, unit, old, new in named if old and new
    ]  # fmt: skip


def errors_of(measured: Floats, values: Floats, channels: Collection[int]) -> Errors:
    """Errors of all channels.

    `measured`: (N, 4) in the order of ``CHANNELS``, NaN where nothing was measured. `values`: of a model or the
    estimator (N, 4), NaN where a delay leaves none.
    """
    pressures = metrics.pressure_errors(measured[:, PRESSURE_1:], values[:, PRESSURE_1:]).rmse_pa
    mean = metrics.rmse((values - measured)[:, PRESSURE_1:].mean(axis=1))
    return Errors(
        channel_errors(measured[:, ANGLE], values[:, ANGLE], "deg") if ANGLE in channels else None,
        channel_errors(measured[:, TORQUE], values[:, TORQUE], "nm") if TORQUE in channels else None,
        pressures,
        mean if max(pressures) < math.inf else math.inf,
        noise=_noise_of(measured),
    )


def _noise_of(measured: Floats) -> Noise:
    angle, torque, *pressures = (
        block_noise(values, 1) if np.isfinite(values).sum() >= _FEWEST else 0.0 for values in measured.T
    )
    return Noise(float(np.degrees(angle)), torque, float(np.sqrt(np.mean(np.square(pressures)))))


def total_of(parts: Sequence[Errors], samples: Sequence[int]) -> Errors:
    """Errors over several recordings: root mean squares over all samples, the largest of the other figures."""
    if len(parts) == 1:
        return parts[0]

    def mean(values: Sequence[float], counts: Sequence[int]) -> float:
        # A recording of which no value was held out does not count.
        known = ~np.isnan(values)
        if not known.any():
            return math.nan
        return float(np.sqrt(np.average(np.square(values)[known], weights=np.asarray(counts)[known])))

    def channel(own: Sequence[ChannelErrors | None]) -> ChannelErrors | None:
        known = [(item, count) for item, count in zip(own, samples, strict=True) if item is not None]
        if not known:
            return None
        items, counts = zip(*known, strict=True)
        largest, ratio = max(item.largest for item in items), max(item.ratio for item in items)
        inside = [(item.coverage95, count) for item, count in known if item.coverage95 is not None]
        every = sum(count for _, count in inside)
        covered = sum(share * count for share, count in inside) / every if every else None
        return ChannelErrors(items[0].unit, mean([item.rmse for item in items], counts), largest, ratio, covered)

    return Errors(
        channel([part.angle for part in parts]),
        channel([part.torque for part in parts]),
        (mean([part.rmse_pa[0] for part in parts], samples), mean([part.rmse_pa[1] for part in parts], samples)),
        None if None in (means := [part.mean_rmse_pa for part in parts]) else mean(means, samples),  # type: ignore[arg-type]
        noise=Noise(*(mean(values, samples) for values in zip(*(part.noise for part in parts), strict=True))),
    )
