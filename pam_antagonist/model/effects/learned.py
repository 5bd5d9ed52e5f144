r"""A law that was learned from recordings: a table of numbers at one place of the equations.

```math
\text{place} \mathrel{+}= \theta(\mathcal{O}[a]),\qquad
\theta(z) = \theta_k + (\theta_{k+1} - \theta_k)\,\frac{z - z_k}{z_{k+1} - z_k}\quad (z_k \le z \le z_{k+1}).
```

$a$ is what the law depends on. $\mathcal{O}$ is an operator with a memory, or none. $\theta$ is a table with up to 15
nodes $z_k$ and as many values. Outside of the nodes, which are the range that was seen, it is constant. A rig has up to
four laws. Its file names what a law is made of:

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
| `friction` | joint | N m | change of the Coulomb torque T_s + T_p, which stays at 0 or above |
| `exchange` | joint | kg/s | mass flow from muscle 1 to muscle 2, only towards the lower pressure |
| `supply` | joint | - | change of the supply's pressure, as a share of it |

The arguments `pressure_1`, `pressure_2`, `pressure_difference` (P_1 − P_2), `pressure_sum`, `angle`, `velocity`,
`speed` (its absolute value), `time` (since the start) and the names of the file's `signals` are known everywhere. At a
place of a muscle there are its own `pressure`, `other_pressure`, `length` and `length_rate`. At `flow` and `leak` there
are `open_rate` (that the voltage asks for) and `valve_flow`, at `valve` there is `open_rate`. A place of the joint may
depend on `draw`, the flow of both valves out of the supply, with the operator `lag`. `none` makes a constant, with one
node.

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
from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter, SealedJoint, played

LAWS, NODES = 4, 15
"""The most laws of a rig, and the most nodes of a law."""
PLACES = {
    "flow": "kg/s", "leak": "m2", "valve": "-", "sensor": "Pa", "force": "N", "strength": "-", "torque": "N m",
    "friction": "N m", "exchange": "kg/s", "supply": "-",
}  # fmt: skip
"""Places of a law, with the unit of its values. Their codes are 1, 2 and so on, as those of the other tables."""
OF_JOINT = ("torque", "friction", "exchange", "supply")
"""Places that do not belong to a muscle."""
ARGUMENTS = {
    "none": "-", "pressure_1": "Pa", "pressure_2": "Pa", "pressure_difference": "Pa", "pressure_sum": "Pa",
    "angle": "rad", "velocity": "rad/s", "speed": "rad/s", "pressure": "Pa", "other_pressure": "Pa", "length": "m",
    "length_rate": "m/s", "open_rate": "-", "valve_flow": "kg/s", "draw": "kg/s", "time": "s",
    "signal1": "SI", "signal2": "SI", "signal3": "SI", "signal4": "SI",
}  # fmt: skip
"""What a law may depend on, with units."""
OPERATORS = ("none", "clock", "lag", "play", "high_pass", "stop")
"""Operators; ``clock`` is that of the argument ``time``."""
MUSCLES = ("both", "1", "2", "joint")
"""Where a law acts; these codes begin at 0."""

# numba would compile a function anew for each literal.
FLOW, LEAK, VALVE, SENSOR, FORCE, STRENGTH, TORQUE, FRICTION, EXCHANGE, SUPPLY = map(np.int64, range(1, 11))
JOINT = np.int64(2)
"""Index of the joint, in the place of a muscle's."""
(
    _, _FIRST, _SECOND, _DIFFERENCE, _SUM, _ANGLE, _VELOCITY, _SPEED, _PRESSURE, _OTHER, _LENGTH, _LENGTH_RATE,
    _OPEN_RATE, _VALVE_FLOW, _DRAW, _TIME, FIRST_SIGNAL,
) = range(1, 18)  # fmt: skip
_NONE, _CLOCK, _LAG, _PLAY, _HIGH_PASS, _STOP = range(1, 1 + len(OPERATORS))

