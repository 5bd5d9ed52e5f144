"""A rig file from simple measurements and data sheets: the start of an identification.

Values that cannot be measured simply are assumed, with a wide prior, so that ``identify`` can change them.

**Force.** A data sheet gives the force F_n without contraction at a gauge pressure p_n, and the contraction ε_n at
which no force is left. The linear map in between, with ε = 1 − l/L_n,

    F = F_n (p/p_n) (1 − k ε) − F_n (h + c ε),

has two parts: one of the pressure, and one of the rubber, which reduces the force. The shares h = 0.06 and c = 0.59 k
come from a measured map (Martens and Boblan 2017, DMSP-20, contractions up to 26 %; k = 2.5 there). F(ε_n, p_n) = 0
then gives k = (1 − h)/(1.59 ε_n). With absolute pressure P this is equation (6), (7).

**Volume.** Inextensible threads of length b with n turns enclose V = l (b² − l²)/(4 π n²) (Chou and Hannaford 1996).
D_1, D_2, D_3 of equation (3) are the best fit to this volume over the joint's range.

**Valve.** The inflow area gives the flow of the data sheet, by equation (5).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.model import orifice
from pam_antagonist.rig.parts import MusclePart, RegulatorPart, ValvePart
from pam_antagonist.rig.physical import RANGE_WITHOUT_STOP, unphysical
from pam_antagonist.rig.schema import Rig
from pam_antagonist.strict_yaml import validated

ATMOSPHERE = 101.3e3
"""Pressure of the surroundings [Pa]."""
_RUBBER, _RUBBER_SLOPE = 0.06, 0.59
_THREAD_ANGLE = math.radians(25.0)
"""Angle between threads and axis without pressure, for which the braid's force at ε = 0 agrees with data sheets."""
_MOST_STRETCH = 0.05
"""[-] Largest stretch that data sheets allow."""
_LITRES_A_MINUTE = 1.189e-3 / 60.0
"""[kg/s] Mass flow of 1 l/min of air at 20 °C and 1 bar, the reference of ISO 6358."""
_NOMINAL = 7e5, 6e5
"""Absolute pressures before and behind the valve at its nominal flow [Pa]."""

_PRIORS = {
    "valve_1.inflow_area": 0.25, "valve_1.outflow_area": 0.25,
    "valve_2.inflow_area": 0.25, "valve_2.outflow_area": 0.25,
    "gas.polytropic_flow": 0.1, "gas.polytropic_volume": 0.2, "joint.inertia": 0.2, "joint.viscous_friction": 0.5,
    "friction.shaft": 0.3, "friction.muscle": 0.2,
}  # fmt: skip
"""Standard deviations before identification, as shares of the value."""
_AREA_UNCERTAINTY = 0.19
"""[-] Uncertainty of an area, as a share of it: below a fifth, so that the area is above 0 at all sigma points."""
_CURVE_PRIOR = 0.05
"""Prior of the shift of a valve's guessed curve, as a share of the range of voltages [-]."""
_DAMPING = 0.6
"""Damping ratio of a regulator whose step overshoots by 10 %, assumed [-]."""
_FORCE_PRIOR = 0.15
"""Difference between two muscles of one kind, or between a muscle and its data sheet, as a share of the force [-]."""


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
    """Facts that are possible one by one, but not together.

    Args:
        text: what is wrong.
        answers: that may have to change, as options of ``new_rig``; empty: any.
    """

    def __init__(self, text: str, answers: Sequence[str]) -> None:
        super().__init__(text)
        self.answers = tuple(answers)

    @classmethod
    def of(cls, complaint: str, name: str) -> Contradiction:
        """A complaint about the rig file, which names the path of a value.

        Args:
            complaint: in words.
            name: of the rig.
        """
        text = complaint.removeprefix(f"{name}: ")
        places = [(text.index(path), -len(path), answers) for path, answers in _BEHIND.items() if path in text]
        return cls(f"these answers together make an impossible rig: {text}", min(places)[2] if places else ())


