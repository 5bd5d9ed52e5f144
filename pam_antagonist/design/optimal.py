"""A D-optimal excitation: block by block, the voltages that add most to the determinant of the information.

An experiment is a sequence of blocks. In a block, the valves alternate between two pairs of voltages, slowly (one step)
or quickly. The pairs and the pace are chosen by differential evolution (scipy) so that

    log det(I + M_before + M_block)

is largest, with the information M in units of the priors. A block is allowed only if the joint stays within the limits
during the block and during the rest that may follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from pam_antagonist.design.information import Information, SimulatedPiece, predicted_std, unknowns
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import free_parameters
from pam_antagonist.inference.unknown import Unknown, change_of
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import steady_voltage
from pam_antagonist.shown import Shown

Floats = NDArray[np.float64]

MARGIN = 3.0
"""Standard deviations of a prediction that a plan keeps from a limit."""
_LOWEST_SHARE, _HIGHEST_SHARE = 0.15, 0.97
"""Default limits of the pressures, as shares of the supply's gauge pressure."""
_STOP_SHARE = 0.9
_ANGLE_WITHOUT_STOP = math.radians(20.0)
_RATE = 10.0


@dataclass(frozen=True)
class Limits:
    """Bounds of an experiment.

    Attributes:
        pressure: least and largest pressure of a muscle [Pa], absolute.
        angle: largest magnitude of the angle [rad].
        rate: largest magnitude of its rate [rad/s].
        voltage: least and largest voltage of a valve [V].
    """

    pressure: tuple[float, float]
    angle: float
    rate: float
    voltage: tuple[float, float]

    @classmethod
    def of(
        cls,
        rig: Rig,
        pressure: tuple[float, float] | None = None,
        angle: float | None = None,
        rate: float | None = None,
    ) -> Limits:
        """The limits that are given; the others get defaults from the rig file.

        Args:
            rig: the joint.
            pressure: least and largest pressure [Pa], absolute.
            angle: [rad].
            rate: [rad/s].

        Raises:
            BadInput: limits that the rig cannot have.
        """
        air, supply = rig.atmosphere.pressure, rig.supply.pressure
        if pressure is None:
            pressure = air + _LOWEST_SHARE * (supply - air), air + _HIGHEST_SHARE * (supply - air)
        low, high = pressure
        if not air <= low < high <= supply:
            raise BadInput(
                f"pressures {low / 1e3:.0f} to {high / 1e3:.0f} kPa: expected absolute ones, the lower first, from "
                f"{air / 1e3:.0f} (the atmosphere) to {supply / 1e3:.0f} kPa (the supply)"
            )
        if angle is None:
            angle = _ANGLE_WITHOUT_STOP if rig.joint.stop is None else _STOP_SHARE * rig.joint.stop
        stop = math.pi / 2.0 if rig.joint.stop is None else rig.joint.stop
        if not 0.0 < angle <= stop:
            raise BadInput(f"angle {math.degrees(angle):.1f} deg: expected above 0, to {math.degrees(stop):.1f} deg")
        if rate is None:
            rate = _RATE
        if not rate > 0.0:
            raise BadInput(f"rate {rate:g} rad/s: expected above 0")
        return cls(pressure, angle, rate, (rig.valves.voltage_min, rig.valves.voltage_max))

    def excess(self, states: Floats, std: Floats | None = None) -> float:
        """The largest excess of a course over the limits, as a share of their width; 0 within them.

        Args:
            states: (N, n), the first columns angle [rad], rate [rad/s] and pressures [Pa].
            std: standard deviations of the prediction (N, 4), in the order of these columns; None: it is certain.
        """
        kept = np.zeros((len(states), 4)) if std is None else MARGIN * std
        low, high = self.pressure
        over = [
            (np.abs(states[:, 0]) + kept[:, 0]) / self.angle - 1.0,
            (np.abs(states[:, 1]) + kept[:, 1]) / self.rate - 1.0,
        ]
        for value, margin in zip(states[:, 2:4].T, kept[:, 2:].T, strict=True):
            over += [(value + margin - high) / (high - low), (low - value + margin) / (high - low)]
        return max(0.0, float(np.max(np.nan_to_num(np.array(over), nan=np.inf))))

    def broken(self, pressures: Floats, angle: float) -> str:
        """The limit that a measurement breaks, in words; empty if there is none.

        A pressure below its lower limit is allowed: a joint that is vented, or not filled yet, is safe.

        Args:
            pressures: measured (2,) [Pa].
            angle: measured [rad], NaN if missing.
        """
        for i, pressure in enumerate(pressures, 1):
            if pressure > self.pressure[1]:
                return f"pressure {i} is {pressure / 1e3:.0f} kPa, above the limit of {self.pressure[1] / 1e3:.0f} kPa"
        if abs(angle) > self.angle:
            most = math.degrees(self.angle)
            return f"the angle is {math.degrees(angle):+.1f} deg, beyond the limit of {most:.1f} deg"
        return ""


