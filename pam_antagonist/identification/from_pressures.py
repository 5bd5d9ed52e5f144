"""Identification of any rig from its measured pressures: joint, air, filter, and a judgement on held-out data.

1. Joint and muscles from the measured pressures (:mod:`~pam_antagonist.identification.joint_stage`).
2. Chambers and valves, or regulators, from the measured motion (:mod:`~pam_antagonist.identification.air_stage`).
3. Noise and covariance of the filter (:mod:`~pam_antagonist.identification.filter_stage`).
4. Errors on data that no step saw, beside those of the rig as configured and of a linear map of the two pressures.

One long recording and many short trials take the same way, as do valves and regulators.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification import joint_stage
from pam_antagonist.identification.air_stage import errors, fit_air
from pam_antagonist.identification.filter_stage import Covered, Given, with_process_noise, with_unknown_torque
from pam_antagonist.identification.joint_stage import DELAY, ZERO, fit_joint, model_values
from pam_antagonist.identification.runs import Run, runs_of, said
from pam_antagonist.identification.unknowns import Fit
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.model import parameters as par
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.replays import Replay, after, replay
from pam_antagonist.replays.result import ReplayReport
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import unphysical

Floats = NDArray[np.float64]

_WHOLE_FROM = 4
"""From so many short recordings on, whole ones are held out: they start from rest, as those to come will."""
_SHORT = 30.0
"""[s] A recording or an episode that is not longer is a trial."""
_LEAST_MOTION = 1.0
"""[deg] A joint that moves less tells nothing of its muscles."""
_EXPLAINED = 0.8
"""Largest error of the modelled pressures, as a share of the error if nothing flows. With exchanged commands it is 0.97
or more on three simulated joints, with the right ones 0.06 or less there."""


@dataclass(frozen=True, eq=False)
class Held:
    """Held-out data of one recording.

    Attributes:
        name: of the recording.
        from_s: begin of the held-out part [s].
        whole: the recording, replayed with the identified rig.
        identified: errors of the held-out part with the identified rig.
        as_configured: the same with the rig file.
        pressures_alone: error of the angle where the measured pressures drive the joint, RMS [deg]; NaN where locked.
        linear: error of a linear map of the two pressures, fitted to the same data, RMS [deg]; NaN likewise.
        rows: number of rows with a measured angle.
    """

    name: str
    from_s: float
    whole: Replay
    identified: ReplayReport
    as_configured: ReplayReport
    pressures_alone: float
    linear: float
    rows: int

    def error(self, column: str) -> float:
        """Error of the angle, RMS [deg]; NaN without any.

        Args:
            column: ``identified``, ``as_configured``, ``model_alone``, ``pressures_alone`` or ``linear``.
        """
        if column in ("pressures_alone", "linear"):
            return float(getattr(self, column))
        report = self.as_configured if column == "as_configured" else self.identified
        errors = report.model_alone.angle if column == "model_alone" else report.ukf.angle
        return math.nan if errors is None else errors.rmse

    @property
    def coverage(self) -> float:
        """Share of the angles in their 95 % intervals; NaN without any."""
        errors = self.identified.ukf.angle
        share = None if errors is None else errors.coverage95
        return math.nan if share is None else share


@dataclass(frozen=True, eq=False)
class FromPressures:
    """An identified rig and how it was found.

    Attributes:
        start: the rig as configured.
        rig: the result.
        joint: values of joint and muscles.
        air: values of chambers and valves, or regulators; None without commands.
        covered: the unknown torque of the filter.
        held: errors on held-out data.
        fitted: name of each recording, and the end of its part that was fitted [s].
        notes: for the user.
        pressures: errors of the pressures in a second from the commands [Pa]: of the model, and if nothing flowed.
    """

    start: Rig
    rig: Rig
    joint: Fit
    air: Fit | None
    covered: Covered
    held: tuple[Held, ...]
    fitted: tuple[tuple[str, float], ...]
    notes: tuple[str, ...]
    pressures: tuple[float, float]

    def pooled(self, column: str) -> float:
        """Error of the angle over all held-out rows, RMS [deg]; NaN without any.

        Args:
            column: as for :meth:`Held.error`.
        """
        known = [(item.error(column), item.rows) for item in self.held if math.isfinite(item.error(column))]
        total = sum(rows for _, rows in known)
        return math.sqrt(sum(rows * error**2 for error, rows in known) / total) if total else math.nan

    @property
    def coverage(self) -> float:
        """Share of the held-out angles in their 95 % intervals; NaN without any."""
        known = [(item.coverage, item.rows) for item in self.held if math.isfinite(item.coverage)]
        total = sum(rows for _, rows in known)
        return sum(rows * share for share, rows in known) / total if total else math.nan

    @property
    def rejected(self) -> str:
        """Why the rig should not be used, in a sentence; empty if it may."""
        now, before = self.pooled("identified"), self.pooled("as_configured")
        if not math.isfinite(now):
            return "the filter gives no angle on the held-out data with it."
        if now > before:
            return (
                f"on the held-out data the filter errs by {now:.3g}° with it and by {before:.3g}° with the rig file. "
                "The recordings do not fit two muscles on one joint, or their channels are exchanged: run check."
            )
        if now > (linear := self.pooled("linear")):
            return (
                f"on the held-out data the filter errs by {now:.3g}°, a linear map of the two pressures by "
                f"{linear:.3g}°. The recordings do not fit two muscles on one joint, the joint moved too little, or it "
                "hit a stop that the rig file does not have."
            )
        model, rest = self.pressures
        if model > _EXPLAINED * rest:
            return (
                f"the commands do not explain the pressures: within a second the model errs by {model / 1e3:.3g} kPa, "
                f"and by {rest / 1e3:.3g} kPa if nothing flows. The commands are exchanged, or of another joint: run "
                "check."
            )
        if complaint := unphysical(self.rig):
            return f"{complaint}. The recordings do not fit two muscles on one joint."
        return ""


def is_for(rig: Rig) -> bool:
    """Whether a rig is identified in this way: its muscles are braided ones, its chambers open."""
    return rig.model.force == "braided" and not rig.valves.sealed


def identify(
    recordings: Sequence[Given],
    rig: Rig,
    holdout: float = 1.0 / 3.0,
    starts: int = 2,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
    whole: int = 0,
) -> FromPressures:
    """Identify a rig.

    Args:
        recordings: each with its joint's condition and a name.
        rig: start values and priors.
        holdout: share of the data that is held out.
        starts: number of starts of the joint's fit.
        seed: of the further starts.
        jobs: threads.
        progress: called with a text about each step.
        whole: number of recordings at the end that are held out as a whole, in place of the share.

    Raises:
        BadInput: no free joint with a measured angle.
    """
    progress = progress or (lambda text: None)
    if not any(_is_free(given) for given in recordings):
        raise BadInput("no recording has a joint that moves and a measured angle: expected one at least, to fit")
    if not any(_is_judged(given) for given in recordings):
        raise BadInput(
            "no recording of a free joint has commands: expected the voltages of the valves, or the commanded "
            "pressures of the regulators, in one at least"
        )
    ends = fitted_until(recordings, holdout, whole)
    runs = parts_of(recordings, ends)
    _check_motion(recordings, runs, ends)
    joint = fit_joint(rig, runs, starts=starts, seed=seed, jobs=jobs, progress=progress)
    own, corrected = with_joint(rig, joint, recordings)
    air = fit_air(own, parts_of(corrected, ends), 0.0, jobs=jobs, progress=progress)
    return concluded(recordings, ends, rig, joint, air, jobs, progress)


def with_joint(rig: Rig, joint: Fit, recordings: Sequence[Given]) -> tuple[Rig, list[Given]]:
    """The rig with the values of its joint, and the recordings with the zero and the delay that were found.

    Args:
        rig: as configured.
        joint: values of joint and muscles.
        recordings: with the calibration of the rig.
    """
    found = _found(joint)
    return moved(rig, model_values(joint.unknowns, joint.values)), [
        (found.applied(recording), state, name) for recording, state, name in recordings
    ]


def _found(joint: Fit) -> Corrections:
    return Corrections(encoder_zero=joint.values[ZERO], delay_angle=-joint.values[DELAY])


def concluded(
    recordings: Sequence[Given],
    ends: Sequence[float],
    rig: Rig,
    joint: Fit,
    air: Fit | None,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
) -> FromPressures:
    """Noise and covariance of the filter for values that were found, and its errors on held-out data.

    Args:
        recordings: each with its joint's condition and a name.
        ends: of the fitted part of each [s], see :func:`fitted_until`.
        rig: as configured.
        joint: values of joint and muscles.
        air: values of chambers and valves, or regulators; None without commands.
        jobs: threads.
        progress: called with a text about each step.
    """
    progress = progress or (lambda text: None)
    own, corrected = with_joint(rig, joint, recordings)
    if air is not None:
        own = moved(own, air.parameters)
    parts = _cut(corrected, ends)
    progress("process noise of the filter")
    covered = with_unknown_torque(with_process_noise(own, parts, jobs), parts, jobs, progress)
    calibration = _calibration(rig).followed_by(_found(joint)).calibration()
    result = covered.rig.replaced(calibration=rig.calibration.replaced(**calibration))
    progress("held-out data")
    runs = parts_of(corrected, ends)
    line = _linear(runs)
    held = tuple(
        _held(given, before, end, covered.rig, rig, line)
        for given, before, end in zip(corrected, recordings, ends, strict=True)
        if _is_judged(given) and end < given[0].duration_s
    )
    fitted = tuple((name, end) for (_, _, name), end in zip(recordings, ends, strict=True) if end > 0.0)
    notes = (*said(runs), *_notes(joint, air))
    return FromPressures(rig, result, joint, air, covered, held, fitted, notes, errors(own, runs))


def _is_free(given: Given) -> bool:
    recording, state, _ = given
    return state.condition == "free" and recording.angle is not None and bool(np.isfinite(recording.angle).any())


def _is_judged(given: Given) -> bool:
    """Whether a filter's angle can be compared with the measured one."""
    return _is_free(given) and bool(np.isfinite(given[0].voltage).all(axis=1).any())


