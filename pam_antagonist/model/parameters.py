"""The parameter vector: every number that the physics needs, in one flat array.

The compiled physics reads parameters by the indices defined here; people read and write them by name.
A name is the dotted path of the value in a rig file (``muscle_1.force.v1``), so that rigs, uncertainties
and identified values use the same names. Values that depend on others (the flow constants of
equation (5)) follow the named ones and are filled in by :func:`refresh`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.chebyshev import chebpts1

from pam_antagonist.model.effects import ADDED_STATES, CATALOGUE, learned, parameter_path
from pam_antagonist.model.effects.base import COEFFICIENTS as WEAK_COEFFICIENTS
from pam_antagonist.model.effects.base import SIGNALS
from pam_antagonist.model.force_forms import FORMS

TERMS = 16
"""Coefficients of the polynomial of the subsonic flow (:func:`series`)."""
MAX_KNOTS = 24
"""The most points that a valve curve may have."""

FORCE_FORMS = tuple(FORMS)
"""Forms of the static force map (``muscle.force``)."""
FRICTION_LAWS = ("kikuuwe", "simple", "tondu", "none")
"""Laws of friction (``joint.friction_torque``)."""
COEFFICIENTS = 7
"""The most coefficients of a force map other than the linear one."""

_MUSCLE = (
    *("volume.d1", "volume.d2", "volume.d3", "force.v1", "force.v2", "force.w1", "force.w2"),
    *(f"force.c{i}" for i in range(1, COEFFICIENTS + 1)),
)
_VALVE = ("inflow_area", "outflow_area", "overlap")
_NAMES = (
    *(f"muscle_1.{name}" for name in _MUSCLE),
    *(f"muscle_2.{name}" for name in _MUSCLE),
    *(f"valve_1.{name}" for name in _VALVE),
    *(f"valve_2.{name}" for name in _VALVE),
    "geometry.radius",
    "geometry.length",
    "geometry.cam_1",
    "geometry.cam_2",
    "gas.heat_ratio",
    "gas.constant",
    "gas.temperature",
    "gas.polytropic_flow",
    "gas.polytropic_volume",
    "supply.pressure",
    "atmosphere.pressure",
    "valves.charge_1",
    "valves.charge_2",
    "joint.inertia",
    "joint.stiffness",
    "joint.viscous_friction",
    "joint.shaft_radius",
    "joint.mass",
    "joint.gravity",
    "joint.stop",
    "friction.shaft",
    "friction.muscle",
    "friction.pressure_floor",
    "friction.lever_force",
    "friction.static",
    "friction.kinetic",
    "friction.velocity",
    "friction.time_step",
    *(parameter_path(effect.name, item.name) for effect in CATALOGUE.values() for item in effect.parameters),
)
INDEX: Mapping[str, int] = {name: index for index, name in enumerate(_NAMES)}
"""Index of each named parameter in the vector."""

MUSCLE, MUSCLE_SIZE = INDEX["muscle_1.volume.d1"], len(_MUSCLE)
D1, D2, D3, V1, V2, W1, W2, C1 = range(len(_MUSCLE) - COEFFICIENTS + 1)
VALVE, VALVE_SIZE = INDEX["valve_1.inflow_area"], len(_VALVE)
INFLOW_AREA, OUTFLOW_AREA, OVERLAP = range(len(_VALVE))
RADIUS = INDEX["geometry.radius"]
LENGTH = INDEX["geometry.length"]
CAM_1 = INDEX["geometry.cam_1"]
CAM_2 = INDEX["geometry.cam_2"]
HEAT_RATIO = INDEX["gas.heat_ratio"]
GAS_CONSTANT = INDEX["gas.constant"]
TEMPERATURE = INDEX["gas.temperature"]
POLYTROPIC_FLOW = INDEX["gas.polytropic_flow"]
POLYTROPIC_VOLUME = INDEX["gas.polytropic_volume"]
SUPPLY = INDEX["supply.pressure"]
ATMOSPHERE = INDEX["atmosphere.pressure"]
CHARGE = INDEX["valves.charge_1"]
INERTIA = INDEX["joint.inertia"]
STIFFNESS = INDEX["joint.stiffness"]
VISCOUS = INDEX["joint.viscous_friction"]
SHAFT_RADIUS = INDEX["joint.shaft_radius"]
MASS = INDEX["joint.mass"]
GRAVITY = INDEX["joint.gravity"]
STOP = INDEX["joint.stop"]
SHAFT_FRICTION = INDEX["friction.shaft"]
MUSCLE_FRICTION = INDEX["friction.muscle"]
PRESSURE_FLOOR = INDEX["friction.pressure_floor"]
LEVER_FORCE = INDEX["friction.lever_force"]
STATIC_FRICTION = INDEX["friction.static"]
KINETIC_FRICTION = INDEX["friction.kinetic"]
FRICTION_VELOCITY = INDEX["friction.velocity"]
FRICTION_STEP = INDEX["friction.time_step"]
LONGEST_STEP = 1e-3
"""[s] Longest step of the integration; a longer sample is divided. A step may be a tenth longer
(:func:`~pam_antagonist.model.integration.substeps_of`), and a half longer between uneven stamps in the filter."""

# The named values are followed by the options of the joint, the derived values and the two valve curves.
LOCKED = len(_NAMES)
CRITICAL_RATIO = LOCKED + 1
CHOKED_FLOW = LOCKED + 2
SUBSONIC_FLOW = LOCKED + 3
FLOW_CONSTANTS = (CRITICAL_RATIO, CHOKED_FLOW, SUBSONIC_FLOW)
PULLEY = LOCKED + 4
FORCE_FORM = LOCKED + 5
FRICTION_LAW = LOCKED + 6
STATELESS_EFFECTS = LOCKED + 7
"""1 if an effect without an added state is present; a rig that has none costs one comparison."""
STATES = LOCKED + 8
"""Number of states, added ones included."""
PLAIN = LOCKED + 9
"""1 for the paper's own model without effects, which most rigs have and which runs fastest."""
SUBSONIC = LOCKED + 10
"""First of the coefficients of the subsonic flow (:func:`series`)."""
SIGNAL = SUBSONIC + TERMS
"""First of the further signals on which effects may depend; the value is 0 where a signal is not measured."""
WEAK_LAWS = SIGNAL + SIGNALS
"""First of the coefficients of the weak laws, which follow the signals."""
SLOT = WEAK_LAWS + WEAK_COEFFICIENTS
"""First of the slots for ``effects.ADDED_STATES``: each holds the index in the state, or 0 for an absent state."""
LAWS_PRESENT = SLOT + len(ADDED_STATES)
"""Number of learned laws whose values are not all 0."""
LAW = LAWS_PRESENT + 1
"""First of the codes of these laws, one after another, a copy of the named ones: they are the same in all lanes."""
LAWS_IN = {hook: LAW + learned.LAWS * learned.SIZE + k for k, hook in enumerate(learned.EFFECT.hooks)}
"""Indices of whether laws act in a function of the effects, by its name."""
CURVE = max(LAWS_IN.values()) + 1
CURVE_SIZE = 1 + 2 * MAX_KNOTS
SIZE = CURVE + 2 * CURVE_SIZE