def uncertain_directions(rig: Rig) -> tuple[Unknown, ...]:
    """What the rig file leaves uncertain, as independent changes of one standard deviation each.

    These are the directions and uncertainties that the estimator considers, and the priors of the other parameters
    that a fit would free. Of a force map with a declared uncertainty only that counts: its coefficients nearly cancel
    in the force, so their priors would say nothing about it.
    """
    found = [change_of(name, changes) for name, changes in rig.directions.items()]
    found += [change_of(name, {name: std}) for name, std in rig.uncertainty.items()]
    declared = {name for direction in found for name in direction.adds}
    maps = {name.rsplit(".", 1)[0] for name in declared if ".force." in name}
    for item in free_parameters(rig):
        if item.name not in declared and item.name.rsplit(".", 1)[0] not in maps:
            found.append(change_of(item.name, {item.name: item.prior_std}))
    return tuple(found)


def uncertainty_of(rig: Rig, sought: Sequence[Unknown]) -> tuple[tuple[Unknown, ...], Floats]:
    """:func:`uncertain_directions` in terms of directions that are simulated anyway."""
    place = {next(iter(direction.adds)): k for k, direction in enumerate(sought)}
    ways: list[dict[int, float]] = []
    further: list[Unknown] = []
    for direction in uncertain_directions(rig):
        if set(direction.adds) <= set(place):
            column = {place[n]: amount / sought[place[n]].adds[n] for n, amount in direction.adds.items()}
        else:
            column = {len(sought) + len(further): 1.0}
            further.append(direction)
        ways.append(column)
    spread = np.zeros((len(sought) + len(further), len(ways)))
    for k, column in enumerate(ways):
        for row, amount in column.items():
            spread[row, k] = amount
    return tuple(further), spread


BLOCK = 2.0
"""[s] Approximate length of a block."""
REST = 1.5
"""[s] At rest before the first block and after the last one."""
SHORTEST = 6.0
"""[s] Shortest experiment."""
_PACES = (1, 2, 3, 5, 8, 14)
"""How many pairs of voltages a block holds one after the other."""
TAIL = 0.4
"""[s] Rest after a block in the check of the limits: long enough for the joint to swing out."""
STEP = 4e-3
"""[s] Integration step of the design; the expected errors of a plan are computed with finer steps."""
_POPULATION, _GENERATIONS = 16, 3
FORBIDDEN = 1e6
"""Least merit of a block that leaves the limits; it grows with the excess."""


@dataclass(frozen=True, eq=False, repr=False)
class Plan(Shown):
    """An experiment that was designed.

    Attributes:
        voltage: (N, 2) [V], a row a sample period.
        period: [s].
        joint: ``free`` or ``locked``.
        lock_angle: [rad], of a locked joint.
        limits: limits that it keeps.
        pressure: of both muscles at rest, where it begins and ends [Pa].
        rest: voltages of both valves that hold this pressure [V].
    """

    voltage: Floats
    period: float
    joint: str
    lock_angle: float
    limits: Limits
    pressure: float
    rest: tuple[float, float]

    @classmethod
    def at_rest(cls, rig: Rig, limits: Limits, joint: str = "free", lock_angle: float = 0.0) -> Plan:
        """A plan without voltages yet, in the middle of the pressures [Pa], where experiments begin and end.

        Args:
            rig: the joint.
            limits: limits that it keeps.
            joint: ``free`` or ``locked``.
            lock_angle: [rad], of a locked joint.
        """
        pressure = 0.5 * (limits.pressure[0] + limits.pressure[1])
        rest = steady_voltage(rig, pressure)
        return cls(np.empty((0, 2)), rig.sample_period, joint, lock_angle, limits, pressure, rest)

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self.voltage) * self.period


