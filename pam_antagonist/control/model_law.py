"""Control of angle or torque together with stiffness, through the model.

For each estimate:

1. **Torque.** To hold an angle ψ_r the muscles have to give, by (8), τ = k_s ψ_r − load − torque from outside +
   friction's side + I. The torque from outside counts as far as it is known: an estimate d with variance σ² counts as
   d³/(d² + σ²), and one that is not there as nothing. Friction has to be overcome on the way: its torque T_s + T_p
   counts on the side on which the joint is to move, and fades to nothing over the last ``approach``. To give a torque
   τ_r at the present angle, it is τ = τ_r + I.
2. **Pressures** that have this torque and the wanted stiffness, or the nearest one
   (:func:`~pam_antagonist.control.stiffness.set_pressures`).
3. **Rates.** Ṗ_i = ω (wanted − estimated pressure), and in mode IMPEDANCE the rate of the wanted pressure beside it.
4. **Open rates** by (4) and (5), solved for the flow and then for α, at the present pressure, volume and volume's rate.
5. **Voltages** by the inverse of κ, clipped to the valves' limits.

Pressure regulators take the place of steps 3 to 5: they are asked for the pressures of step 2.

I is the integral of the estimate's error, as a torque. It moves only while both pressures are near what is wanted, and
stands still where the torque is out of reach and it would go further (anti-windup). The first voltages equal those that
the valves have; the difference fades away with ``blend_time`` (bumpless start).

**Impedance.** The joint is to yield to the torque from outside d as a spring K and a damper D around ψ_0 would. The
angle ψ_v with D dψ_v/dt + K (ψ_v − ψ_0) = d is worked out from d as far as it is known, and held with stiffness K as
above, with I = 0: an integral would push back. The muscles are a spring of stiffness K by themselves, as long as the
valves can hold their pressures. What the law adds is the damping, and what friction holds back. Where d is not
estimated, that spring is all there is. The wanted pressures swing with d: without their own rate they would be followed
1/ω late, which at 2 Hz costs a third of the yielding. What the valves can follow at all says
:func:`~pam_antagonist.control.yielding.largest_torque`. The joint's inertia, which is left out of ψ_v, counts above
10 Hz or so.

The model is the rig's own, effects included, through the same functions as the estimator's. States that effects add
are taken as steady.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.control.command import Command, Law, Mode, Status, VoltageLimits
from pam_antagonist.control.stiffness import Box, set_pressures
from pam_antagonist.errors import BadInput
from pam_antagonist.model import composition, dynamics, equilibrium, flow, muscle
from pam_antagonist.model.dynamics import PRESSURE_1, PRESSURE_2, WITH_EFFECTS
from pam_antagonist.model.parameters import SLOT_OF, STATES, SUPPLY

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_leverage, _length, _length_rate, _volume = muscle.leverage, muscle.length, muscle.length_rate, muscle.volume
_flow_for, _open_rate_for, _voltage_for = flow.flow_for, flow.open_rate_for, flow.voltage_for
_pull, _make_steady, _mass_loss = equilibrium.pull, equilibrium.make_steady, composition.mass_loss
_torque, _sliding_friction = dynamics.torque, dynamics.sliding_friction

_REGULATED = SLOT_OF["regulator_rate_1"]
_NEAR = 15e3
"""[Pa] A pressure within this of what is wanted counts as arrived: the integral moves. Above the ripple of an estimated
pressure, well below the 60 kPa or so by which friction's torque shifts the pressures of the paper's joint."""
_RATE_TIME = 0.010
"""[s] Over which the rate of a wanted pressure is smoothed: the estimated torque from outside is noisy."""


@dataclass(frozen=True)
class ModelGains:
    """What the law is tuned with. Nothing of it depends on the joint's size.

    Attributes:
        bandwidth: ω, rate at which a pressure's error is corrected [1/s].
        integral: rate at which the torque follows an error of angle times stiffness, or of torque [1/s].
        approach: part of the way before the angle wanted over which friction's side fades [rad].
    """

    bandwidth: float = 25.0
    integral: float = 3.0
    approach: float = 0.010

    def __post_init__(self) -> None:
        for name in ("bandwidth", "approach"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise BadInput(f"{name} {getattr(self, name)!r}: expected a finite number above 0")
        if not (math.isfinite(self.integral) and self.integral >= 0.0):
            raise BadInput(f"integral {self.integral!r} 1/s: expected a finite number, 0 or more")


class Seen(NamedTuple):
    """What of an estimate the law goes by.

    Attributes:
        angle: ψ [rad].
        velocity: ψ̇ [rad/s].
        torque: τ [N m].
        pressure_1: P_1 [Pa].
        pressure_2: P_2 [Pa].
        external_torque: torque from outside [N m]; NaN where it is not estimated.
        external_variance: of it [(N m)²].
        angle_variance: [rad²].
        velocity_variance: [rad²/s²].
        torque_variance: [(N m)²].
        pressure_variance_1: of P_1 [Pa²], or a bound of it.
        pressure_variance_2: of P_2 likewise.
    """

    angle: float
    velocity: float
    torque: float
    pressure_1: float
    pressure_2: float
    external_torque: float = math.nan
    external_variance: float = 0.0
    angle_variance: float = 0.0
    velocity_variance: float = 0.0
    torque_variance: float = 0.0
    pressure_variance_1: float = 0.0
    pressure_variance_2: float = 0.0


class Reached(NamedTuple):
    """What the law asked for last.

    Attributes:
        pressure_1: wanted P_1 [Pa].
        pressure_2: wanted P_2 [Pa].
        softest: least stiffness that the torque leaves [N m/rad].
        stiffest: largest one [N m/rad].
        missing: torque that is out of reach [N m]; 0 where none is.
    """

    pressure_1: float
    pressure_2: float
    softest: float
    stiffest: float
    missing: float


@inlined
def known_torque(external, variance):
    """What of a torque from outside counts [N m]: d³/(d² + σ²).

    Args:
        external: d [N m]; NaN where it is not estimated.
        variance: σ² [(N m)²].
    """
    if not (math.isfinite(external) and math.isfinite(variance)) or external == 0.0:
        return 0.0
    square = external * external
    return external * square / (square + variance)


@in_place
def wanted_pressures(of_torque, value, stiffness, seen, integral, approach, box, held, x, p):
    """Steps 1 and 2: set the pressures of x to those that are wanted.

    Args:
        of_torque: whether the value is a torque [N m]; else it is an angle [rad].
        value: of the reference.
        stiffness: [N m/rad]; NaN: free.
        seen: what is estimated, a :class:`Seen`.
        integral: I [N m].
        approach: as of :class:`ModelGains` [rad].
        box: a :class:`~pam_antagonist.control.stiffness.Box`.
        held: voltages (2,) on the valves [V].
        x: state (n,) that is written over; its angle becomes the one at which the pressures count.
        p: parameter vector.

    Returns:
        As :func:`~pam_antagonist.control.stiffness.set_pressures`.
    """
    angle = seen.angle if of_torque else value
    _make_steady(x, angle, seen.pressure_1, seen.pressure_2, held, p, 0.0, WITH_EFFECTS)
    torque = value + integral
    if not of_torque:
        side = min(max((value - seen.angle) / approach, -1.0), 1.0)
        # What the muscles give is no part of what they have to give: the difference is k_s ψ and the load.
        torque = _torque(x, p) - _pull(x, p) + _sliding_friction(x, side, p) + integral
        torque -= known_torque(seen.external_torque, seen.external_variance)
    return set_pressures(torque, stiffness, box, x, p)


@inlined
def voltage_towards(i, pressure, wanted, angle, velocity, bandwidth, p):
    """Steps 3 to 5 for one muscle: the voltage [V] by which its pressure goes to the wanted one.

    A regulator is asked for the wanted pressure itself [Pa].

    Args:
        i: muscle, 0 or 1.
        pressure: P_i [Pa].
        wanted: pressure [Pa].
        angle: ψ [rad].
        velocity: ψ̇ [rad/s].
        bandwidth: ω [1/s].
        p: parameter vector.
    """
    if p[_REGULATED + i] > 0.0:
        return wanted
    sine, cosine, _ = _leverage(angle, p)
    volume, slope = _volume(i, _length(i, sine, p), p)
    volume_rate = slope * _length_rate(i, cosine, velocity, p)
    net = _flow_for(bandwidth * (wanted - pressure), pressure, volume, volume_rate, p)
    lost = -_mass_loss(0.0, i, pressure, None, p)
    return _voltage_for(i, _open_rate_for(i, net + lost, pressure, p[SUPPLY], p), p)


@inlined
def _led(i, wanted, lead, period):
    """Rate [Pa/s] of wanted pressure i, smoothed; lead holds the last wanted pressures, NaN for none, and the rates."""
    if math.isfinite(lead[i]):
        lead[2 + i] += ((wanted - lead[i]) - lead[2 + i] * period) / (_RATE_TIME + period)
    lead[i] = wanted
    return lead[2 + i]


@in_place
def _step(of_torque, value, stiffness, seen, integral, gains, period, box, leads, lead, held, x, p):
    """One call of the law: voltages, what was asked for, and the integral after it."""
    bandwidth, rate, approach = gains
    softest, stiffest, missing = wanted_pressures(
        of_torque, value, stiffness, seen, integral, approach, box, held, x, p
    )
    first, second = x[PRESSURE_1], x[PRESSURE_2]
    ahead_1 = ahead_2 = 0.0
    if leads:
        ahead_1, ahead_2 = _led(0, first, lead, period) / bandwidth, _led(1, second, lead, period) / bandwidth
    u_1 = voltage_towards(0, seen.pressure_1, first + ahead_1, seen.angle, seen.velocity, bandwidth, p)
    u_2 = voltage_towards(1, seen.pressure_2, second + ahead_2, seen.angle, seen.velocity, bandwidth, p)
    error = value - seen.torque if of_torque else (value - seen.angle) * 0.5 * (softest + stiffest)
    arrived = abs(first - seen.pressure_1) < _NEAR and abs(second - seen.pressure_2) < _NEAR
    if arrived and missing * error <= 0.0:
        integral += period * rate * error
    return u_1, u_2, first, second, softest, stiffest, missing, integral


class ModelController(Law):
    """Angle or torque with stiffness, one command for each estimate.

    Args:
        p: parameter vector (parameters.SIZE,) of the rig.
        box: within what pressures and forces are to stay.
        gains: the tuning.
        sample_period: T_stp, the time between two estimates [s].
        limits: of both valves.
        safe_voltage: what the valves get while there is nothing to go by (2,) [V]; also what they have at the start.
        resume_time: longest interruption after which the integral goes on where it was [s].
        blend_time: time constant with which the remainder of a bumpless start fades away [s].

    Raises:
        BadInput: a value that is out of range.

    Attributes:
        reached: what was asked for last; None: nothing yet.
    """

    BLEND_TIME = 0.1
    """[s] Shorter than the PI's: an offset of the voltage is an error of the pressure's rate, and is corrected."""

    def __init__(
        self,
        p: np.ndarray,
        box: Box,
        gains: ModelGains | None = None,
        *,
        sample_period: float = 1e-3,
        limits: VoltageLimits | None = None,
        safe_voltage: tuple[float, float] = (5.5, 5.5),
        resume_time: float = 0.5,
        blend_time: float = BLEND_TIME,
    ) -> None:
        super().__init__(sample_period, limits, safe_voltage, resume_time, blend_time)
        self._p, self._box = p, box
        self._x = np.zeros(int(p[STATES]))
        self._held = np.array(self._safe)
        self._integral = self._yielded = 0.0
        self._lead = np.zeros(4)
        self._leads = not (p[_REGULATED] > 0.0 or p[_REGULATED + 1] > 0.0)  # a regulator's lag is not the law's
        self.reached: Reached | None = None
        self.retune(gains or ModelGains())
        # Nothing is compiled in the loop.
        self.step(Mode.ANGLE, 0.0, math.nan, Seen(0.0, 0.0, 0.0, box.lowest, box.lowest))
        self.reached, self._mode, self._valves = None, None, self._safe

    @property
    def integral(self) -> float:
        """I [N m]."""
        return self._integral

    @property
    def gains(self) -> tuple[float, float, float]:
        """Bandwidth [1/s], integral [1/s] and approach [rad]."""
        return self._gains

    def retune(self, gains: ModelGains) -> None:
        """Change the gains; the command goes on without a bump."""
        self._gains = (gains.bandwidth, gains.integral, gains.approach)
        self._mode = None

    def step(
        self,
        mode: Mode | None,
        value: float,
        stiffness: float,
        seen: Seen,
        *,
        damping: float = 0.0,
        late: bool = False,
    ) -> Command:
        """The command for one estimate.

        Args:
            mode: what the reference is; None: there is no reference yet.
            value: angle [rad] or torque [N m] wanted.
            stiffness: −∂τ/∂ψ wanted [N m/rad]; NaN: free, the middle of what the torque leaves.
            seen: what is estimated.
            damping: of ``Mode.IMPEDANCE`` [N m s/rad].
            late: whether the estimate is too old to act on.

        Returns:
            The voltages and why they are so.
        """
        if mode is None:
            return self.safe(Status.NO_REFERENCE)
        if late:
            return self.safe(Status.LATE)
        if not all(map(math.isfinite, seen[:5])):
            return self.safe(Status.NOT_FINITE)
        if not math.isfinite(value):
            return self.safe(Status.BAD_REFERENCE)
        self._interrupted = 0
        if self._mode is None or self._mode.quantity is not mode.quantity:
            self._integral = 0.0
        bandwidth, rate, approach = self._gains
        if mode is Mode.IMPEDANCE:
            value = self._yielding(value, stiffness, damping, seen)
            self._integral = rate = 0.0
            approach = approach if math.isfinite(seen.external_torque) else math.inf
        if self._mode is not Mode.IMPEDANCE:
            self._lead[:] = (math.nan, math.nan, 0.0, 0.0)
        self._held[:] = self._valves
        u_1, u_2, first, second, softest, stiffest, missing, integral = _step(
            mode.quantity is Mode.TORQUE, value, stiffness, seen, self._integral, (bandwidth, rate, approach),
            self._period, self._box, mode is Mode.IMPEDANCE and self._leads, self._lead, self._held, self._x, self._p,
        )  # fmt: skip
        if not (math.isfinite(u_1) and math.isfinite(u_2)):
            return self.safe(Status.NOT_FINITE)
        self.reached = Reached(first, second, softest, stiffest, missing)
        if self._mode is not mode:
            self._mode = mode
            self._offset = (self._valves[0] - u_1, self._valves[1] - u_2)
            command = Command(self._valves, Status.TRACKING)
        else:
            rest_1, rest_2 = self._fade()
            command = self._clipped(u_1 + rest_1, u_2 + rest_2)
        self._integral = integral
        self._valves = command.voltage
        return command

    def _yielding(self, value: float, stiffness: float, damping: float, seen: Seen) -> float:
        """ψ_v [rad], one sample on: an implicit step, which no ratio of damping to stiffness makes unstable."""
        before = self._yielded if self._mode is Mode.IMPEDANCE else seen.angle
        viscous = damping / self._period
        external = float(known_torque(seen.external_torque, seen.external_variance))
        self._yielded = (viscous * before + stiffness * value + external) / (viscous + stiffness)
        return self._yielded
