"""PI gains for a rig from its linearised model, with bandwidth and margins.

The model is linearised at rest in the middle of its pressures, without Coulomb friction, which only holds the joint.
The input is half the difference of both voltages, the output the angle of the free joint or the torque of the locked
one. Of all gains whose Nyquist curve keeps the distance :data:`DISTANCE` from −1, those with the largest integral gain
are taken (Åström and Hägglund 2006): the distance bounds the peak of the sensitivity, and the integral gain removes a
disturbance such as friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import steady_voltage

Floats = NDArray[np.float64]

DISTANCE = 0.6
"""Least distance of the Nyquist curve from −1: a gain margin of 2.5 and a phase margin of 35 degrees at least."""
_FASTEST = 2.0
"""[Hz] Largest bandwidth: above it the valves' dynamics and the estimate's noise matter, which the model leaves out."""
_DELAY_SAMPLES = 1.5
"""Delay from a pressure to the voltage that answers it, in samples, with half of the hold."""
_MOVES = np.array([1e-4, 1e-3, 100.0, 100.0])
"""Steps of the state for the linearisation [rad, rad/s, Pa, Pa]."""
_VOLTS = 1e-2
_DRY = (
    *(f"friction.{name}" for name in ("shaft", "muscle", "lever_force", "static", "kinetic")),
    *(f"effects.friction.{name}" for name in ("coulomb", "stribeck")),
)
"""Friction that holds a joint at rest, of all models. It is set to 0: its slope at rest is almost infinite."""
_MOST_GAIN = 1e3
_MOST_CORNER = 10.0
"""[rad/s] Largest ratio of integral to proportional gain."""


@dataclass(frozen=True)
class LoopGains:
    """Gains of one mode, and bandwidth and margins of the linearised loop."""

    proportional: float  # [V/rad] or [V/(N m)]
    integral: float  # [V/(rad s)] or [V/(N m s)]
    bandwidth: float | None  # frequency at which the loop's gain is 1 the last time [Hz]; None if it never reaches 1
    gain_margin: float  # factor by which the gain may grow; infinite where no phase reaches −180 degrees
    phase_margin: float | None  # at the bandwidth [rad]; None likewise

    def in_words(self) -> str:
        """Bandwidth and margins."""
        if self.bandwidth is None or self.phase_margin is None:
            return "the loop's gain never reaches 1, so the joint will hardly follow"
        return (
            f"{self.bandwidth:.2g} Hz, gain margin {self.gain_margin:.2g}, "
            f"phase margin {math.degrees(self.phase_margin):.0f} deg"
        )


def loop_gains(rig: Rig, mode: str) -> LoopGains:
    """Gains of the PI controller for a rig. `mode`: ``angle`` or ``torque``."""
    a, b, c = _linear(rig, mode)
    slowest = float(np.min(np.abs(np.linalg.eigvals(a).real)))
    omega = np.geomspace(1e-2, np.pi / rig.sample_period, 6000)
    plant = np.linalg.solve(1j * omega[:, None, None] * np.eye(len(a)) - a, b[:, None])[..., 0] @ c
    plant *= np.exp(-1j * omega * _DELAY_SAMPLES * rig.sample_period)
    corners = np.geomspace(max(slowest, 0.05), _MOST_CORNER, 24)
    gains = [_largest_gain(plant * (1.0 + corner / (1j * omega)), omega) for corner in corners]
    best = int(np.argmax(np.array(gains) * corners))
    gain, corner = gains[best], float(corners[best])
    loop = gain * plant * (1.0 + corner / (1j * omega))
    size, phase = np.abs(loop), np.unwrap(np.angle(loop))
    above = np.flatnonzero(size >= 1.0)
    last = int(above[-1]) if len(above) else 0
    largest = float(np.max(size[last:][phase[last:] <= -np.pi], initial=0.0))
    margin = 1.0 / largest if largest > 0.0 else math.inf
    if not len(above):
        return LoopGains(gain, gain * corner, None, margin, None)
    return LoopGains(gain, gain * corner, float(omega[last] / (2.0 * np.pi)), margin, float(np.pi + phase[last]))


def _largest_gain(loop: NDArray[np.complex128], omega: Floats) -> float:
    """The largest gain up to which the loop keeps its distance and is not too fast; 0 where none does."""
    fastest, gain = int(np.searchsorted(omega, 2.0 * np.pi * _FASTEST)), 0.0
    for tried in np.geomspace(1e-3, _MOST_GAIN, 300):
        if tried * abs(loop[fastest]) > 1.0 or np.min(np.abs(1.0 + tried * loop)) < DISTANCE:
            break
        gain = float(tried)
    return gain


def _linear(rig: Rig, mode: str) -> tuple[Floats, Floats, Floats]:
    """Matrices A (n, n), b (n,) and c (n,) at rest, for the n states of the model and of its effects."""
    plain = rig.parameters("locked" if mode == "torque" else "free", 0.0)
    p = par.changed(plain, dict.fromkeys(_DRY, 0.0))
    pressure = 0.5 * (rig.atmosphere.pressure + rig.supply.pressure)
    rest = np.array([*steady_voltage(rig, pressure), 0.0])
    angle = 0.0 if mode == "torque" else equilibrium.rest_angle(pressure, pressure, p)
    x = np.asarray(equilibrium.initial_state(angle, pressure, pressure, rest, p))
    count = len(x)
    moves = np.append(_MOVES, np.full(count - 4, 1e-4))
    out = np.empty(count)

    def rate(state: Floats, voltage: Floats) -> Floats:
        dynamics.derivative(state, voltage, p, out)
        return out.copy()

    units = np.eye(count)
    steps = list(zip(moves, units, strict=True))
    a = np.stack([(rate(x + m * e, rest) - rate(x - m * e, rest)) / (2.0 * m) for m, e in steps], axis=1)
    push = np.array([_VOLTS, -_VOLTS, 0.0])
    b = (rate(x, rest + push) - rate(x, rest - push)) / (2.0 * _VOLTS)
    if mode == "angle":
        return a, b, units[0]
    c = np.array([(dynamics.torque(x + m * e, p) - dynamics.torque(x - m * e, p)) / (2.0 * m) for m, e in steps])
    return a[2:, 2:], b[2:], c[2:]
