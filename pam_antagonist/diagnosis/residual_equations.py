"""Residual equations of a recording: what the model's equations leave, and where a law could stand.

A recording becomes blocks of about 10 ms. An observer runs the chambers along the measured motion; the readings that
correct it are at least 20 ms old, so that nothing that is read off it has the noise of what it explains. About its
course everything is linear: the error of each pressure follows dP/dt, torque and motion are read off. A *place* is a
column in these equations: what one unit of an unknown input there does to each of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.model import dynamics, equilibrium, flow, integration, lever_arm, muscle, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, PRESSURE_2, SECOND, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import FRICTION_STEP
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

CHANNELS = ("pressure 1", "pressure 2", "torque", "motion")
PLACES: dict[str, tuple[str, ...]] = {
    "flow": ("flow_1", "flow_2", "flow_both"),
    "valve": ("valve_1", "valve_2", "valve_both"),
    "supply": ("supply",),
    "exchange": ("exchange",),
    "volume": ("volume_1", "volume_2"),
    "force": ("force_1", "force_2"),
    "strength": ("strength_1", "strength_2", "strength_both"),
    "sensor": ("sensor_1", "sensor_2", "sensor_both"),
    "line": ("line_1", "line_2", "line_both"),
    "encoder": ("encoder",),
    "meter": ("meter",),
    "torque": ("torque",),
    "friction": ("friction",),
}
"""Places of each class."""
_BLOCK_S = 0.010
_OLD_S = 0.020
_OBSERVER_S = 0.15
_SLOWEST = 0.02
"""[rad/s] A slower joint may stick."""
_REACH = 2
"""Blocks to both sides from which velocity and acceleration come."""
_INERTIAL = 0.15
"""Share of the inertial torque by which a block's acceleration is uncertain."""
_STEP = 1e-3
_rk4_step, _initial_state = integration.rk4_step_within, equilibrium.initial_state
_torque, _needed = dynamics.torque, dynamics.torque_needed
_open_rate, _valve_flow = flow.open_rate, flow.valve_flow
_length, _volume, _leverage = muscle.length, muscle.volume, lever_arm.leverage


@kernel
def _advanced(x, command, before, after, substeps, p, dt, scratch, shown):
    """The chambers from the middle of a block to that of the next, ``x`` in place; pressures after each sample too.

    Args:
        x: state (n,).
        command: of the samples (S, 2).
        before: angle in the middle of the block [rad].
        after: likewise of the next block.
        substeps: integration steps a sample.
        p: parameter vector.
        dt: step of the integration [s].
        scratch: as of the step.
        shown: pressures after each sample (S, 2), result.
    """
    p[FRICTION_STEP] = dt
    count = command.shape[0] * substeps
    x[VELOCITY] = (after - before) / (count * dt)
    for k in range(command.shape[0]):
        for s in range(substeps):
            x[ANGLE] = before + (after - before) * (k * substeps + s + 0.5) / count
            _rk4_step(x, command[k], p, dt, x, scratch)
        shown[k, 0], shown[k, 1] = x[PRESSURE_1], x[PRESSURE_2]


