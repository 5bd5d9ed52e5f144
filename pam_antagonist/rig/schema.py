"""What a rig file may hold: every value with its unit, its bounds and what it is called in the paper.

The bounds are wide enough for any pneumatic muscle joint that fits on a table, and narrow enough that a
gauge pressure, degrees, kilopascals or millimetres are caught. Works with pydantic 1.10 and 2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Dict, Literal, NamedTuple, Optional, Tuple  # noqa: UP035  (pydantic 1 evaluates annotations on Python 3.10)

import numpy as np
from pydantic import Field
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.strict_yaml import Strict, fields_of, unknown

if TYPE_CHECKING:
    _Force = str
else:
    _Force = Literal[tuple(FORMS)]


class ModelForm(Strict):
    """Which of the compared models is used; the first of each is the paper's own."""

    force: _Force = Field("linear", description="static force map")
    friction: Literal["kikuuwe", "simple", "tondu", "none"] = Field("kikuuwe", description="law of friction")


class Geometry(Strict):
    """Equation (2)."""

    kind: Literal["lever", "pulley"] = Field("lever", description="lever: l = L_0 ∓ r sin ψ; pulley: l = L_0 ∓ r ψ")
    radius: float = Field(gt=1e-3, lt=0.5, description="r, radius of the seesaw or pulley [m]")
    length: float = Field(gt=0.02, lt=2.0, description="L_0, muscle length at ψ = 0 [m]")
    cam_1: float = Field(0.0, gt=-2.0, lt=2.0, description="share by which the lever arm grows with ψ [1/rad]")
    cam_2: float = Field(0.0, gt=-3.0, lt=3.0, description="share by which it grows with ψ² [1/rad²]")


class Volume(Strict):
    """Equation (3): V = d1 l² + d2 l + d3."""

    d1: float = Field(description="D_1 [m]")
    d2: float = Field(description="D_2 [m²]")
    d3: float = Field(description="D_3 [m³]")


class Force(Strict):
    """Equations (6), (7): F = (v1 l + v2) P + w1 l + w2, with absolute pressure; or c1 to c7 of another form."""

    v1: float = Field(0.0, description="p_v1 [m]")
    v2: float = Field(0.0, description="p_v2 [m²]")
    w1: float = Field(0.0, description="p_w1 [N/m]")
    w2: float = Field(0.0, description="p_w2 [N]")
    c1: float = Field(0.0, description="c1 of the other forms [N]; braided: a, force at 100 kPa gauge [N]")
    c2: float = Field(0.0, description="c2 of the other forms [N]; braided: k, 1/contraction without area [-]")
    c3: float = Field(0.0, description="c3 of other forms [N]; sarosi: exponent [-]; braided: b, force of rubber [N]")
    c4: float = Field(0.0, description="c4 of the other forms [N]; braided: s, its steepness [-]")
    c5: float = Field(0.0, description="c5 of the other forms [N]; braided: ε_0, contraction where it is 0 [-]")
    c6: float = Field(0.0, description="c6 of the other forms [N]; braided: L_n, length at contraction 0 [m]")
    c7: float = Field(0.0, description="c7 of the other forms [N]; braided: w, force over which slack sets in [N]")


class Muscle(Strict):
    """One muscle."""

    volume: Volume
    force: Force


class Curve(Strict):
    """α = κ(u), linear between the points."""

    voltage: Tuple[float, ...] = Field(description="u [V], increasing")  # noqa: UP006
    open_rate: Tuple[float, ...] = Field(description="α [-], 0 to 1, not decreasing")  # noqa: UP006


class Valve(Strict):
    """Equation (5) and the valve's curve."""

    inflow_area: float = Field(gt=1e-11, lt=1e-4, description="A_1, orifice area while the muscle fills [m²]")
    outflow_area: float = Field(gt=1e-11, lt=1e-4, description="A_2, orifice area while it empties [m²]")
    overlap: float = Field(
        0.0, ge=0.0, le=0.9, description="open rate at which an orifice shuts [-]: 0: equation (5), 0.5: closed centre"
    )
    curve: Curve