def held(pairs: Floats, seconds: float, step: float) -> Floats:
    """Voltages (N, 2) of pairs (K, 2) [V] that follow one another in equal times, a row a step [s]."""
    count = round(seconds / step)
    return np.asarray(pairs[np.minimum(np.arange(count) * len(pairs) // count, len(pairs) - 1)])


def best_block(
    merit: Callable[[Floats], float], start: Plan, seconds: float, step: float, rng: np.random.Generator
) -> Floats:
    """The block (N, 2) [V] with the least merit that a short differential evolution finds.

    `merit` takes a block; :data:`FORBIDDEN` or more where it leaves the limits. Where all do, the joint stays at rest.
    """
    (low, high), rest = start.limits.voltage, np.array(start.rest)

    def block(choice: Floats) -> Floats:
        pairs = choice[1:].reshape(2, 2)
        pace = _PACES[min(int(choice[0] * len(_PACES)), len(_PACES) - 1)]
        return held(np.array([pairs[k % 2] for k in range(pace)]), seconds, step)

    first = qmc.Sobol(5, rng=rng).random(_POPULATION)
    first[:, 1:] = low + (high - low) * first[:, 1:]
    # Staying at rest is always allowed.
    first[0] = [0.0, *rest, *rest]
    found = differential_evolution(
        lambda choice: merit(block(choice)), [(0.0, 1.0), *[(low, high)] * 4], init=first, maxiter=_GENERATIONS,
        polish=False, tol=0.0, rng=rng,
    )  # fmt: skip
    return held(rest[None], seconds, step) if found.fun >= FORBIDDEN else block(found.x)


def grown(
    start: Plan,
    merit: Callable[[Floats], float],
    take: Callable[[Floats], None],
    blocks: Iterable[float],
    step: float,
    seed: int,
    progress: Callable[[float], None] | None,
    seconds: float | None = None,
) -> Plan:
    """The plan of a rest, the best blocks one after the other, and a rest.

    `merit` judges a block with a rest behind it, of which only the block counts; `take` adds what was chosen to what is
    known; `blocks` are their lengths [s], each asked for when it is its turn; `seconds` is the length of the whole
    plan, by default what the blocks add up to.
    """
    rng, rest, chosen = np.random.default_rng(seed), np.array(start.rest)[None], list[Floats]()

    def go_on(rows: Floats) -> None:
        take(rows)
        chosen.append(rows)

    go_on(held(rest, REST, step))
    for length in blocks:
        go_on(best_block(merit, start, length, step, rng))
        if progress is not None:
            progress(length)
    go_on(held(rest, REST, step))
    voltage = np.concatenate(chosen)
    return replace(start, voltage=resampled(voltage, step, start.period, seconds or len(voltage) * step))


def resampled(voltage: Floats, step: float, period: float, seconds: float) -> Floats:
    """Voltages (N, 2), a row a step, as rows a period [s]."""
    times = np.arange(round(seconds / period)) * period
    return np.asarray(voltage[np.minimum((times / step + 1e-6).astype(np.int64), len(voltage) - 1)])


def designed(
    rig: Rig,
    limits: Limits,
    seconds: float,
    joint: str = "free",
    lock_angle: float = 0.0,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """An excitation of a given length: a rest, blocks with most information, and a rest.

    Args:
        rig: what is known of the joint.
        limits: limits that it keeps.
        seconds: length [s].
        joint: ``free`` or ``locked``.
        lock_angle: [rad], of a locked joint.
        seed: of the search.
        progress: is called with the number of further seconds that are designed.

    Raises:
        BadInput: too short, or a joint that may leave the limits even at rest.
    """
    if seconds < SHORTEST:
        raise BadInput(f"{seconds:g} s: expected {SHORTEST:g} s or more")
    start, sought = Plan.at_rest(rig, limits, joint, lock_angle), unknowns(rig)
    further, spread = uncertainty_of(rig, sought)
    work, count = Information(rig, (*sought, *further), joint, lock_angle, step=STEP), len(sought)
    rest = np.array(start.rest)
    tail = held(rest[None], TAIL, STEP)
    states, known = work.start((start.pressure, start.pressure), rest), np.eye(count)

    def excess(course: SimulatedPiece) -> float:
        return limits.excess(course.states, predicted_std(course, spread))

    def merit(rows: Floats) -> float:
        course = work.along(states, np.concatenate([rows, tail]))
        if (over := excess(course)) > 0.0:
            return FORBIDDEN * (1.0 + over)
        inside = work.matrix(replace(course, slopes=course.slopes[: len(rows)]), count)
        before, after = (np.linalg.slogdet(matrix)[1] for matrix in (known, known + inside))
        return float(before - after)

    def take(rows: Floats) -> None:
        nonlocal states, known
        course = work.along(states, rows)
        known, states = known + work.matrix(course, count), course.ends

    if excess(work.along(states, tail)) > 0.0:
        raise BadInput(
            "with the uncertainties of the rig file, the joint may leave the limits even at rest: expected wider "
            "limits, or a rig file with smaller uncertainties (identify)"
        )
    left = seconds - 2.0 * REST
    blocks = max(1, round(left / BLOCK))
    return grown(start, merit, take, [left / blocks] * blocks, STEP, seed, progress, seconds)