@dataclass(frozen=True)
class Facts:
    """Known values of a rig.

    Attributes:
        name: of the rig.
        kind: ``lever`` or ``pulley``.
        radius: lever arm r [m].
        length: of a muscle at angle 0 [m].
        nominal_length: of a muscle without pressure and load [m].
        muscle: of both sides.
        muscle_name: name of the muscle.
        supply: gauge pressure of the supply [Pa].
        valve: of both sides.
        valve_name: name of the valve.
        voltage: least and largest voltage of a valve [V].
        shaft_radius: [m].
        mass: carried by the shaft [kg].
        inertia: of the moving parts [kg m²].
        stop: magnitude of the angle at which the joint stops [rad], None for none.
        pressure_range: of a pressure sensor [Pa].
        pressure_bits: of its converter.
        period: from sample to sample [s].
        regulator: of both sides of a joint with pressure regulators; None: it has valves.
        regulator_time: rise time of the regulator from 10 to 90 % of a small step [s].
    """

    name: str
    kind: str
    radius: float
    length: float
    nominal_length: float
    muscle: MusclePart
    muscle_name: str
    supply: float
    valve: ValvePart
    valve_name: str
    voltage: tuple[float, float]
    shaft_radius: float
    mass: float
    inertia: float
    stop: float | None
    pressure_range: float
    pressure_bits: int
    period: float
    regulator: RegulatorPart | None = None
    regulator_time: float = 0.0

    def travel(self) -> tuple[float, float]:
        """Shortest and longest length of a muscle within the joint's range [m]."""
        bound = RANGE_WITHOUT_STOP if self.stop is None else self.stop
        reach = self.radius * (math.sin(bound) if self.kind == "lever" else bound)
        return self.length - reach, self.length + reach

    def contractions(self) -> tuple[float, float]:
        """Least and largest contraction of a muscle within the joint's range [-]."""
        shortest, longest = self.travel()
        return 1.0 - longest / self.nominal_length, 1.0 - shortest / self.nominal_length


def starting_point(facts: Facts) -> Rig:
    """A rig from the facts, with assumed values and wide priors for the rest.

    Args:
        facts: known values of the rig.

    Raises:
        Contradiction: facts that contradict each other, or are not physical.
    """
    try:
        return _starting_point(facts)
    except Contradiction:
        raise
    except BadInput as error:
        raise Contradiction.of(str(error), facts.name) from None


def _starting_point(facts: Facts) -> Rig:
    least, largest = facts.contractions()
    if least < -_MOST_STRETCH:
        raise Contradiction(
            f"muscle length {facts.length * 1e3:g} mm at angle 0, nominal length {facts.nominal_length * 1e3:g} mm: at "
            f"the end of its travel a muscle would be stretched by {-least:.0%}; expected {_MOST_STRETCH:.0%} at most",
            _LENGTHS,
        )
    if (left := _force(facts, facts.travel()[0], facts.supply)) <= 0.0:
        raise Contradiction(
            f"muscle length {facts.length * 1e3:g} mm at angle 0, nominal length {facts.nominal_length * 1e3:g} mm: at "
            f"the end of travel a muscle would be contracted by {largest:.0%}: there {facts.muscle_name} pulls with "
            f"{left:.0f} N at the supply's pressure; expected more than 0: less radius or stop, or more length",
            (*_LENGTHS, *_MUSCLE, "supply"),
        )
    content = _rounded(_content(facts))
    rig = validated(Rig, content, facts.name, ("consider", "sealed"))
    # The area follows from equation (5) with the rig's constants.
    flow = orifice.orifice_flow(*_NOMINAL, rig.parameters())
    area = facts.valve.flow * _LITRES_A_MINUTE / flow
    valve = _rounded({**content["valve_1"], "inflow_area": area, "outflow_area": area})
    rig = validated(Rig, {**content, "valve_1": valve, "valve_2": valve}, facts.name, ("consider", "sealed"))
    priors = {**{name: share * rig.value(name) for name, share in _PRIORS.items()}, **_force_priors(facts)}
    shift = _CURVE_PRIOR * (facts.voltage[1] - facts.voltage[0])
    priors |= {f"effects.valve_offset.voltage_{i}": shift for i in (1, 2)}
    # With a guessed valve taken as exact, the estimator would explain an error of the flow by a motion of the joint.
    guessed = {name: _AREA_UNCERTAINTY * rig.value(name) for name in priors if name.startswith("valve_")}
    guessed |= {name: std for name, std in priors.items() if name.startswith("effects.valve_offset.")}
    rig = _with_regulators(rig.replaced(priors=priors, uncertainty={**rig.uncertainty, **_rounded(guessed)}), facts)
    rig = rig.replaced(priors=_rounded(rig.priors))
    complaint = unphysical(rig)
    if complaint:
        raise BadInput(complaint)
    return rig


