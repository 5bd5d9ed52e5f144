"""Hooks: where an effect can act on the model, and which quantities it can use there.

The equations name no effect. At each hook they pass a value, which effects add to, subtract from or replace. The names
of its arguments say what an effect's function gets: parameters of the effect (``area`` for ``area_1`` or ``area_2``,
whichever muscle is computed), its states (likewise), and the quantities below.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pam_antagonist.model.effects.base import COEFFICIENTS, SIGNALS

QUANTITIES: dict[str, tuple[str, str]] = {
    "atmosphere": ("Pa", "pressure of the atmosphere, P_out"),
    "supply_pressure": ("Pa", "pressure that the supply is set to, P_tank"),
    "quickest_lag": ("s", "shortest time constant that a step of the integration follows"),
    "joint_angle": ("rad", "ψ"),
    "joint_velocity": ("rad/s", "ψ̇"),
    "travel": ("-", "travel of a muscle's end over r: sin ψ of a lever, ψ of a pulley"),
    "muscle_length": ("m", "l_i, equation (2)"),
    "length_rate": ("m/s", "dl_i/dt"),
    "static_force": ("N", "contraction force by the static map, equations (6) and (7)"),
    "passive_force": ("N", "the same at the pressure of the atmosphere"),
    "muscle_force": ("N", "contraction force, with what effects add to it"),
    "valve_voltage": ("V", "u_i"),
    "asked_pressure": ("Pa", "u_i of a pressure regulator, with what the effects before make of it"),
    "wanted_open_rate": ("-", "open rate that the voltage asks for"),
    "valve_pressure": ("Pa", "pressure at valve and sensor, P_i"),
    "chamber_pressure": ("Pa", "pressure in the muscle; P_i unless an effect says otherwise"),
    "valve_flow": ("kg/s", "mass flow through the valve into the muscle, equation (5)"),
    "orifice_flow": ("kg/(s m2)", "flow of an ideal orifice from the muscle to the atmosphere, by its area"),
    "drawn_flow": ("kg/s", "mass flow that both valves draw from the supply"),
    "bulk_modulus": ("Pa", "of the air in the muscle, k_2 P_i"),
    "volume_rate": ("1/s", "dV_i/dt over V_i"),
    "polytropic_rate": ("Pa/s", "dP_i/dt of equation (4)"),
    "chamber_rate": ("Pa/s", "dP_i/dt of the muscle, effects included"),
    "coulomb_torque": ("N m", "T_s + T_p of equation (10)"),
    "muscle_torque": ("N m", "τ of equation (9), and the torque from outside where it is known"),
    "pressure": ("Pa", "pressure at a sensor"),
    "reading": ("Pa", "what a sensor shows"),
    "now": ("rad, rad/s, Pa, Pa", "ψ, ψ̇ and the pressures in both muscles of the state, as one tuple"),
    "first_pressure": ("Pa", "pressure in muscle 1"),
    "second_pressure": ("Pa", "pressure in muscle 2"),
    **{
        f"signal{k}": ("SI", f"further signal {k} of the rig file, less its value there") for k in range(1, SIGNALS + 1)
    },
    **{f"coefficient{k}": ("N m", f"coefficient {k} of the weak laws now") for k in range(1, COEFFICIENTS + 1)},
}
"""Unit and meaning of each quantity that a function of an effect may ask for."""

EVERYWHERE = (
    "atmosphere", "supply_pressure", "quickest_lag", *(f"signal{k}" for k in range(1, SIGNALS + 1)),
    *(f"coefficient{k}" for k in range(1, COEFFICIENTS + 1)),
)  # fmt: skip
"""Quantities that every function may ask for."""


@dataclass(frozen=True)
class Hook:
    """A place in the equations where effects act."""

    name: str  # as in ``Effect.hooks``
    meaning: str
    unit: str
    way: Literal["adds", "subtracts", "replaces"]
    value: str
    quantities: tuple[str, ...] = ()
    of_muscle: bool = True  # whether the hook is at each muscle (valve, sensor) in turn
    # whether functions may ask for states, must do so, or cannot.
    states: Literal["possible", "needed", "none"] = "possible"
    floor: bool = False  # whether the value is kept at 0 at least


_JOINT = ("joint_angle", "joint_velocity", "travel")
_FRICTION = (*_JOINT, "first_pressure", "second_pressure", "now")
_LENGTH = ("muscle_length", "length_rate", "now")
_LOSS = ("chamber_pressure", "orifice_flow", *_LENGTH, "wanted_open_rate")
_LINE = ("valve_pressure", "chamber_pressure", "valve_flow")
_SWELLING = ("bulk_modulus", "volume_rate", *_LENGTH)
_FORCE = (*_LENGTH, "chamber_pressure", "passive_force")

HOOKS: dict[str, Hook] = {
    hook.name: hook
    for hook in (
        Hook("spool_voltage", "the spool's voltage", "V", "replaces", "valve_voltage", ("now",), states="needed"),
        Hook("voltage_shift", "shift of the curve along the voltage", "V", "subtracts", "valve_voltage", states="none"),
        Hook("open_rate_shift", "change of the open rate", "-", "adds", "wanted_open_rate", states="none"),
        Hook("open_rate", "open rate of the valve", "-", "replaces", "wanted_open_rate", _LENGTH, states="needed"),
        Hook("asked_pressure", "pressure that the regulator goes by", "Pa", "replaces", "asked_pressure"),
        Hook("supply_change", "change of the supply's pressure", "Pa", "adds", "supply_pressure", ("now",), False),
        Hook("chamber_pressure", "pressure in the muscle", "Pa", "replaces", "valve_pressure", states="needed"),
        Hook("mass_loss", "mass flow out of the muscle past the valve", "kg/s", "subtracts", "valve_flow", _LOSS),
        Hook("swelling", "dP/dt of a muscle of another volume", "Pa/s", "replaces", "polytropic_rate", _SWELLING),
        Hook("cooling", "what dP/dt loses", "Pa/s", "subtracts", "polytropic_rate", ("chamber_pressure",)),
        Hook("valve_pressure_rate", "dP/dt at the valve", "Pa/s", "replaces", "chamber_rate", _LINE, states="needed"),
        Hook("contraction_force", "further contraction force", "N", "adds", "static_force", _FORCE),
        Hook("muscle_force", "force that the muscle passes on", "N", "replaces", "muscle_force", states="none"),
        Hook("coulomb_torque", "further Coulomb torque", "N m", "adds", "coulomb_torque", _FRICTION, False, floor=True),
        Hook("disturbance_torque", "torque from outside", "N m", "adds", "muscle_torque", (), False, states="needed"),
        Hook("joint_torque", "torque on the joint", "N m", "adds", "muscle_torque", (*_JOINT, "now"), False),
        Hook("sensor_reading", "what the pressure sensor shows", "Pa", "replaces", "pressure", states="none"),
        Hook("sensor_inverse", "the pressure behind a reading", "Pa", "replaces", "reading", states="none"),
    )
}
"""All hooks by name, in the order in which the model passes them."""

MUSCLE_RATE = (
    *_JOINT, "muscle_length", "length_rate", "static_force", "valve_voltage", "asked_pressure", "wanted_open_rate",
    "valve_pressure", "chamber_pressure", "valve_flow", "polytropic_rate", "chamber_rate", "now",
)  # fmt: skip
"""What the derivative of a muscle's state may ask for."""
JOINT_RATE = (*_JOINT, "drawn_flow", "now")
"""What the derivative of a state of the whole joint may ask for."""
MUSCLE_STEADY = (
    *_JOINT, "muscle_length", "length_rate", "static_force", "valve_voltage", "asked_pressure", "wanted_open_rate",
    "valve_pressure", "chamber_pressure", "valve_flow", "now",
)  # fmt: skip
"""What the steady value of a muscle's state may ask for."""
JOINT_STEADY = ("drawn_flow", "now")
"""What the steady value of a state of the whole joint may ask for."""