CODES = ("place", "muscle", "argument", "operator", "count", "keeps_1", "keeps_2", "keeps")
"""What a law is made of. The last ones are 1 for each state that it has, at muscle 1, muscle 2 and the joint."""
_PLACE, _MUSCLE, _ARGUMENT, _OPERATOR, _COUNT, STATE, _, _, SIGNAL = range(1 + len(CODES))
SIZE = len(CODES) + 1
"""Entries of a law's codes where all lanes find them: there the indices of its states and of its signal are too."""
USED = LAWS * SIZE
"""After the codes of all laws: their number, then for each place whether there is a law."""
NUMBERS = len(CODES) + 2 + 2 * NODES
"""Numbers of a law: codes, time, width, nodes, values."""
_TIME_AT, _WIDTH_AT, _NODE_AT = len(CODES), len(CODES) + 1, len(CODES) + 2
_VALUE_AT = _NODE_AT + NODES
_LARGEST = 1e12
"""Largest number of a table, in the unit of its place or argument."""
_FADE = 2e3
"""[Pa] Difference of pressures within which a flow goes to 0, so that it never turns against it."""


@inlined
def _tabled(law, rows, argument, p):
    """Value of a table, linear between its nodes and constant outside."""
    nodes = rows + _NODE_AT
    values = rows + _VALUE_AT
    count = int(p[law + _COUNT])
    if count < 2:
        return p[values]
    lowest, low = p[nodes], p[values]
    highest, high = p[nodes + 1], p[values + 1]
    for k in range(2, count):
        if argument > p[nodes + k - 1]:
            lowest, low = p[nodes + k - 1], p[values + k - 1]
            highest, high = p[nodes + k], p[values + k]
    share = min(max((argument - lowest) / (highest - lowest), 0.0), 1.0)
    return low + share * (high - low)


@inlined
def _span(law, rows, p):
    """Distance between the first node and the last one: the unit of a law's state."""
    count = int(p[law + _COUNT])
    if count < 2:
        return 1.0
    return p[rows + _NODE_AT + count - 1] - p[rows + _NODE_AT]


@inlined
def _of_joint(what, now):
    """An argument that the whole joint has [SI]."""
    angle, velocity, first, second = now
    value = 0.0 * first
    if what == _FIRST:
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
    return value


@inlined
def _argued(law, muscle, now, own, p):
    """What a law depends on, before its operator [SI]; arguments as for :func:`total`."""
    what = int(p[law + _ARGUMENT])
    _, _, first, second = now
    length, length_rate, open_rate, flow = own
    if what < _PRESSURE:
        return _of_joint(what, now)
    value = 0.0 * first
    if what >= FIRST_SIGNAL:
        value = p[int(p[law + SIGNAL])]
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
    elif what < _TIME:
        value = flow
    return value


@in_place
def total(place, muscle, now, own, law, rows, x, p):
    """Sum of the laws at a place, in its unit.

    Args:
        place: its code.
        muscle: 0 or 1, or JOINT.
        now: ψ [rad], ψ̇ [rad/s], pressures in both muscles [Pa].
        own: of the muscle: length [m], its rate [m/s], open rate that the voltage asks for [-], flow through the valve
            [kg/s].
        law: index of the first law's codes in ``p``.
        rows: index of its numbers.
        x: state (n,), or None where no state is added.
        p: parameter vector (m,).
    """
    out = 0.0
    for k in range(LAWS):
        codes = law + k * SIZE
        numbers = rows + k * NUMBERS
        if p[codes + _PLACE] == place and (p[codes + _MUSCLE] == 0.0 or p[codes + _MUSCLE] == muscle + 1):
            argument = _argued(codes, muscle, now, own, p)
            if p[codes + _OPERATOR] == _NONE:
                out += _passive(place, codes, _tabled(codes, numbers, argument, p), argument, p)
            elif x is not None:
                at = p[codes + STATE + muscle]
                if at > 0.0 and at < x.shape[0]:
                    held = x[np.uint64(at)] * _span(codes, numbers, p)
                    if p[codes + _OPERATOR] >= _HIGH_PASS:
                        held = argument - held
                    out += _tabled(codes, numbers, held, p)
    return out


@inlined
def _passive(place, law, value, rate, p):
    """A value that depends on a rate, but 0 where it would drive the motion; others as they are."""
    if FORCE <= place <= TORQUE and (p[law + _ARGUMENT] == _VELOCITY or p[law + _ARGUMENT] == _LENGTH_RATE):
        # A muscle pulls: it works against the motion while it gets longer.
        against = -value if place == TORQUE else value
        value = value if against * rate >= 0.0 else 0.0
    return value


@inlined
def _faded(flow, left):
    """A flow [kg/s] where a difference of pressures [Pa] is left for it."""
    return flow * min(max(left / _FADE, 0.0), 1.0)