def _with_regulators(rig: Rig, facts: Facts) -> Rig:
    """The rig with pressure regulators in place of the valves, if the facts have regulators."""
    if facts.regulator is None:
        return rig
    part = facts.regulator
    # A step of second order rises from 10 to 90 % within (1 + 1.1 ζ + 1.4 ζ²)/ω, about.
    frequency = (1.0 + 1.1 * _DAMPING + 1.4 * _DAMPING**2) / facts.regulator_time
    lag = {"frequency_1": frequency, "frequency_2": frequency, "damping": _DAMPING}
    limits = {"lowest": part.lowest + ATMOSPHERE, "highest": min(part.highest, facts.supply) + ATMOSPHERE}
    effects = {"regulator_lag": lag, "regulator_limits": limits}
    if part.hysteresis:
        effects["regulator_threshold"] = {"threshold_1": part.hysteresis, "threshold_2": part.hysteresis}
    names = {name: f"effects.regulator_lag.{name}" for name in lag}
    flow = ("valve_", "gas.polytropic_flow", "effects.valve_offset.")
    return rig.replaced(
        drive="regulator",
        effects=_rounded(effects),
        priors={
            **{name: std for name, std in rig.priors.items() if not name.startswith(flow)},
            **{path: 0.5 * lag[name] for name, path in names.items()},
        },
        uncertainty={
            **{name: std for name, std in rig.uncertainty.items() if not name.startswith(flow)},
            **{path: _rounded(0.1 * lag[name]) for name, path in names.items()},
        },
    )


def _rounded(value: Any) -> Any:
    """The content with numbers of five digits: more are not known, and people read the file."""
    if isinstance(value, Mapping):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, tuple):
        return tuple(_rounded(item) for item in value)
    return float(f"{value:.5g}") if isinstance(value, float) else value


def force_map(facts: Facts) -> dict[str, float]:
    """Coefficients v1, v2, w1, w2 of equations (6) and (7), from the data sheet."""
    part, nominal = facts.muscle, facts.nominal_length
    k = (1.0 - _RUBBER) / ((1.0 + _RUBBER_SLOPE) * part.contraction)
    gain, rubber = part.force / part.pressure, _RUBBER_SLOPE * k * part.force
    v1, v2 = gain * k / nominal, gain * (1.0 - k)
    return {
        "v1": v1,
        "v2": v2,
        "w1": rubber / nominal - v1 * ATMOSPHERE,
        "w2": -_RUBBER * part.force - rubber - v2 * ATMOSPHERE,
    }


def _force(facts: Facts, length: float, gauge: float) -> float:
    """Contraction force [N] at a length [m] and a gauge pressure [Pa], equations (6) and (7)."""
    force = force_map(facts)
    pressure = gauge + ATMOSPHERE
    return (force["v1"] * length + force["v2"]) * pressure + force["w1"] * length + force["w2"]


_SHARE, _STEEPNESS, _REST, _BEND = 0.19, 15.0, 0.007, 0.005
"""Of the braided force map: rubber as a share of F_n; s ε_n; ε_0; w as a share of F_n. The first two are within a tenth
of the best fit to a measured map (Martens and Boblan 2017, DMSP-20)."""


def is_from_data_sheet(rig: Rig) -> bool:
    """Whether the force maps of a rig are still those that :func:`force_map` made of a data sheet."""
    made = rig.source.startswith("new_rig") and "force map from" not in rig.source  # which static writes
    return rig.model.force == "linear" and made and not rig.identified


def with_base_laws(rig: Rig) -> Rig:
    """A rig from data sheets with the laws that real joints have: braided muscles, valves with a closed centre.

    The data sheet's numbers follow from the linear map of :func:`force_map`. In the middle of its voltages a
    proportional valve lets no air pass, unless its curve is known to be another one.

    Args:
        rig: made by :func:`starting_point`.
    """
    muscles = {}
    for name in ("muscle_1", "muscle_2"):
        part = getattr(rig, name)
        area, stretched = part.force.v1, part.force.v2
        rubber, offset = part.force.w1 + area * ATMOSPHERE, part.force.w2 + stretched * ATMOSPHERE
        # F_n/p_n (1 − k) = v2 and F_n/p_n k/L_n = v1; the rubber's part gives F_n.
        closing = (-_RUBBER_SLOPE * offset * area / rubber - _RUBBER * stretched) / (_RUBBER + _RUBBER_SLOPE)
        gain = stretched + closing
        force, contraction = (
            rubber / area * gain / _RUBBER_SLOPE,
            (1.0 - _RUBBER) * gain / closing / (1.0 + _RUBBER_SLOPE),
        )
        map_ = {
            "c1": gain * 1e5, "c2": (1.0 - _SHARE) / contraction, "c3": _SHARE * force, "c4": _STEEPNESS / contraction,
            "c5": _REST, "c6": closing / area, "c7": _BEND * force,
        }  # fmt: skip
        muscles[name] = part.replaced(force=part.force.replaced(**_rounded(map_)))
    valves = {}
    for name in ("valve_1", "valve_2"):
        valve = getattr(rig, name)
        if len(valve.curve.voltage) <= _GUESSED_POINTS:
            ends = (valve.curve.voltage[0], valve.curve.voltage[-1])
            valves[name] = valve.replaced(overlap=0.5, curve=valve.curve.replaced(voltage=ends, open_rate=(0.0, 1.0)))
    friction = rig.friction.replaced(muscle=0.0)
    return rig.replaced(**muscles, **valves, friction=friction, model=rig.model.replaced(force="braided"))


