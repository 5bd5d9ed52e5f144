"""A joint that its valves drive, as an experiment: the recorded voltages are the input.

Pressure regulators drive a joint likewise, with the pressures that they are asked for in the place of the voltages.

The model runs by itself from the first sample on, effects and sensors included.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference import calibration
from pam_antagonist.inference.expected import expected_sizes
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate, base_directions, candidates
from pam_antagonist.inference.free_run import (
    Key,
    Phase,
    Start,
    StartedModel,
    courses,
    in_steps,
    predict_each,
    start_of,
    stride_blocks,
)
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.trial import ANGLE, CHANNELS, Trial
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import small_signal_lags
from pam_antagonist.model.effects import places
from pam_antagonist.model.effects.places import AIR, JOINT, SENSORS, VALVES
from pam_antagonist.model.joint import quickest_lag

Floats = NDArray[np.float64]

_START_ANGLE = 1.7e-3
"""[rad] How well a measured start angle is known, stiction and encoder step together."""
_CLOCKS_S = 0.02
"""[s] How well clocks agree: where a recording begins in motion, its start is known as well as that."""
_RECENT = 3
"""Simulations of a recording that are kept: where it is fitted, and in longer steps."""
_LONG_STEPS = (10e-3, 4e-3, 2e-3)
"""[s] Steps in which derivatives are simulated, the longest first that goes the model's way."""
_OF_A_LAG = 0.5
"""Longer steps are shorter than this share of each lag, so that they follow it."""
_ASTRAY = 0.5
"""A simulation in longer steps goes the model's way if no channel is off by more than so many noises (RMS)."""
TITLES = (
    Channel("Angle", "°", 180.0 / np.pi),
    Channel("Torque", "N m", 1.0),
    Channel("Pressure 1", "kPa", 1e-3),
    Channel("Pressure 2", "kPa", 1e-3),
)


