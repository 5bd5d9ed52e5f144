"""Which part of the recordings is fitted and which is held out, whether they tell enough, and their corrections."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.identification import joint_stage
from pam_antagonist.identification.filter_stage import Given, shows
from pam_antagonist.identification.joint_stage import DELAY, ZERO, model_values
from pam_antagonist.identification.runs import Run, runs_of
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.trial import check, make_trial
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.rig import Rig

_WHOLE_FROM = 4
"""From so many short recordings on, whole ones are held out: they start from rest, as those to come will."""
_SHORT = 30.0
"""[s] A recording or an episode that is not longer is a trial."""
_LEAST_MOTION = 1.0
"""[deg] A joint that moves less tells nothing of its muscles."""
_SHORTEST_HOLDOUT = 1.0


def is_free(given: Given) -> bool:
    """Whether the joint of a recording moves and its angle was measured."""
    return shows("angle", given)


def has_commands(given: Given) -> bool:
    """Whether a filter can run over a recording."""
    return bool(np.isfinite(given[0].voltage).all(axis=1).any())


def held_runs(given: Given, end: float) -> list[Run]:
    """The runs of a recording's held-out part that have a measured angle."""
    parts = [part for run in runs_of(*given) if (part := run.part(end, math.inf)) is not None]
    return [part for part in parts if np.isfinite(part.angle).any()]


def fitted_until(recordings: Sequence[Given], holdout: float, whole: int = 0) -> list[float]:
    """For each recording the end of the part that is fitted [s]; 0 where all of it is held out.

    `whole`: number of recordings at the end that are held out as a whole, in place of the share.
    """
    free = [k for k, given in enumerate(recordings) if is_free(given) and has_commands(given)]
    out = [recording.duration_s + 1.0 for recording, _, _ in recordings]
    if whole:
        return [*out[:-whole], *[0.0] * whole]
    if len(free) >= _WHOLE_FROM and all(recordings[k][0].duration_s <= _SHORT for k in free):
        every = max(round(1.0 / holdout), 2)
        for k in free[every - 1 :: every]:
            out[k] = 0.0
    else:
        for k, given in enumerate(recordings):
            if has_commands(given):
                out[k] = (1.0 - holdout) * given[0].duration_s
    return out


def parts_of(
    recordings: Sequence[Given], ends: Sequence[float], held_out: bool = False, locked: bool = False
) -> list[Run]:
    """Runs of the fitted parts of recordings, or of the held-out ones of a free joint.

    `ends`: of the fitted part of each [s].
    """
    found = []
    for (recording, state, name), end in zip(recordings, ends, strict=True):
        span = (end, math.inf) if held_out else (0.0, end)
        left_out = (state.condition == "locked" and not locked) or end > recording.duration_s
        if span[0] < span[1] and not (held_out and left_out):
            found += [part for run in runs_of(recording, state, name) if (part := run.part(*span)) is not None]
    return found


def checked(recordings: Sequence[Given], ends: Sequence[float], rig: Rig) -> list[Run]:
    """The runs of the fitted parts. `ends`: of the fitted part of each [s]."""
    guessed = rig.is_from_data_sheets
    if guessed and not any(is_free(given) for given in recordings):
        raise BadInput("no recording has a joint that moves and a measured angle: expected one at least, to fit")
    if not any(has_commands(given) and (not guessed or is_free(given)) for given in recordings):
        raise BadInput(
            "no recording of a free joint has commands: expected the voltages of the valves, or the commanded "
            "pressures of the regulators, in one at least"
        )
    for (recording, state, name), end in zip(recordings, ends, strict=True):
        if not guessed and recording.episode_ns is None and end > 0.0:
            if 0.0 <= recording.duration_s - end < _SHORTEST_HOLDOUT:
                raise BadInput(
                    f"{name}: {recording.duration_s - end:.1f} s would be held out; expected at least "
                    f"{_SHORTEST_HOLDOUT:g} s, to judge the result by"
                )
            check(make_trial(recording, rig, state.condition, state.lock_angle, name).part(0.0, end))
    runs = parts_of(recordings, ends)
    if guessed:
        _check_motion(recordings, runs, ends)
    return runs


def _check_motion(recordings: Sequence[Given], runs: Sequence[Run], ends: Sequence[float]) -> None:
    """Refuse data that hold too little to fit, or to judge a fit."""
    fitted = [run.angle[np.isfinite(run.angle)] for run in runs if not run.locked]
    moved_by = math.degrees(float(np.ptp(np.concatenate([np.zeros(0), *fitted])))) if any(map(len, fitted)) else 0.0
    if moved_by < _LEAST_MOTION:
        raise BadInput(
            f"the joint moves by {moved_by:.2g}° in the data to be fitted; expected {_LEAST_MOTION:g}° at least, "
            "better its whole range"
        )
    for given, end in zip(recordings, ends, strict=True):
        if is_free(given) and has_commands(given) and end < given[0].duration_s and held_runs(given, end):
            return
    raise BadInput("the part that is held out has no second with pressures and angle; expected a longer recording")


def with_joint(rig: Rig, joint: Fit, recordings: Sequence[Given]) -> tuple[Rig, list[Given]]:
    """The rig with the values of its joint, and the recordings with the zero and the delay that were found."""
    found = calibration_of(joint)
    return moved(rig, model_values(joint.unknowns, joint.values)), [
        (found.applied(recording), _read_with(found, recording, state), name) for recording, state, name in recordings
    ]


def _read_with(corrections: Corrections, recording: Recording, state: JointCondition) -> JointCondition:
    """The condition of a joint whose lock angle was read from its encoder, without the encoder's zero."""
    measured = recording.angle is not None and np.isfinite(recording.angle).any()
    return replace(state, lock_angle=state.lock_angle - corrections.encoder_zero) if measured else state


def calibration_of(joint: Fit) -> Corrections:
    """Zero and delay of the encoder that a joint's fit found."""
    return Corrections(encoder_zero=joint.values.get(ZERO, 0.0), delay_angle=joint.values.get(DELAY, 0.0))


def moving_parts(rig: Rig, recordings: Sequence[Given], ends: Sequence[float]) -> list[Run]:
    """Runs of the fitted parts; where the angle of a free joint was not measured, the model gives it.

    `ends`: of the fitted part of each [s].
    """
    p = rig.parameters()
    runs = parts_of(recordings, ends)
    return [run if np.isfinite(run.angle).any() else joint_stage.by_the_model(run, p) for run in runs]


def near_joints(
    rig: Rig, joint: Fit, recordings: Sequence[Given], ends: Sequence[float]
) -> list[tuple[Rig, list[Run]]]:
    """Rig and runs for the joint that was found, changed by each independent error of what the air depends on."""
    names = [item.name for item in joint.unknowns]
    low, high = np.array([item.bounds for item in joint.unknowns]).reshape(-1, 2).T
    seen = [k for k, name in enumerate(names) if name in (ZERO, DELAY) or name.startswith("geometry.")]
    out = []
    for column in np.linalg.cholesky(joint.covariance[np.ix_(seen, seen)]).T if seen else ():
        amounts = joint.amounts.copy()
        amounts[seen] += column
        own, corrected = with_joint(rig, replace(joint, amounts=np.clip(amounts, low, high)), recordings)
        out.append((own, moving_parts(own, corrected, ends)))
    return out