@kernel
def _observed(begin, fresh, command, angle, reading, size, period, substeps, old, gains, points):
    """The chambers along a recording.

    Args:
        begin: first sample of each block (K,).
        fresh: whether a block begins anew (K,).
        command: (N, 2) of the samples.
        angle: block means (K,) [rad].
        reading: block means of the pressures (K, 2) [Pa].
        size: samples of a block, odd.
        period: of the samples [s].
        substeps: integration steps a sample.
        old: blocks by which a reading is old when it corrects.
        gains: of pressure [-] and of its unknown rate [1/s].
        points: parameter vectors (M, m), the first of them the model's.

    Returns:
        States in the middles (K, n), means of the pressures over the blocks less those in the middles (K, 2) [Pa],
        jumps by which the next block was corrected (K, 2) [Pa], slopes of the pressures to those a block before
        (K, 2), and what the other vectors change of the next block (M - 1, K, 2) [Pa].
    """
    count, half, p = begin.shape[0], size // 2, points[0]
    x = _initial_state(angle[0], reading[0, 0], reading[0, 1], command[0], p)
    n = x.shape[0]
    states, jumps, slopes = np.zeros((count, n)), np.zeros((count, 2)), np.ones((count, 2))
    changes, means = np.zeros((points.shape[0] - 1, count, 2)), np.zeros((count, 2))
    scratch, other, before = np.empty((STAGES + 1, n)), np.empty(n), np.empty(n)
    shown, unused, dt = np.empty((size, 2)), np.empty((size, 2)), period / substeps
    rate, since = np.zeros(2), 0
    for k in range(count):
        first = begin[k] + half
        if fresh[k]:
            x = _initial_state(angle[k], reading[k, 0], reading[k, 1], command[first], p)
            rate[:] = 0.0
            since = 0
        states[k] = x
        if k + 1 == count or fresh[k + 1]:
            continue
        given = command[first + 1 : first + 1 + size]
        before[:] = x
        _advanced(x, given, angle[k], angle[k + 1], substeps, p, dt, scratch, shown)
        other[:] = before
        other[PRESSURE_1] += 100.0
        other[PRESSURE_2] += 100.0
        _advanced(other, given, angle[k], angle[k + 1], substeps, p, dt, scratch, unused)
        for i in range(2):
            slopes[k, i] = (other[PRESSURE_1 + i] - x[PRESSURE_1 + i]) / 100.0
            for j in range(size - 1):
                if j < half:
                    means[k, i] += (shown[j, i] - before[PRESSURE_1 + i]) / size
                else:
                    means[k + 1, i] += (shown[j, i] - x[PRESSURE_1 + i]) / size
        for m in range(1, points.shape[0]):
            other[:] = before
            _advanced(other, given, angle[k], angle[k + 1], substeps, points[m], dt, scratch, unused)
            for i in range(2):
                changes[m - 1, k, i] = other[PRESSURE_1 + i] - x[PRESSURE_1 + i]
        if since >= old:
            for i in range(2):
                error = reading[k - old, i] - means[k - old, i] - states[k - old, PRESSURE_1 + i]
                rate[i] += gains[1] * error
                jumps[k, i] = gains[0] * error + rate[i] * size * period
                x[PRESSURE_1 + i] += jumps[k, i]
        x[ANGLE] = angle[k + 1]
        since += 1
    return states, means, jumps, slopes, changes


@kernel
def _torques(states, p):
    """Torque of the muscles in each state (K,) [N m]."""
    out = np.empty(states.shape[0])
    for k in range(states.shape[0]):
        out[k] = _torque(states[k], p)
    return out


@kernel
def _motions(states, acceleration, direction, p):
    """Torque of the muscles that the motion needs, by equation (8) (K,) [N m]."""
    out = np.empty(states.shape[0])
    for k in range(states.shape[0]):
        out[k] = _needed(states[k], acceleration[k], direction[k], p) + _torque(states[k], p)
    return out