LAW_NUMBERS = INDEX[parameter_path("learned", "law1_place")]
"""First of the named numbers of the learned laws."""
SLOT_OF: Mapping[str, int] = {state.name: SLOT + k for k, (_, state) in enumerate(ADDED_STATES)}
"""Index of each added state's slot, by the state's name."""
_SWITCHES = [
    [INDEX[parameter_path(effect, name)] for name in (state.switch, *state.further)] for effect, state in ADDED_STATES
]
_SWITCH = np.concatenate(_SWITCHES)
_FIRST_SWITCH = np.cumsum([0, *map(len, _SWITCHES[:-1])])
_STATELESS = np.array(
    [
        INDEX[parameter_path(effect.name, item.name)]
        for effect in CATALOGUE.values()
        if not effect.states
        for item in effect.parameters
        if item.is_size
    ]
)
BASE_STATES = 4


def added_states(p: np.ndarray) -> list[str]:
    """Names of the states that follow P_2, in their order."""
    return [state.name for k, (_, state) in enumerate(ADDED_STATES) if p[SLOT + k] > 0.0]


@lru_cache(maxsize=64)
def series(heat_ratio: float) -> tuple[float, ...]:
    """The subsonic branch of equation (5) as a polynomial, which takes a third of the time of a power.

    With the gap s = (P_up − P_down)/P_up, the pressures' part of the branch is

        r^(2/k) − r^((k+1)/k) = s h(s),  r = 1 − s

    and h is smooth from s = 0 to where the flow chokes. Its Chebyshev polynomial is right to 1e-14 there.

    `heat_ratio`: k [-], above 1. Returns the coefficients of h by powers of s, the constant first (TERMS).
    """
    k = heat_ratio
    widest = 1.0 - (2.0 / (k + 1.0)) ** (k / (k - 1.0))
    s = 0.5 * widest * (chebpts1(TERMS) + 1.0)
    log_r = np.log1p(-s)
    h = -np.exp(2.0 / k * log_r) * np.expm1((k - 1.0) / k * log_r) / s
    return tuple(Chebyshev.fit(s, h, TERMS - 1, domain=[0.0, widest]).convert(kind=Polynomial).coef.tolist())