def _check_motion(recordings: Sequence[Given], runs: Sequence[Run], ends: Sequence[float]) -> None:
    """Refuse data that hold too little to fit, or to judge a fit.

    Raises:
        BadInput: they do.
    """
    fitted = [run.angle[np.isfinite(run.angle)] for run in runs if not run.locked]
    moved_by = math.degrees(float(np.ptp(np.concatenate([np.zeros(0), *fitted])))) if any(map(len, fitted)) else 0.0
    if moved_by < _LEAST_MOTION:
        raise BadInput(
            f"the joint moves by {moved_by:.2g}° in the data to be fitted; expected {_LEAST_MOTION:g}° at least, "
            "better its whole range"
        )
    for given, end in zip(recordings, ends, strict=True):
        if _is_judged(given) and end < given[0].duration_s and _held_runs(given, end):
            return
    raise BadInput("the part that is held out has no second with pressures and angle; expected a longer recording")


def _held_runs(given: Given, end: float) -> list[Run]:
    """The runs of a recording's held-out part that have a measured angle."""
    parts = [part for run in runs_of(*given) if (part := run.part(end, math.inf)) is not None]
    return [part for part in parts if np.isfinite(part.angle).any()]


def _calibration(rig: Rig) -> Corrections:
    return Corrections(**dict(rig.calibration))


