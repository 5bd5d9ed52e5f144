"""Residual equations of a recording: what the model's equations leave, and where a law could stand.

A recording becomes blocks of about 10 ms. An observer runs the chambers along the measured motion; the readings that
correct it are at least 20 ms old, so that nothing that is read off it has the noise of what it explains. About its
course everything is linear: the error of each pressure follows dP/dt, torque and motion are read off. A *place* is a
column in these equations: what one unit of an unknown input there does to each of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.law_kernels import air_columns, motions, observed, torques
from pam_antagonist.model import dynamics, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.effects.places import TABLE
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


@dataclass(frozen=True, eq=False)
class Equations:
    """The residual equations of a recording in K blocks, about a model."""

    time: Floats  # middle of each block [s] (K,)
    step: float  # length of a block [s]
    fresh: NDArray[np.bool_]  # whether a block begins anew (K,)
    slope: Floats  # of the errors of the pressures over a block (K, 2)
    residual: Floats  # pressures, torque and motion less the model (K, 4); NaN where there is none
    jumps: Floats  # corrections of the observer over a block (K, 2) [Pa]
    noise: Floats  # variance of each residual (K, 4)
    # what one prior standard deviation of each base direction does: over a block (D, K, 2), and to torque and motion
    # (D, K, 2).
    base: tuple[Floats, Floats]
    # what one unit at a place does: over a block (K, 2), and to the residuals (K, 4), by name.
    places: Mapping[str, tuple[Floats, Floats]]
    # what a law may depend on (K,), by name as :mod:`~pam_antagonist.model.effects.learned` has it.
    arguments: Mapping[str, Floats]
    amounts: Floats  # standard deviations by which the model is off the middle of the base directions' prior (D,)

    @property
    def data_columns(self) -> tuple[Floats, Floats]:
        """Columns of data and base directions: over a block (1 + D, K, 2), and to the channels (1 + D, K, 4)."""
        moved, static = self.base
        inside = np.concatenate([self.jumps[None], moved])
        outside = np.zeros((len(inside), len(self.time), len(CHANNELS)))
        outside[0] = np.nan_to_num(self.residual)
        outside[1:, :, 2:] = static
        return inside, outside

    @property
    def seen(self) -> Floats:
        """Variances of the channels, infinite where there is no residual."""
        return np.asarray(np.where(np.isfinite(self.residual), self.noise, np.inf))

    @property
    def quiet(self) -> float:
        """Variance of the errors' steps that the discrete equations themselves have [Pa²]."""
        return float(0.01 * np.median(self.noise[:, 0]))

    def unit(self, place: str) -> float:
        """Amount at a place that shows within a second as much as the noise of a block."""
        inside, outside = self.places[place]
        shows = [np.sqrt(np.mean((inside[:, i] / self.step) ** 2 / self.noise[:, i])) for i in (0, 1)]
        for c in range(len(CHANNELS)):
            there = np.isfinite(self.residual[:, c])
            if there.any():
                shows.append(np.sqrt(np.mean((outside[there, c] ** 2) / self.noise[there, c])))
        return float(1.0 / max(*shows, 1e-30))