class ValveLimits(Strict):
    """What may be put on the valves."""

    voltage_min: float = Field(ge=-10.0, le=10.0, description="[V]; below 0 with a bipolar amplifier")
    voltage_max: float = Field(ge=-10.0, le=10.0, description="[V]")
    sealed: bool = Field(False, description="no air passes: the chambers are closed")
    charge_1: float = Field(0.0, ge=0.0, lt=2e6, description="pressure of sealed muscle 1 at ψ = 0 [Pa], 0: not known")
    charge_2: float = Field(0.0, ge=0.0, lt=2e6, description="the same of muscle 2 [Pa]")


class Gas(Strict):
    """Equations (4) and (5)."""

    heat_ratio: float = Field(gt=1.0, lt=2.0, description="k [-]")
    constant: float = Field(gt=50.0, lt=5000.0, description="R [J/(kg K)]")
    temperature: float = Field(gt=200.0, lt=400.0, description="T [K]")
    polytropic_flow: float = Field(gt=0.2, lt=2.0, description="k_1 [-]")
    polytropic_volume: float = Field(
        gt=0.0, lt=2.0, description="k_2 [-]; above 0.2 where no regulator holds the pressure"
    )


class Supply(Strict):
    """The tank."""

    pressure: float = Field(gt=150e3, lt=2e6, description="P_tank, absolute [Pa]")


class Atmosphere(Strict):
    """The surroundings."""

    pressure: float = Field(gt=50e3, lt=120e3, description="P_out, absolute [Pa]")


class Joint(Strict):
    """Equations (8), (9) and T_s."""

    inertia: float = Field(gt=1e-7, lt=10.0, description="J [kg m²]")
    stiffness: float = Field(ge=0.0, lt=1e3, description="k_s [N m/rad]")
    viscous_friction: float = Field(ge=0.0, lt=10.0, description="c_s [N m s/rad]")
    shaft_radius: float = Field(gt=0.0, lt=0.1, description="r_p [m]")
    mass: float = Field(ge=0.0, lt=100.0, description="M [kg]")
    gravity: float = Field(ge=0.0, lt=25.0, description="g [m/s²]")
    stop: Optional[float] = Field(gt=0.0, lt=math.pi / 2, description="mechanical stop at ± [rad], or null")  # noqa: UP045


class Friction(Strict):
    """Equation (10)."""

    shaft: float = Field(ge=0.0, lt=5.0, description="μ_s [-]")
    muscle: float = Field(ge=0.0, lt=1e13, description="μ_p [N m Pa²], T_p' in the paper's tables")
    pressure_floor: float = Field(
        gt=500.0, lt=200e3, description="least gauge pressure in T_p, which is singular at the atmosphere's [Pa]"
    )
    lever_force: float = Field(13.7, ge=0.0, lt=1e4, description="F_r of law 'simple', on the lever [N]")
    static: float = Field(0.146, ge=0.0, lt=100.0, description="f_s of law 'tondu' [N m]")
    kinetic: float = Field(0.03285, ge=0.0, lt=100.0, description="f_k of law 'tondu' [N m]")
    velocity: float = Field(0.8, gt=0.0, lt=100.0, description="x_k of law 'tondu' [rad/s]")


class Reading(NamedTuple):
    """Error of a reading: normal noise, and a converter that rounds by up to half its step.

    Attributes:
        std: of the noise, in the unit of the reading.
        step: of the converter, likewise.
    """

    std: float = 0.0
    step: float = 0.0

    @property
    def error(self) -> float:
        """Standard deviation of noise and rounding together."""
        return math.hypot(self.std, self.step / math.sqrt(12.0))

    def scaled(self, factor: float) -> Reading:
        """The same in another unit."""
        return Reading(self.std * factor, self.step * factor)


class Sensors(Strict):
    """Noise (one standard deviation) and step of the converter (0: none) of each sensor."""

    pressure_std: float = Field(gt=0.05, lt=100e3, description="[Pa]")
    pressure_step: float = Field(ge=0.0, lt=100e3, description="[Pa]")
    angle_std: float = Field(ge=0.0, lt=0.2, description="validation only [rad]")
    angle_step: float = Field(ge=0.0, lt=0.2, description="validation only [rad]")
    torque_std: float = Field(ge=0.0, lt=10.0, description="validation only [N m]")
    torque_step: float = Field(ge=0.0, lt=10.0, description="validation only [N m]")

    def reading(self, quantity: str) -> Reading:
        """Error of one reading. `quantity`: ``pressure`` [Pa], ``angle`` [rad] or ``torque`` [N m]."""
        return Reading(getattr(self, f"{quantity}_std"), getattr(self, f"{quantity}_step"))

    def error(self, quantity: str) -> float:
        """Standard deviation of one reading, noise and converter together, of a quantity as above."""
        return self.reading(quantity).error


