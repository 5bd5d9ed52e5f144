"""A rig file from simple measurements and data sheets: the start of an identification.

Values that cannot be measured simply are assumed, with a wide prior, so that ``identify`` can change them.

**Force.** A data sheet gives the force F_n without contraction at a gauge pressure p_n, and the contraction ε_n at
which no force is left. The map is that of :mod:`~pam_antagonist.model.muscle` with a = F_n/p_n. The rubber takes
the share h = 0.19 of F_n, which it reaches within a quarter of ε_n: b = h F_n, s = 15/ε_n, ε_0 = 0.007. F(ε_n, p_n) = 0
then gives k = (1 − h)/ε_n. The shares come from a measured map (Martens and Boblan 2017, DMSP-20): a, b, k and s of its
best fit are within a tenth of those that its data sheet gives in this way.

**Volume.** Inextensible threads of length b with n turns enclose V = l (b² − l²)/(4 π n²) (Chou and Hannaford 1996).
D_1, D_2, D_3 of equation (3) are the best fit to this volume over the joint's range.

**Valve.** The inflow area gives the flow of the data sheet, by equation (5). A valve with a closed centre has an
overlap of 0.5: above the middle of its voltages it fills, below it empties, and in the middle no air passes.

**Filter.** With a guessed valve the model's flow is worth little. So the process noise of the pressures lets the
measured pressures drive the joint. What is left is the joint's own error: muscles that differ from their data sheet,
and a torque that nobody told. Where no limb was told it is the largest that the weight of the moving parts can have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.model import muscle, orifice
from pam_antagonist.model import parameters as par
from pam_antagonist.rig.parts import MusclePart, RegulatorPart, ValvePart
from pam_antagonist.rig.physical import RANGE_WITHOUT_STOP, unphysical
from pam_antagonist.rig.schema import Rig
from pam_antagonist.strict_yaml import validated

_GRAVITY = 9.81
"""[m/s²]"""
ATMOSPHERE = 101.3e3
"""Pressure of the surroundings [Pa]."""
_RUBBER, _STEEPNESS, _REST, _BEND = 0.19, 15.0, 0.007, 0.005
"""Of a muscle's force map: h; s ε_n; ε_0; w as a share of F_n, all [-]."""
_OVERLAP, _OVERLAP_PRIOR, _OVERLAP_BOUNDS = 0.5, 0.05, (0.3, 0.7)
"""Of a valve whose centre is closed: open rate at which an orifice shuts, its prior, and its bounds."""
_PRESSURE_DRIFT = 20e3**2 / 0.01
"""[Pa²/s] Growth of a pressure's variance by the errors of a guessed valve: 20 kPa in 10 ms."""
_THREAD_ANGLE = math.radians(25.0)
"""Angle between threads and axis without pressure, for which the braid's force at ε = 0 agrees with data sheets."""
_MOST_STRETCH = 0.05
"""[-] Largest stretch that data sheets allow."""
_LITRES_A_MINUTE = 1.189e-3 / 60.0
"""[kg/s] Mass flow of 1 l/min of air at 20 °C and 1 bar, the reference of ISO 6358."""
_NOMINAL = 7e5, 6e5
"""Absolute pressures before and behind the valve at its nominal flow [Pa]."""

_PRIORS = {
    "valve_1.inflow_area": 0.35, "valve_1.outflow_area": 0.35,
    "valve_2.inflow_area": 0.35, "valve_2.outflow_area": 0.35,
    "gas.polytropic_flow": 0.1, "gas.polytropic_volume": 0.3, "joint.inertia": 0.2, "joint.viscous_friction": 1.0,
    "friction.shaft": 0.5, "effects.friction_by_pressure.slope_1": 1.0, "effects.friction_by_pressure.slope_2": 1.0,
    "geometry.radius": 0.06, "effects.limb_weight.torque": 0.2,
    **{f"muscle_{i}.force.{name}": share for i in (1, 2)
       for name, share in {"c1": 0.25, "c2": 0.15, "c3": 0.4, "c4": 0.5, "c6": 0.03}.items()},
}  # fmt: skip
"""Standard deviations before identification, as shares of the value."""
_CURVE_PRIOR = 0.05
"""Prior of the shift of a valve's guessed curve, as a share of the range of voltages [-]."""
_DAMPING = 0.6
"""Damping ratio of a regulator whose step overshoots by 10 %, assumed [-]."""
_FORCE_PRIOR = 0.15
"""Difference between two muscles of one kind, or between a muscle and its data sheet, as a share of the force [-]."""
_RULER = 0.01
"""[-] Error of a muscle's nominal length."""
_WEIGHT_TOLD = 0.2
"""[-] Error of a limb's weight that was told, as a share of it."""


