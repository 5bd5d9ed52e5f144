r"""A law that was learned from recordings: a table of numbers at one place of the equations.

```math
\text{place} \mathrel{+}= \theta(\mathcal{O}[a]),\qquad
\theta(z) = \theta_k + (\theta_{k+1} - \theta_k)\,\frac{z - z_k}{z_{k+1} - z_k}\quad (z_k \le z \le z_{k+1}).
```

$a$ is what the law depends on. $\mathcal{O}$ is an operator with a memory, or none. $\theta$ is a table with up to 15
nodes $z_k$ and as many values. Outside of the nodes, which are the range that was seen, it is constant. A rig has up to
twelve laws. Its file names what a law is made of:

```yaml
effects:
  learned:
    law1:
      place: flow                      # mass flow into the muscle beside the valve [kg/s]
      muscle: 2                        # 1, 2 or both
      argument: pressure_difference    # P_1 - P_2 [Pa]
      operator: lag                    # leave it out for none
      time: 0.5                        # of the lag [s]
      nodes: [-1.0e+5, 0.0, 1.0e+5]    # of the argument, increasing
      values: [0.0, 1.0e-6, 3.0e-6]    # at the nodes
```

| place | of | unit | |
|---|---|---|---|
| `flow` | muscle | kg/s | mass flow into the muscle beside the valve, within the pressures of air and supply |
| `leak` | muscle | m2 | area of a leak to the atmosphere, 0 at least |
| `valve` | muscle | - | change of the open rate at which the valve stands, which stays within 0 and 1 |
| `sensor` | muscle | Pa | by how much the pressure sensor reads too high, by its reading (`pressure`) |
| `force` | muscle | N | further contraction force |
| `strength` | muscle | - | share of the force that the pressure adds, F(l, P) − F(l, P_out) |
| `torque` | joint | N m | further torque on the joint |
| `damping` | joint | N m s/rad | change of the viscous friction c_s, which stays at 0 or above |
| `friction` | joint | N m | change of the Coulomb torque T_s + T_p, which stays at 0 or above |
| `exchange` | joint | kg/s | mass flow from muscle 1 to muscle 2, only towards the lower pressure |
| `supply` | joint | - | change of the supply's pressure, as a share of it |
| `passage` | muscle | - | change of the flow through the valve, as a share of it, −1 at least: a hose that throttles |
| `volume` | muscle | - | change of the volume, as a share of it, by `length` or `pressure`, without an operator |
| `command` | muscle | V | change of the voltage for which the valve's spool stands |

The arguments `pressure_1`, `pressure_2`, `pressure_difference` (P_1 − P_2), `pressure_sum`, `angle`, `velocity`,
`speed` (its absolute value), `time` (since the start) and the names of the file's `signals` are known everywhere. At a
place of a muscle there are its own `pressure`, `other_pressure`, `length` and `length_rate`. At `flow`, `leak` and
`passage` there are `open_rate` (that the voltage asks for) and `valve_flow`, at `valve` there is `open_rate`, at
`command` the valve's `voltage`. A place of the joint may depend on `draw`, the flow of both valves out of the supply,
with the operator `lag`. `none` makes a constant, with one node.

| operator | its number | what the table gets |
|---|---|---|
| `lag` | `time` [s] | z with dz/dt = (a − z)/`time` |
| `high_pass` | `time` [s] | a − z, with the same z |
| `play` | `width`, in the argument's unit | z, which is held within a ± `width`/2 and stays otherwise |
| `stop` | `width`, in the argument's unit | a − z, with the same z |

An operator adds a state for each muscle, or one for the joint, and so does `time`. The state is z over the distance
from the first to the last node. It starts at rest, z = a.

A law makes no energy where physics has none. Flows fade within 2 kPa of where they would turn against the pressures. A
torque, force or strength that depends on `velocity` or `length_rate`, without operator, acts only against the motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model.effects import places
from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter, SealedJoint, played
from pam_antagonist.model.lane_values import shared

LAWS, NODES = 12, 15
"""The most laws of a rig, and the most nodes of a law."""
PLACES = {name: place.unit for name, place in places.TABLE.items() if place.hooks}
"""Places of a law, with the unit of its values. Their codes are 1, 2 and so on, as those of the other tables."""
OF_JOINT = tuple(name for name in PLACES if not places.TABLE[name].sides)
"""Places that do not belong to a muscle."""
ARGUMENTS = {
    "none": "-", "pressure_1": "Pa", "pressure_2": "Pa", "pressure_difference": "Pa", "pressure_sum": "Pa",
    "angle": "rad", "velocity": "rad/s", "speed": "rad/s", "pressure": "Pa", "other_pressure": "Pa", "length": "m",
    "length_rate": "m/s", "open_rate": "-", "valve_flow": "kg/s", "draw": "kg/s", "voltage": "V", "time": "s",
    "signal1": "SI", "signal2": "SI", "signal3": "SI", "signal4": "SI",
}  # fmt: skip
"""What a law may depend on, with units."""
OPERATORS = ("none", "clock", "lag", "play", "high_pass", "stop")
"""Operators; ``clock`` is that of the argument ``time``."""
MUSCLES = ("both", "1", "2", "joint")
"""Where a law acts; these codes begin at 0."""

# numba would compile a function anew for each literal.
(
    FLOW, LEAK, EXCHANGE, FORCE, STRENGTH, VALVE, SENSOR, TORQUE, _DAMPING, FRICTION, SUPPLY, PASSAGE, VOLUME, COMMAND,
) = map(np.int64, range(1, 15))  # fmt: skip
JOINT = np.int64(2)
"""Index of the joint, in the place of a muscle's."""
(
    _, _FIRST, _SECOND, _DIFFERENCE, _SUM, _ANGLE, _VELOCITY, _SPEED, _PRESSURE, _OTHER, _LENGTH, _LENGTH_RATE,
    _OPEN_RATE, _VALVE_FLOW, _DRAW, _VOLTAGE, _TIME, FIRST_SIGNAL,
) = range(1, 19)  # fmt: skip
_NONE, _CLOCK, _LAG, _PLAY, _HIGH_PASS, _STOP = range(1, 1 + len(OPERATORS))

