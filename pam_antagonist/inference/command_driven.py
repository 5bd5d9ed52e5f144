"""The pressure regulators of a joint in many short recordings: their commands are the input.

The package's own model of the air runs each episode from its first row, with the commands and with the joint's measured
motion (:mod:`pam_antagonist.model.command_driven`). What it makes of the pressures is compared with what was measured.
Free is the lag; what else a regulator may have are candidates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.episodes import EpisodeModel, Episodes, noise_of
from pam_antagonist.inference.free_parameters import Candidate, FreeDirection
from pam_antagonist.inference.point import Point
from pam_antagonist.model import parameters as par
from pam_antagonist.model.command_driven import pressures
from pam_antagonist.model.effects import CATALOGUE, Form, parameter_path

Floats = NDArray[np.float64]

_LAG = ("frequency_1", "frequency_2", "damping")
_QUICK = 0.99
_LEAST = {"largest_rate": 2e3, "highest": 1e3}
"""Values that mean *any* at 0 stay above it [Pa/s, Pa]."""
_STARTS = {
    "regulator_dead_time.time_1": 8e-3, "regulator_dead_time.time_2": 8e-3, "regulator_lag.dead_zone": 3e3,
    "regulator_lag.largest_rate": 2e6, "regulator_threshold.threshold_1": 5e3, "regulator_threshold.threshold_2": 5e3,
}  # fmt: skip
"""Where a fit starts where the rig has no value [s, Pa, Pa/s]."""


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
    def directions(self) -> tuple[FreeDirection, ...]:
        """Free base directions: frequencies and damping of the lag."""
        paths = [parameter_path("regulator_lag", name) for name in _LAG]
        return tuple(FreeDirection(path, {path: max(self.rig.value(path), 1e-2)}) for path in paths)

    @override
    def candidates(self, taken: Mapping[str, float]) -> dict[str, tuple[Candidate, ...]]:
        """What a regulator may have beside its lag; a range only where the rig has one, without which no fit starts.

        Args:
            taken: values of the model's effects' parameters, by dotted path.
        """
        offered = {name: one for name, one in _CANDIDATES.items() if not {item.path for item in one.free} & set(taken)}
        if "regulator_limits" not in self.rig.effects:
            offered.pop("range", None)
        return {name: (candidate,) for name, candidate in offered.items()}

    def starts(self, model: EpisodeModel, candidate: Candidate) -> tuple[EpisodeModel, ...]:
        """Where the fit of a candidate may start.

        A lag that was fitted alone may be so slow that a rate, a zone or a range beside it changes nothing: then the
        lag starts as configured, and the others where the readings point.

        Args:
            model: without the candidate.
            candidate: a candidate.
        """
        paths = [path for item in candidate.free for path in item.paths]
        usual = {path: self.rig.value(path) or _STARTS.get(path.removeprefix("effects."), 0.0) for path in paths}
        pointed = {path: self._pointed[path] for path in paths if path in self._pointed}
        free = (*model.free, *candidate.free)
        begins = [EpisodeModel(model.theta, {**model.effects, **usual}, free)]
        if pointed and not model.free:
            begins.append(EpisodeModel(self.origin.theta, pointed, free))
        return tuple(begins)

    @cached_property
    def _pointed(self) -> dict[str, float]:
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
        """The pressures (N, 2) [Pa]."""
        return self.pressure

    @property
    @override
    def runaway(self) -> float:
        """[Pa] Beyond it a model is wrong."""
        return 1e7

    @property
    @override
    def share_of_steps(self) -> float:
        """Of the usual steps: nothing sticks here, and the ends of a range are sharp."""
        return 0.1

    @cached_property
    def _motion(self) -> Floats:
        """Measured angle, missing values filled in linearly (N,) [rad]."""
        known, at = np.isfinite(self.angle), np.arange(len(self.angle))
        return np.interp(at, at[known], self.angle[known])

    @override
    def simulated(self, point: Point) -> Floats:
        """What the pressure sensors would show (N, 2) [Pa]."""
        p = par.changed(self.rig.parameters("locked", 0.0), self.values(point))
        start = np.ascontiguousarray(self.pressure[self.first[:-1]])
        longest = min(self.longest_step, _LONGEST_STEP)
        return np.asarray(pressures(self.first, start, self.time, self.command, self._motion, p, longest))

    @override
    def as_if(self, model: Point) -> CommandDriven:
        """These episodes as if a model were right: what it does, with the noise of the readings once more."""
        noise = [noise_of(column) for column in self.pressure.T]
        drawn = np.random.default_rng(0).standard_normal(self.pressure.shape)
        return replace(self, pressure=self.simulated(model) + noise * drawn)

    @override
    def shown(self, model: Point) -> dict[str, float]:
        """The lag, and effects; an end of the range only where commands go beyond it."""
        values = self.values(model)
        least = values.get("effects.regulator_limits.lowest", np.inf)
        if not np.any(self.command < least):
            values.pop("effects.regulator_limits.lowest", None)
        if not np.any(self.command > values.get("effects.regulator_limits.highest", np.inf)):
            values.pop("effects.regulator_limits.highest", None)
        return values


_LONGEST_STEP = 2.7e-3
"""[s] Step of the integration, a quarter of the row of 10 ms of a measured arm."""