_LENGTHS = ("length", "nominal-length", "radius", "stop")
_MUSCLE = ("muscle", "muscle-diameter", "muscle-pressure", "muscle-force", "muscle-contraction")
_BEHIND = {
    "muscle_": (*_MUSCLE, "nominal-length", "length"),
    "friction.muscle": (*_MUSCLE, "supply", "radius"),
    "joint.viscous_friction": ("inertia", "radius", *_MUSCLE),
    "joint.": ("inertia", "mass", "shaft-radius", "stop"),
    "geometry.": ("radius", "length"),
    "supply.": ("supply",),
    "valve": ("valve", "valve-flow", "voltage"),
    "gas.": ("supply",),
    "sensors.": ("sensor-range", "sensor-bits"),
    "sample_period": ("rate",),
    "effects.regulator_limits": ("regulator", "regulator-range", "supply"),
    "effects.regulator_threshold": ("regulator",),
    "effects.regulator_lag": ("regulator-time",),
}
"""Beginning of a path in the rig file -> the answers that its value comes from, as options of ``new_rig``."""


class Contradiction(BadInput):
    """Facts that are possible one by one, not together; ``answers`` are the options that may have to change."""

    def __init__(self, text: str, answers: Sequence[str]) -> None:
        super().__init__(text)
        self.answers = tuple(answers)

    @classmethod
    def of(cls, complaint: str, name: str) -> Contradiction:
        """A complaint about the rig file, which names the path of a value."""
        text = complaint.removeprefix(f"{name}: ")
        places = [(text.index(path), -len(path), answers) for path, answers in _BEHIND.items() if path in text]
        return cls(f"these answers together make an impossible rig: {text}", min(places)[2] if places else ())


@dataclass(frozen=True)
class Facts:
    """Known values of a rig."""

    name: str
    kind: str  # ``lever`` or ``pulley``
    radius: float  # lever arm r [m]
    length: float  # of a muscle at angle 0 [m]
    nominal_length: float  # of a muscle without pressure and load [m]
    muscle: MusclePart
    muscle_name: str
    supply: float  # gauge pressure of the supply [Pa]
    valve: ValvePart
    valve_name: str
    voltage: tuple[float, float]  # least and largest voltage of a valve [V]
    shaft_radius: float  # [m]
    mass: float  # carried by the shaft [kg]
    inertia: float  # of the moving parts [kg m²]
    stop: float | None  # magnitude of the angle at which the joint stops [rad], None for none
    pressure_range: float  # of a pressure sensor [Pa]
    pressure_bits: int
    period: float  # from sample to sample [s]
    regulator: RegulatorPart | None = None  # of both sides of a joint with pressure regulators; None: it has valves
    regulator_time: float = 0.0  # rise time of the regulator from 10 to 90 % of a small step [s]
    # A limb in a vertical plane: mass [kg], centre from the axis [m], angle at which it hangs [rad]; None: not told.
    limb: tuple[float, float, float] | None = None

    def travel(self) -> tuple[float, float]:
        """Shortest and longest length of a muscle within the joint's range [m]."""
        bound = RANGE_WITHOUT_STOP if self.stop is None else self.stop
        reach = self.radius * (math.sin(bound) if self.kind == "lever" else bound)
        return self.length - reach, self.length + reach


def starting_point(facts: Facts) -> Rig:
    """A rig from the facts, with assumed values and wide priors for the rest."""
    try:
        return _starting_point(facts)
    except Contradiction:
        raise
    except BadInput as error:
        raise Contradiction.of(str(error), facts.name) from None


def _starting_point(facts: Facts) -> Rig:
    shortest, longest = facts.travel()
    least, largest = 1.0 - longest / facts.nominal_length, 1.0 - shortest / facts.nominal_length
    where = (
        f"muscle length {facts.length * 1e3:g} mm at angle 0, nominal length {facts.nominal_length * 1e3:g} mm: at the "
        "end of its travel a muscle would be"
    )
    if least < -_MOST_STRETCH:
        raise Contradiction(f"{where} stretched by {-least:.0%}; expected {_MOST_STRETCH:.0%} at most", _LENGTHS)
    if (left := _force(facts, shortest, facts.supply)) <= 0.0:
        raise Contradiction(
            f"{where} contracted by {largest:.0%}: there {facts.muscle_name} pulls with {left:.0f} N at the supply's "
            "pressure; expected more than 0: less radius or stop, or more length",
            (*_LENGTHS, *_MUSCLE, "supply"),
        )
    content = _rounded(_content(facts))
    rig = validated(Rig, content, facts.name, ("consider", "sealed"))
    # The area follows from equation (5) with the rig's constants.
    flow = orifice.orifice_flow(*_NOMINAL, rig.parameters())
    area = facts.valve.flow * _LITRES_A_MINUTE / flow
    valve = _rounded({**content["valve_1"], "inflow_area": area, "outflow_area": area})
    rig = validated(Rig, {**content, "valve_1": valve, "valve_2": valve}, facts.name, ("consider", "sealed"))
    priors = {name: share * rig.value(name) for name, share in _PRIORS.items() if rig.value(name)}
    # Sizes that are 0 in the file, but expected there: an identification looks for them.
    priors["effects.friction.coulomb"] = _friction_guess(facts)
    if facts.limb is not None:
        priors["effects.limb_weight.hanging"] = 0.2
    elif facts.mass:
        priors["effects.limb_weight.torque"] = _unknown_torque(facts)
    shift = _CURVE_PRIOR * (facts.voltage[1] - facts.voltage[0])
    priors |= {f"effects.valve_offset.voltage_{i}": shift for i in (1, 2)}
    overlaps = [f"valve_{i}.overlap" for i in (1, 2) if facts.valve.closed_centre]
    priors |= dict.fromkeys(overlaps, _OVERLAP_PRIOR)
    rig = rig.replaced(priors=priors, bounds=dict.fromkeys(overlaps, _OVERLAP_BOUNDS))
    rig = rig if facts.regulator is None else _with_regulators(rig, facts, facts.regulator)
    rig = rig.replaced(priors=_rounded(rig.priors))
    if complaint := unphysical(rig):
        raise BadInput(complaint)
    return rig


