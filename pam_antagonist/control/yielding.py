"""The largest torque to which a joint can yield like a spring and a damper, as far as its valves allow.

Under a torque d = A cos ωt from outside, the spring K and the damper D around ψ_0 would move by

    ψ_v = ψ_0 + Re[A e^{iωt} / (K + iωD)].

At this angle with the stiffness K, the joint needs two pressures at each moment
(:func:`~pam_antagonist.control.model_law.wanted_pressures`), and for these, by equation (4), two mass flows. The torque
is within reach if all pressures are in the box, and if a valve can pass each flow between fully closed and fully open,
by equation (5). Friction is neglected: its sign changes at once when the motion reverses, and no valve can follow that.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place
from pam_antagonist.control.model_law import Seen, wanted_pressures
from pam_antagonist.control.stiffness import Box
from pam_antagonist.errors import BadInput
from pam_antagonist.model import flow, lever_arm, muscle
from pam_antagonist.model.dynamics import PRESSURE_1
from pam_antagonist.model.parameters import SLOT_OF, STATES, SUPPLY

_leverage, _length, _length_rate, _volume = lever_arm.leverage, muscle.length, muscle.length_rate, muscle.volume
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

    Args:
        p: parameter vector (parameters.SIZE,) of a rig with valves.
        stiffness: K of the spring [N m/rad].
        damping: D [N m s/rad].
        frequency: of the torque [Hz].
        angle: ψ_0 of equilibrium [rad].
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