NO_ENCODER = (
    "rig {rig} has no encoder in its file; write into it, in rad: encoder: {{std: 5.0e-4, step: 0.0, offset: 0.0}}"
)
"""Message where an encoder is needed."""


class Encoder(Strict):
    """A measured angle that the filter may use: noise (one standard deviation), step of the converter, and zero."""

    std: float = Field(ge=0.0, lt=0.2, description="[rad]")
    step: float = Field(0.0, ge=0.0, lt=0.2, description="[rad], 0: none")
    offset: float = Field(0.0, ge=-math.pi, le=math.pi, description="by how much the encoder reads too high [rad]")

    @property
    def variance(self) -> float:
        """Variance of one reading, noise and converter together [rad²]."""
        return Reading(self.std, self.step).error ** 2


def _late(what: str) -> Any:
    return Field(default=0.0, ge=-1.0, le=1.0, description=f"by how much the stamps of the {what} are too early [s]")


ENCODER_ZERO = "encoder_zero"
"""Field of :class:`Calibration`; a hypothesis of the monitor has its name."""


class Calibration(Strict):
    """Zeros, scale and clocks of the recordings, which are corrected by them while they are read; no node uses them."""

    encoder_zero: float = Field(
        default=0.0, ge=-math.pi, le=math.pi, description="zero error: by how much the encoder reads too high [rad]"
    )
    torque_zero: float = Field(
        default=0.0, ge=-1e3, le=1e3, description="zero error: by how much the torque meter reads too high [N m]"
    )
    torque_scale: float = Field(
        default=1.0, ge=0.1, le=10.0, description="scale error: reading of the torque meter over the torque [-]"
    )
    delay_voltage: float = _late("voltages")
    delay_angle: float = _late("angle")
    delay_torque: float = _late("torque")
    delay_pressure: float = _late("pressures")


_Diagonal = Tuple[float, float, float, float]  # noqa: UP006


class Tuning(Strict):
    """One tuning of the filter. Variances of [ψ, ψ̇, P_1, P_2] in [rad², rad²/s², Pa², Pa²]."""

    initial: _Diagonal = Field(description="diagonal of P(0)")
    process: _Diagonal = Field(description="diagonal of Q, a step")
    change: float = Field(
        0.0, ge=0.0, lt=10.0, description="error of a predicted change of pressure, relative to it; adds to Q [-]"
    )
    measurement: Tuple[float, float] = Field(description="diagonal of R [Pa²]")  # noqa: UP006
    kappa: float = Field(ge=0.0, lt=100.0, description="scaling of the sigma points [-]")
    consider: bool = Field(description="carry the rig's uncertain parameters in the covariance")
    gate: float = Field(gt=1.0, description="largest Mahalanobis distance of a pressure that is used [-]")
    gain: Literal["standard", "printed"] = Field(
        "standard", description="standard: P_xy/P_yy; printed: P_xy/(P_yy + R), which counts R twice"
    )
    states: Dict[str, Tuple[float, float]] = Field(  # noqa: UP006
        {}, description="of states that effects add: initial variance, and process variance a step"
    )


class Units(Strict):
    """Which units of a recording are what they are called."""

    pressure: Literal["pascal", "unknown"] = Field(
        "pascal", description="unknown: gain and offset of the recorded pressures are assumed"
    )
    force: Literal["newton", "per_inertia"] = Field(
        "newton", description="per_inertia: joint.inertia is assumed, and all torques are proportional to it"
    )


class WeakLaws(Strict):
    """Numbers of the effect ``weak_laws``: how its coefficients go with pressures and further signals."""

    middle: Dict[str, float] = Field(  # noqa: UP006
        description="what of each input is taken off: of pressure_1 and pressure_2 [Pa], and of signals [SI]"
    )
    range: Dict[str, float] = Field(description="unit in which what is left of each counts, likewise")  # noqa: UP006
    numbers: Dict[str, Dict[str, float]] = Field(  # noqa: UP006
        description="of each coefficient, by what it goes with [N m; N m s/rad of drag]"
    )


