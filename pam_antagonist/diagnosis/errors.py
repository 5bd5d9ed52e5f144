"""Errors of the three models on held-out data, with the keys of ``report.json`` of ``close_loop``."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist import shown
from pam_antagonist.diagnosis.thresholds import ESTIMATOR_WORSE
from pam_antagonist.estimation import metrics
from pam_antagonist.estimation.metrics import ChannelErrors, channel_errors
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE

Floats = NDArray[np.float64]
_FILTER = "the filter's"
_Pair = tuple[str, str, float, float]
"""Name of an error, its unit, and the error before and after."""


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

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        mean = {} if self.mean_rmse_pa is None else {"mean_rmse_pa": self.mean_rmse_pa}
        sliding = {} if self.sliding is None else vars(self.sliding)
        out: dict[str, Any] = {
            "angle": self.angle,
            "torque": None if self.torque is None else {**self.torque.to_json(), **sliding},
            "pressure": {"rmse_pa": self.rmse_pa, **mean},
        }
        return out if self.innovation is None else {**out, "innovation": self.innovation}


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
        """Errors with another file that are more than a share of those with this one, in words.

        `share`: largest ratio of an error to the one with this file; in a single recording, chance may enlarge it.
        `of_model`: the same for errors of the model alone; default: share.
        """
        # An error that is no number is larger than any.
        out = {
            what: (" ", unit, before, after)
            for what, unit, before, after in self._pairs(now)
            if not after <= (share if of_model is None or what.startswith(_FILTER) else of_model) * before
        }
        most = max(share, ESTIMATOR_WORSE)
        for one, other in zip(self.each, now.each, strict=False):
            for what, unit, before, after in _pairs(_FILTER, one, other):
                if not after <= most * before:
                    out.setdefault(what, (" in one recording ", unit, before, after))
        return tuple(
            f"{what} error{where}{shown.error_in_words(after, unit, 3)}, before {shown.error_in_words(before, unit, 3)}"
            for what, (where, unit, before, after) in out.items()
        )

    def ratio(self, now: RigErrors) -> float:
        """Geometric mean of the ratios of errors with another file to those with this one."""
        ratios = np.array([_finite(after) / _finite(before) for *_, before, after in self._pairs(now)])
        of_filter = [what.startswith(_FILTER) for what, *_ in self._pairs(now)]
        means = [float(np.exp(np.mean(np.log(some)))) for some in (ratios, ratios[of_filter]) if len(some)]
        return max(means)

    def in_words(self, now: RigErrors) -> str:
        """The first error that was measured: the filter's, if it was run, of the angle, if it was measured."""
        what, unit, before, after = self._pairs(now)[0]
        return f"{what} error {shown.error_in_words(after, unit, 3)} instead of {shown.error_in_words(before, unit, 3)}"

    def _pairs(self, now: RigErrors) -> list[_Pair]:
        """Each error with this file and with another one, the most important first."""
        out = [] if self.ukf is None or now.ukf is None else _pairs(_FILTER, self.ukf, now.ukf)
        out += _pairs("the model's", self.model, now.model)
        before, after = (float(np.sqrt(np.mean(np.square(one.rmse_pa)))) / 1e3 for one in (self.model, now.model))
        # NaN where no pressure was measured.
        return out if np.isnan(before + after) else [*out, ("the model's pressure", " kPa", before, after)]


def _pairs(whose: str, before: Errors, after: Errors) -> list[_Pair]:
    """The errors of angle and torque before and after, where they were measured."""
    named = ("angle", "°", before.angle, after.angle), ("torque", " N m", before.torque, after.torque)
    return [(f"{whose} {what}", unit, old.rmse, new.rmse) for what, unit, old, new in named if old and new]


def _finite(value: float) -> float:
    """An error above 0, very large where the model diverges."""
    return max(value, 1e-12) if np.isfinite(value) else 1e12


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
    )


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
        return ChannelErrors(items[0].unit, mean([item.rmse for item in items], counts), largest, ratio)

    return Errors(
        channel([part.angle for part in parts]),
        channel([part.torque for part in parts]),
        (mean([part.rmse_pa[0] for part in parts], samples), mean([part.rmse_pa[1] for part in parts], samples)),
        mean([part.mean_rmse_pa or 0.0 for part in parts], samples),
    )
