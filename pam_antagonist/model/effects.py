"""The catalogue of effects that the paper's model leaves out.

An effect is what a real rig may have beside equations (1) to (11). It is part of the one model: its physics stands with
its domain (``muscle``, ``flow``, ``joint``), its parameters are named here, and at their neutral values it vanishes
to the last bit. ``docs/effects.md`` shows how one is added.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect.

    Attributes:
        name: as in a rig file; ends in ``_1`` or ``_2`` where each muscle has its own.
        unit: of the value.
        neutral: value of a rig that does not mention it; a *size* is 0 there, a *shape* (a time, a width) has a start.
        low: least value that makes sense.
        high: largest value.
        scale: a value that is neither small nor large, for searches.
        meaning: in words.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    scale: float
    meaning: str

    @property
    def is_size(self) -> bool:
        """Whether the effect vanishes with this parameter: sizes are neutral at zero, shapes are not."""
        return self.neutral == 0.0

    @property
    def muscle(self) -> int | None:
        """1 or 2 where the parameter belongs to one muscle."""
        return int(self.name[-1]) if self.name.endswith(("_1", "_2")) else None


@dataclass(frozen=True)
class AddedState:
    """A state that an effect adds to [ψ, ψ̇, P_1, P_2].

    Attributes:
        name: of the state.
        unit: of the state.
        switch: the parameter (in this effect) whose value other than zero brings the state.
        initial_std: how well it is known when a filter starts.
        noise: process noise of a filter, standard deviation a square root of a second.
        further: other parameters (in this effect) that bring the state likewise.
    """

    name: str
    unit: str
    switch: str
    initial_std: float
    noise: float
    further: tuple[str, ...] = ()


@dataclass(frozen=True)
class Effect:
    """An effect of the catalogue.

    Attributes:
        name: as in a rig file and in reports.
        meaning: what happens, in a sentence.
        law: its equation in words and symbols.
        source: where the law comes from.
        signature: which residual it moves, and how.
        parameters: its numbers.
        states: the states that it adds.
    """

    name: str
    meaning: str
    law: str
    source: str
    signature: str
    parameters: tuple[EffectParameter, ...]
    states: tuple[AddedState, ...] = ()


def _both(name: str, unit: str, low: float, high: float, scale: float, meaning: str) -> tuple[EffectParameter, ...]:
    """A size that each muscle has."""
    return tuple(
        EffectParameter(f"{name}_{i}", unit, 0.0, low, high, scale, f"{meaning} of muscle {i}") for i in (1, 2)
    )


def _pair(name: str, unit: str, switch: str, initial_std: float, noise: float, *further: str) -> tuple[AddedState, ...]:
    return tuple(AddedState(f"{name}_{i}", unit, f"{switch}_{i}", initial_std, noise, further) for i in (1, 2))


_EFFECTS = (
    Effect(
        "hysteresis",
        "The contraction force depends on which way the length came: braid and tube rub while they move.",
        "F_i gains a_i z_i, dz_i/dt = (dl_i/dt − (|dl_i/dt| z_i + dl_i/dt |z_i|)/2)/s",
        "Bouc (1967), Wen (1976), with A = 1, β = γ = 1/2, n = 1; for muscles: Vo-Minh et al. (2011)",
        "Torque and rest angle differ between shortening and lengthening, at any speed.",
        (
            *_both("amplitude", "N", -60.0, 60.0, 4.0, "half the width of the force's loop"),
            EffectParameter("width", "m", 2e-3, 2e-4, 2e-2, 2e-3, "length over which the force turns round"),
        ),
        _pair("hysteresis", "-", "amplitude", 0.5, 1e-4),
    ),
    Effect(
        "leak",
        "Air escapes from a muscle to the atmosphere past the valve.",
        "m_i loses A_i ((P_i − P_out)/350 kPa)^(n − 1) times the orifice flow (5) from P_i to P_out",
        "ideal orifice, as equation (5), for n = 1; a fine crack or capillary, whose flow is viscous, up to n = 2",
        "Mass flow of one muscle too low, the more the higher its pressure; steady pressures below the curve's.",
        (
            *_both("area", "m2", 0.0, 5e-8, 1e-9, "area of the leak"),
            EffectParameter("exponent", "-", 1.0, 0.6, 3.0, 1.0, "power of the gauge pressure beside an orifice's"),
        ),
    ),
    Effect(
        "supply_droop",
        "The tank's pressure falls while air is drawn from it and recovers with time.",
        "P_tank gains s, ds/dt = −c (m_in,1 + m_in,2) − s/T",
        "isothermal tank behind a regulator, first order",
        "Inflow of both muscles too low while either fills; steady pressures low by what the valves go on drawing.",
        (
            EffectParameter("stiffness", "Pa/kg", 0.0, 0.0, 5e10, 2e8, "fall of the supply a kilogram drawn from it"),
            EffectParameter("time", "s", 0.5, 0.02, 20.0, 0.5, "time constant of its recovery"),
        ),
        (AddedState("supply", "Pa", "stiffness", 1e3, 10.0),),
    ),
    Effect(
        "valve_lag",
        "The valve follows its voltage late: with a delay of first order, and no quicker than it can.",
        "dα_i/dt = (κ(u_i) − α_i)/(w T_i), at most 1/T_i either way",
        "first-order spool whose drive saturates: the small-signal and the full-stroke time of data sheets",
        "Mass flow wrong for milliseconds after each change of voltage, nothing in the steady state.",
        (
            *_both("time", "s", 0.0, 2.0, 0.01, "time constant, or of a full stroke, of the valve"),
            EffectParameter("reach", "-", 1.0, 1e-2, 1.0, 0.05, "lag of the open rate from which on speed is full"),
        ),
        _pair("open_rate", "-", "time", 0.02, 1e-4),
    ),
    Effect(
        "valve_offset",
        "The valve's curve is shifted: along the voltage, along the open rate, or both.",
        "α_i = κ(u_i − δ_i) + ρ_i, within 0 and 1",
        "null shift of a proportional valve: of its electronics δ, of its spool or seat ρ",
        "Steady pressure of one muscle off as by another voltage: by δ most where the curve is steep, by ρ everywhere.",
        (
            *_both("voltage", "V", -2.0, 2.0, 0.1, "shift of the curve along the voltage"),
            *_both("open_rate", "-", -0.1, 0.1, 0.01, "shift of the curve along the open rate"),
        ),
    ),
    Effect(
        "line_resistance",
        "Tube or fitting between valve and muscle: the sensor at the valve shows more than the chamber while it fills.",
        "P_s,i = P_c,i + R_i m_i (|m_i|/0.05 g/s)^(n − 1) behind a lag T; valve and sensor see P_s, the muscle P_c",
        "laminar flow for n = 1, turbulent flow and fittings up to n = 2; line volume neglected",
        "Both flow and torque wrong with the flow while air moves, nothing in the steady state.",
        (
            *_both("resistance", "Pa s/kg", 0.0, 5e9, 1e8, "resistance of the line"),
            EffectParameter("time", "s", 2e-3, 1e-3, 0.05, 2e-3, "lag of the line"),
            EffectParameter("exponent", "-", 1.0, 1.0, 2.0, 1.5, "power of the flow in the fall of pressure"),
        ),
        _pair("chamber", "Pa", "resistance", 1e3, 50.0),
    ),
    Effect(
        "pressure_sensor",
        "A pressure sensor reads with a wrong offset or gain.",
        "reading_i = (1 + g_i) P_i + o_i",
        "linear sensor error",
        "Torque and steady pressure off together, as if the muscle had another pressure than its sensor says.",
        (
            *_both("offset", "Pa", -60e3, 60e3, 3e3, "offset of the sensor"),
            *_both("gain", "-", -0.3, 0.3, 0.01, "error of the sensor's gain"),
        ),
    ),
    Effect(
        "load_torque",
        "Something beside the muscles pulls at the joint always: a limb's weight, a spring.",
        "τ gains b + a sin ψ on the joint's side; a torque meter on the muscles does not see it",
        "rigid body under gravity",
        "Joint motion and rest angle off; torque of a locked joint and pressures as they should be.",
        (
            EffectParameter("constant", "N m", 0.0, -3.0, 3.0, 0.05, "torque at angle 0"),
            EffectParameter("sine", "N m", 0.0, -10.0, 10.0, 0.1, "torque that grows with the sine of the angle"),
        ),
    ),
    Effect(
        "friction",
        "Friction of another kind than (10): constant, or larger at rest than in motion.",
        "T_s + T_p gains c + d exp(−|ψ̇|/v)",
        "Coulomb and Stribeck; Tondu and Lopez (2000)",
        "Joint sticks longer or shorter than it should; flow and locked torque as they should be.",
        (
            EffectParameter("coulomb", "N m", 0.0, -0.5, 2.0, 0.02, "constant Coulomb torque"),
            EffectParameter("stribeck", "N m", 0.0, -0.5, 2.0, 0.02, "further torque at rest"),
            EffectParameter("velocity", "rad/s", 0.3, 0.01, 10.0, 0.3, "velocity over which that fades"),
        ),
    ),
    Effect(
        "creep",
        "The muscle gives way slowly after its load or its length has changed: rubber relaxes.",
        "F_i gains c_i − y_i, dc_i/dt = (y_i − c_i)/T, with y_i = φ_i F_i − κ l_i",
        "standard linear solid (Zener): a share φ of the whole force, and the stiffness κ of the tube, which does not "
        "depend on the pressure; for muscles: Vo-Minh et al. (2011)",
        "Torque and rest angle drift for seconds after a step while the pressures stand; with κ alone, of a moving "
        "joint only.",
        (
            *_both("share", "-", -0.5, 0.5, 0.02, "share of a change of force that comes late"),
            EffectParameter("stiffness", "N/m", 0.0, -2000.0, 2000.0, 50.0, "stiffness of a muscle that relaxes"),
            EffectParameter("time", "s", 4.0, 0.2, 60.0, 4.0, "time constant"),
        ),
        _pair("creep", "N", "share", 3.0, 1e-2, "stiffness"),
    ),
    Effect(
        "thermal",
        "The gas warms when it is compressed and cools with time, so the pressure goes on moving.",
        "dP_i/dt loses q_i/T, dq_i/dt = χ_i dP_i/dt|(4) − q_i/T",
        "first-order heat exchange with the wall about the polytropic law (4)",
        "Pressure relaxes for seconds after each filling and emptying, against its change.",
        (
            *_both("share", "-", -0.5, 0.9, 0.05, "share of a change of pressure that is warmth"),
            EffectParameter("time", "s", 1.0, 0.05, 30.0, 1.0, "time constant of the heat exchange"),
        ),
        _pair("warmth", "Pa", "share", 500.0, 20.0),
    ),
    Effect(
        "external_torque",
        "Somebody or something pushes the joint now and then.",
        "τ gains d, a random walk whose increments have the standard deviation σ a square root of a second",
        "disturbance observer",
        "Joint moves without a cause in the pressures, at some times and not at others.",
        (EffectParameter("noise", "N m/s^0.5", 0.0, 0.0, 10.0, 0.05, "size of the random walk"),),
        (AddedState("external_torque", "N m", "noise", 0.2, 0.0),),
    ),
)

CATALOGUE: Mapping[str, Effect] = {effect.name: effect for effect in _EFFECTS}
"""All effects by name."""

ADDED_STATES: tuple[tuple[str, AddedState], ...] = tuple(
    (effect.name, state) for effect in _EFFECTS for state in effect.states
)
"""Every state that effects can add, with the effect's name, in the order in which they follow P_2."""


def parameter_path(effect: str, name: str) -> str:
    """Dotted path of an effect's parameter, as in a rig file."""
    return f"effects.{effect}.{name}"
