"""How well a reference is followed, and the largest torque to which a joint can yield.

The paper calls zeta = reference - measured the actual tracking error, and 1 - max|zeta| / range the steady-state
tracking control performance, with the worst steady-state error and the range of the references (2.1° of 40°: 94.75 %).
It does not define a steady state. Here it is the last fifth of each step of the reference that lasts at least two
seconds.

Under a torque d = A cos ωt from outside, a spring K and a damper D around ψ_0 move by

    ψ_v = ψ_0 + Re[A e^{iωt} / (K + iωD)].

At this angle with the stiffness K, the joint needs two pressures at each moment
(:func:`~pam_antagonist.control.model_law.wanted_pressures`), and for these, by equation (4), two mass flows. The torque
is within reach if all pressures are in the box, and if a valve can pass each flow between fully closed and fully open,
by equation (5). Friction is neglected: its sign changes at once when the motion reverses, and no valve can follow that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import in_place
from pam_antagonist.control.model_law import Seen, wanted_pressures
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.model import flow, muscle
from pam_antagonist.model.dynamics import PRESSURE_1
from pam_antagonist.model.parameters import SLOT_OF, STATES, SUPPLY

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

STEADY_PART = 0.2
"""The part of a step, at its end, that counts as steady."""

SHORTEST_STEP = 2.0
"""Steps of the reference that are shorter have no steady part [s]."""

SETTLED = 0.05
"""A step has settled once the error stays below this part of the step's height."""


@dataclass(frozen=True)
class ReferenceStep:
    """One constant stretch of the reference."""

    start_s: float  # from the first sample [s]
    length_s: float  # [s]
    reference: float  # [rad] or [N m]
    steady_error: float  # largest |reference - measured| in its steady part, in the same unit; NaN if it has none
    settling_s: float  # from its start until it has settled [s]; NaN if it has not, and for the first stretch


@dataclass(frozen=True)
class Tracking:
    """How a reference was followed, in rad or N m."""

    steps: tuple[ReferenceStep, ...]
    rmse: float  # root mean square of reference - measured over all samples
    largest: float
    worst_steady_error: float  # largest steady error of all steps; NaN if no step was long enough
    range: float
    performance: float  # 1 - worst_steady_error / range; NaN where either is not known

    def numbers(self, unit: str) -> dict[str, Any]:
        """The keys of ``report.json``, with a unit in their names."""
        steps = [
            {
                "start_s": step.start_s, "length_s": step.length_s, f"reference_{unit}": step.reference,
                f"steady_error_{unit}": step.steady_error, "settling_s": step.settling_s,
            }
            for step in self.steps
        ]  # fmt: skip
        return {
            f"rmse_{unit}": self.rmse,
            f"max_{unit}": self.largest,
            f"worst_steady_error_{unit}": self.worst_steady_error,
            f"reference_range_{unit}": self.range,
            "steady_state_performance": self.performance,
            "steps": steps,
        }


def held(stamp_ns: Stamps, reference_stamp_ns: Stamps, value: Floats) -> Floats:
    """The reference at each sample (N,) [ns]: the last value of (K,) that was sent; NaN before the first."""
    last = np.searchsorted(reference_stamp_ns, stamp_ns, side="right") - 1
    if len(value) == 0:
        return np.full(len(stamp_ns), np.nan)
    return np.where(last >= 0, np.asarray(value, dtype=np.float64)[np.maximum(last, 0)], np.nan)