@inlined
def lost_air(
    valve_flow, chamber_pressure, orifice_flow, muscle_length, length_rate, wanted_open_rate, now, atmosphere,
    supply_pressure, muscle, law, rows, x, p,
):  # fmt: skip
    """Mass flow out of a muscle beside the valve [kg/s]: places ``flow``, ``leak`` and ``exchange``.

    Args:
        valve_flow: into the muscle [kg/s].
        chamber_pressure: P [Pa].
        orifice_flow: of an ideal orifice from P to P_out, by its area [kg/(s m²)].
        muscle_length: l [m].
        length_rate: dl/dt [m/s].
        wanted_open_rate: open rate that the voltage asks for [-].
        now: as for :func:`total`.
        atmosphere: P_out [Pa].
        supply_pressure: P_tank [Pa].
        muscle: 0 or 1.
        law: as for :func:`total`.
        rows: likewise.
        x: likewise.
        p: parameter vector (m,).
    """
    lost = 0.0
    own = (muscle_length, length_rate, wanted_open_rate, valve_flow)
    if p[law + USED + FLOW] != 0.0:
        flow = total(FLOW, muscle, now, own, law, rows, x, p)
        left = supply_pressure - chamber_pressure if flow > 0.0 else chamber_pressure - atmosphere
        lost -= _faded(flow, left)
    if p[law + USED + LEAK] != 0.0:
        lost += max(total(LEAK, muscle, now, own, law, rows, x, p), 0.0) * orifice_flow
    if p[law + USED + EXCHANGE] != 0.0:
        flow = total(EXCHANGE, JOINT, now, own, law, rows, x, p)
        _, _, first, second = now
        flow = _faded(flow, first - second if flow > 0.0 else second - first)
        lost += flow if muscle == 0 else -flow
    return lost


@inlined
def _moved_valve(opening, muscle_length, length_rate, wanted_open_rate, now, muscle, law, rows, x, p):
    """Open rate at which a valve stands [-]: place ``valve``; arguments as for :func:`lost_air`."""
    if p[law + USED + VALVE] == 0.0:
        return opening
    own = (muscle_length, length_rate, wanted_open_rate, 0.0 * opening)
    return min(max(opening + total(VALVE, muscle, now, own, law, rows, x, p), 0.0), 1.0)


@inlined
def _further(place, now, law, rows, x, p):
    """Sum of the laws at a place of the joint; arguments as for :func:`total`."""
    _, _, first, _ = now
    nothing = 0.0 * first
    return total(place, JOINT, now, (nothing, nothing, nothing, nothing), law, rows, x, p)


@inlined
def _supply_shift(supply_pressure, now, law, rows, x, p):
    """Change of the supply's pressure [Pa]: place ``supply``; arguments as for :func:`lost_air`."""
    if p[law + USED + SUPPLY] == 0.0:
        return 0.0
    return max(_further(SUPPLY, now, law, rows, x, p), -0.9) * supply_pressure


@inlined
def _further_force(static_force, passive_force, muscle_length, length_rate, now, muscle, law, rows, x, p):
    """Further contraction force [N]: places ``force`` and ``strength``; arguments as for :func:`lost_air`."""
    force = 0.0
    own = (muscle_length, length_rate, 0.0 * length_rate, 0.0 * length_rate)
    if p[law + USED + FORCE] != 0.0:
        force += total(FORCE, muscle, now, own, law, rows, x, p)
    if p[law + USED + STRENGTH] != 0.0:
        force += total(STRENGTH, muscle, now, own, law, rows, x, p) * (static_force - passive_force)
    return force


@inlined
def _further_torque(now, law, rows, x, p):
    """Further torque on the joint [N m]: place ``torque``; arguments as for :func:`lost_air`."""
    if p[law + USED + TORQUE] == 0.0:
        return 0.0
    return _further(TORQUE, now, law, rows, x, p)


@inlined
def _further_friction(now, law, rows, x, p):
    """Change of the Coulomb torque [N m]: place ``friction``; arguments as for :func:`lost_air`."""
    if p[law + USED + FRICTION] == 0.0:
        return 0.0
    return _further(FRICTION, now, law, rows, x, p)


