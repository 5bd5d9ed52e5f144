"""Control of angle or torque together with stiffness, through the model.

For each estimate:

1. **Torque.** To hold an angle ψ_r the muscles need, by (8), the torque τ = k_s ψ_r − load − torque from outside +
   friction + I. The torque from outside enters as far as it is known: an estimate d with variance σ² as
   d³/(d² + σ²), and a missing estimate as 0. Friction enters with T_s + T_p in the direction of the wanted motion, and
   decreases to 0 over the last ``approach``. For a torque reference τ_r at the present angle, it is τ = τ_r + I.
2. **Pressures** that have this torque and the wanted stiffness, or the nearest one
   (:func:`~pam_antagonist.control.stiffness.set_pressures`).
3. **Rates.** Ṗ_i = ω (wanted − estimated pressure), plus the rate of the wanted pressure in mode IMPEDANCE.
4. **Open rates** by (4) and (5), solved for the flow and then for α, at the present pressure, volume and volume's rate.
5. **Voltages** by the inverse of κ, clipped to the valves' limits.

Pressure regulators replace steps 3 to 5: their commands are the pressures of step 2.

I is the integral of the estimate's error, as a torque. It changes only while both pressures are near the wanted ones,
and not further in a direction in which the torque is out of reach (anti-windup). The first voltages equal the present
ones of the valves; the difference decays with ``blend_time`` (bumpless start).

**Impedance.** The joint should yield to the torque from outside d like a spring K and a damper D around ψ_0. The angle
ψ_v with D dψ_v/dt + K (ψ_v − ψ_0) = d is computed from d as far as it is known. It is held with stiffness K as above,
but with I = 0, since an integral would push back. The muscles alone are a spring of stiffness K, as long as the valves
can hold their pressures. The law adds the damping and the compensation of friction. If d is not estimated, the joint
has only this spring. The wanted pressures change with d. Without their own rate they would be followed with a lag of
1/ω, which reduces the yielding by a third at 2 Hz. :func:`~pam_antagonist.control.tracking.largest_torque` computes
which torque the valves can follow. ψ_v neglects the joint's inertia, which matters above about 10 Hz.

The model is that of the rig, effects included, and uses the same functions as the estimator. States that effects add
are assumed to be steady.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.control.command import Command, ControlLaw, Mode, Status, VoltageLimits
from pam_antagonist.control.stiffness import Box, set_pressures
from pam_antagonist.errors import BadInput
from pam_antagonist.model import composition, dynamics, equilibrium, flow, muscle
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY, WITH_EFFECTS
from pam_antagonist.model.parameters import FORCE_FORM, SLOT_OF, STATES, SUPPLY

# numba compiles calls of plain names, not of attributes that it would have to look up again.
_leverage, _length, _length_rate, _volume = muscle.leverage, muscle.length, muscle.length_rate, muscle.volume
_flow_for, _open_rate_for, _voltage_for = flow.flow_for, flow.open_rate_for, flow.voltage_for
_pull, _make_steady, _mass_loss = equilibrium.pull, equilibrium.make_steady, composition.mass_loss
_torque, _sliding_friction = dynamics.torque, dynamics.sliding_friction

_REGULATED = SLOT_OF["regulator_rate_1"]
_NEAR = 15e3
"""[Pa] The integral changes only while both pressures are so near the wanted ones. This is above the ripple of an
estimated pressure, and well below the 60 kPa or so by which friction shifts the pressures of the paper's joint."""
_REST = 1e-4
"""[N m] Part of a torque that the search of the pressures may leave."""
_RATE_TIME = 0.010
"""[s] Time constant that smooths the rate of a wanted pressure: the estimated torque from outside is noisy."""


