"""A recording that a model is compared with: the one interface of what fits and judges recordings by blocks.

A way of driving a joint is one class. :class:`~pam_antagonist.inference.valve_driven.ValveDriven` puts in the recorded
voltages, or what pressure regulators were asked for, :class:`~pam_antagonist.inference.angle_driven.AngleDriven` the
recorded angle. For a third way, derive from :class:`Experiment` and give what it declares abstract; all else follows
from that. Many short episodes are :class:`~pam_antagonist.inference.episodes.Episodes`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference import calibration
from pam_antagonist.inference.driven import Driven
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.likelihood import ERROR_S, LinearProblem, Scale, in_decibels
from pam_antagonist.inference.point import THROUGHOUT, Channel, Point, Span
from pam_antagonist.inference.trial import Split, Trial, continued
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_RUNAWAY = 1e9


@dataclass(frozen=True, eq=False)
class Experiment(Driven):
    """A recording of a rig, made ready to be explained.

    Every recording has base parameters and effects of its own: a day later the rig is warmer, and what is wrong with
    it may have changed. What recordings have in common is looked for afterwards.
    """

    rig: Rig
    trial: Trial
    fitted: int  # how many of its samples may be fitted; the rest is held out
    # recordings that are held out as a whole, on which this one's models are judged; `fitted` of theirs is their start,
    # from which nothing but their first state is fitted. Then all of this one is fitted.
    judged: tuple[Experiment, ...] = ()
    seed: int = 0
    jobs: int = 1
    # which blocks are fitted and which are held out, where that is not the first part and the rest; `fitted` is then
    # all of the recording.
    split: Split | None = None
    # blocks that are held out in turn, where all of the recording is fitted and models are judged by what each split
    # leaves of its held-out blocks; empty where `split` or `fitted` says what is held out.
    splits: tuple[Split, ...] = ()
    # when effects of a point act, by the effect's name; one that is not named acts as :attr:`span` says. Effects of the
    # rig file act throughout.
    spans: Mapping[str, Span] = field(default_factory=dict)
    span: Span = THROUGHOUT
    # by how much sensors read too high (N, 4), by what they should show (N, 4) and the time between samples [s].
    misread: Callable[[Floats, float], Floats] | None = None
    narrower: float = 1.0  # factor by which the priors of the base parameters are narrower than the rig file's

    # What each way of driving a joint gives.

    @property
    @abstractmethod
    def channels(self) -> tuple[int, ...]:
        """What is compared: columns of :meth:`simulated` (C)."""

    @property
    @abstractmethod
    def titles(self) -> tuple[Channel, ...]:
        """The channels' names and units (C)."""

    @property
    @abstractmethod
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensors alone (C,)."""

    @abstractmethod
    def simulated_each(self, points: Sequence[Point], whole: bool = False) -> list[Floats]:
        """What the sensors would show of several models, sample by sample.

        `whole`: over all of the recording, or over the part that may be fitted.
        """

    @abstractmethod
    def states(self, point: Point) -> tuple[Floats, Floats]:
        """Course of the model over all of the recording.

        Returns states (N, n), the first of them angle [rad], velocity [rad/s] and pressures [Pa], and torques (N,) [N
        m].
        """

    @property
    @abstractmethod
    def runs_by_itself(self) -> bool:
        """Whether the model runs from its inputs alone, so that it carries every error along.

        One that is given the measured angle at every step shows the errors of its equations in its residuals.
        """

    @cached_property
    def measured(self) -> Floats:
        """Block means of the measurements (B, C), NaN where there are none."""
        return self.trial.blocks(self.trial.measured[:, list(self.channels)])

    @abstractmethod
    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        """Effects that this recording can show, beside those that a model has already.

        `taken`: values of the model's effects' parameters, by dotted path.
        """

    def calibrations(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        """Calibrations that this recording can show, beside those that a model has already; by default none."""
        return ()

    # What may differ, with what holds for most.

    @cached_property
    def vector(self) -> Floats:
        """Parameter vector of the rig as configured."""
        p = self.rig.parameters(self.trial.joint, self.trial.lock_angle)
        p[par.FRICTION_STEP] = self.trial.step
        return p

    @property
    def blocks_per_error(self) -> float:
        """Blocks per value that a fit counts: what a model lacks moves with the commands, about once a second."""
        return max(1.0, ERROR_S / self.trial.block_s)

    def excess_removed(self, before: Floats, after: Floats) -> tuple[float, float]:
        """What of one residual's excess over noise is gone in another one, and what was there [dB].

        `before`: residual of a model (B, C). `after`: of another one (B, C).
        """
        return in_decibels(before, after, self.noise, round(self.blocks_per_error))

    def shown(self, point: Point, rig: Rig) -> Floats:
        """What every sensor would show over all of the recording (N, 4), in the order of ``CHANNELS``."""
        return self.simulated(point, whole=True)

    @property
    def free_run(self) -> Experiment:
        """The same recording as a report shows it: with a model that runs by itself, wherever it is judged by spans."""
        return self

    @property
    def noise_memory(self) -> float:
        """Blocks per independent value of the sensors' noise."""
        return 1.0

    @property
    def noise_at_rest(self) -> Floats:
        """Largest root mean square that the sensors' noise has over a stretch in which the joint rests (C,)."""
        return self.noise

    @property
    def tolerated(self) -> Floats:
        """Root mean square error of each channel that does not call a model wrong (C,): the sensors' noise."""
        return self.noise

    @property
    def judged_channels(self) -> tuple[int, ...]:
        """Columns of :meth:`shown` that have something to be judged by."""
        return self.channels

    @property
    def is_kept_near(self) -> bool:
        """Whether the measured motion is an input of all that is compared, so that the model does not drift away."""
        return False

    @property
    def in_one_piece(self) -> bool:
        """Whether its rows follow each other in time."""
        return True

    @property
    def law_places(self) -> tuple[str, ...]:
        """Where a law may stand that this recording can show; none if laws are not looked for."""
        return ()

    @property
    def for_laws(self) -> tuple[Experiment, ...]:
        """The recording as laws are judged on it; a law is judged on the first of several that has its place."""
        return (self,)

    @property
    def slides(self) -> NDArray[np.bool_] | None:
        """Where the joint slides (N,), None where that makes no difference to the model."""
        return None

    # What follows from that.

    def simulated(self, point: Point, whole: bool = False) -> Floats:
        """:meth:`simulated_each` of one model."""
        return self.simulated_each([point], whole)[0]

    def signals(self, point: Point) -> dict[str, Floats]:
        """What a residual may go with, by name: block means over the whole recording (B,) each.

        Pressures and motion are the model's, which have no noise in common with a residual. A locked joint has no
        motion.
        """
        course = continued(self.trial.blocks(self.states(point)[0][:, :4]))
        out = {"pressure 1": course[:, 2], "pressure 2": course[:, 3]}
        return out if self.trial.joint == "locked" else out | {"angle": course[:, 0], "velocity": course[:, 1]}

    @cached_property
    def prior(self) -> Floats:
        """Precision of the prior of each base coordinate (K + S,)."""
        base = [(direction.prior / self.narrower) ** -2 for direction in self.directions]
        return np.array(base + [1.0] * len(self.start_std))

    def of_rig(self, rig: Rig) -> Experiment:
        """The recording, and those that judge it, with another rig."""
        return replace(self, rig=rig, judged=tuple(other.of_rig(rig) for other in self.judged))

    def corrected(self, point: Point) -> tuple[Experiment, Point]:
        """The recording as calibrated sensors would have shown it, and the model of it without its calibrations."""
        values = calibration.values_of(point.effects)
        if not values:
            return self, point
        trial = calibration.corrected(self.trial, values)
        return replace(self, trial=trial), Point(point.theta, calibration.without(point.effects))

    def start_shift(self, point: Point) -> Floats:
        """Deviations of the start from what the sensors showed first (S,) [rad, Pa, Pa]."""
        return np.asarray(point.theta[len(self.directions) :] * self.start_std)

    def parameters(self, point: Point, at_s: float | None = None) -> Floats:
        """Parameter vector of a point: with all of its effects, or with those that act at a time [s]."""
        p = self.vector.copy()
        for name, value in self.changes(point).items():
            p[par.INDEX[name]] = value
        effects = calibration.without(point.effects)
        if at_s is None:
            return par.changed(p, effects)
        spans = {path: self.span_of(path.split(".")[1]) for path in effects}
        return par.changed(
            p, {path: value for path, value in effects.items() if spans[path].begin_s <= at_s < spans[path].end_s}
        )

    def span_of(self, effect: str) -> Span:
        """When an effect of a point acts."""
        return self.spans.get(effect, self.span)

    def edges(self, point: Point) -> tuple[float, ...]:
        """When effects of a point begin or end within the recording [s], in order."""
        effects = {path.split(".")[1] for path in calibration.without(point.effects)}
        return tuple(sorted({edge for effect in effects for edge in self.span_of(effect).edges}))

    @override
    def residual(self, point: Point, whole: bool = False) -> Floats:
        """Measured minus simulated block means (B, C), 0 where nothing was measured.

        The whole is followed by what it leaves of recordings that are held out, see :meth:`residual_elsewhere`.
        """
        if not whole:
            return self.residuals([point])[0]
        own = self.residual_of(self.trial.blocks(self.simulated(point, whole)[:, list(self.channels)]))
        return np.concatenate([own, *(self.residual_elsewhere(other, point) for other in self.judged)])

    @override
    def residuals(self, points: Iterable[Point]) -> list[Floats]:
        def left(group: Sequence[Point]) -> list[Floats]:
            return [self.left_by(shown) for shown in self.simulated_each(group)]

        return self.in_lanes(left, points)

    def left_by(self, shown: Floats) -> Floats:
        """Residual (B, C) of the blocks that may be fitted. `shown`: what the sensors would show there (N, 4)."""
        return self.fitted_rows(self.residual_of(self.trial.blocks(shown[:, list(self.channels)])))

    def near(self, there: Point, point: Point, residual: Floats) -> Floats:
        """Residual (B, C) of a model near one whose residual is known, as exact as derivatives need it.

        `residual`: which that leaves (B, C).
        """
        return residual + self.differences(point, residual, [there])[0]

    def residual_of(self, simulated: Floats) -> Floats:
        """Measured minus simulated block means (B, C), 0 where nothing was measured. `simulated`: the latter (B, C)."""
        difference = self.measured[: len(simulated)] - simulated
        # A model that runs away is wrong, not undefined.
        bound = _RUNAWAY * self.noise
        return np.clip(np.nan_to_num(difference, nan=0.0, posinf=np.inf, neginf=-np.inf), -bound, bound)

    def scale(self, residual: Floats | None = None, blocks_per_error: float | None = None) -> Scale:
        """How residuals are judged.

        `residual`: whose memory counts (B, C); default: of none. `blocks_per_error`: blocks per value that a fit
        counts; default: those of a model that lacks something.
        """
        usual = self.blocks_per_error
        counted = usual if blocks_per_error is None else blocks_per_error
        if residual is None:
            return Scale(self.noise, np.ones(len(self.noise)), counted, usual)
        return Scale.of(residual, self.noise, counted, usual)

    def fitted_rows(self, values: Floats) -> Floats:
        """The blocks that may be fitted of what covers them (B, ...)."""
        return values if self.split is None else values[self.split.fitted[: len(values)]]

    @property
    def errors_from(self) -> int:
        """Sample from which on a report shows errors: what is behind was held out, or is the end of the recording."""
        return self.fitted if self.split is None else self.split.errors_from

    @property
    def held_samples(self) -> NDArray[np.bool_]:
        """Which samples no fit saw (N,)."""
        samples = np.arange(len(self.trial))
        if self.split is None:
            return samples >= self.fitted
        blocks = samples // self.trial.block
        return (blocks < len(self.split.held)) & self.split.held[np.minimum(blocks, len(self.split.held) - 1)]

    @property
    def held_parts(self) -> tuple[Span, ...]:
        """The parts of the recording that no fit saw, in order."""
        edges = np.flatnonzero(np.diff(self.held_samples, prepend=False, append=False)) * self.trial.dt
        return tuple(Span(float(begin), float(end)) for begin, end in edges.reshape(-1, 2))

    def held(self, residual: Floats) -> Floats:
        """The held-out blocks of a residual of the whole; none where there is nothing to judge by."""
        if self.split is not None:
            return residual[: len(self.split.held)][self.split.held]
        return residual[-(-self.fitted // self.trial.block) :]

    def times_noise(self, residual: Floats) -> Floats:
        """Root mean square of each channel over its noise (C,); 1 where there is nothing to judge by."""
        if not len(residual):
            return np.ones(residual.shape[1])
        return np.asarray(np.sqrt(np.mean(residual**2, axis=0)) / self.noise)

    def residual_elsewhere(self, other: Experiment, point: Point) -> Floats:
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
        """A point with the start's deviations fitted to the fitted samples, and everything else as it is."""
        count, starts = len(self.directions), len(self.start_std)
        if not starts:
            return point
        now = Point(np.concatenate([point.theta[:count], np.zeros(starts)]), point.effects)
        residual = self.residual(now)
        shifts = np.eye(self.size)[count:]
        moved_by = (Point(now.theta + shift, now.effects) for shift in shifts)
        columns = np.stack(self.differences(now, residual, moved_by), axis=2)
        # Weighed and counted as in any fit, and pulled to what the sensors showed.
        scale, none = self.scale(), np.zeros((*residual.shape, 0))
        step = (
            LinearProblem.of(residual, columns, none).solved(scale, np.ones(starts), np.zeros(starts), rounds=1).theta
        )
        moved = Point(np.concatenate([point.theta[:count], step]), point.effects)
        weight = 1.0 / (scale.variances(residual) * scale.blocks_per_error)
        before, after = (weight @ np.sum(part**2, axis=0) for part in (residual, self.residual(moved)))
        return moved if after + step @ step < before else now