class Rig(Strict):
    """A rig: the numbers of its model, sensors and filter tunings.

    Read one with :func:`pam_antagonist.rig.load_rig`.
    """

    name: str
    source: str = Field(description="where the numbers come from")
    identified: str = Field("", description="recordings that the values were identified from; empty: from none")
    fitted: Dict[str, float] = Field(  # noqa: UP006
        {}, description="recordings that the values were fitted to: SHA-256 of each, and the end of that part [s]"
    )
    sample_period: float = Field(ge=1e-4, le=0.1, description="T_stp [s]")
    model: ModelForm = Field(default_factory=lambda: ModelForm(force="linear", friction="kikuuwe"))
    drive: Literal["valve", "regulator"] = Field(
        "valve", description="what drives the joint: voltages of valves, or pressures that regulators hold"
    )
    units: Units = Field(default_factory=lambda: Units(pressure="pascal", force="newton"))
    signals: Dict[str, float] = Field(  # noqa: UP006
        {},
        description="further signals on which effects depend, each with its reference value [SI]",
    )
    geometry: Geometry
    muscle_1: Muscle
    muscle_2: Muscle
    valve_1: Valve
    valve_2: Valve
    valves: ValveLimits
    supply: Supply
    atmosphere: Atmosphere
    gas: Gas
    joint: Joint
    friction: Friction
    sensors: Sensors
    encoder: Optional[Encoder] = Field(None, description="of angle_sensor: encoder")  # noqa: UP045
    calibration: Calibration = Calibration()
    effects: Dict[str, Dict[str, float]] = Field({}, description="what the paper's model lacks: docs/effects.md")  # noqa: UP006
    weak_laws: Optional[WeakLaws] = Field(  # noqa: UP045
        None, description="numbers of the effect weak_laws, which many episodes teach"
    )
    uncertainty: Dict[str, float]  # noqa: UP006
    directions: Dict[str, Dict[str, float]] = Field(  # noqa: UP006
        {}, description="parameters that are uncertain together: changes of one standard deviation each"
    )
    priors: Dict[str, float] = Field({}, description="standard deviations before identification, by parameter")  # noqa: UP006
    bounds: Dict[str, Tuple[float, float]] = Field(  # noqa: UP006
        {}, description="least and largest value that identification may find, by parameter"
    )
    tunings: Dict[str, Tuning]  # noqa: UP006

    @override
    def __repr__(self) -> str:
        source = " ".join(self.source.split())[:200]
        return f"Rig {self.name}: {self.drive} drive, {1.0 / self.sample_period:g} Hz; {source}"

    __str__ = __repr__

    @property
    def is_from_data_sheets(self) -> bool:
        """Whether data sheets and a ruler tell of the joint, as in a file of ``new_rig``, identified since or not.

        A known joint may have muscles of this force law as well, from a measured map: its lever has no prior.
        """
        return self.model.force == "braided" and "geometry.radius" in self.priors

    def value(self, name: str) -> float:
        """The number at a dotted path, such as ``muscle_1.force.w2``.

        Raises:
            BadInput: no such number.
        """
        node: Any = self
        head, *rest = name.split(".")
        try:
            if head == "effects":
                effect, item = rest
                return float(self.effects.get(effect, {}).get(item, _NEUTRAL[name]))
            for part in (head, *rest):
                node = getattr(node, part)
            return math.inf if node is None else float(node)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise BadInput(f"rig {self.name}: {unknown(name, par.INDEX)}; expected the name of a number") from None

    def with_value(self, name: str, value: Any) -> Rig:
        """This rig with another value, checked as a rig file is.

        Args:
            name: dotted, as the file has it: ``muscle_1.force.w2``, ``effects.leak.area_1``, ``sensors.pressure_std``,
                ``uncertainty.joint.inertia``.
            value: new value, in the unit of the file; None where the file may have null.

        Raises:
            BadInput: no such value (the message names the nearest one), or one that the file could not have.

        Example:
            >>> from pam_antagonist import load_rig
            >>> load_rig("shin2022").with_value("joint.inertia", 0.02).value("joint.inertia")
            0.02
        """
        from pam_antagonist.rig.file import with_value  # which imports this module

        return with_value(self, name, value)

    @property
    def command_limits(self) -> tuple[float, float]:
        """Least and largest command: voltages of the valves [V], or pressures of the regulators [Pa]."""
        if self.drive == "valve":
            return self.valves.voltage_min, self.valves.voltage_max
        low, high = (self.value(f"effects.regulator_limits.{name}") for name in ("lowest", "highest"))
        return max(low, self.atmosphere.pressure), high or self.supply.pressure

    def parameters(
        self, joint: str = "free", lock_angle: float = 0.0, changes: Mapping[str, float] | None = None
    ) -> np.ndarray:
        """The parameter vector of the physics.

        Args:
            joint: ``free`` or ``locked``.
            lock_angle: angle [rad] at which a locked joint is held; states must start there.
            changes: values that differ from the file's, by dotted path.

        Returns:
            Vector (parameters.SIZE,), float64.

        Raises:
            BadInput: a joint condition that does not exist, or a locked angle beyond the stop.
        """
        if joint not in ("free", "locked"):
            raise BadInput(f"joint condition {joint!r}: expected 'free' or 'locked'")
        bound = math.pi / 2 if self.joint.stop is None else self.joint.stop
        if not abs(lock_angle) <= bound:
            raise BadInput(f"lock angle {lock_angle:g} rad: expected within ±{bound:g} rad")
        p = np.zeros(par.SIZE)
        p[_EFFECTS] = list(_NEUTRAL.values())
        for effect, values in self.effects.items():
            for item, value in values.items():
                path = parameter_path(effect, item)
                if path not in _NEUTRAL:
                    raise BadInput(f"rig {self.name}: {unknown(path, _NEUTRAL)}; expected the parameter of an effect")
                p[par.INDEX[path]] = value
        for name, index in _BASE.items():
            p[index] = min(self.sample_period, par.LONGEST_STEP) if name == "friction.time_step" else self.value(name)
        p[par.LOCKED] = float(joint == "locked")
        p[par.PULLEY] = float(self.geometry.kind == "pulley")
        p[par.FORCE_FORM] = float(par.FORCE_FORMS.index(self.model.force))
        p[par.FRICTION_LAW] = float(par.FRICTION_LAWS.index(self.model.friction))
        if self.valves.sealed or self.drive == "regulator":
            p[par.VALVE : par.VALVE + 2 * par.VALVE_SIZE] = 0.0
        for number, valve in enumerate((self.valve_1, self.valve_2)):
            par.set_curve(p, number, np.array(valve.curve.voltage), np.array(valve.curve.open_rate))
        return par.changed(p, changes or {})

    def tuning(self, name: str) -> Tuning:
        """The filter tuning of that name.

        Raises:
            BadInput: the rig has no such tuning.
        """
        if name not in self.tunings:
            raise BadInput(f"tuning {name!r} of rig {self.name}: expected one of {', '.join(sorted(self.tunings))}")
        return self.tunings[name]