CODES = ("place", "muscle", "argument", "operator", "count", "keeps_1", "keeps_2", "keeps")
"""What a law is made of. The last ones are 1 for each state that it has, at muscle 1, muscle 2 and the joint."""
_PLACE, _MUSCLE, _ARGUMENT, _OPERATOR, _COUNT, STATE, _, _, SIGNAL, TABLE = range(2 + len(CODES))
SIZE = len(CODES) + 2
"""Entries of a law's codes where all lanes find them: there the indices of its states, signal and numbers are too."""
NUMBERS = len(CODES) + 2 + 2 * NODES
"""Numbers of a law: codes, time, width, nodes, values."""
_TIME_AT, _WIDTH_AT, _NODE_AT = len(CODES), len(CODES) + 1, len(CODES) + 2
_LARGEST = 1e12
"""Largest number of a table, in the unit of its place or argument."""
_LEAST_VOLUME, _LEAST_GIVE = 0.5, 0.1
"""A volume stays above that share of itself, and a pressure follows its flow by no more than ten times as much."""
_FADE = 2e3
"""[Pa] Difference of pressures within which a flow goes to 0, so that it never turns against it."""

# In all functions, ``law`` is the index in ``p`` of the first law's codes, behind the number of laws; ``muscle`` is 0,
# 1 or JOINT; ``now`` is ψ [rad], ψ̇ [rad/s] and the pressures in both muscles [Pa]; ``own`` is of the muscle: length and
# its rate [m, m/s], open rate that the voltage asks for [-], flow through the valve [kg/s], its voltage [V].


@inlined
def _entry(place, p):
    """An entry of the vector. numba does not wrap around an unsigned index, which would take time in each loop."""
    return p[np.uint64(place)]


@inlined
def _code(law, which, p):
    """An entry of a law's codes, which are the same in all lanes."""
    return shared(_entry(law + which, p))


@inlined
def _is_at(law, place, muscle, p):
    """Whether a law without a state acts at a place of a muscle."""
    return _code(law, _PLACE, p) == place and (_code(law, _MUSCLE, p) == 0.0 or _code(law, _MUSCLE, p) == muscle + 1)


@inlined
def _tabled(law, argument, p):
    """Value of a table, linear between its nodes and constant outside."""
    nodes = int(_code(law, TABLE, p)) + _NODE_AT
    values = nodes + NODES
    count = int(_code(law, _COUNT, p))
    if count < 2:
        return _entry(values, p)
    lowest, low = _entry(nodes, p), _entry(values, p)
    highest, high = _entry(nodes + 1, p), _entry(values + 1, p)
    for k in range(2, count):
        if argument > _entry(nodes + k - 1, p):
            lowest, low = _entry(nodes + k - 1, p), _entry(values + k - 1, p)
            highest, high = _entry(nodes + k, p), _entry(values + k, p)
    share = min(max((argument - lowest) / (highest - lowest), 0.0), 1.0)
    return low + share * (high - low)


