"""Limits of an experiment: pressures, angle and its rate, with margins for what the rig file leaves uncertain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Direction, free_parameters
from pam_antagonist.rig import Rig

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