def refresh(p: np.ndarray) -> np.ndarray:
    """Fill in the values that follow from the named ones.

    These are the constants of equation (5) that do not depend on a pressure, and the states that the effects add.

    `p`: parameter vector (SIZE,), changed in place.
    """
    k, gas, root_t = p[HEAT_RATIO], p[GAS_CONSTANT], np.sqrt(p[TEMPERATURE])
    p[CRITICAL_RATIO] = (2.0 / (k + 1.0)) ** (k / (k - 1.0))
    p[CHOKED_FLOW] = np.sqrt(k / gas * (2.0 / (k + 1.0)) ** ((k + 1.0) / (k - 1.0))) / root_t
    p[SUBSONIC_FLOW] = np.sqrt(2.0 * k / (gas * (k - 1.0))) / root_t
    p[SUBSONIC : SUBSONIC + TERMS] = series(float(k))
    p[STATELESS_EFFECTS] = float(np.any(p[_STATELESS] != 0.0))
    present = np.logical_or.reduceat(p[_SWITCH] != 0.0, _FIRST_SWITCH)
    p[SLOT : SLOT + len(present)] = np.where(present, BASE_STATES - 1 + np.cumsum(present), 0)
    count = BASE_STATES + int(present.sum())
    p[STATES] = count
    _copy_laws(p)
    own = p[FORCE_FORM] == 0.0 and p[FRICTION_LAW] == 0.0
    p[PLAIN] = float(own and p[STATELESS_EFFECTS] == p[LAWS_PRESENT] == 0.0 and count == BASE_STATES)
    return p


def _copy_laws(p: np.ndarray) -> None:
    """Write the codes of the laws that are present, whose values are not all 0, where all lanes find them."""
    p[LAWS_PRESENT:CURVE] = 0.0
    numbers = p[LAW_NUMBERS : LAW_NUMBERS + learned.LAWS * learned.NUMBERS].reshape(learned.LAWS, learned.NUMBERS)
    for k in np.flatnonzero((numbers[:, 0] != 0.0) & numbers[:, -learned.NODES :].any(axis=1)):
        codes = p[LAW + int(p[LAWS_PRESENT]) * learned.SIZE :][: learned.SIZE]
        codes[: learned.STATE] = numbers[k, : learned.STATE]
        slot = SLOT_OF[f"law{k + 1}_memory_1"]
        codes[learned.STATE : learned.SIGNAL] = p[slot : slot + learned.SIGNAL - learned.STATE]
        codes[learned.SIGNAL] = SIGNAL + max(codes[2] - learned.FIRST_SIGNAL, 0.0)
        codes[learned.TABLE] = LAW_NUMBERS + k * learned.NUMBERS
        p[LAWS_PRESENT] += 1.0
        place = list(learned.PLACES)[int(codes[0]) - 1]
        for hook, index in LAWS_IN.items():
            acts = place in learned.IN_HOOKS[hook] if hook in learned.IN_HOOKS else codes[learned.STATE :][:3].any()
            p[index] = max(p[index], float(acts))


def set_curve(p: np.ndarray, valve: int, voltage: np.ndarray, open_rate: np.ndarray) -> None:
    """Write the curve α = κ(u) of one valve into the vector.

    `p`: parameter vector (SIZE,), changed in place. `voltage`: knots (K,) [V], increasing, at most ``MAX_KNOTS``.
    `open_rate`: open rates (K,) [-] at the knots.
    """
    start = CURVE + valve * CURVE_SIZE
    knots = len(voltage)
    p[start] = knots
    p[start + 1 : start + 1 + knots] = voltage
    p[start + 1 + MAX_KNOTS : start + 1 + MAX_KNOTS + knots] = open_rate


def changed(p: np.ndarray, changes: Mapping[str, float]) -> np.ndarray:
    """A copy of the vector with some named values set.

    `p`: parameter vector (SIZE,). Returns the new vector (SIZE,), refreshed.
    """
    result = p.copy()
    for name, value in changes.items():
        result[INDEX[name]] = value
    return refresh(result)