@inlined
def _argued(law, muscle, now, own, p):  # noqa: C901 (a table of cases)
    """What a law depends on, before its operator [SI]; and the distance from its first node to the last one."""
    what = int(_code(law, _ARGUMENT, p))
    angle, velocity, first, second = now
    length, length_rate, open_rate, flow, voltage = own
    value = 0.0 * first
    if what >= FIRST_SIGNAL:
        value = p[int(_code(law, SIGNAL, p))]
    elif what == _FIRST:
        value = first
    elif what == _SECOND:
        value = second
    elif what == _DIFFERENCE:
        value = first - second
    elif what == _SUM:
        value = first + second
    elif what == _ANGLE:
        value = angle
    elif what == _VELOCITY:
        value = velocity
    elif what == _SPEED:
        value = abs(velocity)
    elif what == _PRESSURE:
        value = first if muscle == 0 else second
    elif what == _OTHER:
        value = second if muscle == 0 else first
    elif what == _LENGTH:
        value = length
    elif what == _LENGTH_RATE:
        value = length_rate
    elif what == _OPEN_RATE:
        value = open_rate
    elif what == _VOLTAGE:
        value = voltage
    elif what < _TIME:
        value = flow
    first_node = int(_code(law, TABLE, p)) + _NODE_AT
    return value, p[first_node + int(_code(law, _COUNT, p)) - 1] - p[first_node]


@in_place
def _sums(place, muscle, now, own, law, x, p):
    """Sums of the laws at a place and at the two whose codes follow, in their units."""
    first_sum, second_sum, third_sum = 0.0, 0.0, 0.0
    for k in range(int(shared(p[law - 1]))):
        codes = law + k * SIZE
        further = _code(codes, _PLACE, p) - place
        side = JOINT if _code(codes, _MUSCLE, p) == 3.0 else muscle
        at = _code(codes, STATE + side, p)
        acts = _code(codes, _MUSCLE, p) == 0.0 or _code(codes, _MUSCLE, p) == side + 1
        if acts and 0.0 <= further <= 2.0 and at < x.shape[0]:
            argument, span = _argued(codes, side, now, own, p)
            entry = argument
            if at > 0.0:
                held = x[np.uint64(at)] * span
                entry = argument - held if _code(codes, _OPERATOR, p) >= _HIGH_PASS else held
            value = _tabled(codes, entry, p)
            if at == 0.0:
                value = _passive(codes, value, argument, p)
            if further == 0.0:
                first_sum += value
            elif further == 1.0:
                second_sum += value
            else:
                third_sum += value
    return first_sum, second_sum, third_sum


@inlined
def _passive(law, value, rate, p):
    """A value that depends on a rate, but 0 where it would drive the motion; others as they are."""
    of_torque = _code(law, _PLACE, p) == TORQUE
    if _code(law, _ARGUMENT, p) == _VELOCITY or _code(law, _ARGUMENT, p) == _LENGTH_RATE:
        if of_torque or _code(law, _PLACE, p) == FORCE or _code(law, _PLACE, p) == STRENGTH:
            # A muscle pulls: it works against the motion while it gets longer.
            against = -value if of_torque else value
            value = value if against * rate >= 0.0 else 0.0
    return value


@in_place
def _lost_air(chamber_pressure, orifice_flow, now, own, atmosphere, supply_pressure, muscle, law, x, p):
    """Mass flow out of a muscle beside the valve [kg/s]: places ``flow``, ``leak``, ``exchange`` and ``passage``."""
    share, _, _ = _sums(PASSAGE, muscle, now, own, law, x, p)
    _, _, _, through_valve, _ = own
    flow, area, passed = _sums(FLOW, muscle, now, own, law, x, p)
    _, _, first, second = now
    left = supply_pressure - chamber_pressure if flow > 0.0 else chamber_pressure - atmosphere
    drop = first - second if passed > 0.0 else second - first
    passed = passed * min(max(drop / _FADE, 0.0), 1.0)
    lost = max(area, 0.0) * orifice_flow - max(share, -1.0) * through_valve - flow * min(max(left / _FADE, 0.0), 1.0)
    return lost + (passed if muscle == 0 else -passed)