def _with_regulators(rig: Rig, facts: Facts, part: RegulatorPart) -> Rig:
    """The rig with pressure regulators in place of the valves."""
    # A step of second order rises from 10 to 90 % within (1 + 1.1 ζ + 1.4 ζ²)/ω, about.
    frequency = (1.0 + 1.1 * _DAMPING + 1.4 * _DAMPING**2) / facts.regulator_time
    lag = {"frequency_1": frequency, "frequency_2": frequency, "damping": _DAMPING}
    limits = {"lowest": part.lowest + ATMOSPHERE, "highest": min(part.highest, facts.supply) + ATMOSPHERE}
    effects = {"regulator_lag": lag, "regulator_limits": limits}
    if part.hysteresis:
        effects["regulator_threshold"] = {"threshold_1": part.hysteresis, "threshold_2": part.hysteresis}
    flow = ("valve_", "gas.polytropic_flow", "effects.valve_offset.")
    priors = {name: std for name, std in rig.priors.items() if not name.startswith(flow)}
    priors |= {f"effects.regulator_lag.{name}": 0.5 * value for name, value in lag.items()}
    return rig.replaced(drive="regulator", effects={**rig.effects, **_rounded(effects)}, bounds={}, priors=priors)


def _rounded(value: Any) -> Any:
    """The content with numbers of five digits: more are not known, and people read the file."""
    if isinstance(value, Mapping):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, tuple):
        return tuple(_rounded(item) for item in value)
    return float(f"{value:.5g}") if isinstance(value, float) else value


def force_map(facts: Facts) -> dict[str, float]:
    """Coefficients of the force map of braided muscles, from the data sheet."""
    part = facts.muscle
    return {
        "c1": part.force / part.pressure * 1e5,
        "c2": (1.0 - _RUBBER) / part.contraction,
        "c3": _RUBBER * part.force,
        "c4": _STEEPNESS / part.contraction,
        "c5": _REST,
        "c6": facts.nominal_length,
        "c7": _BEND * part.force,
    }


def _numbers(facts: Facts) -> np.ndarray:
    """Parameter vector with the force map of the first muscle, for the functions of the model."""
    p = np.zeros(par.SIZE)
    p[par.ATMOSPHERE], p[par.FORCE_FORM] = ATMOSPHERE, par.FORCE_FORMS.index("braided")
    for name, value in force_map(facts).items():
        p[par.INDEX[f"muscle_1.force.{name}"]] = value
    return p


def _force(facts: Facts, length: float, gauge: float) -> float:
    """Contraction force [N] at a length [m] and a gauge pressure [Pa]; below 0 where the muscle would have to push."""
    force, bend = float(muscle.force(0, length, gauge + ATMOSPHERE, _numbers(facts))), _BEND * facts.muscle.force
    return force - 0.25 * bend * bend / force


def volume_map(facts: Facts) -> dict[str, float]:
    """D_1, D_2, D_3 of equation (3): the best fit to the braid's volume over the joint's range."""
    thread = facts.nominal_length / math.cos(_THREAD_ANGLE)
    turns = facts.nominal_length * math.tan(_THREAD_ANGLE) / (math.pi * facts.muscle.diameter)
    lengths = np.linspace(*facts.travel(), 21)
    volume = lengths * (thread**2 - lengths**2) / (4.0 * math.pi * turns**2)
    d1, d2, d3 = np.polyfit(lengths, volume, 2)
    return {"d1": float(d1), "d2": float(d2), "d3": float(d3)}