def base_groups(rig: Rig) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Directions in which the base parameters are uncertain: parameters that scale together, and by how much."""
    groups: list[tuple[tuple[str, ...], float]] = []
    for i in (1, 2):
        volume = tuple(f"muscle_{i}.volume.{name}" for name in ("d1", "d2", "d3"))
        names = (f"muscle_{i}.force.{name}" for name in ("v1", "v2", "w1", "w2", "c1", "c3", "area", "rubber"))
        force = tuple(name for name in names if name in par.INDEX)
        groups += [(volume, 0.02), (force, 0.02), ((f"muscle_{i}.force.w2",), 0.02)]
        groups += [((f"valve_{i}.{name}",), 0.02) for name in ("inflow_area", "outflow_area")]
    groups += [((name,), 0.03) for name in ("gas.polytropic_flow", "gas.polytropic_volume")]
    groups += [(("supply.pressure",), 0.02), (("joint.inertia",), 0.03)]
    groups += [((name,), 0.05) for name in ("joint.viscous_friction", "friction.shaft", "friction.muscle")]
    effects = (f"effects.{effect}.{name}" for effect, own in rig.effects.items() if effect != "learned" for name in own)
    groups += [((name,), 0.03) for name in effects]
    return tuple((names, std) for names, std in groups if any(rig.value(name) != 0.0 for name in names))


def with_base(p: Floats, groups: Sequence[tuple[tuple[str, ...], float]], amounts: Sequence[float] | Floats) -> Floats:
    """A parameter vector that is moved along base directions, in prior standard deviations."""
    factors: dict[str, float] = {}
    for (names, std), amount in zip(groups, amounts, strict=True):
        for name in names:
            factors[name] = factors.get(name, 1.0) * math.exp(std * amount)
    return par.changed(p, {name: p[par.INDEX[name]] * factor for name, factor in factors.items()})


def equations(
    rig: Rig, p: Floats, stretches: Sequence[Mapping[str, Floats]], period: float, locked: bool, amounts: Floats
) -> Equations:
    """The residual equations of a recording about a parameter vector of the joint as it was, free or locked.

    The stretches are without holes: time [s], pressure (N, 2) [Pa], command (N, 2), angle [rad], torque [N m] (NaN:
    none). The model is off the middle of the base directions' prior by some standard deviations (D,).
    """
    size = 2 * int(0.5 * _BLOCK_S / period) + 1
    step = size * period
    parts = [{key: np.asarray(v)[: len(v) // size * size] for key, v in part.items()} for part in stretches]
    parts = [
        {**part, "pressure": dynamics.pressures_behind(part["pressure"], p)}
        for part in parts if len(part["time"]) >= 10 * size
    ]  # fmt: skip
    joined = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    blocks = {key: v.reshape(-1, size, *v.shape[1:]).mean(axis=1) for key, v in joined.items()}
    count = len(blocks["time"])
    segment = np.repeat(np.arange(len(parts)), [len(part["time"]) // size for part in parts])
    fresh = np.diff(segment, prepend=-1) != 0
    directions = [((names, std),) for names, std in base_groups(rig)]
    own = p.copy()
    own[par.LOCKED] = 1.0
    old = max(int(np.ceil(_OLD_S / step)), 1)
    tau = max(_OBSERVER_S, 6.0 * old * step)
    states, means, jumps, slope, changes = observed(
        np.arange(count) * size, fresh, joined["command"], blocks["angle"], blocks["pressure"], size, period,
        integration.substeps_of(period), old, np.array([2.0 * step / tau, step / tau**2]),
        np.array([own, *(with_base(own, one, [1.0]) for one in directions)]),
    )  # fmt: skip
    angle = blocks["angle"]
    velocity, acceleration = _derivatives(angle, step, segment)
    # What torque and motion are read off, and what laws may depend on, which has no noise of what it explains.
    shown = states.copy()
    shown[:, ANGLE], shown[:, VELOCITY] = angle, 0.0 if locked else np.nan_to_num(velocity)
    reference = shown.copy()
    shown[:, PRESSURE_1 : PRESSURE_2 + 1] = blocks["pressure"]
    model = torques(shown, p)
    by_pressure = np.column_stack([_slope_of(lambda x: torques(x, p), shown, PRESSURE_1 + i, 100.0) for i in (0, 1)])
    by_angle = _slope_of(lambda x: torques(x, p), shown, ANGLE, 1e-4)
    has_torque = np.isfinite(blocks["torque"])
    measured = np.where(has_torque, blocks["torque"], model)
    direction = np.sign(shown[:, VELOCITY])
    moves = (np.abs(shown[:, VELOCITY]) > _SLOWEST) & np.isfinite(acceleration) & (not locked)
    for shift in (-1, 1):
        moves &= np.roll(direction, shift) == direction
    acceleration = np.nan_to_num(acceleration)
    needed = motions(shown, acceleration, direction, p)
    residual = np.column_stack([
        blocks["pressure"] - means - states[:, PRESSURE_1 : PRESSURE_2 + 1],
        np.where(has_torque, blocks["torque"] - model, np.nan),
        np.where(moves, measured - needed, np.nan),
    ])  # fmt: skip
    columns = air_columns(reference, blocks["command"], p)
    noise = _noise(rig, p, size, states, columns, by_pressure, has_torque, acceleration)
    static = np.zeros((len(directions), count, 2))
    for k, one in enumerate(directions):
        q = with_base(p, one, [1.0])
        static[k, :, 0] = torques(shown, q) - model
        static[k, :, 1] = motions(shown, acceleration, direction, q) - needed
        static[k, ~has_torque, 1] -= static[k, ~has_torque, 0]
    valve = rig.drive == "valve" and not rig.valves.sealed
    places = _places(columns, slope, step, by_pressure, by_angle, shown, reference, p, direction, has_torque, valve)
    arguments = _arguments(reference, blocks, columns, p, valve)
    return Equations(
        blocks["time"], step, fresh, slope, residual, jumps, noise, (changes, static), places, arguments, amounts
    )


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


def _slope_of(function: Callable[[Floats], Floats], states: Floats, at: int, amount: float) -> Floats:
    up, down = states.copy(), states.copy()
    up[:, at] += amount
    down[:, at] -= amount
    return np.asarray((function(up) - function(down)) / (2.0 * amount))


def _noise(
    rig: Rig, p: Floats, size: int, states: Floats, columns: Floats, by_pressure: Floats,
    has_torque: NDArray[np.bool_], acceleration: Floats,
) -> Floats:  # fmt: skip
    """Variance of each residual (K, 4): of the sensors, and of what was read off their readings."""
    pressure, angle, meter = (rig.sensors.error(name) ** 2 / size for name in ("pressure", "angle", "torque"))
    carried = p[par.POLYTROPIC_VOLUME] * states[:, PRESSURE_1 : PRESSURE_2 + 1] * columns[:, :, 5] * p[par.RADIUS]
    through = np.sum(by_pressure**2, axis=1) * pressure
    inertial = (_INERTIAL * p[par.INERTIA] * acceleration) ** 2
    motion = np.where(has_torque, meter, through) + inertial + 1e-12
    return np.column_stack([pressure + carried**2 * angle, meter + through, motion])


def _places(
    columns: Floats, slope: Floats, step: float, by_pressure: Floats, by_angle: Floats, shown: Floats,
    reference: Floats, p: Floats, direction: Floats, has_torque: NDArray[np.bool_], valve: bool,
) -> dict[str, tuple[Floats, Floats]]:  # fmt: skip
    """What one unit at each place does: over a block (K, 2), and to the residuals (K, 4).

    ``columns`` are those of the air (K, 2, 8), ``by_pressure`` and ``by_angle`` the torque's slopes [N m/Pa, N m/rad],
    ``shown`` states with measured pressures and motion, ``reference`` likewise with those of the observer; ``valve``:
    whether valves drive the joint.
    """
    zero, one = np.zeros(len(shown)), np.ones(len(shown))
    arm = np.cos(shown[:, ANGLE]) if p[par.PULLEY] == 0.0 else one
    lever = p[par.RADIUS] * np.column_stack([arm, -arm])
    pressure_force = by_pressure / lever * (shown[:, PRESSURE_1 : PRESSURE_2 + 1] - p[par.ATMOSPHERE])
    shaft = p[par.SHAFT_RADIUS] * p[par.SHAFT_FRICTION] * direction
    per_flow, per_opening, per_supply, passed, _, swell, by_own, _ = np.moveaxis(columns, 2, 0)
    out: dict[str, tuple[Floats, Floats]] = {}

    def place(
        name: str, inside: Sequence[Floats] = (zero, zero), shown_as: Sequence[Floats] = (zero, zero),
        torque: Floats = zero, motion: Floats = zero, pulled: bool = False,
    ) -> None:  # fmt: skip
        # Without a torque meter what the muscles lack shows in the motion, with one what they pull beside.
        if pulled:
            motion = np.where(has_torque, motion, motion - torque)
        out[name] = (np.column_stack(inside), np.column_stack([*shown_as, torque, motion]))

    for i in (0, 1):
        n = i + 1

        def own(values: Floats, i: int = i) -> list[Floats]:
            return [values if k == i else zero for k in (0, 1)]

        c = step * per_flow[:, i]
        place(f"flow_{n}", own(c))
        if valve:
            place(f"valve_{n}", own(c * per_opening[:, i]))
            place(f"passage_{n}", own(c * passed[:, i]))
            place(f"line_{n}", own(c * by_own[:, i]), own(one), -by_pressure[:, i], pulled=True)
        # With e' = e + k2 P φ no derivative of φ is needed.
        # The observer's pressure: a measured one holds the noise that it would explain.
        share = p[par.POLYTROPIC_VOLUME] * reference[:, PRESSURE_1 + i]
        place(f"volume_{n}", own((1.0 - slope[:, i]) * share - c * passed[:, i]), own(-share))
        place(f"force_{n}", torque=lever[:, i], motion=shaft, pulled=True)
        scaled = pressure_force[:, i]
        place(f"strength_{n}", torque=lever[:, i] * scaled, motion=shaft * scaled, pulled=True)
        place(f"sensor_{n}", shown_as=own(one), torque=-by_pressure[:, i], pulled=True)
    for kind, place_of in TABLE.items():
        if "both" in place_of.sides and f"{kind}_1" in out:
            (g1, h1), (g2, h2) = out[f"{kind}_1"], out[f"{kind}_2"]
            out[f"{kind}_both"] = (g1 + g2, h1 + h2)
    if valve:
        place("supply", list((step * per_flow * per_supply).T))
    place("exchange", (-step * per_flow[:, 0], step * per_flow[:, 1]))
    # An angle that is read too high by φ: lengths and volumes are wrong, their rates as well.
    grow = p[par.RADIUS] * np.column_stack([-one, one]) * swell
    carried = p[par.POLYTROPIC_VOLUME] * shown[:, PRESSURE_1 : PRESSURE_2 + 1] * grow
    through = step * per_flow * passed * grow - (1.0 - slope) * carried
    place("encoder", list(through.T), list(carried.T), -by_angle, -p[par.STIFFNESS] * one, pulled=True)
    if has_torque.any():
        # Else it is one torque that is missing: of muscles or of the joint, nothing tells them apart.
        place("meter", torque=np.where(has_torque, 1.0, 0.0), motion=np.where(has_torque, 1.0, 0.0))
    place("torque", motion=-one)
    place("friction", motion=direction)
    return {name: value for name, value in out.items() if np.any(value[0]) or np.any(value[1])}


def _arguments(
    reference: Floats, blocks: Mapping[str, Floats], columns: Floats, p: Floats, valve: bool
) -> dict[str, Floats]:
    """What a law may depend on (K,), by name; of a muscle with its number."""
    out = measured_arguments(reference[:, PRESSURE_1 : PRESSURE_2 + 1], blocks["angle"], reference[:, VELOCITY], p)
    out["time"] = blocks["time"]
    out["draw"] = columns[:, 0, 4] + columns[:, 1, 4]
    for i in (1, 2):
        out[f"valve_flow_{i}"] = columns[:, i - 1, 3]
        if valve:
            out[f"open_rate_{i}"] = columns[:, i - 1, 7]
    return out


def measured_arguments(pressure: Floats, angle: Floats, velocity: Floats, p: Floats) -> dict[str, Floats]:
    """What a law of any joint may depend on (K,), by name: of pressures (K, 2) [Pa] and motion (K,) [rad, rad/s]."""
    first, second = pressure.T
    sine = np.sin(angle) if p[par.PULLEY] == 0.0 else angle
    arm = np.cos(angle) if p[par.PULLEY] == 0.0 else np.ones(len(angle))
    out = {
        "pressure_1": first, "pressure_2": second,
        "pressure_difference": first - second, "pressure_sum": first + second,
        "angle": angle, "velocity": velocity, "speed": np.abs(velocity),
    }  # fmt: skip
    for i, side in ((1, -1.0), (2, 1.0)):
        out[f"length_{i}"] = p[par.LENGTH] + side * p[par.RADIUS] * sine
        out[f"length_rate_{i}"] = side * p[par.RADIUS] * arm * velocity
    return out