@kernel
def _air_columns(states, voltage, p):
    """What the places of the air act with.

    Returns:
        For each block and muscle: dP/dt per kg/s, flow per open rate, flow per share of the supply, flow, drawn flow, volume's
        slope by length over the volume, flow per Pa in the chamber, open rate (K, 2, 8).
    """
    out = np.zeros((states.shape[0], 2, 8))
    for k in range(states.shape[0]):
        sine, _, _ = _leverage(states[k, ANGLE], p)
        for i in range(2):
            muscle_index = FIRST if i == 0 else SECOND
            pressure = states[k, PRESSURE_1 + i]
            volume, slope = _volume(muscle_index, _length(muscle_index, sine, p), p)
            alpha = _open_rate(muscle_index, voltage[k, i], p)
            supply = p[par.SUPPLY]
            passed, drawn = _valve_flow(muscle_index, alpha, pressure, supply, p)
            low, high = max(alpha - 0.01, 0.0), min(alpha + 0.01, 1.0)
            above, _ = _valve_flow(muscle_index, high, pressure, supply, p)
            below, _ = _valve_flow(muscle_index, low, pressure, supply, p)
            more, _ = _valve_flow(muscle_index, alpha, pressure, supply * 1.01, p)
            less, _ = _valve_flow(muscle_index, alpha, pressure, supply * 0.99, p)
            higher, _ = _valve_flow(muscle_index, alpha, pressure + 500.0, supply, p)
            out[k, i, 0] = p[par.POLYTROPIC_FLOW] * p[par.GAS_CONSTANT] * p[par.TEMPERATURE] / volume
            out[k, i, 1] = (above - below) / max(high - low, 1e-9)
            out[k, i, 2] = (more - less) / 0.02
            out[k, i, 3] = passed
            out[k, i, 4] = drawn
            out[k, i, 5] = slope / volume
            out[k, i, 6] = (higher - passed) / 500.0
            out[k, i, 7] = alpha
    return out