@inlined
def _slope_of(law, argument, p):
    """Slope of a table at an argument, 0 outside of the nodes."""
    nodes = int(_code(law, TABLE, p)) + _NODE_AT
    slope = 0.0
    for k in range(1, int(_code(law, _COUNT, p))):
        if argument >= p[nodes + k - 1] and argument < p[nodes + k]:
            slope = (p[nodes + NODES + k] - p[nodes + NODES + k - 1]) / (p[nodes + k] - p[nodes + k - 1])
    return slope


@in_place
def _swollen(polytropic_rate, bulk_modulus, volume_rate, now, own, muscle, law, x, p):
    """dP/dt [Pa/s] of a muscle whose volume is V (1 + φ): place ``volume``."""
    share, by_length, by_pressure = 0.0, 0.0, 0.0
    for k in range(int(shared(p[law - 1]))):
        codes = law + k * SIZE
        if _is_at(codes, VOLUME, muscle, p):
            argument, _ = _argued(codes, muscle, now, own, p)
            share += _tabled(codes, argument, p)
            slope = _slope_of(codes, argument, p)
            by_length += slope if _code(codes, _ARGUMENT, p) == _LENGTH else 0.0
            by_pressure += slope if _code(codes, _ARGUMENT, p) == _PRESSURE else 0.0
    _, length_rate, _, _, _ = own
    volume = max(1.0 + share, _LEAST_VOLUME)
    carried = bulk_modulus * volume_rate
    rate = (polytropic_rate + carried - bulk_modulus * by_length * length_rate) / volume - carried
    return rate / max(1.0 + bulk_modulus * by_pressure / volume, _LEAST_GIVE)


@in_place
def _moved_command(value, now, own, muscle, law, x, p):
    """Voltage for which the spool stands [V], from the one without laws: place ``command``."""
    change, _, _ = _sums(COMMAND, muscle, now, own, law, x, p)
    return value + change


@in_place
def _moved_valve(value, now, own, muscle, law, x, p):
    """Open rate at which a valve stands [-], from the one without laws: place ``valve``."""
    change, _, _ = _sums(VALVE, muscle, now, own, law, x, p)
    return min(max(value + change, 0.0), 1.0)


@in_place
def _further_force(static_force, passive_force, now, own, muscle, law, x, p):
    """Further contraction force [N]: places ``force`` and ``strength``."""
    force, share, _ = _sums(FORCE, muscle, now, own, law, x, p)
    return force + share * (static_force - passive_force)


@inlined
def _nothing_own(now):
    """The argument ``own`` where no muscle's is known."""
    angle, velocity, first, second = now
    return angle, velocity, first, second, second


@inlined
def _of_joint(place, now, law, x, p):
    """Sum of the laws at a place of the joint: ``friction`` [N m], ``supply``."""
    value, _, _ = _sums(place, JOINT, now, _nothing_own(now), law, x, p)
    return value


@inlined
def _further_torque(now, viscous, law, x, p):
    """Further torque on the joint [N m]: places ``torque`` and ``damping``."""
    torque, damping, _ = _sums(TORQUE, JOINT, now, _nothing_own(now), law, x, p)
    _, velocity, _, _ = now
    return torque - max(damping, -viscous) * velocity


@inlined
def _supply_shift(supply_pressure, now, law, x, p):
    """Change of the supply's pressure [Pa]: place ``supply``."""
    return max(_of_joint(SUPPLY, now, law, x, p), -0.9) * supply_pressure


@in_place
def _shown(value, muscle, law, p):
    """Reading of a pressure sensor [Pa]; the inverse of :func:`_pressure_behind`, which is straight between nodes."""
    reading = value
    for k in range(int(shared(p[law - 1]))):
        codes = law + k * SIZE
        if _is_at(codes, SENSOR, muscle, p):
            nodes = int(_code(codes, TABLE, p)) + _NODE_AT
            values = nodes + NODES
            reading = value + p[values]
            for j in range(1, int(_code(codes, _COUNT, p))):
                before, after = p[nodes + j - 1] - p[values + j - 1], p[nodes + j] - p[values + j]
                if value > before:
                    share = min((value - before) / (after - before), 1.0)
                    reading = p[nodes + j - 1] + share * (p[nodes + j] - p[nodes + j - 1]) + max(value - after, 0.0)
    return reading


