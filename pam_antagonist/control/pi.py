"""The PI controller of the paper's section "Application to Sensor-less Control", extended for real valves.

The paper's law, with e = reference - estimate in rad or N m, k the sample::

    x(k+1) = x(k) + e(k),    u(k) = C x(k) + D e(k) + beta,    C = [+c, -c],  D = [+T_P, -T_P],  beta = [5.5, 5.5] V

The paper prints c = T_I / T_stp. Since x adds up e once a sample, an integral gain in V per (rad s) needs
c = T_I * T_stp; with the printed value the valves are saturated nearly all the time. The paper leaves open:

* **Limits.** Each valve's voltage is clipped separately.
* **Anti-windup** (conditional integration and a clamp). The integral term is stored as a voltage I = c x. It does not
  grow while a valve is at its limit and e drives it further. It never exceeds the span, the largest difference at which
  no valve is beyond its limits. So the output leaves a limit in the same sample in which e changes sign.
* **Bumpless start, mode switch and retuning.** The integral term is chosen so that the first output equals the present
  voltages of the valves. The rest (the mean of both voltages, and the part beyond the span) is an offset that decays
  with ``blend_time``.
* **Safe voltages** while there is no reference, while the estimate is late, or while either is not finite. The
  integral is frozen meanwhile and goes on with its old value. After more than ``resume_time`` the valves have moved
  the joint, and the controller starts again, bumplessly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pam_antagonist.control.command import PI_MODES, Command, ControlLaw, Mode, Status, VoltageLimits
from pam_antagonist.errors import BadInput


@dataclass(frozen=True)
class Gains:
    """Gains of one mode, per rad or per N m."""

    proportional: float  # T_P [V/rad or V/(N m)]
    integral: float  # T_I [V/(rad s) or V/(N m s)]
    bias: float = 5.5  # beta, the voltage of both valves at rest [V]
    velocity: float = 0.0  # feed-forward of the reference's velocity [V s/rad]; the paper has none


PUBLISHED_GAINS: Mapping[Mode, Gains] = {Mode.ANGLE: Gains(5.45, 1.55), Mode.TORQUE: Gains(7.45, 4.75)}
"""The paper's gains, "determined by trial-and-error"."""

FAST_GAINS: Mapping[Mode, Gains] = {Mode.ANGLE: Gains(70.0, 70.0), Mode.TORQUE: Gains(15.0, 20.0)}
"""Gains for the joint shin2022: steps of 20° and 2 N m settle within about 2 s, where the valves are fully open most of
the time. Chosen in simulation, seed 0, from twenty pairs; not tried on a real joint."""


class PiController(ControlLaw):
    """PI control of an antagonistic pair: one command for each estimate."""

    def __init__(
        self,
        gains: Mapping[Mode, Gains] = PUBLISHED_GAINS,
        *,
        sample_period: float = 1e-3,
        limits: VoltageLimits | None = None,
        safe_voltage: tuple[float, float] = (5.5, 5.5),
        resume_time: float = 0.5,
        blend_time: float = 0.5,
    ) -> None:
        super().__init__(sample_period, limits, safe_voltage, resume_time, blend_time)
        self._gains: dict[Mode, Gains] = {}
        self.integral = 0.0  # I [V]: half of its contribution to the voltage difference between the valves
        for mode in PI_MODES:
            self.retune(mode, gains[mode])

    def span(self, mode: Mode) -> float:
        """Largest half difference [V] at which neither valve has reached a limit."""
        bias = self._gains[mode].bias
        return min(self._limits.maximum - bias, bias - self._limits.minimum)

    def retune(self, mode: Mode, gains: Gains) -> None:
        """Change the gains of a mode; the command goes on without a bump."""
        if not self._limits.minimum < gains.bias < self._limits.maximum:
            raise BadInput(
                f"bias {gains.bias:g} V: expected between the limits, {self._limits.minimum:g} and "
                f"{self._limits.maximum:g} V"
            )
        self._gains[mode] = gains
        if self._mode is mode:
            self._mode = None

    def step(
        self, mode: Mode | None, reference: float, value: float, *, velocity: float = 0.0, late: bool = False
    ) -> Command:
        """The command for one estimate.

        `value` is the estimated angle [rad] or torque [N m]; `velocity` that of the reference, for the feed-forward
        [rad/s]; `late`: the estimate is too old to act on. Without a mode there is no reference yet.
        """
        if mode is None:
            return self.safe(Status.NO_REFERENCE)
        if late:
            return self.safe(Status.LATE)
        if not math.isfinite(value):
            return self.safe(Status.NOT_FINITE)
        error = reference - value
        if not math.isfinite(error) or mode not in self._gains:
            return self.safe(Status.BAD_REFERENCE)
        self._interrupted = 0
        gains = self._gains[mode]
        proportional = gains.proportional * error + gains.velocity * velocity
        if self._mode is not mode:
            self._start(mode, proportional)
            command = Command(self._valves, Status.TRACKING)
            half = (self._valves[0] - self._valves[1]) / 2.0
        else:
            mean, rest = self._fade()
            half = self.integral + proportional + rest
            command = self._clipped(gains.bias + mean + half, gains.bias + mean - half)
        self._integrate(mode, gains, error, half)
        self._valves = command.voltage
        return command

    def _start(self, mode: Mode, proportional: float) -> None:
        """Choose integral and offset so that the law gives the present voltages of the valves."""
        half = (self._valves[0] - self._valves[1]) / 2.0
        mean = (self._valves[0] + self._valves[1]) / 2.0 - self._gains[mode].bias
        span = self.span(mode)
        self._mode = mode
        self.integral = min(max(half - proportional, -span), span)
        self._offset = (mean, half - proportional - self.integral)

    def _integrate(self, mode: Mode, gains: Gains, error: float, half: float) -> None:
        span = self.span(mode)
        # A valve at its limit cannot follow a larger integral.
        if (half >= span and error > 0.0) or (half <= -span and error < 0.0):
            return
        self.integral = min(max(self.integral + gains.integral * self._period * error, -span), span)
