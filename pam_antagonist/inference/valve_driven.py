"""A joint that its valves drive, as an experiment: the recorded voltages are the input.

Pressure regulators drive a joint likewise, with the pressures that they are asked for in the place of the voltages.

The model runs by itself from the first sample on, effects and sensors included.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference import calibration
from pam_antagonist.inference.experiment import Channel, Experiment, Point
from pam_antagonist.inference.free_parameters import Candidate, FreeDirection, base_directions, candidates
from pam_antagonist.inference.long_steps import in_steps, stride_blocks
from pam_antagonist.inference.trial import ANGLE, CHANNELS, PRESSURE_1, Trial
from pam_antagonist.model import dynamics, equilibrium, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import small_signal_lags
from pam_antagonist.model.joint import quickest_lag

Floats = NDArray[np.float64]

_START_S = 0.02
"""[s] At the beginning of a recording: a straight line through it tells the first sample's true values."""
_LATEST_ANGLE_S = 0.5
"""[s] An angle that begins so late tells the start as well: a node of its own, or its stamps, may be late."""
_START_ANGLE = 1.7e-3
"""[rad] How well a measured start angle is known, stiction and encoder step together."""
_CLOCKS_S = 0.02
"""[s] How well clocks agree: where a recording begins in motion, its start is known as well as that."""
_RATE_S = 0.1
"""[s] At the beginning of a recording, in which it is told how quickly something changes."""
_RECENT = 3
"""Simulations of a recording that are kept: where it is fitted, and in longer steps."""
STARTS = 3
"""Start values: the angle and both pressures."""
_LONG_STEPS = (4e-3, 2e-3)
"""[s] Steps in which derivatives are simulated, the longest first that goes the model's way."""
_ASTRAY = 0.5
"""A simulation in longer steps goes the model's way if no channel is off by more than so many noises (RMS)."""
_TITLES = (
    Channel("Angle", "°", 180.0 / np.pi),
    Channel("Torque", "N m", 1.0),
    Channel("Pressure 1", "kPa", 1e-3),
    Channel("Pressure 2", "kPa", 1e-3),
)


