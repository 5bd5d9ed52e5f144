"""What the paper says of the model itself: the valve curve κ(u), Proposition 1, the 18 subsystems, the profile."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pam_antagonist.identification.valve_curve import steady_points, valve_curve
from pam_antagonist.model import equilibrium, flow, integration
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import Span
from validation.paper.virtual import START, Floats, VirtualRig

LEVELS = (4.2, 4.4, 4.6, 4.8, 5.0, 5.25, 5.5, 5.75, 6.0, 6.3, 6.6, 7.0, 7.5)
"""Voltages that are held [V]: the range of the profile."""
_HOLD_S = 25.0
_AREAS = tuple(f"valve_{i}.{way}_area" for i in (1, 2) for way in ("inflow", "outflow"))
PARAMETERS = {
    "T_p'": ("friction.muscle",),
    "μ_s": ("friction.shaft",),
    "A_0": _AREAS,
    "k_1": ("gas.polytropic_flow",),
    "k_2": ("gas.polytropic_volume",),
}
STEADY = ("T_p'", "μ_s")
"""Those that the paper says affect the steady state; the others, the transients."""
_FACTOR = 1.5
_REST_S, _STAND_S, _RAMP_S, _DRIVE = 2.0, 60.0, 120.0, 0.4
_PULSES_S, _PULSE = (0.3, 0.6, 1.0, 1.5, 3.0), (1.0, -1.0)


def kappa(rig: VirtualRig) -> dict[str, float]:
    """The valve curve by three steps from voltages that are held: errors of the found and of the declared open rate."""
    period = rig.declared.sample_period
    steps = np.repeat(np.array(LEVELS), round(_HOLD_S / period))
    recording = rig.record(np.column_stack([steps, steps]), "locked")
    p, true_p = rig.declared.parameters("locked"), rig.plant("locked").parameters
    errors: dict[str, list[float]] = {"found": [], "declared": []}
    for valve in (0, 1):
        points = steady_points(recording.voltage[:, valve], recording.pressure[:, valve], period)
        for voltage, rate in zip(*valve_curve(points, p), strict=True):
            true = flow.open_rate(valve, voltage, true_p)
            errors["found"].append(abs(rate - true))
            errors["declared"].append(abs(flow.open_rate(valve, voltage, p) - true))
    return {f"error of the {name} open rate, {word}": float(pick(values)) for name, values in errors.items()
            for word, pick in (("median", np.median), ("largest", np.max))}  # fmt: skip


class Response(NamedTuple):
    """What one set of parameters does."""

    pressures: Floats  # where they stand in the end [Pa]
    slow_angle: float  # of rest, after voltages that changed slowly [deg]
    abrupt_angle: float  # after a step [deg]
    pulse_angles: Floats  # after pulses of several lengths beyond those voltages [deg]
    angle_time: float  # from the step until the angle has made 90 % of its way [s]


def response(rig: Rig, factors: dict[str, float]) -> Response:
    """Steady state and transient time of the declared model with some parameters times a factor."""
    period, span = rig.sample_period, Span()
    end = np.array([_DRIVE, -_DRIVE])
    at = np.arange(round((_REST_S + _STAND_S) / period)) * period
    abrupt = (at >= _REST_S)[:, None] * end
    ramp = np.minimum(np.arange(round((_RAMP_S + _STAND_S) / period)) * period / _RAMP_S, 1.0)[:, None] * end
    p = rig.parameters("free", 0.0, {name: rig.value(name) * factor for name, factor in factors.items()})

    def states(drive: Floats) -> Floats:
        voltage = span.voltage(drive)
        start = equilibrium.initial_state(float(equilibrium.rest_angle(*START, p)), *START, voltage[0], p)
        return np.asarray(integration.course(start, voltage, p, period, 1)[0])

    pulsed = []
    for length in _PULSES_S:
        pulse = abrupt.copy()
        pulse[(at >= _REST_S) & (at < _REST_S + length)] = _PULSE
        pulsed.append(states(pulse)[-1, 0])
    stepped, first = states(abrupt), round(_REST_S / period)
    way = stepped[first:, 0] - stepped[first - 1, 0]
    return Response(
        stepped[-1, 2:4],
        math.degrees(states(ramp)[-1, 0]),
        math.degrees(stepped[-1, 0]),
        np.degrees(pulsed),
        float(np.argmax(way / way[-1] >= 0.9) * period),
    )


def influence(rig: VirtualRig) -> dict[str, float]:
    """One parameter of the declared model at a time is 1.5 times as large: what changes, against the declared one."""
    base = response(rig.declared, {})
    out = {"steady pressures, largest change": 0.0, "transient parameters: steady angle, largest change": 0.0}
    for label, names in PARAMETERS.items():
        other = response(rig.declared, dict.fromkeys(names, _FACTOR))
        most = float(np.max(np.abs(other.pressures - base.pressures)))
        out["steady pressures, largest change"] = max(out["steady pressures, largest change"], most)
        if label in STEADY:
            out[f"{label} up by half: size of the steady ψ"] = abs(other.slow_angle) - abs(base.slow_angle)
            continue
        key = "transient parameters: steady angle, largest change"
        out[key] = max(out[key], abs(other.slow_angle - base.slow_angle), abs(other.abrupt_angle - base.abrupt_angle))
        pulsed = float(np.max(np.abs(other.pulse_angles - base.pulse_angles)))
        key = "transient parameters: angle after a pulse, largest change"
        out[key] = max(out.get(key, 0.0), pulsed)
        out[f"{label} up by half: time of ψ to 90 %"] = other.angle_time - base.angle_time
    return out


def profile(rig: VirtualRig) -> dict[str, float]:
    """Range of the pressures, and how many of the 18 subsystems the plant itself is in."""
    pressure = rig.free.pressure
    return {
        "length": len(rig.voltage) * rig.declared.sample_period,
        "lowest pressure": float(pressure.min()) / 1e3,
        "highest pressure": float(pressure.max()) / 1e3,
        "subsystems visited, of 18": float(len(np.unique(rig.run(rig.voltage)[2]))),
    }