@dataclass(frozen=True, eq=False)
class ValveDriven(Experiment):
    """A recording of a joint that its valves drive."""

    at_stop: bool = False  # whether it, or another one that is explained with it, shows the angle of the stops

    @cached_property
    @override
    def directions(self) -> tuple[Unknown, ...]:
        return base_directions(self.rig, self.at_stop)

    @cached_property
    @override
    def channels(self) -> tuple[int, ...]:
        return tuple(c for c in range(len(CHANNELS)) if self.trial.has(c))

    @property
    @override
    def titles(self) -> tuple[Channel, ...]:
        return tuple(TITLES[c] for c in self.channels)

    @cached_property
    @override
    def noise(self) -> Floats:
        return np.array([self.trial.noise(c) for c in self.channels])

    @cached_property
    @override
    def noise_at_rest(self) -> Floats:
        return self.noise * np.array([self.trial.noise_growth_at_rest(c) for c in self.channels])

    @cached_property
    def first(self) -> Start:
        """What the recording starts from."""
        return start_of(self.trial)

    @cached_property
    @override
    def start_std(self) -> Floats:
        sensors = self.rig.sensors
        sample = float(np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0)))
        known = np.hypot([_START_ANGLE, *(sample * self.first.share)], _CLOCKS_S * self.first.rate)
        return known * np.array([0.0 if self.trial.joint == "locked" else 1.0, 1.0, 1.0])

    @property
    @override
    def runs_by_itself(self) -> bool:
        return True

    @override
    def signals(self, point: Point) -> dict[str, Floats]:
        voltage = self.trial.blocks(self.trial.voltage)
        return {f"voltage {i + 1}": voltage[:, i] for i in (0, 1)} | super().signals(point)

    @property
    @override
    def law_places(self) -> tuple[str, ...]:
        regulated = self.rig.drive == "regulator"
        return places.of_parts([AIR, JOINT, SENSORS] if regulated else [AIR, JOINT, VALVES, SENSORS])

    @override
    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        """What could be wrong beside the effects that a model has already.

        `taken`: values of the model's effects' parameters, by dotted path.
        """
        # What a rig file says of its regulators is no candidate any more, and no effect is that it expects.
        known = {**taken, **dict.fromkeys(expected_sizes(self.rig), 0.0)}
        if self.rig.drive == "regulator":
            known |= dict.fromkeys((f"effects.{name}." for name in self.rig.effects), 0.0)
        return candidates(known, {"valve": "valve", "regulator": "command"}[self.rig.drive])

    @override
    def calibrations(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        return calibration.candidates(self.trial, self.channels, taken)

    @override
    def start_shift(self, point: Point) -> Floats:
        shift = super().start_shift(point)
        zero = calibration.values_of(point.effects).get("encoder_zero", 0.0)
        return shift - np.array([zero if self.trial.joint != "locked" or self._lock_measured else 0.0, 0.0, 0.0])

    @cached_property
    def _lock_measured(self) -> bool:
        return calibration.is_lock_measured(self.trial)

    @override
    def depends_on(self, k: int) -> bool:
        if self.trial.joint != "locked":
            return True
        if k < len(self.directions):
            return not (self.directions[k].free_only and self.trial.lock_angle == 0.0)
        return k != len(self.directions) + ANGLE

    @override
    def simulated_each(self, points: Sequence[Point], whole: bool = False) -> list[Floats]:
        return self._made_of_each(self.trial if whole else self._part, points, np.copy)

    @override
    def states(self, point: Point) -> tuple[Floats, Floats]:
        return courses(self.trial, [self._run(point)], self.first)[0]

    def _shown(self, trial: Trial, point: Point) -> Floats:
        """What the sensors would show (N, 4), calibrations included, in the steps of a trial."""
        return self._made_of_each(trial, [point], np.copy)[0]

    def _made_of_each(self, trial: Trial, points: Sequence[Point], made: Callable[[Floats], Floats]) -> list[Floats]:
        """What is made of :meth:`_shown` of several models."""
        models = [self._run(point) for point in points]
        # Calibrations change what is shown, and not what the model does: one simulation serves for all that are tried.
        alike: dict[Key, list[int]] = {}
        for k, model in enumerate(models):
            alike.setdefault(model.key, []).append(k)

        def of_all(key: Key, exact: Floats) -> dict[int, Floats]:
            def read(k: int) -> Floats:
                right = calibration.readings(exact, trial.dt, calibration.values_of(points[k].effects))
                return right if self.misread is None else right + self.misread(right, trial.dt)

            return {k: made(read(k)) for k in alike[key]}

        recent = self._recent.get("runs", ())
        known = {key: exact for of, key, exact in recent if of is trial and key in alike}
        new = [key for key in alike if key not in known]

        def simulated(number: int, exact: Floats) -> dict[int, Floats]:
            if len(models) == 1:
                # One alone is kept: what a step is tried at may be where the next derivatives are taken.
                # Put in place as a whole: other threads see the former runs or these.
                self._recent["runs"] = ((trial, new[number], exact), *recent)[:_RECENT]
            return of_all(new[number], exact)

        runs = [models[alike[key][0]] for key in new]
        found = [of_all(key, exact) for key, exact in known.items()]
        found += predict_each(trial, runs, self.first, self.jobs, simulated)
        each = {k: values for some in found for k, values in some.items()}
        return [each[k] for k in range(len(models))]

    @cached_property
    def _recent(self) -> dict[str, tuple[tuple[Trial, Key, Floats], ...]]:
        return {}

    def _run(self, point: Point) -> StartedModel:
        """The model at the start of the recording, and after each time at which an effect begins or ends."""
        later = tuple(Phase(edge, self.parameters(point, edge)) for edge in self.edges(point) if edge > 0.0)
        return StartedModel(self.parameters(point, 0.0), self.start_shift(point), later)

    @cached_property
    def _part(self) -> Trial:
        return self.trial.part(0.0, self.fitted * self.trial.dt)

    @override
    def differences(self, point: Point, residual: Floats, moved: Iterable[Point]) -> list[Floats]:
        """How the residual (B, C) changes from a point to others nearby.

        Derivatives are most of what a fit works out, and need no steps as fine as the residual itself: theirs are
        longer wherever the model in longer steps goes the same way.

        `residual`: there (B, C).
        """
        coarse, here = self._coarsest(point, residual)
        p = self.vector.copy()
        p[par.FRICTION_STEP] = coarse.step
        lags, shortest = small_signal_lags(self.parameters(point)), quickest_lag(p)

        def fine(there: Point) -> bool:
            # Longer steps follow no shorter lags than themselves: there, a lag that moves would seem to stay.
            moved_lags = small_signal_lags(self.parameters(there))
            unseen = (lags != moved_lags) & (np.minimum(lags, moved_lags) < shortest)
            return coarse is self._part or bool(np.any(unseen))

        points = list(moved)
        in_fine = [fine(there) for there in points]
        exact = iter(self.residuals(there for there, as_it_is in zip(points, in_fine, strict=True) if as_it_is))
        others = [there for there, as_it_is in zip(points, in_fine, strict=True) if not as_it_is]
        approximate = iter(self._made_of_each(coarse, others, lambda shown: self._coarse_means(shown, coarse)))
        return [next(exact) - residual if as_it_is else next(approximate) - here for as_it_is in in_fine]

    @override
    def residuals(self, points: Iterable[Point]) -> list[Floats]:
        return self._made_of_each(self._part, list(points), self.left_by)

    def _coarsest(self, point: Point, residual: Floats) -> tuple[Trial, Floats]:
        """The part that is fitted in the longest steps in which the model goes its way at a point; its residual."""
        known = self._coarse.get(point)
        if known is None or known[0] is not residual:
            found = self._part, residual
            lags = small_signal_lags(self.parameters(point))
            for coarse in self.in_long_steps:
                if np.any((lags > 0.0) & (coarse.step >= _OF_A_LAG * lags)):
                    continue
                here = self._coarse_residual(point, coarse)
                if self.goes_its_way(here - residual):
                    found = coarse, here
                    break
            # Both derivatives and the next step ask for it at the same point.
            known = self._coarse[point] = residual, *found
        return known[1:]

    @cached_property
    def _coarse(self) -> WeakKeyDictionary[Point, tuple[Floats, Trial, Floats]]:
        return WeakKeyDictionary()

    def goes_its_way(self, change: Floats) -> bool:
        """Whether longer steps change what is compared by so little that they serve for derivatives.

        `change`: of the block means (B, C).
        """
        return bool(np.all(np.sqrt(np.nanmean(change**2, axis=0)) <= _ASTRAY * self.noise))

    @cached_property
    def in_long_steps(self) -> tuple[Trial, ...]:
        """The part that is fitted as models in longer steps see it, the longest steps first."""
        found = (in_steps(self._part, longest) for longest in _LONG_STEPS)
        return tuple(coarse for coarse in found if coarse.step > self._part.step)

    def _coarse_residual(self, point: Point, coarse: Trial) -> Floats:
        """The residual (B, C) of the blocks that may be fitted, simulated in longer steps."""
        return self._coarse_means(self._shown(coarse, point), coarse)

    def _coarse_means(self, shown: Floats, coarse: Trial) -> Floats:
        """The residual (B, C) of what the sensors would show (N, 4) in longer steps."""
        simulated = shown[:, list(self.channels)]
        stride = round(coarse.dt / self.trial.dt)
        means = stride_blocks(simulated, stride, self.fitted // self.trial.block, self.trial.block)
        return self.fitted_rows(self.residual_of(means))