@dataclass(frozen=True, eq=False)
class ValveDriven(Experiment):
    """A recording of a joint that its valves drive."""

    @cached_property
    def directions(self) -> tuple[FreeDirection, ...]:
        """Free base directions."""
        return base_directions(self.rig)

    @cached_property
    def channels(self) -> tuple[int, ...]:
        """What was measured and can show something, indices of ``CHANNELS``."""
        return tuple(c for c in range(len(CHANNELS)) if self.trial.has(c))

    @property
    def titles(self) -> tuple[Channel, ...]:
        """The channels' names and units."""
        return tuple(_TITLES[c] for c in self.channels)

    @cached_property
    def measured(self) -> Floats:
        """Block means of the measurements (B, C) of these channels."""
        return self.trial.blocks(self.trial.measured[:, list(self.channels)])

    @cached_property
    def noise(self) -> Floats:
        """Standard deviation of a block mean by the sensor alone (C,)."""
        return np.array([self.trial.noise(c) for c in self.channels])

    @cached_property
    def first(self) -> Start:
        """What the recording starts from."""
        return start_of(self.trial)

    @cached_property
    def start_std(self) -> Floats:
        """How well the start is known (3,) [rad, Pa, Pa]."""
        sensors = self.rig.sensors
        sample = float(np.hypot(sensors.pressure_std, sensors.pressure_step / np.sqrt(12.0)))
        known = np.hypot([_START_ANGLE, *(sample * self.first.share)], _CLOCKS_S * self.first.rate)
        return known * np.array([0.0 if self.trial.joint == "locked" else 1.0, 1.0, 1.0])

    @property
    def runs_by_itself(self) -> bool:
        """It does: from the voltages."""
        return True

    def signals(self, point: Point) -> dict[str, Floats]:
        """Voltages, pressures and, of a free joint, its motion."""
        model, voltage = (self.trial.blocks(v) for v in (self.simulated(point, whole=True), self.trial.voltage))
        out = {f"voltage {i + 1}": voltage[:, i] for i in (0, 1)}
        out |= {f"pressure {i + 1}": model[:, PRESSURE_1 + i] for i in (0, 1)}
        if self.trial.joint == "free":
            out |= {"angle": model[:, ANGLE], "velocity": np.gradient(model[:, ANGLE], self.trial.block_s)}
        return {name: np.asarray(values, dtype=np.float64) for name, values in out.items()}

    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        """What could be wrong beside the effects that a model has already.

        Args:
            taken: values of the model's effects' parameters, by dotted path.
        """
        # What a rig file says of its regulators is no candidate any more.
        declared = dict.fromkeys((f"effects.{name}." for name in self.rig.effects), 0.0)
        known = {**taken, **declared} if self.rig.drive == "regulator" else taken
        return candidates(known, {"valve": "valve", "regulator": "command"}[self.rig.drive])

    def calibrations(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        """Zeros, scales and late stamps that could be wrong, beside those that a model has already.

        Args:
            taken: values of the model's parameters, by dotted path.
        """
        return calibration.candidates(self.trial, self.channels, taken)

    def start_shift(self, point: Point) -> Floats:
        """Deviations of the start from what the sensors showed first (3,) [rad, Pa, Pa], with the encoder's zero."""
        shift = super().start_shift(point)
        zero = calibration.values_of(point.effects).get("encoder_zero", 0.0)
        return shift - np.array([zero if self.trial.joint != "locked" or self._lock_measured else 0.0, 0.0, 0.0])

    @cached_property
    def _lock_measured(self) -> bool:
        return calibration.is_lock_measured(self.trial)

    def depends_on(self, k: int) -> bool:
        """Whether anything that is compared depends on a base coordinate."""
        if self.trial.joint != "locked":
            return True
        if k < len(self.directions):
            return not (self.directions[k].free_only and self.trial.lock_angle == 0.0)
        return k != len(self.directions) + ANGLE

    def simulated(self, point: Point, whole: bool = False) -> Floats:
        """What the sensors would show (N, 4): in the part that is fitted, or in all of the recording."""
        trial = self.trial if whole else self._part
        return self._shown(trial, point)

    def states(self, point: Point) -> tuple[Floats, Floats]:
        """States (N, n) and torques (N,) [N m] of the model over all of the recording."""
        return run(self.trial, self._first(point), self.first, self.start_shift(point), self._later(point))

    def _shown(self, trial: Trial, point: Point) -> Floats:
        """What the sensors would show (N, 4), calibrations included, in the steps of a trial."""
        exact = self._exact(trial, self._first(point), self.start_shift(point), self._later(point))
        return calibration.readings(exact, trial.dt, calibration.values_of(point.effects))

    def _exact(self, trial: Trial, p: Floats, shift: Floats, later: Sequence[Phase]) -> Floats:
        """What exact sensors would show (N, 4), once for all the calibrations that are tried beside a model."""
        phases = tuple((phase.begin_s, phase.parameters.tobytes()) for phase in later)
        key = p.tobytes(), shift.tobytes(), phases
        known = self._recent.get("runs", ())
        for of, other, exact in known:
            if of is trial and other == key:
                return exact.copy()
        exact = predict(trial, p, self.first, shift, later)
        # Put in place as a whole: other threads see the former runs or these.
        self._recent["runs"] = ((trial, key, exact), *known[: _RECENT - 1])
        return exact.copy()

    @cached_property
    def _recent(self) -> dict[str, tuple[tuple[Trial, object, Floats], ...]]:
        return {}

    def _first(self, point: Point) -> Floats:
        """Parameter vector at the start of the recording."""
        return self.parameters(point, 0.0)

    def _later(self, point: Point) -> tuple[Phase, ...]:
        """What the model is after each time at which an effect begins or ends."""
        return tuple(Phase(edge, self.parameters(point, edge)) for edge in self.edges(point) if edge > 0.0)

    @cached_property
    def _part(self) -> Trial:
        return self.trial.part(0.0, self.fitted * self.trial.dt)

    def differences(self, point: Point, residual: Floats, moved: Iterable[Point]) -> list[Floats]:
        """How the residual (B, C) changes from a point to others nearby.

        Derivatives are most of what a fit works out, and need no steps as fine as the residual itself: theirs are
        longer wherever the model in longer steps goes the same way.

        Args:
            point: where the residual is known.
            residual: there (B, C).
            moved: the others.
        """
        coarse, here = self._coarsest(point, residual)
        p = self.vector.copy()
        p[par.FRICTION_STEP] = coarse.step
        lags, shortest = small_signal_lags(self.parameters(point)), quickest_lag(p)

        def difference(there: Point) -> Floats:
            # Longer steps follow no shorter lags than themselves: there, a lag that moves would seem to stay.
            moved_lags = small_signal_lags(self.parameters(there))
            unseen = (lags != moved_lags) & (np.minimum(lags, moved_lags) < shortest)
            fine = coarse is self._part or np.any(unseen)
            return self.residual(there) - residual if fine else self._coarse_residual(there, coarse) - here

        return self.side_by_side(difference, moved)

    def _coarsest(self, point: Point, residual: Floats) -> tuple[Trial, Floats]:
        """The part that is fitted in the longest steps in which the model goes its way at a point; its residual."""
        for coarse in self.in_long_steps:
            here = self._coarse_residual(point, coarse)
            if self.goes_its_way(here - residual):
                return coarse, here
        return self._part, residual

    def goes_its_way(self, change: Floats) -> bool:
        """Whether longer steps change what is compared by so little that they serve for derivatives.

        Args:
            change: of the block means (B, C).
        """
        return bool(np.all(np.sqrt(np.nanmean(change**2, axis=0)) <= _ASTRAY * self.noise))

    @cached_property
    def in_long_steps(self) -> tuple[Trial, ...]:
        """The part that is fitted as models in longer steps see it, the longest steps first."""
        found = (in_steps(self._part, longest) for longest in _LONG_STEPS)
        return tuple(coarse for coarse in found if coarse.step > self._part.step)

    def _coarse_residual(self, point: Point, coarse: Trial) -> Floats:
        """The residual (B, C) of the blocks that may be fitted, simulated in longer steps."""
        simulated = self._shown(coarse, point)[:, list(self.channels)]
        stride = round(coarse.dt / self.trial.dt)
        means = stride_blocks(simulated, stride, self.fitted // self.trial.block, self.trial.block)
        return self.fitted_rows(self.residual_of(means))


class Phase(NamedTuple):
    """A part of a recording in which the same effects act.

    Attributes:
        begin_s: since the first sample [s]; it lasts until the next phase or the recording's end.
        parameters: vector (P,) of the model.
    """

    begin_s: float
    parameters: Floats


@dataclass(frozen=True)
class Start:
    """What the sensors showed at the start of a recording.

    Attributes:
        angle: [rad], None where it was not measured.
        pressure: of both muscles (2,) [Pa].
        share: standard deviation of these (2,), over that of one sample.
        rate: how quickly angle and pressures change there (3,) [rad/s, Pa/s, Pa/s].
    """

    angle: float | None
    pressure: Floats
    share: Floats
    rate: Floats


def start_of(trial: Trial) -> Start:
    """What the first samples of a recording say of its start.

    The means of these samples lie behind it: valves that fill a muscle change its pressure by much more than the noise
    in that time.

    Args:
        trial: the recording.
    """
    first = trial.measured[: trial.samples(_START_S)]
    pressure, share = np.transpose([_at_first(first[:, k]) for k in (PRESSURE_1, PRESSURE_1 + 1)])
    early = trial.measured[: trial.samples(_LATEST_ANGLE_S), ANGLE]
    begin = int(np.argmax(np.isfinite(early)))
    angle = trial.lock_angle if trial.joint == "locked" else _at_first(early[begin : begin + len(first)])[0]
    begun = trial.measured[: trial.samples(_RATE_S)]
    rate = np.array([_rate(begun[:, k]) / trial.dt for k in (ANGLE, PRESSURE_1, PRESSURE_1 + 1)])
    return Start(angle if np.isfinite(angle) else None, pressure, share, rate)


def _at_first(values: Floats) -> tuple[float, float]:
    """The straight line through values (N,) at the first of them, and its standard deviation over that of a value."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) < 2:
        return (float(values[known[0]]), 1.0) if len(known) else (np.nan, 1.0)
    middle, spread = known.mean(), np.sum((known - known.mean()) ** 2)
    line = np.polynomial.Polynomial.fit(known, values[known], 1)
    return float(line(0.0)), float(np.sqrt(1.0 / len(known) + middle**2 / spread))


def _rate(values: Floats) -> float:
    """Size of the slope of values (N,), a sample; 0 where there are not two."""
    known = np.flatnonzero(np.isfinite(values))
    return abs(float(np.polynomial.Polynomial.fit(known, values[known], 1).deriv()(0.0))) if len(known) > 1 else 0.0


def predict(trial: Trial, p: Floats, start: Start, shift: Floats | None = None, later: Sequence[Phase] = ()) -> Floats:
    """The model alone, from the start of a recording on.

    Args:
        trial: its voltages are used.
        p: parameter vector (P,).
        start: what the sensors showed first; the added states start settled.
        shift: deviation of the true start from that (3,) [rad, Pa, Pa].
        later: what the model is from some times on, in their order.

    Returns:
        What the sensors would show (N, 4), in the order of ``trial.CHANNELS``.
    """
    states, torque = run(trial, p, start, shift, later)
    shown = np.empty((len(states), 2))
    for rows, vector in _parts(trial, p, later):
        shown[rows] = sensor.readings(states[rows, 2:4], vector)
    return np.column_stack([states[:, 0], torque, shown])


def run(
    trial: Trial, p: Floats, start: Start, shift: Floats | None = None, later: Sequence[Phase] = ()
) -> tuple[Floats, Floats]:
    """States (N, n) and torques (N,) [N m] of the same.

    Args:
        trial: its voltages are used.
        p: parameter vector (P,); the step of its friction is that of the integration.
        start: what the sensors showed first.
        shift: deviation of the true start from that (3,) [rad, Pa, Pa].
        later: what the model is from some times on, in their order. States that a phase adds start settled.
    """
    given = trial.voltage if trial.external is None else trial.given
    courses: list[tuple[Floats, Floats]] = []
    before = p
    for rows, vector in _parts(trial, p, later):
        now = vector.copy()
        # A joint must be able to stick within a step.
        now[par.FRICTION_STEP] = trial.step
        if not courses:
            x0 = initial_state(trial, now, start, shift)
            courses.append(dynamics.course(x0, given[rows], now, trial.dt, trial.substeps))
        else:
            # The first row of a course is its start, which is the last one of the course before.
            last = rows.start - 1
            x0 = _taken_over(courses[-1][0][-1], before, now, given[last])
            states, torque = dynamics.course(x0, given[last : rows.stop], now, trial.dt, trial.substeps)
            courses.append((states[1:], torque[1:]))
        before = now
    if len(courses) == 1:
        return courses[0]
    out = np.zeros((len(given), max(states.shape[1] for states, _ in courses)))
    end = len(given)
    for states, _ in reversed(courses):
        # States that a phase does not have yet stand where the next phase begins with them.
        out[end - len(states) : end] = out[min(end, len(given) - 1)]
        out[end - len(states) : end, : states.shape[1]] = states
        end -= len(states)
    return out, np.concatenate([torque for _, torque in courses])


def initial_state(trial: Trial, p: Floats, start: Start, shift: Floats | None = None) -> Floats:
    """State (n,) of the model at the first sample of a recording; the added states are settled.

    Args:
        trial: its first voltages are used.
        p: parameter vector (P,).
        start: what the sensors showed first.
        shift: deviation of the true start from that (3,) [rad, Pa, Pa].
    """
    moved = np.zeros(3) if shift is None else shift
    pressures = [sensor.pressure_behind(i, start.pressure[i] + moved[1 + i], p) for i in (0, 1)]
    angle = equilibrium.rest_angle(pressures[0], pressures[1], p) if start.angle is None else start.angle + moved[0]
    given = trial.voltage if trial.external is None else trial.given
    return np.asarray(equilibrium.initial_state(angle, pressures[0], pressures[1], given[0], p))


def _parts(trial: Trial, p: Floats, later: Sequence[Phase]) -> list[tuple[slice, Floats]]:
    """The samples of each phase, with its parameter vector (P,); a phase has one sample at least."""
    first = [0, *(round(phase.begin_s / trial.dt) for phase in later), len(trial)]
    rows = [slice(begin, min(end, len(trial))) for begin, end in zip(first[:-1], first[1:], strict=True)]
    vectors = [p, *(phase.parameters for phase in later)]
    return [(part, vector) for part, vector in zip(rows, vectors, strict=True) if part.start < part.stop]


def _taken_over(x: Floats, before: Floats, after: Floats, given: Floats) -> Floats:
    """A state of one model as a state of another one: what that has besides is settled.

    Args:
        x: state (n,).
        before: parameter vector (P,) of the model that it is of.
        after: of the other model.
        given: input (2,) or (3,).
    """
    out = np.asarray(equilibrium.initial_state(x[0], x[2], x[3], given, after))
    out[:4] = x[:4]
    for slot in par.SLOT_OF.values():
        if before[slot] > 0.0 and after[slot] > 0.0:
            out[int(after[slot])] = x[int(before[slot])]
    return out