@inlined
def _shown(pressure, muscle, law, rows, p):
    """Reading of a pressure sensor [Pa]; the inverse of :func:`_pressure_behind`, which is straight between nodes."""
    reading = pressure
    for k in range(LAWS):
        codes, numbers = law + k * SIZE, rows + k * NUMBERS
        if p[codes + _PLACE] == SENSOR and (p[codes + _MUSCLE] == 0.0 or p[codes + _MUSCLE] == muscle + 1):
            nodes, values = numbers + _NODE_AT, numbers + _VALUE_AT
            reading = pressure + p[values]
            for j in range(1, int(p[codes + _COUNT])):
                before, after = p[nodes + j - 1] - p[values + j - 1], p[nodes + j] - p[values + j]
                if pressure > before:
                    share = min((pressure - before) / (after - before), 1.0)
                    reading = p[nodes + j - 1] + share * (p[nodes + j] - p[nodes + j - 1]) + max(pressure - after, 0.0)
    return reading


@inlined
def _pressure_behind(reading, muscle, law, rows, p):
    """The pressure behind a reading [Pa]: place ``sensor``."""
    pressure = reading
    for k in range(LAWS):
        codes = law + k * SIZE
        if p[codes + _PLACE] == SENSOR and (p[codes + _MUSCLE] == 0.0 or p[codes + _MUSCLE] == muscle + 1):
            pressure = reading - _tabled(codes, rows + k * NUMBERS, reading, p)
    return pressure


@inlined
def _followed(law, rows, held, argument, quickest_lag, p):
    """Derivative [1/s] of a law's state, which is in units of the span of its nodes."""
    span = _span(law, rows, p)
    if p[law + _OPERATOR] == _CLOCK:
        return 1.0 / span
    wanted = argument / span
    if p[rows + _WIDTH_AT] > 0.0:
        return played(p[rows + _WIDTH_AT] / span, held, wanted, quickest_lag)
    return (wanted - held) / max(p[rows + _TIME_AT], quickest_lag)


@in_place
def _muscle_rate(
    held, now, muscle_length, length_rate, wanted_open_rate, valve_flow, quickest_lag, muscle, law, rows, p
):
    """Derivative [1/s] of the state ``held`` of a law at a muscle."""
    own = (muscle_length, length_rate, wanted_open_rate, valve_flow)
    return _followed(law, rows, held, _argued(law, muscle, now, own, p), quickest_lag, p)


@in_place
def _muscle_start(now, muscle_length, length_rate, wanted_open_rate, valve_flow, muscle, law, rows, p):
    """State of a law at a muscle after a long rest."""
    own = (muscle_length, length_rate, wanted_open_rate, valve_flow)
    return _argued(law, muscle, now, own, p) / _span(law, rows, p)


@in_place
def _joint_rate(held, now, drawn_flow, quickest_lag, law, rows, p):
    """Derivative [1/s] of the state ``held`` of a law of the joint."""
    own = (drawn_flow, drawn_flow, drawn_flow, drawn_flow)
    return _followed(law, rows, held, _argued(law, JOINT, now, own, p), quickest_lag, p)


@in_place
def _joint_start(now, drawn_flow, law, rows, p):
    """State of a law of the joint after a long rest."""
    own = (drawn_flow, drawn_flow, drawn_flow, drawn_flow)
    return _argued(law, JOINT, now, own, p) / _span(law, rows, p)


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
        yield AddedState(
            f"law{number}_{name}", "-", f"law{number}_keeps{end}", 0.02, 1e-4, law=number,
            rate=_muscle_rate if end else _joint_rate, steady_value=_muscle_start if end else _joint_start,
        )  # fmt: skip


EFFECT = Effect(
    name="learned",
    meaning="A table that was learned from recordings acts at one place of the equations.",
    law="a quantity at a place gains a table of an argument, linear between its nodes and constant outside",
    source="piecewise linear approximation; play and stop: Krasnosel'skii and Pokrovskii (1989)",
    signature="What is left at one place of the equations depends on something that was measured.",
    parameters=tuple(item for number in range(1, LAWS + 1) for item in _parameters(number)),
    states=tuple(state for number in range(1, LAWS + 1) for state in _states(number)),
    hooks={
        "opening": _moved_valve,
        "supply_change": _supply_shift,
        "mass_loss": lost_air,
        "contraction_force": _further_force,
        "coulomb_torque": _further_friction,
        "joint_torque": _further_torque,
        "sensor_reading": _shown,
        "sensor_inverse": _pressure_behind,
    },
    of_tables=True,
    sentence="a law that was learned from the recordings acts on the joint (learned)",
    experiment="repeat the recording over a wider range of what the law depends on: outside of it the law is constant",
    sealed=SealedJoint(part=None, reason="laws are learned from joints with valves"),
    tested_with=(),
)