def base_groups(rig: Rig) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Directions in which the base parameters are uncertain: parameters that scale together, and by how much."""
    groups: list[tuple[tuple[str, ...], float]] = []
    for i in (1, 2):
        groups.append((tuple(f"muscle_{i}.volume.{name}" for name in ("d1", "d2", "d3")), 0.02))
        names = ("v1", "v2", "w1", "w2", "c1", "c3", "area", "rubber")
        groups.append((tuple(f"muscle_{i}.force.{name}" for name in names if f"muscle_{i}.force.{name}" in par.INDEX), 0.02))
        groups.append(((f"muscle_{i}.force.w2",), 0.02))
        groups += [((f"valve_{i}.{name}",), 0.02) for name in ("inflow_area", "outflow_area")]
    groups += [((name,), 0.03) for name in ("gas.polytropic_flow", "gas.polytropic_volume")]
    groups += [(("supply.pressure",), 0.02), (("joint.inertia",), 0.03)]
    groups += [((name,), 0.05) for name in ("joint.viscous_friction", "friction.shaft", "friction.muscle")]
    groups += [
        ((f"effects.{effect}.{name}",), 0.03)
        for effect, numbers in rig.effects.items()
        if effect != "learned"
        for name in numbers
    ]
    return tuple((names, std) for names, std in groups if any(rig.value(name) != 0.0 for name in names))


@dataclass(frozen=True, eq=False)
class Equations:
    """The residual equations of a recording in K blocks.

    Attributes:
        name: of the recording.
        p: parameter vector about which they are linear.
        locked: whether the joint was held.
        time: middle of each block [s] (K,).
        step: length of a block [s].
        fresh: whether a block begins anew (K,).
        states: of the observer (K, n).
        slope: of the errors of the pressures over a block (K, 2).
        residual: pressures, torque and motion less the model (K, 4); NaN where there is none.
        jumps: corrections of the observer over a block (K, 2) [Pa].
        noise: variance of each residual (K, 4).
        base: what one prior standard deviation of each base direction does: over a block (D, K, 2), and to torque and
            motion (D, K, 2).
        places: what one unit at a place does: over a block (K, 2), and to the residuals (K, 4), by name.
        arguments: what a law may depend on (K,), by name as :mod:`~pam_antagonist.model.effects.learned` has it.
        groups: names of the base directions' parameters with the standard deviations.
        amounts: standard deviations by which ``p`` is off the middle of the base directions' prior (D,).
    """

    name: str
    p: Floats
    locked: bool
    time: Floats
    step: float
    fresh: NDArray[np.bool_]
    states: Floats
    slope: Floats
    residual: Floats
    jumps: Floats
    noise: Floats
    base: tuple[Floats, Floats]
    places: Mapping[str, tuple[Floats, Floats]]
    arguments: Mapping[str, Floats]
    groups: tuple[tuple[tuple[str, ...], float], ...]
    amounts: Floats


def _derivatives(angle: Floats, step: float, segment: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """Velocity and acceleration by parabolas over blocks around each; NaN at ends."""
    reach = np.arange(-_REACH, _REACH + 1, dtype=float)
    second = reach**2 - np.mean(reach**2)
    velocity = np.convolve(angle, reach[::-1], "same") / (np.sum(reach**2) * step)
    acceleration = 2.0 * np.convolve(angle, second[::-1], "same") / (np.sum(second**2) * step**2)
    edge = np.zeros(len(angle), bool)
    edge[:_REACH] = edge[len(angle) - _REACH :] = True
    edge[_REACH:-_REACH] = segment[2 * _REACH :] != segment[: -2 * _REACH]
    velocity[edge] = acceleration[edge] = np.nan
    return velocity, acceleration


def equations(
    name: str, rig: Rig, p: Floats, stretches: Sequence[Mapping[str, Floats]], period: float, locked: bool,
    amounts: Floats,
) -> Equations:
    """The residual equations of a recording.

    Args:
        name: of the recording.
        rig: for sensors and uncertain directions.
        p: parameter vector of the model (m,); of the joint as it was, free or locked.
        stretches: without holes: time [s], pressure (N, 2) [Pa], command (N, 2), angle [rad], torque [N m] (NaN: none).
        period: of the samples [s].
        locked: whether the joint was held.
        amounts: standard deviations by which ``p`` is off the middle of the base directions' prior (D,).
    """
    size = 2 * int(0.5 * _BLOCK_S / period) + 1
    step = size * period
    parts = [{key: np.asarray(v)[: len(v) // size * size] for key, v in part.items()} for part in stretches]
    parts = [
        {**part, "pressure": sensor.pressures_behind(part["pressure"], p)}
        for part in parts if len(part["time"]) >= 10 * size
    ]  # fmt: skip
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    blocks = {key: v.reshape(-1, size, *v.shape[1:]).mean(axis=1) for key, v in joined.items()}
    count = len(blocks["time"])
    lengths = [len(part["time"]) // size for part in parts]
    segment = np.repeat(np.arange(len(parts)), lengths)
    fresh = np.diff(segment, prepend=-1) != 0
    groups = base_groups(rig)
    own = p.copy()
    own[par.LOCKED] = 1.0
    moved = [_moved(own, names, std) for names, std in groups]
    old = max(int(np.ceil(_OLD_S / step)), 1)
    tau = max(_OBSERVER_S, 6.0 * old * step)
    gains = np.array([2.0 * step / tau, step / tau**2])
    substeps = integration.substeps_of(period)
    states, means, jumps, slope, changes = _observed(
        np.arange(count) * size, fresh, joined["command"], blocks["angle"], blocks["pressure"], size, period, substeps,
        old, gains, np.array([own, *moved]),
    )  # fmt: skip
    angle = blocks["angle"]
    velocity, acceleration = _derivatives(angle, step, segment)
    shown = states.copy()
    shown[:, ANGLE], shown[:, PRESSURE_1], shown[:, PRESSURE_2] = angle, *blocks["pressure"].T
    shown[:, VELOCITY] = 0.0 if locked else np.nan_to_num(velocity)
    reference = states.copy()
    reference[:, VELOCITY], reference[:, ANGLE] = shown[:, VELOCITY], angle
    model = _torques(shown, p)
    by_pressure = np.column_stack([_slope_of(lambda x: _torques(x, p), shown, 2 + i, 100.0) for i in (0, 1)])
    by_angle = _slope_of(lambda x: _torques(x, p), shown, ANGLE, 1e-4)
    has_torque = np.isfinite(blocks["torque"])
    measured = np.where(has_torque, blocks["torque"], model)
    direction = np.sign(shown[:, VELOCITY])
    steady = np.abs(shown[:, VELOCITY]) > _SLOWEST
    for shift in (-1, 1):
        steady &= np.roll(direction, shift) == direction
    moves = steady & np.isfinite(acceleration) & (not locked)
    acceleration = np.nan_to_num(acceleration)
    motion = measured - _motions(shown, acceleration, direction, p)
    residual = np.column_stack(
        [
            blocks["pressure"] - means - states[:, 2:4],
            np.where(has_torque, blocks["torque"] - model, np.nan),
            np.where(moves, motion, np.nan),
        ]
    )
    error = rig.sensors.error
    held = max(size, 1)
    pressure_noise = np.full(count, error("pressure") ** 2 / held)
    through = np.sum(by_pressure**2, axis=1) * pressure_noise
    meter = error("torque") ** 2 / held
    inertial = (_INERTIAL * p[par.INERTIA] * acceleration) ** 2
    columns = _air_columns(reference, blocks["command"], p)
    carried = p[par.POLYTROPIC_VOLUME] * states[:, 2:4] * columns[:, :, 5] * p[par.RADIUS]
    by_motion = carried**2 * error("angle") ** 2 / held
    noise = np.column_stack(
        [*(pressure_noise[:, None] + by_motion).T, meter + through, np.where(has_torque, meter, through) + inertial + 1e-12]
    )
    base_static = np.zeros((len(groups), count, 2))
    for k, (names, std) in enumerate(groups):
        q = _moved(p, names, std)
        change = _torques(shown, q) - model
        base_static[k, :, 0] = change
        needed = _motions(shown, acceleration, direction, q) - (measured - motion)
        base_static[k, :, 1] = np.where(has_torque, needed, needed - change)
    valve = rig.drive == "valve" and not rig.valves.sealed
    places = _places(columns, slope, step, by_pressure, by_angle, shown, p, direction, has_torque, valve)
    arguments = _arguments(reference, blocks, columns, p, rig, velocity, step, old)
    return Equations(
        name, p, locked, blocks["time"], step, fresh, states, slope, residual, jumps, noise, (changes, base_static),
        places, arguments, groups, amounts,
    )  # fmt: skip


def _moved(p: Floats, names: Sequence[str], std: float) -> Floats:
    return par.changed(p, {name: p[par.INDEX[name]] * (1.0 + std) for name in names})


def _slope_of(function, states: Floats, at: int, amount: float) -> Floats:
    up, down = states.copy(), states.copy()
    up[:, at] += amount
    down[:, at] -= amount
    return np.asarray((function(up) - function(down)) / (2.0 * amount))


def _places(columns, slope, step, by_pressure, by_angle, shown, p, direction, has_torque, valve):
    count = len(shown)
    arm = np.cos(shown[:, ANGLE]) if p[par.PULLEY] == 0.0 else np.ones(count)
    lever = p[par.RADIUS] * np.column_stack([arm, -arm])
    pressure_force = by_pressure / lever * (shown[:, 2:4] - p[par.ATMOSPHERE])
    shaft = p[par.SHAFT_RADIUS] * p[par.SHAFT_FRICTION] * direction
    per_flow, per_opening, per_supply, passed, _, swell, by_own, _ = np.moveaxis(columns, 2, 0)
    zero = np.zeros(count)
    out: dict[str, tuple[Floats, Floats]] = {}

    def place(name, g1=zero, g2=zero, y1=zero, y2=zero, torque=zero, motion=zero, force=False):
        # Without a torque meter what the muscles lack shows in the motion, with one what they pull beside.
        if force:
            motion = np.where(has_torque, motion, motion - torque)
        out[name] = (np.column_stack([g1, g2]), np.column_stack([y1, y2, torque, motion]))

    def of_muscle(i, values):
        return {f"g{i + 1}": values[:, i]}

    for i in (0, 1):
        n = i + 1
        place(f"flow_{n}", **of_muscle(i, step * per_flow))
        if valve:
            place(f"valve_{n}", **of_muscle(i, step * per_flow * per_opening))
            place(
                f"line_{n}", **of_muscle(i, step * per_flow * by_own), **{f"y{n}": np.ones(count)},
                torque=-by_pressure[:, i], force=True,
            )
        # With e' = e + k2 P φ no derivative of φ is needed.
        share = p[par.POLYTROPIC_VOLUME] * shown[:, 2 + i]
        place(
            f"volume_{n}", **{f"g{n}": (1.0 - slope[:, i]) * share - step * per_flow[:, i] * passed[:, i]},
            **{f"y{n}": -share},
        )
        place(f"force_{n}", torque=lever[:, i], motion=shaft, force=True)
        scaled = lever[:, i] * pressure_force[:, i]
        place(f"strength_{n}", torque=scaled, motion=shaft * pressure_force[:, i], force=True)
        place(f"sensor_{n}", **{f"y{n}": np.ones(count)}, torque=-by_pressure[:, i], force=True)
    for kind in ("flow", "valve", "strength", "sensor", "line"):
        if f"{kind}_1" in out:
            (g1, h1), (g2, h2) = out[f"{kind}_1"], out[f"{kind}_2"]
            out[f"{kind}_both"] = (g1 + g2, h1 + h2)
    if valve:
        place("supply", *(step * per_flow * per_supply).T)
    place("exchange", -step * per_flow[:, 0], step * per_flow[:, 1])
    # An angle that is read too high by φ: lengths and volumes are wrong, their rates as well.
    grow = p[par.RADIUS] * np.column_stack([-np.ones(count), np.ones(count)]) * swell
    carried = p[par.POLYTROPIC_VOLUME] * shown[:, 2:4] * grow
    place(
        "encoder", *(step * per_flow * passed * grow - (1.0 - slope) * carried).T, *carried.T, torque=-by_angle,
        motion=np.full(count, -p[par.STIFFNESS]), force=True,
    )  # fmt: skip
    place("meter", torque=np.where(has_torque, 1.0, 0.0), motion=np.where(has_torque, 1.0, 0.0))
    place("torque", motion=-np.ones(count))
    place("friction", motion=direction)
    if not has_torque.any():
        # One torque that is missing: of muscles or of the joint, nothing tells them apart.
        out.pop("meter")
    return {name: value for name, value in out.items() if np.any(value[0]) or np.any(value[1])}


def _late(values: Floats, old: int) -> Floats:
    """Values as they were some blocks ago."""
    return np.concatenate([np.repeat(values[:1], old, axis=0), values[:-old]]) if old else values


def _arguments(reference, blocks, columns, p, rig, velocity, step, old):
    first, second = reference[:, PRESSURE_1], reference[:, PRESSURE_2]
    angle = blocks["angle"]
    speed = np.nan_to_num(velocity)
    sine = np.sin(angle) if p[par.PULLEY] == 0.0 else angle
    arm = np.cos(angle) if p[par.PULLEY] == 0.0 else np.ones(len(angle))
    out = {
        "pressure_1": first, "pressure_2": second, "pressure_difference": first - second, "pressure_sum": first + second,
        "angle": angle, "velocity": speed, "speed": np.abs(speed), "time": blocks["time"],
        "valve_flow_1": columns[:, 0, 3], "valve_flow_2": columns[:, 1, 3],
        "draw": columns[:, 0, 4] + columns[:, 1, 4],
        "length_1": p[par.LENGTH] - p[par.RADIUS] * sine, "length_2": p[par.LENGTH] + p[par.RADIUS] * sine,
        "length_rate_1": -p[par.RADIUS] * arm * speed, "length_rate_2": p[par.RADIUS] * arm * speed,
    }  # fmt: skip
    if rig.drive == "valve" and not rig.valves.sealed:
        for i in (0, 1):
            out[f"open_rate_{i + 1}"] = columns[:, i, 7]
    return out