_GUESSED_POINTS = 4
"""A valve curve of so few points is the guess for a valve with a closed centre, or a straight line."""


def volume_map(facts: Facts) -> dict[str, float]:
    """D_1, D_2, D_3 of equation (3): the best fit to the braid's volume over the joint's range."""
    thread = facts.nominal_length / math.cos(_THREAD_ANGLE)
    turns = facts.nominal_length * math.tan(_THREAD_ANGLE) / (math.pi * facts.muscle.diameter)
    lengths = np.linspace(*facts.travel(), 21)
    volume = lengths * (thread**2 - lengths**2) / (4.0 * math.pi * turns**2)
    d1, d2, d3 = np.polyfit(lengths, volume, 2)
    return {"d1": float(d1), "d2": float(d2), "d3": float(d3)}


def _force_priors(facts: Facts) -> dict[str, float]:
    """Standard deviations of the force map's coefficients.

    They are wide. The slope of the force over the length depends on the end fittings and the hose and may differ from
    the data sheet, while the torques of a recording determine the map well.
    """
    part, force = facts.muscle, force_map(facts)
    stds = {
        "v1": abs(force["v1"]),
        "v2": abs(force["v1"]) * facts.length,
        "w1": part.force / facts.nominal_length,
        "w2": part.force,
    }
    return {f"muscle_{i}.force.{name}": std for i in (1, 2) for name, std in stds.items()}


def _content(facts: Facts) -> dict[str, Any]:
    """Content of the rig file, without the areas of the valves and the priors."""
    muscle: Mapping[str, Any] = {"volume": volume_map(facts), "force": force_map(facts)}
    valve = {
        "inflow_area": 1e-8,
        "outflow_area": 1e-8,
        "curve": {"voltage": facts.valve.curve.voltage, "open_rate": facts.valve.curve.open_rate},
    }
    half, middle = 0.5 * facts.supply, 0.5 * _force(facts, facts.length, facts.supply)
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
        "muscle_1": muscle,
        "muscle_2": muscle,
        "valve_1": valve,
        "valve_2": valve,
        "valves": {"voltage_min": facts.voltage[0], "voltage_max": facts.voltage[1]},
        "supply": {"pressure": facts.supply + ATMOSPHERE},
        "atmosphere": {"pressure": ATMOSPHERE},
        "gas": {
            "heat_ratio": 1.4, "constant": 287.0, "temperature": 293.0,
            "polytropic_flow": 1.1, "polytropic_volume": 0.5,
        },
        "joint": {
            "inertia": facts.inertia,
            "stiffness": 0.0,
            # A damping ratio of 5 % against the muscles' own stiffness.
            "viscous_friction": 0.1 * math.sqrt(facts.inertia * _joint_stiffness(facts)),
            "shaft_radius": facts.shaft_radius,
            "mass": facts.mass,
            "gravity": 9.81,
            "stop": facts.stop,
        },
        # Friction of tube and mesh: a hundredth of a muscle's force, on its lever arm.
        "friction": {
            "shaft": 0.2, "muscle": 0.005 * middle * facts.radius * half**2, "pressure_floor": 20e3,
        },
        "sensors": {
            "pressure_std": noise, "pressure_step": step, "angle_std": 5e-4, "angle_step": 0.0, "torque_std": 0.01,
            "torque_step": 0.0,
        },
        "uncertainty": {
            "muscle_1.force.w2": _FORCE_PRIOR * middle, "muscle_2.force.w2": _FORCE_PRIOR * middle,
            "friction.shaft": 0.03, "gas.polytropic_flow": 0.1, "gas.polytropic_volume": 0.08,
        },
        "tunings": {
            "default": {
                "initial": (1e-4, 1e-4, 1e6, 1e6), "process": (1e-12, 1e-6, 1e4, 1e4),
                "measurement": (variance, variance),
                "kappa": 0.5, "consider": True, "gate": 6.0,
            }
        },
    }  # fmt: skip


def _joint_stiffness(facts: Facts) -> float:
    """−∂τ/∂ψ of both muscles at half the supply and angle 0 [N m/rad], from (7) and (9)."""
    force = force_map(facts)
    slope = force["v1"] * (0.5 * facts.supply + ATMOSPHERE) + force["w1"]
    return 2.0 * facts.radius**2 * max(slope, 1.0)
