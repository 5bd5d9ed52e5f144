"""What the paper says of the model: the static force, the valve curve κ(u), Proposition 1, the 18 subsystems."""

from __future__ import annotations

import hashlib
import math
from typing import Any, NamedTuple

import numpy as np

from pam_antagonist.identification.static_fit import StaticFit, fit
from pam_antagonist.identification.static_table import StaticTable
from pam_antagonist.identification.valve_curve import steady_points, valve_curve
from pam_antagonist.model import dynamics, equilibrium, flow, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import course
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import DriveVoltages
from validation.paper.virtual import START, Floats, VirtualRig

LENGTHS, PRESSURES, FORCE_STD = 6, 11, 0.5
_LOWEST, _HIGHEST = 200e3, 700e3
_REACH_RAD = np.radians(20.0)
"""The lengths span the joint's range of the paper."""
_STREAM = 3
_AT = ((0.165, 450e3), (0.155, 600e3), (0.175, 300e3))
"""Lengths [m] and pressures [Pa] at which maps are compared: coefficients nearly cancel, forces do not."""
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


def static_test(rig: VirtualRig, which: int, noise: float = FORCE_STD) -> StaticTable:
    """Forces of a muscle as a test bench would measure them: each length from both sides, noise of the sensor [N].

    No point counts as slack: the model's muscle is not cut off at zero, and pulls with a newton less than nothing at
    the shortest length and the lowest pressure.
    """
    p = rig.plant("locked").parameters
    # Muscle 1 gets shorter as the angle grows, muscle 2 longer.
    angles = (-1.0 if which == 1 else 1.0) * np.linspace(-_REACH_RAD, _REACH_RAD, LENGTHS)
    grids = np.meshgrid(np.arange(LENGTHS), np.linspace(_LOWEST, _HIGHEST, PRESSURES), [-1.0, 1.0], indexing="ij")
    group, pressure, way = (grid.ravel() for grid in grids)
    angle = angles[group.astype(np.int64)]
    loop = int(p[par.SLOT_OF[f"hysteresis_{which}"]])
    force = np.empty(len(angle))
    for k in range(len(angle)):
        x = equilibrium.initial_state(angle[k], pressure[k], pressure[k], np.zeros(3), p)
        if loop:
            x[loop] = way[k]
        force[k] = dynamics.forces(x, p)[which - 1]
    force += noise * np.random.default_rng([rig.seed, _STREAM, which]).standard_normal(len(force))
    return StaticTable(
        name=f"virtual rig, seed {rig.seed}, muscle {which}",
        sha256=hashlib.sha256(force.tobytes()).hexdigest(),
        length=np.array([muscle.length(which - 1, np.sin(at), p) for at in angle]),
        group=group.astype(np.int64),
        spread=np.ones(len(force)),
        declared=False,
        pressure=np.asarray(pressure, dtype=np.float64),
        atmosphere=float(p[par.ATMOSPHERE]),
        value=force,
        limit=-np.inf,
        slack=np.zeros(len(force), dtype=bool),
    )


def static_fits(rig: VirtualRig, form: str, noise: float = FORCE_STD) -> tuple[StaticFit, StaticFit]:
    """A form of the force map fitted to the static test of either muscle; ``Undetermined`` where a test cannot."""
    rest = rig.declared.geometry.length
    # The search for an exponent meets ones that the test cannot tell apart, whose cost is infinite.
    with np.errstate(invalid="ignore"):
        first, second = (fit(static_test(rig, which, noise), form, rest) for which in (1, 2))
    return first, second


def true_map(rig: VirtualRig, which: int) -> dict[str, float]:
    """Coefficients v1, v2, w1, w2 that the virtual rig's muscle really has."""
    p = rig.plant("locked").parameters
    return {name: float(p[par.INDEX[f"muscle_{which}.force.{name}"]]) for name in ("v1", "v2", "w1", "w2")}


def static(rig: VirtualRig) -> dict[str, float]:
    """How far fitted and declared map are from the muscle's own: the largest force error at ``_AT`` of both muscles."""
    errors: dict[str, list[float]] = {"fitted map": [], "declared map": []}
    for which, found in zip((1, 2), static_fits(rig, "linear"), strict=True):
        true, declared = true_map(rig, which), getattr(rig.declared, f"muscle_{which}").force
        maps = {
            "fitted map": dict(zip(found.names, found.coefficients.tolist(), strict=True)),
            "declared map": {name: getattr(declared, name) for name in true},
        }
        for name, one in maps.items():
            off = {key: one[key] - true[key] for key in true}
            errors[name] += [abs((off["v1"] * at + off["v2"]) * pressure + off["w1"] * at + off["w2"])
                             for at, pressure in _AT]  # fmt: skip
    return {name: max(values) for name, values in errors.items()}


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
    period, span = rig.sample_period, DriveVoltages()
    end = np.array([_DRIVE, -_DRIVE])
    at = np.arange(round((_REST_S + _STAND_S) / period)) * period
    abrupt = (at >= _REST_S)[:, None] * end
    ramp = np.minimum(np.arange(round((_RAMP_S + _STAND_S) / period)) * period / _RAMP_S, 1.0)[:, None] * end
    p = rig.parameters("free", 0.0, {name: rig.value(name) * factor for name, factor in factors.items()})

    def states(drive: Floats) -> Floats:
        voltage = span.voltage(drive)
        start = equilibrium.initial_state(float(equilibrium.rest_angle(*START, p)), *START, voltage[0], p)
        return np.asarray(course(start, voltage, p, period, 1)[0])

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
    out: dict[str, float] = {}
    most = {"steady pressures": 0.0, "transient parameters: steady angle": 0.0,
            "transient parameters: angle after a pulse": 0.0}  # fmt: skip
    for label, names in PARAMETERS.items():
        other = response(rig.declared, dict.fromkeys(names, _FACTOR))
        pairs: Any = zip(other, base, strict=True)
        pressures, slow, abrupt, pulsed, _ = (float(np.max(np.abs(np.subtract(*pair)))) for pair in pairs)
        changes = {"steady pressures": pressures}
        if label in STEADY:
            out[f"{label} up by half: size of the steady ψ"] = abs(other.slow_angle) - abs(base.slow_angle)
        else:
            changes["transient parameters: steady angle"] = max(slow, abrupt)
            changes["transient parameters: angle after a pulse"] = pulsed
            out[f"{label} up by half: time of ψ to 90 %"] = other.angle_time - base.angle_time
        most |= {name: max(most[name], change) for name, change in changes.items()}
    return {**{f"{name}, largest change": change for name, change in most.items()}, **out}


def profile(rig: VirtualRig) -> dict[str, float]:
    """Range of the pressures, and how many of the 18 subsystems the plant itself is in."""
    pressure = rig.free.pressure
    return {
        "length": len(rig.voltage) * rig.declared.sample_period,
        "lowest pressure": float(pressure.min()) / 1e3,
        "highest pressure": float(pressure.max()) / 1e3,
        "subsystems visited, of 18": float(len(np.unique(rig.run(rig.voltage)[2]))),
    }