_NEUTRAL = {
    parameter_path(effect.name, item.name): item.neutral for effect in CATALOGUE.values() for item in effect.parameters
}
_EFFECTS = [par.INDEX[name] for name in _NEUTRAL]
_BASE = {name: index for name, index in par.INDEX.items() if name not in _NEUTRAL}


@cache
def limits(name: str) -> tuple[float, float]:
    """Least and largest value that a rig file may have at a dotted path; infinite where there is no limit."""
    if name.startswith("effects."):
        _, effect, item = name.split(".")
        known = next(entry for entry in CATALOGUE[effect].parameters if entry.name == item)
        return known.low, known.high
    kind: Any = Rig
    low, high = -math.inf, math.inf
    for part in name.split("."):
        field = fields_of(kind)[part]
        kind = getattr(field, "annotation", None) or getattr(field, "outer_type_", None)
        # pydantic 2 has an object for each limit, pydantic 1 all of them in one.
        for each in getattr(field, "metadata", None) or [getattr(field, "field_info", field)]:
            for attribute, inwards in (("ge", None), ("gt", math.inf), ("le", None), ("lt", -math.inf)):
                value = getattr(each, attribute, None)
                if value is None:
                    continue
                reached = float(value) if inwards is None else math.nextafter(value, inwards)
                if attribute[0] == "g":
                    low = reached
                else:
                    high = reached
    return low, high