def _friction_guess(facts: Facts) -> float:
    """Coulomb torque [N m]: a two-hundredth of a muscle's force at the supply's pressure, on its lever arm."""
    return 0.005 * _force(facts, facts.length, facts.supply) * facts.radius


def _unknown_torque(facts: Facts) -> float:
    """Torque on the joint [N m] that nobody has told: that of a weight.

    A body of mass m and inertia J about an axis has its centre at most √(J/m) from it.
    """
    if facts.limb is not None:
        return _WEIGHT_TOLD * facts.limb[0] * _GRAVITY * facts.limb[1]
    return _GRAVITY * math.sqrt(facts.inertia * facts.mass)


def _put_out(facts: Facts) -> tuple[float, ...]:
    """Voltages of the valve's curve [V], as the driver puts them out: a bipolar amplifier lays them over its own."""
    own, (low, high) = facts.valve.curve.voltage, facts.voltage
    if low >= 0.0:
        return own
    return tuple(low + (at - own[0]) / (own[-1] - own[0]) * (high - low) for at in own)


def _content(facts: Facts) -> dict[str, Any]:
    """Content of the rig file, without the areas of the valves and the priors."""
    part: Mapping[str, Any] = {"volume": volume_map(facts), "force": force_map(facts)}
    valve = {
        "inflow_area": 1e-8,
        "outflow_area": 1e-8,
        "overlap": _OVERLAP if facts.valve.closed_centre else 0.0,
        "curve": {"voltage": _put_out(facts), "open_rate": facts.valve.curve.open_rate},
    }
    slope = _friction_guess(facts) / facts.supply
    effects = {"friction_by_pressure": {"slope_1": slope, "slope_2": slope}}
    if facts.limb is not None:
        mass, distance, hanging = facts.limb
        effects["limb_weight"] = {"torque": mass * _GRAVITY * distance, "hanging": hanging}
    drift = _PRESSURE_DRIFT * facts.period
    noise, step = 5e-4 * facts.pressure_range, facts.pressure_range / 2**facts.pressure_bits
    variance = noise**2 + step**2 / 12.0
    return {
        "name": facts.name,
        "source": (
            f"new_rig: what was measured with a ruler and a scale; {facts.muscle_name}: {facts.muscle.source}; "
            f"{facts.valve_name}: {facts.valve.source}; the rest is assumed"
        ),
        "sample_period": facts.period,
        "geometry": {"kind": facts.kind, "radius": facts.radius, "length": facts.length},
        "model": {"force": "braided"},
        "muscle_1": part,
        "muscle_2": part,
        "valve_1": valve,
        "valve_2": valve,
        "valves": {"voltage_min": facts.voltage[0], "voltage_max": facts.voltage[1]},
        "supply": {"pressure": facts.supply + ATMOSPHERE},
        "atmosphere": {"pressure": ATMOSPHERE},
        "gas": {
            "heat_ratio": 1.4, "constant": 287.0, "temperature": 293.0,
            "polytropic_flow": 1.1, "polytropic_volume": 1.0,
        },
        "joint": {
            "inertia": facts.inertia,
            "stiffness": 0.0,
            # A damping ratio of 5 % against the muscles' own stiffness.
            "viscous_friction": 0.1 * math.sqrt(facts.inertia * _joint_stiffness(facts)),
            "shaft_radius": facts.shaft_radius,
            "mass": facts.mass,
            "gravity": _GRAVITY,
            "stop": facts.stop,
        },
        # A bearing with its seals, or a bush; tube and mesh rub with the pressure (friction_by_pressure).
        "friction": {"shaft": 0.1, "muscle": 0.0, "pressure_floor": 20e3},
        "effects": effects,
        "sensors": {
            "pressure_std": noise, "pressure_step": step, "angle_std": 5e-4, "angle_step": 0.0, "torque_std": 0.01,
            "torque_step": 0.0,
        },
        "uncertainty": {
            **{f"muscle_{i}.force.c1": _FORCE_PRIOR * part["force"]["c1"] for i in (1, 2)},
            **{f"muscle_{i}.force.c6": _RULER * part["force"]["c6"] for i in (1, 2)},
            "effects.load_torque.constant": _unknown_torque(facts),
        },
        "tunings": {
            "default": {
                "initial": (1e-4, 1e-4, 1e6, 1e6), "process": (1e-12, 1e-6, drift, drift),
                "measurement": (variance, variance),
                "kappa": 0.5, "consider": True, "gate": 6.0,
            }
        },
    }  # fmt: skip


def _joint_stiffness(facts: Facts) -> float:
    """−∂τ/∂ψ of both muscles at half the supply and angle 0 [N m/rad], from the force map and (9)."""
    slope = muscle.force_length_slope(0, facts.length, 0.5 * facts.supply + ATMOSPHERE, _numbers(facts))
    return 2.0 * facts.radius**2 * max(float(slope), 1.0)