@dataclass(frozen=True)
class ModelGains:
    """Gains of the law, which do not depend on the size of the joint."""

    bandwidth: float = 25.0  # ω, rate at which a pressure's error is corrected [1/s]
    # Rate at which I follows an error of the torque, or an error of the angle times the stiffness [1/s].
    integral: float = 3.0
    approach: float = 0.010  # distance from the wanted angle within which the friction term decreases to 0 [rad]

    def __post_init__(self) -> None:
        for name in ("bandwidth", "approach"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise BadInput(f"{name} {getattr(self, name)!r}: expected a finite number above 0")
        if not (math.isfinite(self.integral) and self.integral >= 0.0):
            raise BadInput(f"integral {self.integral!r} 1/s: expected a finite number, 0 or more")


class Seen(NamedTuple):
    """The part of an estimate that the law uses."""

    angle: float  # ψ [rad]
    velocity: float  # ψ̇ [rad/s]
    torque: float  # τ [N m]
    pressure_1: float  # [Pa]
    pressure_2: float  # [Pa]
    external_torque: float = math.nan  # from outside [N m]; NaN where it is not estimated
    external_variance: float = 0.0  # [(N m)²]
    angle_variance: float = 0.0  # [rad²]
    velocity_variance: float = 0.0  # [rad²/s²]
    torque_variance: float = 0.0  # [(N m)²]
    pressure_variance_1: float = 0.0  # [Pa²], or an upper bound
    pressure_variance_2: float = 0.0  # likewise

    @classmethod
    def of(cls, row: np.void) -> Seen:
        """Of an estimate (a row of ``ESTIMATE_DTYPE``)."""
        covariance, innovation = row["covariance"], row["innovation_covariance"]
        first, second = row["pressure"].tolist()
        return cls(
            float(row["angle"]), float(row["velocity"]), float(row["torque"]), first, second,
            float(row["external_torque"]), float(row["external_torque_covariance"][3]),
            float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[2, 2]),
            float(innovation[0, 0]), float(innovation[1, 1]),
        )  # fmt: skip


class Reached(NamedTuple):
    """Wanted pressures of the law at the last sample."""

    pressure_1: float  # wanted P_1 [Pa]
    pressure_2: float  # wanted P_2 [Pa]
    softest: float  # least stiffness possible with the torque [N m/rad]
    stiffest: float  # largest one [N m/rad]
    missing: float  # part of the torque that is out of reach [N m]; 0 if none is


@inlined
def known_torque(external, variance):
    """Part of a torque from outside that the law uses [N m]: d³/(d² + σ²).

    `external`: d [N m]; NaN where it is not estimated. `variance`: σ² [(N m)²].
    """
    if not (math.isfinite(external) and math.isfinite(variance)) or external == 0.0:
        return 0.0
    square = external * external
    return external * square / (square + variance)


@in_place
def wanted_pressures(of_torque, value, stiffness, seen, integral, approach, box, held, x, p):
    """Steps 1 and 2: set the pressures of x to the wanted ones.

    The value is a torque [N m] or an angle [rad]; `stiffness` [N m/rad], NaN: free; `seen` a :class:`Seen`; `integral`
    is I [N m]; `approach` as of :class:`ModelGains` [rad]; `held` the voltages (2,) on the valves [V]. The state x (n,)
    is overwritten; its angle becomes the one for which the pressures are computed. Returns what
    :func:`~pam_antagonist.control.stiffness.set_pressures` does.
    """
    angle = seen.angle if of_torque else value
    _make_steady(x, angle, seen.pressure_1, seen.pressure_2, held, p, 0.0, WITH_EFFECTS)
    torque = value + integral
    if not of_torque:
        side = min(max((value - seen.angle) / approach, -1.0), 1.0)
        # _pull is the torque of the muscles plus load minus k_s ψ: the difference is k_s ψ minus the load.
        torque = _torque(x, p) - _pull(x, p) + _sliding_friction(x, side, p) + integral
        torque -= known_torque(seen.external_torque, seen.external_variance)
    return set_pressures(torque, stiffness, box, x, p)


