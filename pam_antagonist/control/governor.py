"""A reference governor between reference and control law, which keeps the joint within its limits.

At each sample it predicts the closed loop with a reference. It runs the model from the estimate, in coarse steps over a
short time, and computes the final state. All of these states have to keep every limit. If the wanted reference violates
one, the applied reference moves towards it only as far as the limits allow (a scalar reference governor: Gilbert,
Kolmanovsky and Tan 1995). The applied reference may always stay as it is.

The prediction is not exact. So each limit has a margin:

* **Uncertainty.** Angle, velocity, pressure and force have a margin of z standard deviations. z belongs to the declared
  level: a limit is kept with that probability (chance constraint), as far as the estimate's covariance is right.
* **Pushes.** A torque from outside of the declared size moves the joint by its size over the stiffness, before a valve
  can react. The pressures change as in closed chambers, with P V^k_2 constant. A larger push is not covered, and
  neither is the velocity at the begin of a push: no valve is quick enough.

With a torque as the reference, something else holds the joint. The prediction keeps the angle constant then, and the
limits of angle and velocity do not apply. The stops of ``safety/`` are independent of the governor.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.control.command import Mode
from pam_antagonist.control.model_law import ModelController, Seen, known_torque, voltage_towards, wanted_pressures
from pam_antagonist.control.stiffness import LEAST_FORCE, SUPPLY_MARGIN, Box
from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics, equilibrium, integration, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY, WITH_EFFECTS
from pam_antagonist.model.parameters import LENGTH, POLYTROPIC_VOLUME, RADIUS

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_leverage, _length, _volume = muscle.leverage, muscle.length, muscle.volume
_forces, _torque_slope, _rk4_step = dynamics.forces, dynamics.torque_slope, integration.rk4_step
_make_steady = equilibrium.make_steady

LIMITS = ("", "pressure 1", "pressure 2", "angle", "velocity", "contraction 1", "contraction 2", "force 1", "force 2")
"""Names of the limits, by the number that the prediction returns; 0 is none."""
_PRESSURE, _ANGLE, _VELOCITY, _CONTRACTION, _FORCE = 1, 3, 4, 5, 7
_PRESSURE_SCALE, _ANGLE_SCALE, _VELOCITY_SCALE, _CONTRACTION_SCALE, _FORCE_SCALE = 1e5, 0.1, 1.0, 0.05, 10.0
"""[Pa], [rad], [rad/s], [-], [N] Scales that make excesses of different quantities comparable."""
_STEP = 0.010
"""[s] Step of the prediction: the paper's joint swings at 20 to 25 Hz, and RK4 is stable up to 2.8 rad a step."""
_STEPS = 14
_LEAST_SHARE = 1.0 / 1024.0
_DIRECTIONS = ((1.0, 1.0), (1.0, 0.0), (0.0, 1.0))
"""Directions in which the applied reference moves: value and stiffness together, or only one of them."""
_LEAST_STIFFNESS = 1e-3
"""[N m/rad] Lower bound that prevents a division by zero."""


class JointLimits(NamedTuple):
    """Limits of a joint; infinite: no limit."""

    lowest_pressure: float  # of either muscle, absolute [Pa]
    highest_pressure: float  # likewise [Pa]
    angle: float = math.inf  # magnitude [rad]
    velocity: float = math.inf  # magnitude [rad/s]
    extension: float = math.inf  # largest (l − L_0)/L_0 of either muscle [-]
    contraction: float = math.inf  # largest (L_0 − l)/L_0 [-]
    force: float = 0.0  # least contraction force of either muscle [N]

    def inner(self, margin: float = SUPPLY_MARGIN, force: float = LEAST_FORCE) -> Box:
        """The box of a law whose governor keeps these limits, with a margin of pressures [Pa] and forces [N] to them.

        The law's integral and friction torque change the pressures of an admissible reference. The box bounds them in
        every case.
        """
        return Box(self.lowest_pressure + margin, self.highest_pressure - margin, self.force + force)


@inlined
def _worse(excess, which, new, number):
    return (new, number) if new > excess else (excess, which)