def _notes(joint: Fit, air: Fit | None) -> tuple[str, ...]:
    out = []
    late, std = joint.values[DELAY], joint.stds[DELAY]
    if abs(late) > max(5.0 * std, 2e-3):
        words = "late against" if late > 0.0 else "ahead of"
        out.append(f"The angle is {words} the pressures by {abs(late) * 1e3:.1f} ± {std * 1e3:.1f} ms (corrected).")
    for fit in [joint] if air is None else [joint, air]:
        for name in fit.at_bounds:
            value = fit.values[name]
            out.append(f"{name} stands at the end of its range, {value:.4g}: the model lacks something there.")
    return tuple(out)


def fitted_until(recordings: Sequence[Given], holdout: float, whole: int = 0) -> list[float]:
    """For each recording the end of the part that is fitted [s]; 0 where all of it is held out.

    Args:
        recordings: each with its joint's condition and a name.
        holdout: share of the data that is held out.
        whole: number of recordings at the end that are held out as a whole, in place of the share.
    """
    free = [k for k, given in enumerate(recordings) if _is_judged(given)]
    out = [recording.duration_s + 1.0 for recording, _, _ in recordings]
    if whole:
        return [*out[:-whole], *[0.0] * whole]
    if len(free) >= _WHOLE_FROM and all(recordings[k][0].duration_s <= _SHORT for k in free):
        every = max(round(1.0 / holdout), 2)
        for k in free[every - 1 :: every]:
            out[k] = 0.0
    else:
        for k in free:
            out[k] = (1.0 - holdout) * recordings[k][0].duration_s
    return out


