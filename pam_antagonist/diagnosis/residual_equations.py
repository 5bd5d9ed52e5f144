"""Residual equations of a recording: what the model's equations leave, and where a law could stand.

A recording becomes blocks of about 10 ms. An observer runs the chambers along the measured motion; the readings that
correct it are at least 20 ms old, so that nothing that is read off it has the noise of what it explains. About its
course everything is linear: the error of each pressure follows dP/dt, torque and motion are read off. A *place* is a
column in these equations: what one unit of an unknown input there does to each of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_kernels import air_columns, motions, observed, torques
from pam_antagonist.diagnosis.places import arguments_of, places_of
from pam_antagonist.model import integration, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

CHANNELS = ("pressure 1", "pressure 2", "torque", "motion")
_BLOCK_S = 0.010
_OLD_S = 0.020
_OBSERVER_S = 0.15
_SLOWEST = 0.02
"""[rad/s] A slower joint may stick."""
_REACH = 2
"""Blocks to both sides from which velocity and acceleration come."""
_INERTIAL = 0.15
"""Share of the inertial torque by which a block's acceleration is uncertain."""


def base_groups(rig: Rig) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Directions in which the base parameters are uncertain: parameters that scale together, and by how much."""
    groups: list[tuple[tuple[str, ...], float]] = []
    for i in (1, 2):
        groups.append((tuple(f"muscle_{i}.volume.{name}" for name in ("d1", "d2", "d3")), 0.02))
        names = ("v1", "v2", "w1", "w2", "c1", "c3", "area", "rubber")
        groups.append(
            (tuple(f"muscle_{i}.force.{name}" for name in names if f"muscle_{i}.force.{name}" in par.INDEX), 0.02)
        )
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
    name: str,
    rig: Rig,
    p: Floats,
    stretches: Sequence[Mapping[str, Floats]],
    period: float,
    locked: bool,
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
    states, means, jumps, slope, changes = observed(
        np.arange(count) * size, fresh, joined["command"], blocks["angle"], blocks["pressure"], size, period, substeps,
        old, gains, np.array([own, *moved]),
    )  # fmt: skip
    angle = blocks["angle"]
    velocity, acceleration = _derivatives(angle, step, segment)
    shown = states.copy()
    shown[:, ANGLE], shown[:, PRESSURE_1 : PRESSURE_2 + 1] = angle, blocks["pressure"]
    shown[:, VELOCITY] = 0.0 if locked else np.nan_to_num(velocity)
    reference = states.copy()
    reference[:, VELOCITY], reference[:, ANGLE] = shown[:, VELOCITY], angle
    model = torques(shown, p)
    by_pressure = np.column_stack([_slope_of(lambda x: torques(x, p), shown, 2 + i, 100.0) for i in (0, 1)])
    by_angle = _slope_of(lambda x: torques(x, p), shown, ANGLE, 1e-4)
    has_torque = np.isfinite(blocks["torque"])
    measured = np.where(has_torque, blocks["torque"], model)
    direction = np.sign(shown[:, VELOCITY])
    steady = np.abs(shown[:, VELOCITY]) > _SLOWEST
    for shift in (-1, 1):
        steady &= np.roll(direction, shift) == direction
    moves = steady & np.isfinite(acceleration) & (not locked)
    acceleration = np.nan_to_num(acceleration)
    motion = measured - motions(shown, acceleration, direction, p)
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
    columns = air_columns(reference, blocks["command"], p)
    carried = p[par.POLYTROPIC_VOLUME] * states[:, 2:4] * columns[:, :, 5] * p[par.RADIUS]
    by_motion = carried**2 * error("angle") ** 2 / held
    noise = np.column_stack(
        [
            *(pressure_noise[:, None] + by_motion).T,
            meter + through,
            np.where(has_torque, meter, through) + inertial + 1e-12,
        ]
    )
    base_static = np.zeros((len(groups), count, 2))
    for k, (names, std) in enumerate(groups):
        q = _moved(p, names, std)
        change = torques(shown, q) - model
        base_static[k, :, 0] = change
        needed = motions(shown, acceleration, direction, q) - (measured - motion)
        base_static[k, :, 1] = np.where(has_torque, needed, needed - change)
    valve = rig.drive == "valve" and not rig.valves.sealed
    places = places_of(columns, slope, step, by_pressure, by_angle, shown, p, direction, has_torque, valve)
    arguments = arguments_of(reference, blocks, columns, p, rig, velocity)
    return Equations(
        name, p, locked, blocks["time"], step, fresh, states, slope, residual, jumps, noise, (changes, base_static),
        places, arguments, groups, amounts,
    )  # fmt: skip


def _moved(p: Floats, names: Sequence[str], std: float) -> Floats:
    return par.changed(p, {name: p[par.INDEX[name]] * (1.0 + std) for name in names})


def _slope_of(function: Callable[[Floats], Floats], states: Floats, at: int, amount: float) -> Floats:
    up, down = states.copy(), states.copy()
    up[:, at] += amount
    down[:, at] -= amount
    return np.asarray((function(up) - function(down)) / (2.0 * amount))
