"""A D-optimal excitation: block by block, the voltages that add most to the determinant of the information.

An experiment is a sequence of blocks. In a block, the valves alternate between two pairs of voltages, slowly (one step)
or quickly. The pairs and the pace are chosen by differential evolution (scipy) so that

    log det(I + M_before + M_block)

is largest, with the information M in units of the priors. A block is allowed only if the joint stays within the limits
during the block and during the rest that may follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from pam_antagonist.design.information import Information, predicted_std, unknowns
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Direction, free_parameters
from pam_antagonist.rig import Rig
from pam_antagonist.rig.limits import steady_voltage

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


def uncertain_directions(rig: Rig) -> tuple[Direction, ...]:
    """What the rig file leaves uncertain, as independent changes of one standard deviation each.

    These are the directions and uncertainties that the estimator considers, and the priors of the other parameters
    that a fit would free. Of a force map with a declared uncertainty only that counts: its coefficients nearly cancel
    in the force, so their priors would say nothing about it.
    """
    found = [Direction(name, changes) for name, changes in rig.directions.items()]
    found += [Direction(name, {name: std}) for name, std in rig.uncertainty.items()]
    declared = {name for direction in found for name in direction.changes}
    maps = {name.rsplit(".", 1)[0] for name in declared if ".force." in name}
    for item in free_parameters(rig):
        if item.name not in declared and item.name.rsplit(".", 1)[0] not in maps:
            found.append(Direction(item.name, {item.name: item.prior_std}))
    return tuple(found)


def uncertainty_of(rig: Rig, sought: Sequence[Direction]) -> tuple[tuple[Direction, ...], Floats]:
    """:func:`uncertain_directions` in terms of directions that are simulated anyway."""
    place = {next(iter(direction.changes)): k for k, direction in enumerate(sought)}
    ways: list[dict[int, float]] = []
    further: list[Direction] = []
    for direction in uncertain_directions(rig):
        if set(direction.changes) <= set(place):
            column = {place[n]: change / sought[place[n]].changes[n] for n, change in direction.changes.items()}
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


@dataclass(frozen=True, eq=False)
class Plan:
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

    @property
    def duration(self) -> float:
        """Length [s]."""
        return len(self.voltage) * self.period


def held(pairs: Floats, seconds: float, step: float) -> Floats:
    """Voltages (N, 2) of pairs that follow one another in equal times.

    `pairs`: (K, 2) [V]. `seconds`: of all of them [s]. `step`: from row to row [s].
    """
    count = round(seconds / step)
    return np.asarray(pairs[np.minimum(np.arange(count) * len(pairs) // count, len(pairs) - 1)])


def best_block(
    merit: Callable[[Floats], float],
    bounds: tuple[float, float],
    rest: Floats,
    seconds: float,
    step: float,
    rng: np.random.Generator,
) -> Floats | None:
    """The block with the least merit that a short differential evolution finds.

    `merit`: takes voltages (N, 2) [V]; :data:`FORBIDDEN` or more where they leave the limits. `bounds`: least and
    largest voltage [V]. `rest`: voltages of both valves at rest (2,) [V]. `seconds`: length of the block [s]. `step`:
    from row to row [s]. Returns voltages (N, 2) [V]; None where every block that was tried leaves the limits.
    """
    low, high = bounds

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
    return None if found.fun >= FORBIDDEN else block(found.x)


class Design:
    """The search for an excitation.

    `pressure`: of both muscles at rest [Pa]. `rest`: voltages of both valves that hold this pressure [V]. `step`: time
    between two rows of voltages [s].
    """

    def __init__(
        self,
        rig: Rig,
        limits: Limits,
        joint: str = "free",
        lock_angle: float = 0.0,
        seed: int = 0,
    ) -> None:
        self._rig, self._limits = rig, limits
        sought = unknowns(rig)
        self._count = len(sought)
        further, self._spread = uncertainty_of(rig, sought)
        self._work = Information(rig, (*sought, *further), joint, lock_angle, step=STEP)
        self._rng = np.random.default_rng(seed)
        self.pressure = 0.5 * (limits.pressure[0] + limits.pressure[1])
        self.rest = steady_voltage(rig, self.pressure)
        self.step = self._work.dt
        self._rest = np.array(self.rest)
        self._states = self._work.start((self.pressure, self.pressure), self._rest)
        self._information = np.eye(self._count)
        tail = self._work.along(self._states, held(self._rest[None], TAIL, self.step))
        if limits.excess(tail.states, predicted_std(tail, self._spread)) > 0.0:
            raise BadInput(
                "with the uncertainties of the rig file, the joint may leave the limits even at rest: expected wider "
                "limits, or a rig file with smaller uncertainties (identify)"
            )

    def _merit(self, rows: Floats) -> float:
        """Negative gain of a block, so that less is better; far above 0 if the block leaves the limits."""
        tail = held(self._rest[None], TAIL, self.step)
        course = self._work.along(self._states, np.concatenate([rows, tail]))
        over = self._limits.excess(course.states, predicted_std(course, self._spread))
        if over > 0.0:
            return FORBIDDEN * (1.0 + over)
        inside = self._work.matrix(replace(course, slopes=course.slopes[: len(rows)]), self._count)
        before, after = (np.linalg.slogdet(matrix)[1] for matrix in (self._information, self._information + inside))
        return float(before - after)

    def add(self, seconds: float = BLOCK) -> Floats:
        """Choose one more block. `seconds`: its length [s]. Returns its voltages (N, 2) [V], a row a step."""
        rows = best_block(self._merit, self._limits.voltage, self._rest, seconds, self.step, self._rng)
        return self.at_rest(seconds) if rows is None else self._taken(rows)

    def at_rest(self, seconds: float) -> Floats:
        """Let the joint rest for a while. `seconds`: how long [s]. Returns the voltages (N, 2) [V], a row a step."""
        return self._taken(held(self._rest[None], seconds, self.step))

    def _taken(self, rows: Floats) -> Floats:
        course = self._work.along(self._states, rows)
        self._information = self._information + self._work.matrix(course, self._count)
        self._states = course.ends
        return rows


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
    search = Design(rig, limits, joint, lock_angle, seed)
    rows = [search.at_rest(REST)]
    left = seconds - 2.0 * REST
    count = max(1, round(left / BLOCK))
    for _ in range(count):
        rows.append(search.add(left / count))
        if progress is not None:
            progress(seconds / count)
    rows.append(search.at_rest(REST))
    chosen = np.concatenate(rows)
    samples = np.arange(round(seconds / rig.sample_period)) * rig.sample_period
    index = np.minimum((samples / search.step + 1e-6).astype(np.int64), len(chosen) - 1)
    return Plan(chosen[index], rig.sample_period, joint, lock_angle, limits, search.pressure, search.rest)