def parts_of(recordings: Sequence[Given], ends: Sequence[float], held_out: bool = False) -> list[Run]:
    """Runs of the fitted parts of recordings, or of the held-out ones of a free joint.

    Args:
        recordings: each with its joint's condition and a name.
        ends: of the fitted part of each [s].
        held_out: which of both.
    """
    found = []
    for (recording, state, name), end in zip(recordings, ends, strict=True):
        span = (end, math.inf) if held_out else (0.0, end)
        if span[0] < span[1] and not (held_out and (state.condition == "locked" or end > recording.duration_s)):
            found += [part for run in runs_of(recording, state, name) if (part := run.part(*span)) is not None]
    return found


def _cut(recordings: Sequence[Given], ends: Sequence[float]) -> list[Given]:
    """The fitted parts of the recordings of a free joint with an angle and commands."""
    return [
        (part, state, name)
        for (recording, state, name), end in zip(recordings, ends, strict=True)
        if end > 0.0 and _is_judged((part := recording.slice(0.0, end), state, name))
    ]


def _linear(runs: Sequence[Run]) -> Floats:
    """Coefficients of a linear map from the two pressures [Pa] to the angle [rad] (3,)."""
    free = [run for run in runs if not run.locked]
    pressure, angle = np.concatenate([run.pressure for run in free]), np.concatenate([run.angle for run in free])
    known = np.isfinite(angle)
    found, *_ = np.linalg.lstsq(np.column_stack([pressure, np.ones(len(angle))])[known], angle[known], rcond=None)
    return np.asarray(found)


def _held(given: Given, before: Given, end: float, rig: Rig, start: Rig, line: Floats) -> Held:
    recording, _, name = given
    whole, old = (replay(one, by, "default", "free") for one, by in ((recording, rig), (before[0], start)))
    begin = max(end, 0.0)
    parts = _held_runs(given, begin)
    p = par.changed(rig.parameters(), NO_REGULATORS)
    alone = [joint_stage.simulated(run, p, 0.0, 0.0) - run.angle for run in parts]
    mapped = [np.column_stack([run.pressure, np.ones(len(run))]) @ line - run.angle for run in parts]
    reports = [item.report if begin == 0.0 else after(item, begin).report for item in (whole, old)]
    rows = int(np.isfinite(recording.angle[recording.time_s >= begin]).sum()) if recording.angle is not None else 0
    return Held(name, begin, whole, reports[0], reports[1], _rms_deg(alone), _rms_deg(mapped), rows)


def _rms_deg(errors: Sequence[Floats]) -> float:
    values = np.concatenate([np.zeros(0), *errors])
    known = values[np.isfinite(values)]
    return math.degrees(math.sqrt(float(np.mean(known**2)))) if len(known) else math.nan