@in_place
def _pressure_behind(value, muscle, law, p):
    """The pressure behind a reading [Pa]: place ``sensor``."""
    pressure = value
    for k in range(int(shared(p[law - 1]))):
        codes = law + k * SIZE
        if _is_at(codes, SENSOR, muscle, p):
            pressure = value - _tabled(codes, value, p)
    return pressure


@in_place
def _rates(muscle, now, own, quickest_lag, law, x, dx, p):
    """Fill in the derivatives [1/s] of the laws' states, which are in units of the span of a law's nodes."""
    for k in range(int(shared(p[law - 1]))):
        codes = law + k * SIZE
        at = _code(codes, STATE + muscle, p)
        if at > 0.0:
            argument, span = _argued(codes, muscle, now, own, p)
            rate = 1.0 / span
            if _code(codes, _OPERATOR, p) == _PLAY or _code(codes, _OPERATOR, p) == _STOP:
                rate = played(
                    p[int(_code(codes, TABLE, p)) + _WIDTH_AT] / span, x[int(at)], argument / span, quickest_lag
                )
            elif _code(codes, _OPERATOR, p) != _CLOCK:
                rate = (argument / span - x[int(at)]) / max(p[int(_code(codes, TABLE, p)) + _TIME_AT], quickest_lag)
            dx[int(at)] = rate


@in_place
def _rest(muscle, now, own, law, x, p):
    """Fill in the laws' states after a long rest."""
    for k in range(int(shared(p[law - 1]))):
        codes = law + k * SIZE
        at = _code(codes, STATE + muscle, p)
        if at > 0.0:
            argument, span = _argued(codes, muscle, now, own, p)
            x[int(at)] = argument / span


def _parameters(number: int) -> Iterator[EffectParameter]:
    """The parameters of a law, in their order in the vector."""
    most = {"place": len(PLACES), "muscle": 3, "argument": len(ARGUMENTS), "operator": len(OPERATORS), "count": NODES}
    items = [(name, "-", 0.0, most.get(name, 1) + 1.0, True) for name in CODES]
    items += [(name, unit, 0.0, _LARGEST, True) for name, unit in (("time", "s"), ("width", "SI"))]
    items += [(f"node{k}", "SI", -_LARGEST, _LARGEST, True) for k in range(1, NODES + 1)]
    items += [(f"value{k}", "SI", -_LARGEST, _LARGEST, False) for k in range(1, NODES + 1)]
    for name, unit, low, high, fixed in items:
        yield EffectParameter(f"law{number}_{name}", unit, 0.0, low, high, 1.0, f"{name} of law {number}", fixed=fixed)


def _states(number: int) -> Iterator[AddedState]:
    """The states of a law, in the order of its codes."""
    for name, end in (("memory_1", "_1"), ("memory_2", "_2"), ("held", "")):
        yield AddedState(f"law{number}_{name}", "-", f"law{number}_keeps{end}", 0.02, 1e-4)


IN_HOOKS = {
    hook: tuple(name for name in PLACES if hook in places.TABLE[name].hooks)
    for place in places.TABLE.values()
    for hook in place.hooks
}
"""Places that act in each hook; in all others of the effect's functions, laws with states do."""
EFFECT = Effect(
    name="learned",
    meaning="A table that was learned from recordings acts at one place of the equations.",
    law="a quantity at a place gains a table of an argument, linear between its nodes and constant outside",
    source="piecewise linear approximation; play and stop: Krasnosel'skii and Pokrovskii (1989)",
    signature="What is left at one place of the equations depends on something that was measured.",
    parameters=tuple(item for number in range(1, LAWS + 1) for item in _parameters(number)),
    states=tuple(state for number in range(1, LAWS + 1) for state in _states(number)),
    hooks={
        "spool_voltage": _moved_command,
        "open_rate": _moved_valve,
        "supply_change": _supply_shift,
        "mass_loss": _lost_air,
        "swelling": _swollen,
        "contraction_force": _further_force,
        "coulomb_torque": _of_joint,
        "joint_torque": _further_torque,
        "sensor_reading": _shown,
        "sensor_inverse": _pressure_behind,
        "muscle_rates": _rates,
        "joint_rates": _rates,
        "muscle_steady": _rest,
        "joint_steady": _rest,
    },
    of_tables=True,
    sentence="a law that was learned from the recordings acts on the joint (learned)",
    experiment="repeat the recording over a wider range of what the law depends on: outside of it the law is constant",
    sealed=SealedJoint(part=None, reason="a law is looked for where the catalogue leaves an excess"),
    tested_with=(),
)
