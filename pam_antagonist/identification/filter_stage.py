"""The filter of an identified rig: its noise, and a covariance of the angle that is right for the recordings.

The pressures are measured well, and valves are modelled badly: with a small process noise the innovations tell of the
valve's error, and the filter would explain it by a motion of the joint. With a large one the sigma points lie so far
apart that friction holds some of them and not others, and the joint creeps where it should stick. A model errs most
where a pressure changes most. So the process noise has two parts, a constant one and one relative to the predicted
change. Of a few pairs the one is taken with which the filter's angle errs least on the fitted recordings.

What is left is the joint's own error, slow and of unknown form. The filter considers a constant torque that is not
known (Schmidt-Kalman). Its standard deviation is chosen so that 95 % of the measured angles lie in their intervals. An
error of the forces does the same for the measured torques. Where a model was chosen by the recordings, its errors in
them are smaller than others will be: then what no fit has seen counts as well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy import stats

from pam_antagonist.estimation.metrics import correlation_length
from pam_antagonist.identification.joint_stage import force_gains, torque_scale
from pam_antagonist.identification.runs import runs_of
from pam_antagonist.inference.free_parameters import off_stop
from pam_antagonist.model import equilibrium
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.recording.rows import own_readings
from pam_antagonist.replays import replay
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Given = tuple[Recording, JointCondition, str]


class Unseen(NamedTuple):
    """The end of a recording, which no fit has seen; what is before it lets the filter find the joint."""

    given: Given
    from_s: float


UNKNOWN_TORQUE = "effects.load_torque.constant"
UNKNOWN_FORCE = "force"
"""Name of the direction of all forces."""
_LEAST_RATE = 1e3
"""[Pa] Least error of a predicted pressure over 10 ms. Below it, a valve's error is taken for a motion of the joint."""
_FIRST_RATE = 1e5
"""[Pa] The same, so large that the measured pressures are followed whatever the valves do."""
_PAIRS = ((1.0, 0.0), (0.1, 0.0), (10.0, 0.0), (1.0, 0.2), (1.0, 0.5), (0.5, 0.2), (0.5, 0.5), (0.25, 0.2), (0.25, 0.5))
"""Process noise that is tried: its constant part, as a share of the usual one, and the part relative to the change."""
_WORTH = 1.05
"""Another pair than the first is taken if it gives a smaller error of the angle by this factor."""
_STILL = 0.02
"""[rad/s] A slower joint rests."""
_MOST_REST = math.radians(20.0)
"""[rad] Largest standard deviation of the first angle."""
_RESTS = 50
"""Number of rests of a run that are looked at."""
_AT_STOP = 1e-3
"""[rad] Distance from a stop within which rounding or most sigma points hold an angle there."""
_OPEN_GATE = 1e4
_GATE_MARGIN = 1.5
"""The gate by the largest Mahalanobis distance in the fitted recordings."""
_COVERED = 0.95
_FIRST_SHARE = 0.01
"""First standard deviation of the unknown torque, as a share of a muscle's torque."""
_CLEARLY = 0.8
"""Share of the squared error below which another process noise is taken than the configured one."""
_ROUNDS = 6
_CLOSE = math.log(1.05)
"""The interval's width need not be closer."""
_LARGEST_STEP = (math.log(0.1), math.log(10.0))
"""Of the logarithm of the torque."""
_MARGIN = 1.05
"""Fitted recordings have smaller errors than others will have."""
_SLOW_S = 0.1
"""[s] What a model lacks is slower."""
_FEWEST = 4.0
"""Independent errors that any recording has."""


def with_process_noise(rig: Rig, recordings: Sequence[Given], jobs: int = 1, guessed: bool = True) -> Rig:
    """The rig with process noise of its pressures, and with a gate that lets the errors of their prediction pass.

    `guessed`: whether the valves were guessed, so that several pairs of the noise's parts are tried.
    """
    rig = _with_start(rig.replaced(directions={}, uncertainty={}), recordings)
    first = _followed(_with_process(rig, _FIRST_RATE, _OPEN_GATE), recordings, jobs)
    # A filter that diverges at once has no innovations; its rig is rejected for its errors.
    size = float(np.sqrt(np.mean(first.innovation**2))) if len(first.innovation) else _FIRST_RATE
    usual = max(size * math.sqrt(0.01 / rig.sample_period), _LEAST_RATE)
    # A part relative to the change makes up for a constant part below the least one.
    tried = [_with_process(rig, max(share * usual, 0.0 if change else _LEAST_RATE), _OPEN_GATE, change)
             for share, change in (_PAIRS if guessed else _PAIRS[:1])]  # fmt: skip
    found = [_followed(one, recordings, jobs) for one in tried]
    best = min(range(len(found)), key=lambda k: found[k].error * (1.0 if k == 0 else _WORTH))
    # After a step a regulator's model errs by many standard deviations. The gate must not reject the measurement there.
    gate = max(rig.tuning("default").gate, _GATE_MARGIN * float(np.max(found[best].distance, initial=1.0)))
    return _with_gate(tried[best], gate)


