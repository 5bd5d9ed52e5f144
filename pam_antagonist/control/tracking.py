"""How well a reference is followed: the paper's tracking error and steady-state performance.

The paper calls zeta = reference - measured the actual tracking error, and 1 - max|zeta| / range the steady-state
tracking control performance, with the worst steady-state error and the range of the references (2.1° of 40°: 94.75 %).
It does not define a steady state. Here it is the last fifth of each step of the reference that lasts at least two
seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

STEADY_PART = 0.2
"""The part of a step, at its end, that counts as steady."""

SHORTEST_STEP = 2.0
"""Steps of the reference that are shorter have no steady part [s]."""

SETTLED = 0.05
"""A step has settled once the error stays below this part of the step's height."""


@dataclass(frozen=True)
class Step:
    """One constant stretch of the reference.

    Attributes:
        start_s: from the first sample [s].
        length_s: [s].
        reference: [rad] or [N m].
        steady_error: largest |reference - measured| in its steady part, in the same unit; NaN if it has none.
        settling_s: from its start until it has settled [s]; NaN if it has not, and for the first stretch.
    """

    start_s: float
    length_s: float
    reference: float
    steady_error: float
    settling_s: float


@dataclass(frozen=True)
class Tracking:
    """How a reference was followed, in rad or N m.

    Attributes:
        rmse: root mean square of reference - measured over all samples.
        worst_steady_error: largest steady error of all steps; NaN if no step was long enough.
        performance: 1 - worst_steady_error / range; NaN where either is not known.
    """

    steps: tuple[Step, ...]
    rmse: float
    largest: float
    worst_steady_error: float
    range: float
    performance: float


def held(stamp_ns: Stamps, reference_stamp_ns: Stamps, value: Floats) -> Floats:
    """The reference at each sample: the last one that was sent; NaN before the first.

    Args:
        stamp_ns: samples (N,) [ns].
        reference_stamp_ns: references (K,) [ns], not decreasing.
        value: of the references (K,).
    """
    last = np.searchsorted(reference_stamp_ns, stamp_ns, side="right") - 1
    if len(value) == 0:
        return np.full(len(stamp_ns), np.nan)
    return np.where(last >= 0, np.asarray(value, dtype=np.float64)[np.maximum(last, 0)], np.nan)


def yielded(torque: Floats, equilibrium: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
    """Angle (N,) [rad] of a spring and damper under a torque, from rest on: D dψ/dt + K (ψ − ψ_0) = d.

    Args:
        torque: d (N,) [N m].
        equilibrium: ψ_0 (N,) [rad]; NaN without a reference.
        stiffness: K (N,) [N m/rad].
        damping: D (N,) [N m s/rad].
        period: between two samples [s].
    """
    out, before = np.full(len(torque), np.nan), np.nan
    for k in np.flatnonzero(np.isfinite(torque + equilibrium + stiffness + damping)):
        viscous = damping[k] / period
        before = equilibrium[k] if np.isnan(before) else before
        before = (viscous * before + stiffness[k] * equilibrium[k] + torque[k]) / (viscous + stiffness[k])
        out[k] = before
    return out


def tracking(stamp_ns: Stamps, reference: Floats, measured: Floats) -> Tracking:
    """Judge how a measured angle or torque followed its reference.

    Args:
        stamp_ns: samples (N,) [ns].
        reference: (N,) [rad] or [N m]; NaN where there was none.
        measured: (N,) in the same unit; NaN where missing.
    """
    keep = np.isfinite(reference) & np.isfinite(measured)
    if not keep.any():
        raise ValueError("no sample has both a reference and a measurement")
    time = (stamp_ns[keep] - stamp_ns[keep][0]) * 1e-9
    wanted, error = reference[keep], np.abs(reference - measured)[keep]
    edges = np.flatnonzero(np.diff(wanted)) + 1
    starts = np.concatenate([[0], edges])
    ends = np.concatenate([edges, [len(wanted)]])
    steps = tuple(
        _step(time[a:b], float(wanted[a]), float(wanted[a - 1]) if a else float("nan"), error[a:b])
        for a, b in zip(starts, ends, strict=True)
    )
    steady = [step.steady_error for step in steps if np.isfinite(step.steady_error)]
    worst = max(steady, default=float("nan"))
    extent = float(wanted.max() - wanted.min())
    return Tracking(
        steps=steps,
        rmse=float(np.sqrt(np.mean(error**2))),
        largest=float(error.max()),
        worst_steady_error=worst,
        range=extent,
        performance=1.0 - worst / extent if extent > 0.0 else float("nan"),
    )


def _step(time: Floats, reference: float, before: float, error: Floats) -> Step:
    start, length = float(time[0]), float(time[-1] - time[0])
    steady = float("nan")
    if length >= SHORTEST_STEP:
        steady = float(error[time >= time[-1] - STEADY_PART * length].max())
    # If the last sample is outside the band, the step has not settled. The same holds without a band (NaN).
    outside = np.flatnonzero(~(error <= SETTLED * abs(reference - before)))
    settled = outside[-1] + 1 if len(outside) else 0
    settling = float(time[settled]) - start if settled < len(time) else float("nan")
    return Step(start, length, reference, steady, settling)