@inlined
def _excess(x, with_motion, of_angle, push, of_pressures, of_velocity, of_force, limits, p):
    """Largest excess of a state over its limits, and the number of that limit; negative if all are kept."""
    excess, which = -math.inf, 0
    spread = of_angle + push / max(-_torque_slope(x, p), _LEAST_STIFFNESS)
    if with_motion:
        new = (abs(x[ANGLE]) + spread - limits.angle) / _ANGLE_SCALE
        excess, which = _worse(excess, which, new, _ANGLE)
        new = (abs(x[VELOCITY]) + of_velocity - limits.velocity) / _VELOCITY_SCALE
        excess, which = _worse(excess, which, new, _VELOCITY)
    at = x[ANGLE]
    sine, cosine, _ = _leverage(at, p)
    force_margin = of_force / (p[RADIUS] * max(abs(cosine), 0.1))
    volumes = _volume(0, _length(0, sine, p), p)[0], _volume(1, _length(1, sine, p), p)[0]
    for side in (-1.0, 1.0):
        x[ANGLE] = at + side * spread
        sine, _, _ = _leverage(x[ANGLE], p)
        forces = _forces(x, p)
        for i in range(2):
            pulled = _length(i, sine, p)
            # A push compresses muscle i like a closed chamber. The change is small, so P V^k_2 is linearised.
            share = p[POLYTROPIC_VOLUME] * (volumes[i] / _volume(i, pulled, p)[0] - 1.0)
            pressure = x[PRESSURE_1 + i] * (1.0 + share)
            new = max(
                pressure + of_pressures[i] - limits.highest_pressure,
                limits.lowest_pressure - pressure + of_pressures[i],
            )
            excess, which = _worse(excess, which, new / _PRESSURE_SCALE, _PRESSURE + i)
            ratio = pulled / p[LENGTH] - 1.0
            new = max(ratio - limits.extension, -ratio - limits.contraction) / _CONTRACTION_SCALE
            excess, which = _worse(excess, which, new, _CONTRACTION + i)
            new = (limits.force + force_margin - forces[i]) / _FORCE_SCALE
            excess, which = _worse(excess, which, new, _FORCE + i)
    x[ANGLE] = at
    return excess, which


@in_place
def _predict(of_torque, value, stiffness, seen, integral, gains, box, limits, z, push, held, x, u, p, coarse, effects):
    """Excess over the limits in the final state and on the path to it, and which limit is violated most.

    The excesses of all steps on the path are summed. The largest one alone may belong to the present state, which no
    reference changes. `push`: torque from outside of the margins [N m]. `coarse`: parameter vector of the prediction,
    with its step for the friction, and locked for a torque. Others are as of :func:`wanted_pressures`.
    """
    bandwidth, _, approach = gains
    wanted_pressures(of_torque, value, stiffness, seen, integral, approach, box, held, x, p)
    first, second = x[PRESSURE_1], x[PRESSURE_2]
    of_angle = z * math.sqrt(seen.angle_variance)
    of_pressures = z * math.sqrt(seen.pressure_variance_1), z * math.sqrt(seen.pressure_variance_2)
    # The torque is a difference of two forces: each is assumed to have half of its variance.
    of_velocity, of_force = z * math.sqrt(seen.velocity_variance), z * math.sqrt(0.5 * seen.torque_variance)
    x[VELOCITY] = 0.0
    excess, which = _excess(x, not of_torque, of_angle, push, of_pressures, of_velocity, of_force, limits, p)
    at_end, total = max(excess, 0.0), 0.0
    _make_steady(x, seen.angle, seen.pressure_1, seen.pressure_2, held, p, 0.0, effects)
    x[VELOCITY] = 0.0 if of_torque else seen.velocity
    u[2] = known_torque(seen.external_torque, seen.external_variance)
    for _ in range(_STEPS):
        u[0] = voltage_towards(0, x[PRESSURE_1], first, x[ANGLE], x[VELOCITY], bandwidth, p, x)
        u[1] = voltage_towards(1, x[PRESSURE_2], second, x[ANGLE], x[VELOCITY], bandwidth, p, x)
        _rk4_step(x, u, coarse, _STEP, x, effects)
        new, number = _excess(x, not of_torque, of_angle, push, of_pressures, of_velocity, of_force, limits, p)
        total += max(new, 0.0)
        excess, which = _worse(excess, which, new, number)
    return at_end, total, which


