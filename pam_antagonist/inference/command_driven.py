"""The pressure regulators of a joint in many short recordings: their commands are the input.

The model of the chambers runs from the first row of each episode, with the commands and with the measured motion
(:mod:`pam_antagonist.model.drive`). Its pressures are compared with the measured ones. The lag is free; other
effects of a regulator are candidates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.episodes import EpisodeModel, Episodes, noise_of
from pam_antagonist.inference.free_parameters import Candidate, relative
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import Inputs
from pam_antagonist.model.effects import CATALOGUE, Form, parameter_path

Floats = NDArray[np.float64]

_LAG = ("frequency_1", "frequency_2", "damping")
_QUICK = 0.99
_LEAST = {"largest_rate": 2e3, "highest": 1e3}
"""Least values in a fit [Pa/s, Pa]: at 0, these parameters have no limit at all."""
_STARTS = {
    "regulator_dead_time.time_1": 8e-3, "regulator_dead_time.time_2": 8e-3, "regulator_lag.dead_zone": 3e3,
    "regulator_lag.largest_rate": 2e6, "regulator_threshold.threshold_1": 5e3, "regulator_threshold.threshold_2": 5e3,
}  # fmt: skip
"""Start values of a fit for parameters that the rig does not have [s, Pa, Pa/s]."""


def _of_the_lag(name: str) -> Candidate:
    others = tuple(item.name for item in CATALOGUE["regulator_lag"].parameters if item.name != name)
    return Candidate("regulator_lag", Form(without=others, low=_LEAST))


_CANDIDATES = {
    "dead time": Candidate("regulator_dead_time"),
    "dead zone": _of_the_lag("dead_zone"),
    "largest rate": _of_the_lag("largest_rate"),
    "threshold": Candidate("regulator_threshold"),
    "range": Candidate("regulator_limits", Form(low=_LEAST)),
}


@dataclass(frozen=True, eq=False)
class CommandDriven(Episodes):
    """Episodes whose commands are the input of the model, and whose pressures [Pa] are compared."""

    @cached_property
    @override
    def directions(self) -> tuple[Unknown, ...]:
        paths = [parameter_path("regulator_lag", name) for name in _LAG]
        return tuple(relative(self.rig, path, least=1e-2) for path in paths)

    @override
    def candidates(self, taken: Mapping[str, float]) -> dict[str, tuple[Candidate, ...]]:
        """Effects of a regulator beside its lag; the range only if the rig has one, since a fit needs its start value.

        `taken`: values of the model's effects' parameters, by dotted path.
        """
        offered = {name: one for name, one in _CANDIDATES.items() if not {item.path for item in one.free} & set(taken)}
        if "regulator_limits" not in self.rig.effects:
            offered.pop("range", None)
        return {name: (candidate,) for name, candidate in offered.items()}

    def starts(self, model: EpisodeModel, candidate: Candidate) -> tuple[EpisodeModel, ...]:
        """Start models for the fit of a candidate.

        A lag that was fitted alone may be so slow that a largest rate, a dead zone or a range changes nothing. So a
        second start has the lag as configured, and the candidate's values estimated from the readings.
        """
        paths = [path for item in candidate.free for path in item.paths]
        usual = {path: self.rig.value(path) or _STARTS.get(path.removeprefix("effects."), 0.0) for path in paths}
        estimated = {path: self._from_readings[path] for path in paths if path in self._from_readings}
        free = (*model.free, *candidate.free)
        starts = [EpisodeModel(model.theta, {**model.effects, **usual}, free)]
        if estimated and not model.free:
            starts.append(EpisodeModel(self.origin.theta, estimated, free))
        return tuple(starts)

    @cached_property
    def _from_readings(self) -> dict[str, float]:
        rate = np.abs(np.diff(self.pressure, axis=0)) / np.diff(self.time)[:, None]
        rate[self.first[1:-1] - 1] = 0.0
        low, high = np.quantile(self.pressure, [1.0 - _QUICK, _QUICK])
        return {
            "effects.regulator_lag.dead_zone": _STARTS["regulator_lag.dead_zone"],
            "effects.regulator_lag.largest_rate": float(np.quantile(rate, _QUICK)),
            "effects.regulator_limits.lowest": float(low),
            "effects.regulator_limits.highest": float(high),
        }

    @property
    @override
    def measured(self) -> Floats:
        return self.pressure

    @property
    @override
    def runaway(self) -> float:
        return 1e7

    @property
    @override
    def share_of_steps(self) -> float:
        return 0.1

    @cached_property
    def _motion(self) -> Floats:
        """Measured angle, missing values filled in linearly (N,) [rad]."""
        known, at = np.isfinite(self.angle), np.arange(len(self.angle))
        return np.interp(at, at[known], self.angle[known])

    @override
    def simulated_each(self, points: Sequence[Point]) -> list[Floats]:
        p = self.rig.parameters("locked", 0.0)
        vectors = [par.changed(p, self.values(point)) for point in points]
        motion, longest, begin = self._motion, min(self.longest_step, _LONGEST_STEP), self.first[:-1]
        along = Inputs.at(self.time, longest, self.first, command=self.command, motion=motion[:, None])
        starts = [along.settled(motion[begin], self.pressure[begin], p) for p in vectors]
        return [states[:, 2:4] for states, _ in along.driven_each(starts, vectors)]

    @override
    def as_if(self, model: Point) -> CommandDriven:
        noise = [noise_of(column) for column in self.pressure.T]
        drawn = np.random.default_rng(0).standard_normal(self.pressure.shape)
        return replace(self, pressure=self.simulated(model) + noise * drawn)

    @override
    def shown(self, model: Point) -> dict[str, float]:
        values = self.values(model)
        least = values.get("effects.regulator_limits.lowest", np.inf)
        if not np.any(self.command < least):
            values.pop("effects.regulator_limits.lowest", None)
        if not np.any(self.command > values.get("effects.regulator_limits.highest", np.inf)):
            values.pop("effects.regulator_limits.highest", None)
        return values


_LONGEST_STEP = 2.7e-3
"""[s] Longest step of the integration, about a quarter of the period of 10 ms of a measured arm."""