@inlined
def voltage_towards(i, pressure, wanted, angle, velocity, bandwidth, p, x=None):
    """Steps 3 to 5 for muscle i, 0 or 1: the voltage [V] that moves its pressure P_i [Pa] to the wanted one [Pa].

    A regulator's command is the wanted pressure itself [Pa]. `bandwidth` is ω [1/s]; the state x (n,) is for learned
    flows, None leaves them out.
    """
    if p[_REGULATED + i] > 0.0:
        return wanted
    sine, cosine, _ = _leverage(angle, p)
    length, length_rate = _length(i, sine, p), _length_rate(i, cosine, velocity, p)
    volume, slope = _volume(i, length, p)
    net = _flow_for(bandwidth * (wanted - pressure), pressure, volume, slope * length_rate, p)
    # A learned flow may depend on the open rate: on the one without it.
    alpha = _open_rate_for(i, net, pressure, p[SUPPLY], p)
    lost = -_mass_loss(0.0, i, pressure, length, length_rate, alpha, x, p)
    return _voltage_for(i, _open_rate_for(i, net + lost, pressure, p[SUPPLY], p), p)


@inlined
def _smooth(i, wanted, lead, period):
    """Smoothed rate [Pa/s] of wanted pressure i; ``lead`` holds the last wanted pressures (NaN: none) and the rates."""
    if math.isfinite(lead[i]):
        lead[2 + i] += ((wanted - lead[i]) - lead[2 + i] * period) / (_RATE_TIME + period)
    lead[i] = wanted
    return lead[2 + i]


@in_place
def _step(of_torque, value, stiffness, seen, integral, gains, period, box, leads, lead, held, x, p):
    """One sample of the law: voltages, the numbers of :class:`Reached`, and the new integral."""
    bandwidth, rate, approach = gains
    softest, stiffest, missing = wanted_pressures(
        of_torque, value, stiffness, seen, integral, approach, box, held, x, p
    )
    first, second = x[PRESSURE_1], x[PRESSURE_2]
    ahead_1 = ahead_2 = 0.0
    if leads:
        ahead_1, ahead_2 = _smooth(0, first, lead, period) / bandwidth, _smooth(1, second, lead, period) / bandwidth
    x[ANGLE], x[VELOCITY], x[PRESSURE_1], x[PRESSURE_2] = seen.angle, seen.velocity, seen.pressure_1, seen.pressure_2
    u_1 = voltage_towards(0, seen.pressure_1, first + ahead_1, seen.angle, seen.velocity, bandwidth, p, x)
    u_2 = voltage_towards(1, seen.pressure_2, second + ahead_2, seen.angle, seen.velocity, bandwidth, p, x)
    error = value - seen.torque if of_torque else (value - seen.angle) * 0.5 * (softest + stiffest)
    arrived = abs(first - seen.pressure_1) < _NEAR and abs(second - seen.pressure_2) < _NEAR
    # Where the map is curved, pressures are found to a small rest: it is no torque out of reach.
    rest = _REST if p[FORCE_FORM] > 0.0 else 0.0
    if arrived and (abs(missing) < rest or missing * error <= 0.0):
        integral += period * rate * error
    return u_1, u_2, first, second, softest, stiffest, missing, integral


class ModelController(ControlLaw):
    """Angle or torque with stiffness, one command for each estimate. See :class:`ControlLaw` for what it is made with.

    `reached`: wanted pressures of the last sample; None: nothing yet.
    """

    BLEND_TIME = 0.1
    """[s] Shorter than the PI's: the law corrects an offset of the voltage as an error of the pressure's rate."""

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
        # A regulator gets the wanted pressure itself, without lead.
        self._leads = not (p[_REGULATED] > 0.0 or p[_REGULATED + 1] > 0.0)
        self.reached: Reached | None = None
        self.retune(gains or ModelGains())
        # Compile now and not in the loop.
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
        """The command for one estimate. Without a mode there is no reference yet.

        `value`: wanted angle [rad] or torque [N m]. `stiffness`: wanted −∂τ/∂ψ [N m/rad]; NaN: free, the middle of the
        possible range. `damping`: of ``Mode.IMPEDANCE`` [N m s/rad]. `late`: the estimate is too old to act on.
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
        """ψ_v [rad] at the next sample, by an implicit step that is stable for any damping and stiffness."""
        before = self._yielded if self._mode is Mode.IMPEDANCE else seen.angle
        viscous = damping / self._period
        external = float(known_torque(seen.external_torque, seen.external_variance))
        self._yielded = (viscous * before + stiffness * value + external) / (viscous + stiffness)
        return self._yielded
