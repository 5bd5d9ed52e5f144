"""A recording and the free directions of the model: the residual of any extended model on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.beyond import in_levels
from pam_antagonist.diagnosis.candidates import Candidate, candidates
from pam_antagonist.diagnosis.knobs import Knob, base_knobs
from pam_antagonist.diagnosis.simulation import (
    BLOCK,
    Start,
    blocks,
    predict,
    run,
    start_of,
    stride_blocks,
    strides,
)
from pam_antagonist.diagnosis.solve import PACE
from pam_antagonist.identification.trial import ANGLE, CHANNELS, Trial
from pam_antagonist.model import parameters as par
from pam_antagonist.model.flow import quickest_lag, small_signal_lags
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_STEP = 2e-3
"""Relative step of the base directions' differences: far above what stiction rounds off."""
_START_ANGLE = 1.7e-3
"""[rad] How well a measured start angle is known, stiction and encoder step together."""
_SHIFTS = 3
_STRIDES = (4, 2)
"""[samples] Steps in which derivatives are simulated, the longest first that goes the model's way."""
_ASTRAY = 0.5
"""A simulation in longer steps goes the model's way if no channel is off by more than so many noises (RMS)."""
_LEAST = 1e-12
_RUNAWAY = 1e9


@dataclass(frozen=True, eq=False)
class Point:
    """A point in the space of models of one recording.

    Attributes:
        theta: relative base changes, then the start's deviations in standard deviations (K + 3,).
        effects: values of the effects' parameters by dotted path.
    """

    theta: Floats
    effects: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Experiment:
    """A recording of a rig, made ready to be explained.

    Every recording has base parameters and effects of its own: a day later the rig is warmer, and what is wrong with
    it may have changed. What recordings have in common is looked for afterwards.

    Attributes:
        rig: as configured.
        trial: the recording.
        fitted: how many of its samples may be fitted; the rest is held out.
        judged: recordings that are held out as a whole and that this one's models foretell; `fitted` of theirs is their
            start, from which nothing but their first state is told. Then all of this one is fitted.
        seed: of what is drawn in fits.
        jobs: threads that work out derivatives, beside those that fit several recordings or candidates at once.
    """

    rig: Rig
    trial: Trial
    fitted: int
    judged: tuple[Experiment, ...] = ()
    seed: int = 0
    jobs: int = 1

    @cached_property
    def knobs(self) -> tuple[Knob, ...]:
        """Free base directions."""
        return base_knobs(self.rig)

    @cached_property
    def first(self) -> Start:
        """What the recording starts from."""
        return start_of(self.trial)

    @cached_property
    def channels(self) -> tuple[int, ...]:
        """What was measured and can tell something, indices of ``CHANNELS``."""
        return tuple(c for c in range(len(CHANNELS)) if self.trial.has(c))

    @cached_property
    def measured(self) -> Floats:
        """Block means of the measurements (B, C) of these channels."""
        return blocks(self.trial.measured[:, list(self.channels)])

    @cached_property
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensor alone (C,)."""
        return np.array([block_noise(self.trial.measured[:, c]) for c in self.channels])

    @property
    def size(self) -> int:
        """How many base unknowns there are, the start's included."""
        return len(self.knobs) + _SHIFTS

    @property
    def origin(self) -> Point:
        """The model as configured."""
        return Point(np.zeros(self.size))

    @cached_property
    def prior(self) -> Floats:
        """Precision of the prior of each base unknown (K + 3,)."""
        return np.array([knob.prior**-2 for knob in self.knobs] + [1.0] * _SHIFTS)

    @cached_property
    def _vector(self) -> Floats:
        return self.rig.parameters(self.trial.joint, self.trial.lock_angle)

    @cached_property
    def _start_scale(self) -> Floats:
        sensors = self.rig.sensors
        pressure = float(np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0))) / np.sqrt(BLOCK)
        return np.array([0.0 if self.trial.joint == "locked" else _START_ANGLE, pressure, pressure])

    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        """What could be wrong beside the effects that a model has already.

        Args:
            taken: values of the model's effects' parameters, by dotted path.
        """
        return candidates(taken)

    def changes(self, point: Point) -> dict[str, float]:
        """Values of the base parameters that differ from the rig file's, by dotted path."""
        total: dict[str, float] = {}
        for knob, amount in zip(self.knobs, point.theta, strict=False):
            for name, change in knob.changes.items():
                total[name] = total.get(name, self.rig.value(name)) + change * float(amount)
        return total

    def parameters(self, point: Point) -> Floats:
        """Parameter vector of a point."""
        p = self._vector.copy()
        for name, value in self.changes(point).items():
            p[par.INDEX[name]] = value
        return par.changed(p, point.effects)

    def simulated(self, point: Point, whole: bool = False) -> Floats:
        """What the sensors would show (N, 4): in the part that is fitted, or in all of the recording."""
        trial = self.trial if whole else self.trial.part(0.0, self.fitted * self.trial.dt)
        return predict(trial, self.parameters(point), self.first, point.theta[-_SHIFTS:] * self._start_scale)

    def states(self, point: Point) -> tuple[Floats, Floats]:
        """States (N, n) and torques (N,) [N m] of the model over all of the recording."""
        return run(self.trial, self.parameters(point), self.first, point.theta[-_SHIFTS:] * self._start_scale)

    def residual(self, point: Point, whole: bool = False) -> Floats:
        """Measured minus simulated block means (B, C), 0 where nothing was measured.

        The whole is followed by what recordings that are held out say of the point, see :meth:`foretold`.
        """
        own = self._left(blocks(self.simulated(point, whole)[:, list(self.channels)]))
        return np.concatenate([own, *(self.foretold(other, point) for other in self.judged)]) if whole else own

    def _left(self, simulated: Floats) -> Floats:
        """Measured minus simulated block means (B, C), 0 where nothing was measured."""
        difference = self.measured[: len(simulated)] - simulated
        # A model that runs away is wrong, not undefined.
        bound = _RUNAWAY * self.noise
        return np.clip(np.nan_to_num(difference, nan=0.0, posinf=np.inf, neginf=-np.inf), -bound, bound)

    def _side_by_side(self, work: Callable[[Point], Floats], points: Iterable[Point]) -> list[Floats]:
        """Something of several points: a fit by itself would leave the other cores idle."""
        return list(map(work, points) if self.jobs == 1 else _workers(self.jobs).map(work, points))

    def differences(self, point: Point, residual: Floats, moved: Iterable[Point]) -> list[Floats]:
        """How the residual (B, C) changes from a point to others nearby.

        Derivatives are most of what a fit works out, and need no steps as fine as the residual itself: theirs are
        longer wherever the model in longer steps goes the same way.

        Args:
            point: where the residual is known.
            residual: there (B, C).
            moved: the others.
        """
        stride, here = self._longest_stride(point, residual)
        lags, shortest = small_signal_lags(self.parameters(point)), stride * quickest_lag(self._vector)

        def difference(there: Point) -> Floats:
            # Longer steps follow no shorter lags than themselves: there, a lag that moves would seem to stay.
            moved_lags = small_signal_lags(self.parameters(there))
            unseen = (lags != moved_lags) & (np.minimum(lags, moved_lags) < shortest)
            fine = stride == 1 or np.any(unseen)
            return self.residual(there) - residual if fine else self._strided(there, stride) - here

        return self._side_by_side(difference, moved)

    def _longest_stride(self, point: Point, residual: Floats) -> tuple[int, Floats]:
        """The longest steps [samples] in which the model goes its way at a point, and the residual in those."""
        for stride in self._strides:
            here = self._strided(point, stride)
            if np.all(np.sqrt(np.mean((here - residual) ** 2, axis=0)) <= _ASTRAY * self.noise):
                return stride, here
        return 1, residual

    @property
    def _strides(self) -> tuple[int, ...]:
        return _STRIDES

    @cached_property
    def _in_strides(self) -> dict[int, Trial]:
        part = self.trial.part(0.0, self.fitted * self.trial.dt)
        return {stride: strides(part, stride) for stride in self._strides}

    def _strided(self, point: Point, stride: int) -> Floats:
        """The residual (B, C) simulated in longer steps [samples]."""
        p = self.parameters(point)
        # A joint must be able to stick within a step.
        p[par.FRICTION_STEP] *= stride
        shift = point.theta[-_SHIFTS:] * self._start_scale
        simulated = predict(self._in_strides[stride], p, self.first, shift)[:, list(self.channels)]
        return self._left(stride_blocks(simulated, stride, self.fitted // BLOCK))

    def held(self, residual: Floats) -> Floats:
        """The held-out blocks of a residual of the whole; none where there is nothing to judge by."""
        return residual[-(-self.fitted // BLOCK) :]

    def taken_away(self, before: Floats, after: Floats) -> tuple[float, float]:
        """What of a residual beyond noise (B, C) is gone in another one (B, C), and what was there [dB]."""
        return in_levels(before, after, self.noise)

    def foretold(self, other: Experiment, point: Point) -> Floats:
        """What a point of this recording leaves of another one, behind its start (B, C), in this one's noises.

        A channel that was not measured there is neither for nor against: it counts as noise.
        """
        there = other.started(point)
        left = other.held(other.residual(there, whole=True)) / other.noise
        out = np.ones((len(left), len(self.channels)))
        for k, channel in enumerate(self.channels):
            if channel in other.channels:
                out[:, k] = left[:, other.channels.index(channel)]
        return np.asarray(out * self.noise)

    def started(self, point: Point) -> Point:
        """A point with the start's deviations told from the fitted samples, and everything else as it is."""
        now = Point(np.concatenate([point.theta[:-_SHIFTS], np.zeros(_SHIFTS)]), point.effects)
        residual = self.residual(now)
        shifts = np.eye(self.size)[-_SHIFTS:]
        moved_by = (Point(now.theta + shift, now.effects) for shift in shifts)
        columns = np.stack(self.differences(now, residual, moved_by), axis=2)
        # Weighed and counted as in any fit, and pulled to what the sensors showed.
        weight = 1.0 / (np.maximum(np.mean(residual**2, axis=0), self.noise**2) * PACE)
        information = np.einsum("c,bci,bcj->ij", weight, columns, columns, optimize=True) + np.eye(_SHIFTS)
        step = -np.linalg.solve(information, np.einsum("c,bci,bc->i", weight, columns, residual, optimize=True))
        moved = Point(np.concatenate([point.theta[:-_SHIFTS], step]), point.effects)
        before, after = (weight @ np.sum(part**2, axis=0) for part in (residual, self.residual(moved)))
        return moved if after + step @ step < before else now

    def jacobian(self, point: Point, residual: Floats) -> Floats:
        """Derivatives of the residual by the base unknowns (B, C, K + 3)."""
        result = np.zeros((*residual.shape, self.size))
        free = [k for k in range(self.size) if self._matters(k)]
        steps = np.where(np.arange(self.size) < len(self.knobs), _STEP, 1.0)
        moved = (Point(point.theta + np.eye(self.size)[k] * steps, point.effects) for k in free)
        for k, difference in zip(free, self.differences(point, residual, moved), strict=True):
            result[:, :, k] = difference / steps[k]
        return result

    def _matters(self, k: int) -> bool:
        if self.trial.joint != "locked":
            return True
        if k < len(self.knobs):
            return not (self.knobs[k].free_only and self.trial.lock_angle == 0.0)
        return k != len(self.knobs) + ANGLE


@lru_cache(maxsize=1)
def _workers(jobs: int) -> ThreadPoolExecutor:
    """Threads that all fits share, so that there are no more of them than asked for, however many fits run."""
    return ThreadPoolExecutor(jobs, thread_name_prefix="simulation")


def block_noise(values: Floats) -> float:
    """Standard deviation that a sensor gives to the mean of a block of samples.

    Noise is told from what changes between samples only: the second difference of a signal that is smooth over three
    samples is noise of six times the variance. A converter whose step is coarser than the noise rounds all samples of
    a block alike; its error does not average out.

    Args:
        values: what the sensor showed (N,), NaN where missing.
    """
    known = values[np.isfinite(values)]
    second = np.diff(known, 2)
    bound = 2.0 * float(np.quantile(np.abs(second), 0.95))
    white = float(np.sqrt(np.mean(second[np.abs(second) <= bound] ** 2) / 6.0))
    step = _converter_step(known)
    averaged = white / np.sqrt(BLOCK)
    return float(max(np.hypot(step / np.sqrt(12.0), averaged) if white < step / 2.0 else averaged, _LEAST))


def _converter_step(known: Floats) -> float:
    """Step of the converter behind a signal; 0 where hardly a value comes twice."""
    levels, counts = np.unique(known, return_counts=True)
    if len(levels) < 2 or len(levels) > len(known) / 4:
        return 0.0
    common = levels[counts >= np.quantile(counts, 0.5)]
    return float(np.median(np.diff(common))) if len(common) > 1 else 0.0