class Governor:
    """Moves the applied reference towards the wanted one as far as the limits allow.

    `level`: probability of keeping a limit, 0.5 to 1. `push`: torque from outside that the margins include [N m].
    `active`: name of the limit that held the reference back at the last sample; empty: none. `held_back`: number of
    samples at which one did.
    """

    def __init__(self, p: np.ndarray, box: Box, limits: JointLimits, level: float = 0.999, push: float = 0.3) -> None:
        if not 0.5 <= level < 1.0:
            raise BadInput(f"governor's level {level!r}: expected a probability from 0.5 to below 1")
        if not (math.isfinite(push) and push >= 0.0):
            raise BadInput(f"push {push!r} N m: expected a finite torque, 0 or more")
        if not (limits.lowest_pressure < limits.highest_pressure and limits.angle > 0.0 and limits.velocity > 0.0):
            raise BadInput(f"limits {limits}: expected a lowest below the highest pressure, and motion above 0")
        self._p, self._box, self._limits, self._push = p, box, limits, push
        self._z = NormalDist().inv_cdf(level)
        free, locked = p.copy(), p.copy()
        free[par.FRICTION_STEP] = locked[par.FRICTION_STEP] = _STEP
        locked[par.LOCKED] = 1.0
        self._coarse = {Mode.ANGLE: free, Mode.TORQUE: locked}
        self._effects = None if p[par.PLAIN] != 0.0 else WITH_EFFECTS
        self._x, self._u, self._held = np.zeros(int(p[par.STATES])), np.zeros(3), np.zeros(2)
        self._quantity: Mode | None = None
        self._applied = self._wanted = (math.nan, math.nan)
        self._direction, self._shares = 0, [1.0] * len(_DIRECTIONS)
        self.active, self.held_back = "", 0
        # Compile now and not in the loop.
        self._excess(Mode.ANGLE, 0.0, math.nan, Seen(0.0, 0.0, 0.0, box.lowest, box.lowest), 0.0, (1.0, 1.0, 1.0))

    def reset(self) -> None:
        """Start at the estimate with the next reference."""
        self._quantity, self.active = None, ""

    def _excess(
        self, quantity: Mode, value: float, stiffness: float, seen: Seen, integral: float, gains: tuple[float, ...]
    ) -> tuple[float, float, int]:
        at_end, on_path, which = _predict(
            quantity is Mode.TORQUE, value, stiffness, seen, integral, gains, self._box, self._limits, self._z,
            self._push, self._held, self._x, self._u, self._p, self._coarse[quantity],
            self._effects,
        )  # fmt: skip
        return at_end, on_path, which

    def step(self, mode: Mode, value: float, stiffness: float, seen: Seen, law: ModelController) -> tuple[float, float]:
        """The value and stiffness to apply at one sample, for wanted ones; the law gets them."""
        quantity = mode.quantity
        if self._quantity is not quantity:
            now = seen.torque if quantity is Mode.TORQUE else seen.angle
            self._quantity, self._wanted = quantity, (math.nan, math.nan)
            self._applied = (now, self._present_stiffness(seen))
        if (value, stiffness) != self._wanted:
            self._wanted, self._direction, self._shares = (value, stiffness), 0, [1.0] * len(_DIRECTIONS)
        before, before_stiffness = self._applied
        if math.isnan(stiffness) or math.isnan(before_stiffness):
            before_stiffness = stiffness
        if value == before and (stiffness == before_stiffness or math.isnan(stiffness)):
            self._applied, self.active = (value, stiffness), ""
            return self._applied
        if not all(map(math.isfinite, seen[7:])):  # an estimate without a pressure: stay
            return before, before_stiffness
        self._held[:] = law.valves
        direction, share = self._direction, self._shares[self._direction]
        of_value, of_stiffness = _DIRECTIONS[direction]
        new = value if of_value * share == 1.0 else before + of_value * share * (value - before)
        new_stiffness = before_stiffness + of_stiffness * share * (stiffness - before_stiffness)
        new_stiffness = stiffness if of_stiffness * share == 1.0 else new_stiffness
        at_end, on_path, which = self._excess(quantity, new, new_stiffness, seen, law.integral, law.gains)
        allowed = at_end == on_path == 0.0
        if not allowed:
            # If the applied reference violates a limit as well, as after a push, any that is not worse is allowed.
            stays = self._excess(quantity, before, before_stiffness, seen, law.integral, law.gains)
            allowed = at_end <= stays[0] and on_path <= stays[1]
        if allowed:
            self._shares[direction] = min(2.0 * share, 1.0)
            self._applied = (new, new_stiffness)
        else:
            self.active, self._shares[direction] = LIMITS[which], max(0.5 * share, _LEAST_SHARE)
            self.held_back += 1
        if direction or not allowed:
            self._direction = (direction + 1) % len(_DIRECTIONS) if not math.isnan(stiffness) else 0
        return self._applied

    def _present_stiffness(self, seen: Seen) -> float:
        _make_steady(self._x, seen.angle, seen.pressure_1, seen.pressure_2, self._held, self._p, 0.0, WITH_EFFECTS)
        return -float(_torque_slope(self._x, self._p))