def _with_start(rig: Rig, recordings: Sequence[Given]) -> Rig:
    """The rig with the variance of the filter's first angle: a joint with friction rests beside its equilibrium."""
    p, errors = rig.parameters(), []
    for run in (run for given in recordings for run in runs_of(*given)):
        still = np.flatnonzero(np.isfinite(run.angle) & (np.abs(run.velocity) < _STILL))
        for k in still[:: max(len(still) // _RESTS, 1)]:
            errors.append(equilibrium.rest_angle(run.pressure[k, 0], run.pressure[k, 1], p) - run.angle[k])
    tuning = rig.tuning("default")
    known = np.array(errors)[np.isfinite(errors)]
    variance = max(min(float(np.mean(known**2)) if len(known) else 0.0, _MOST_REST**2), tuning.initial[0])
    return rig.replaced(
        tunings={**rig.tunings, "default": tuning.replaced(initial=(variance, *tuning.initial[1:]))}
    )  # fmt: skip


def _with_process(rig: Rig, rate: float, gate: float, change: float = 0.0) -> Rig:
    """The rig with an error of the predicted pressures over 10 ms [Pa], one relative to their change, and a gate."""
    tuning, pressure = rig.tuning("default"), rate**2 * rig.sample_period / 0.01
    process = (*tuning.process[:2], pressure, pressure)
    tuned = tuning.replaced(process=process, change=change, consider=True)
    return _with_gate(rig.replaced(tunings={**rig.tunings, "default": tuned}), gate)


def _with_gate(rig: Rig, gate: float) -> Rig:
    return rig.replaced(tunings={**rig.tunings, "default": rig.tuning("default").replaced(gate=gate)})


@dataclass(frozen=True)
class _Followed:
    """What a filter gives over recordings: innovations [Pa], Mahalanobis distances, error of the angle, RMS [rad]."""

    innovation: Floats
    distance: Floats
    error: float


def _followed(rig: Rig, recordings: Sequence[Given], jobs: int) -> _Followed:
    def of(recording: Recording, state: JointCondition, _name: str) -> tuple[Floats, Floats, Floats]:
        lock_angle = state.lock_angle if state.condition == "locked" else None
        run = replay(recording, rig, "default", state.condition, lock_angle).run
        error = np.zeros(0)
        angle = own_readings(recording)[1]
        if state.condition == "free" and angle is not None:
            error = run.rows["angle"] - angle[run.index]
        return run.rows["innovation"].ravel(), np.sqrt(run.rows["nis"]), error

    parts = Parallel(n_jobs=jobs, prefer="threads")(delayed(of)(*item) for item in recordings)
    columns = (np.concatenate(column) for column in zip(*parts, strict=True))
    innovation, distance, error = (column[np.isfinite(column)] for column in columns)
    return _Followed(innovation, distance, float(np.sqrt(np.mean(error**2))) if len(error) else math.inf)


@dataclass(frozen=True)
class UnknownTorque:
    """The unknown torque, and what it gives."""

    rig: Rig
    torque: float  # its standard deviation [N m]
    share: float  # of the measured angles in their 95 % intervals, on the fitted recordings


def with_unknown_torque(
    rig: Rig, recordings: Sequence[Given], jobs: int = 1, progress: Callable[[str], None] | None = None
) -> UnknownTorque:
    """The rig with the standard deviation of an unknown torque, so that 95 % of the angles lie in their intervals.

    Where the uncertainty of the rig's values alone makes the intervals wider than that, it is made smaller.

    `recordings`: of free joints with a measured angle.
    """
    known = {path: std for path, std in rig.uncertainty.items() if path != UNKNOWN_TORQUE}
    certain = rig.replaced(uncertainty=known)
    lacking, share = _lacking(certain, "angle", recordings, jobs)

    def narrower(part: float) -> Rig:
        turned = {name: {path: part * step for path, step in steps.items()} for name, steps in rig.directions.items()}
        return rig.replaced(uncertainty={path: part * std for path, std in known.items()}, directions=turned)

    if lacking < -_CLOSE and (known or rig.directions):
        found, _, share = _covering(narrower, math.exp(lacking), "angle", recordings, jobs, progress)
        return UnknownTorque(found, 0.0, share)
    made = partial(_with_torque, rig)
    return UnknownTorque(*_covering(made, _first_torque(rig), "angle", recordings, jobs, progress))


def with_unknown_force(
    rig: Rig, recordings: Sequence[Given], jobs: int = 1, progress: Callable[[str], None] | None = None
) -> Rig:
    """The rig with an error of all forces by one share, so that 95 % of the torques lie in their intervals.

    It hardly moves the angle, at which both muscles are in balance. Nothing changes where no torque was measured.
    """
    known = [given for given in recordings if shows("torque", given)]
    return _widened(rig, "torque", known, jobs, progress)


def wider(rig: Rig, unseen: Sequence[Unseen], jobs: int = 1, progress: Callable[[str], None] | None = None) -> Rig:
    """The rig with intervals that hold 95 % of the angles that no fit has seen as well; none gets narrower."""
    known = [one for one in unseen if shows("angle", one.given)]
    return _widened(rig, "angle", [one.given for one in known], jobs, progress, [one.from_s for one in known])


def _widened(
    rig: Rig, channel: str, recordings: Sequence[Given], jobs: int, progress: Callable[[str], None] | None,
    unseen_from: Sequence[float] = (),
) -> Rig:  # fmt: skip
    """The rig with more that is not known, where its intervals of a channel hold less than 95 %; else as it is."""
    if not recordings or _lacking(rig, channel, recordings, jobs, unseen_from)[0] <= 0.0:
        return rig
    made, first = (_with_force, _FIRST_SHARE) if channel == "torque" else (_with_torque, _first_torque(rig))
    return _covering(partial(made, rig), first, channel, recordings, jobs, progress, unseen_from)[0]


def shows(channel: str, given: Given) -> bool:
    """Whether a recording shows errors of a channel; the angle of a locked joint is known."""
    recording, state, _ = given
    values = recording.torque if channel == "torque" else recording.angle if state.condition == "free" else None
    return values is not None and bool(np.isfinite(values).any())


def _first_torque(rig: Rig) -> float:
    return _FIRST_SHARE * torque_scale(rig)


def _with_torque(rig: Rig, torque: float) -> Rig:
    return rig.replaced(uncertainty={**rig.uncertainty, UNKNOWN_TORQUE: torque})


def _with_force(rig: Rig, share: float) -> Rig:
    steps = {path: share * value for path, value in force_gains(rig).items()}
    return rig.replaced(directions={**rig.directions, UNKNOWN_FORCE: steps})


def _covering(
    made: Callable[[float], Rig], first: float, channel: str, recordings: Sequence[Given], jobs: int,
    progress: Callable[[str], None] | None, unseen_from: Sequence[float] = (),
) -> tuple[Rig, float, float]:  # fmt: skip
    """The rig whose intervals of a channel hold 95 % of the measurements, its size, and the share that they hold.

    `made`: the rig by the size of what is not known, `first` to begin with. `unseen_from`: as for :func:`_lacking`.
    """
    seen, size = [], first
    for number in range(_ROUNDS):
        if progress:
            progress(f"covariance of the {channel}, run {number + 1} of {_ROUNDS} at most")
        rig = made(size)
        lacking, share = _lacking(rig, channel, recordings, jobs, unseen_from)
        seen.append((abs(lacking), math.log(size), lacking, (rig, size, share)))
        if abs(lacking) < _CLOSE:
            break
        size = math.exp(_next(seen))
    return min(seen, key=lambda item: item[0])[-1]


def _lacking(
    rig: Rig, channel: str, recordings: Sequence[Given], jobs: int, unseen_from: Sequence[float] = ()
) -> tuple[float, float]:
    """By how much the logarithm of the intervals' width falls short, and the share of measurements that they hold.

    `unseen_from`: time of each recording [s] from which on no fit has seen it; without, all were fitted.
    """
    begins = unseen_from or [0.0] * len(recordings)
    tasks = (delayed(_errors)(rig, channel, *given, begin) for given, begin in zip(recordings, begins, strict=True))
    parts = Parallel(n_jobs=jobs, prefer="threads")(tasks)
    error, std = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not len(error):
        return _LARGEST_STEP[0], math.nan
    noise = rig.sensors.error(channel)
    # Errors within the sensor's own noise need nothing.
    beyond = np.sqrt(np.maximum((error / 1.96) ** 2 - noise**2, 0.0)) / np.maximum(std, 1e-9)
    margin = _MARGIN
    if unseen_from:
        # Few errors are independent: those of one step go together.
        count = sum(_independent(own, round(_SLOW_S / rig.sample_period)) for own, _ in parts)
        margin = float(stats.t.ppf(0.5 + 0.5 * _COVERED, max(count - 1.0, 1.0))) / 1.96
    lacking = float(np.clip(math.log(margin * max(float(np.quantile(beyond, _COVERED)), 1e-9)), *_LARGEST_STEP))
    return lacking, float(np.mean(np.abs(error) <= 1.96 * np.hypot(std, noise)))


def _independent(error: Floats, block: int) -> float:
    """How many independent values an error (M,) has, in means over so many samples: noise of samples is none."""
    means = error[: len(error) // block * block].reshape(-1, block).mean(axis=1)
    return len(means) / correlation_length(means, _FEWEST) if len(means) else 0.0


def _next(seen: Sequence[tuple[float, float, float, object]]) -> float:
    """Logarithm of the next size to try, such as that of the unknown torque.

    The interval grows with it, but not in proportion where the joint sticks or nears its stop. Between a size that is
    too small and one that is too large, a straight line is taken.

    `seen`: of each size the logarithm, and by how much the logarithm of the interval's width falls short.
    """
    below = max(((at, lacks) for _, at, lacks, _ in seen if lacks > 0.0), default=None)
    above = min(((at, lacks) for _, at, lacks, _ in seen if lacks <= 0.0), default=None)
    if below is None or above is None or below[0] >= above[0]:
        return seen[-1][1] + seen[-1][2]
    share = below[1] / (below[1] - above[1])
    return below[0] + min(max(share, 0.1), 0.9) * (above[0] - below[0])


def _errors(
    rig: Rig, channel: str, recording: Recording, state: JointCondition, _name: str, from_s: float
) -> tuple[Floats, Floats]:
    """Errors of the estimated angle [rad] or torque [N m] and their standard deviations (M,), from a time on.

    At its stop the filter is sure of the angle whatever the torque: such rows would ask for any torque.
    """
    lock_angle = state.lock_angle if state.condition == "locked" else None
    run = replay(recording, rig, "default", state.condition, lock_angle).run
    _, angle, torque = own_readings(recording)
    readings, place = (angle, 0) if channel == "angle" else (torque, 2)
    assert readings is not None
    error = run.rows[channel] - readings[run.index]
    known = np.isfinite(error) & (run.stamp_ns - recording.stamp_ns[0] >= from_s * 1e9)
    inside = known & (np.abs(run.rows["angle"]) < off_stop(rig, _AT_STOP))
    known = inside if inside.any() else known
    return error[known], np.sqrt(run.rows["covariance"][:, place, place])[known]


def with_least_error(rigs: Sequence[Rig], recordings: Sequence[Given], jobs: int = 1) -> Rig:
    """The one whose filter errs least in angle, or in torque where no angle of a free joint was measured.

    `rigs`: the first is taken where nothing was measured, or where none is clearly better.
    """

    def error(rig: Rig, given: Given) -> tuple[float, float]:
        recording, state, _ = given
        lock_angle = state.lock_angle if state.condition == "locked" else None
        found = replay(recording, rig, "default", state.condition, lock_angle).report.ukf
        return tuple(math.nan if one is None else one.rmse for one in (found.angle, found.torque))  # type: ignore[return-value]

    parts = Parallel(n_jobs=jobs, prefer="threads")(delayed(error)(rig, given) for rig in rigs for given in recordings)
    each = np.array(parts, dtype=np.float64).reshape(len(rigs), len(recordings), 2)
    each[:, [state.condition == "locked" for _, state, _ in recordings], 0] = np.nan
    for channel in (0, 1):
        if (known := np.isfinite(each[0, :, channel])).any():
            squares = np.mean(each[:, known, channel] ** 2, axis=1)
            best = int(np.argmin(squares))
            return rigs[best if squares[best] < _CLEARLY * squares[0] else 0]
    return rigs[0]