def yielded(torque: Floats, equilibrium: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
    """Angle (N,) [rad] of a spring and damper under a torque, from rest on: D dψ/dt + K (ψ − ψ_0) = d.

    Given d (N,) [N m], ψ_0 (N,) [rad], NaN without a reference, K (N,) [N m/rad], D (N,) [N m s/rad] and the period
    [s].
    """
    out, before = np.full(len(torque), np.nan), np.nan
    for k in np.flatnonzero(np.isfinite(torque + equilibrium + stiffness + damping)):
        viscous = damping[k] / period
        before = equilibrium[k] if np.isnan(before) else before
        before = (viscous * before + stiffness[k] * equilibrium[k] + torque[k]) / (viscous + stiffness[k])
        out[k] = before
    return out


def tracking(stamp_ns: Stamps, reference: Floats, measured: Floats) -> Tracking:
    """Judge how a measured angle or torque (N,) followed its reference (N,), NaN where either is missing."""
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


def _step(time: Floats, reference: float, before: float, error: Floats) -> ReferenceStep:
    start, length = float(time[0]), float(time[-1] - time[0])
    steady = float("nan")
    if length >= SHORTEST_STEP:
        steady = float(error[time >= time[-1] - STEADY_PART * length].max())
    # If the last sample is outside the band, the step has not settled. The same holds without a band (NaN).
    outside = np.flatnonzero(~(error <= SETTLED * abs(reference - before)))
    settled = outside[-1] + 1 if len(outside) else 0
    settling = float(time[settled]) - start if settled < len(time) else float("nan")
    return ReferenceStep(start, length, reference, steady, settling)


_leverage, _length, _length_rate, _volume = muscle.leverage, muscle.length, muscle.length_rate, muscle.volume
_flow_for, _valve_flow = flow.flow_for, flow.valve_flow

_PHASES = 24
"""Phases of a period that are checked; they meet the largest flow of a sinusoid within 1 %."""
_PHASE_STEP = 1e-3
"""[rad] Step of the phase to either side, for the rate of a pressure."""
_MISSING, _SOFT = 1e-5, 1e-3
"""[N m], [N m/rad] Larger deviations are out of reach; above the tolerance of the solution."""
_MOST = 20.0
"""[N m] Upper end of the search."""
_HALVINGS = 20


@in_place
def _wanted(phase, torque, angle, stiffness, viscous, box, held, x, p):
    """Angle [rad] and pressures [Pa] at a phase, and whether they are within reach; viscous is ω D."""
    square = stiffness * stiffness + viscous * viscous
    at = angle + torque * (stiffness * math.cos(phase) + viscous * math.sin(phase)) / square
    seen = Seen(at, 0.0, 0.0, box.lowest, box.lowest, torque * math.cos(phase), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    softest, stiffest, missing = wanted_pressures(False, at, stiffness, seen, 0.0, 1.0, box, held, x, p)
    within = abs(missing) <= _MISSING and softest - _SOFT <= stiffness <= stiffest + _SOFT
    return at, x[PRESSURE_1], x[PRESSURE_1 + 1], within


@in_place
def _follows(torque, angle, stiffness, damping, turn, box, held, x, p):
    """Whether the valves can follow a torque of this amplitude; ``turn`` is ω [rad/s]."""
    for k in range(_PHASES):
        phase = 2.0 * math.pi * k / _PHASES
        before = _wanted(phase - _PHASE_STEP, torque, angle, stiffness, turn * damping, box, held, x, p)
        after = _wanted(phase + _PHASE_STEP, torque, angle, stiffness, turn * damping, box, held, x, p)
        if not (before[3] and after[3]):
            return False
        at, velocity = 0.5 * (before[0] + after[0]), (after[0] - before[0]) * turn / (2.0 * _PHASE_STEP)
        sine, cosine, _ = _leverage(at, p)
        for i in range(2):
            first, second = (before[1], after[1]) if i == 0 else (before[2], after[2])
            pressure, rate = 0.5 * (first + second), (second - first) * turn / (2.0 * _PHASE_STEP)
            volume, slope = _volume(i, _length(i, sine, p), p)
            needed = _flow_for(rate, pressure, volume, slope * _length_rate(i, cosine, velocity, p), p)
            most, least = _valve_flow(i, 1.0, pressure, p[SUPPLY], p)[0], _valve_flow(i, 0.0, pressure, p[SUPPLY], p)[0]
            if not least <= needed <= most:
                return False
    return True


def largest_torque(
    p: np.ndarray, box: Box, stiffness: float, damping: float, frequency: float, angle: float = 0.0
) -> float:
    """Amplitude [N m] of the largest sinusoidal torque from outside that the valves can follow; 0: none.

    For a rig with valves, a spring K [N m/rad] and damper D [N m s/rad] around an angle ψ_0 [rad], at a frequency [Hz].
    """
    if not (stiffness > 0.0 and damping >= 0.0 and frequency > 0.0 and math.isfinite(stiffness + damping + frequency)):
        raise BadInput(
            f"stiffness {stiffness:g} N m/rad, damping {damping:g} N m s/rad at {frequency:g} Hz: expected finite "
            "numbers, the first and the last above 0, the damping 0 or more"
        )
    if p[SLOT_OF["regulator_rate_1"]] > 0.0:
        raise BadInput("a rig with pressure regulators: expected valves, whose flow the model knows")
    x, held = np.zeros(int(p[STATES])), np.full(2, 5.0)

    def follows(torque: float) -> bool:
        return bool(_follows(torque, angle, stiffness, damping, 2.0 * math.pi * frequency, box, held, x, p))

    low, high = 0.0, _MOST
    if follows(high):
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if follows(middle) else (low, middle)
    return low if low > _MOST * 0.5 ** (_HALVINGS - 1) else 0.0
