"""From recordings to experiments: grids, checks, what is held out, and which recordings are explained together.

Each way of driving a joint gives its own experiments. A recording with moving valves is one
:class:`~pam_antagonist.inference.valve_driven.ValveDriven`. A recording of a sealed joint that something moves is two
:class:`~pam_antagonist.inference.angle_driven.AngleDriven`: its air and its balance of torques, which share no
parameter. Experiments in which the same effects can show form a group. Everything after this module is the same for all
groups.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.hypotheses import ResumeFolder
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.stamps import LONGEST_GAP_NS
from pam_antagonist.identification.sealed import (
    SealedTrial,
    balance,
    closed_chambers,
    refuse_moving_valves,
    sealed_trial,
)
from pam_antagonist.inference.angle_driven import AIR, BALANCE, AngleDriven, sweeps
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import moved, shows_stop
from pam_antagonist.inference.trial import ANGLE, TORQUE, Trial, check, make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.model.effects import random_part
from pam_antagonist.recording import Recording, bag_name, seen_in_words
from pam_antagonist.recording.joint import joint_condition, refuse_other_condition
from pam_antagonist.rig import Rig
from pam_antagonist.shown import unlike

START = 5.0
"""[s] Beginning of a held-out recording, to which its first state is fitted; errors count after it."""
WHOLE = "joint"
"""Name of a group that shows all of the joint."""
DRIVEN = "driven"
"""Condition of a joint that something moves: its angle is an input."""
_PARTS = ((AIR, "pressures"), (BALANCE, "torque"))


def silent(_text: str) -> None:
    """Progress that nobody wants to know."""


@dataclass(frozen=True, eq=False)
class Settings:
    """How a diagnosis is made."""

    joint: str = "auto"  # ``free``, ``locked`` or ``auto``: found from the recordings
    lock_angle: float | None = None  # angle of a locked joint [rad], where it is known
    holdout: float = 1.0 / 3.0  # share at the end of each recording that no fit sees
    in_turn: bool = False  # whether every third stretch is held out, and not the end
    catalogue: bool = True  # whether effects of the catalogue are asked; where not, calibrations alone
    laws: bool = False  # whether laws are learned of what the catalogue does not explain
    jobs: int = 2  # threads
    seed: int = 0  # draws the starts of fits
    progress: Callable[[str], None] = silent  # is called with what is being done
    profiles: bool = True  # whether to work out profile likelihoods
    estimator: bool = True  # whether to run the estimator before and after
    store: ResumeFolder = ResumeFolder()  # keeps finished candidates; default: nowhere

    def about(self, group: Group) -> Callable[[str], None]:
        """What is being done to a group, with its name where there are several."""
        prefix = "" if group.name == WHOLE else f"{group.name}: "
        return lambda text: self.progress(prefix + text)


class Timings:
    """A stopwatch; ``seconds`` holds the time of each step over all groups, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._begin = time.perf_counter()

    def end(self, name: str) -> None:
        """The step of that name is over, the next one begins."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._begin
        self._begin = now


@dataclass(frozen=True, eq=False)
class Group:
    """Experiments in which the same effects can show, and which are explained together."""

    name: str  # ``joint``, or the part of it that they show
    experiments: tuple[Experiment, ...]
    numbers: tuple[int, ...]  # which recording each is of, in the order in which they were given
    held_out: tuple[Experiment, ...] = ()


@dataclass(frozen=True, eq=False)
class Prepared:
    """What a diagnosis works on."""

    rig: Rig
    base: Rig
    recordings: tuple[Recording, ...]
    trials: tuple[Trial, ...]
    groups: tuple[Group, ...]
    fitted: int
    notes: tuple[str, ...] = ()

    @property
    def holds_out_recordings(self) -> bool:
        """Whether whole recordings are held out, and not parts of those that are fitted."""
        return len(self.recordings) > self.fitted

    @property
    def friction_removed(self) -> bool:
        """Whether friction of the rig file was taken out of the base model."""
        declared = self.rig.friction.shaft > 0.0 or self.rig.friction.muscle > 0.0
        return self.angle_driven and declared

    @property
    def angle_driven(self) -> bool:
        """Whether the measured angle is the input."""
        return self.trials[0].joint == DRIVEN


def prepare(recordings: Sequence[Recording], held_out: Sequence[Recording], rig: Rig, settings: Settings) -> Prepared:
    """Prepare recordings for a diagnosis.

    `held_out`: that are held out as a whole; none to hold out the end of each.
    """
    if not recordings:
        raise BadInput("no recording: expected one at least")
    least = thresholds.SHORTEST_DRIVEN if rig.valves.sealed else thresholds.SHORTEST
    pieces = [longest_piece(recording, least) for recording in (*recordings, *held_out)]
    seen = (
        f"{bag_name(one.path)}: {text}"
        for one in (*recordings, *held_out)
        if (text := seen_in_words(one, rig.fitted, rig.name))
    )
    notes = (*(note for _, note in pieces if note), *seen)
    whole = [recording for recording, _ in pieces]
    recordings, held_out = whole[: len(recordings)], whole[len(recordings) :]
    low, high = thresholds.HOLDOUT
    if not low <= settings.holdout <= high:
        raise BadInput(f"holdout {settings.holdout:g}: expected a share of each recording from {low:g} to {high:g}")
    if not rig.valves.sealed:
        return replace(_valve_driven(recordings, held_out, rig, settings), notes=notes)
    if held_out:
        raise BadInput(f"rig {rig.name} is sealed: expected a share to be held out, not whole recordings")
    return replace(_angle_driven(recordings, rig, settings), notes=notes)


def longest_piece(recording: Recording, least: float) -> tuple[Recording, str]:
    """The longest piece without a hole: what was commanded in a hole is not known, and the model errs after it.

    `least`: length of a piece [s].
    """
    known = np.flatnonzero(np.isfinite(recording.voltage).all(axis=1))
    time = recording.time_s[known]
    holes = np.flatnonzero(np.diff(time) > LONGEST_GAP_NS * 1e-9)
    if not len(holes):
        return recording, ""
    begin, end = time[np.append(0, holes + 1)], time[np.append(holes, len(time) - 1)]
    best, name = int(np.argmax(end - begin)), bag_name(recording.path)
    first, last = float(begin[best]), float(end[best])
    count = f"{len(holes)} holes" if len(holes) > 1 else "a hole"
    where = f"{name}: has {count}, the first from {time[holes[0]]:.1f} to {time[holes[0] + 1]:.1f} s"
    if last - first < least:
        raise BadInput(
            f"{where}; the longest piece without one has {last - first:.1f} s, expected at least {least:g} s"
        )
    return recording.slice(first, last + 0.5 * recording.sample_period_s), (
        f"{where}, so only the piece from {first:.1f} to {last:.1f} s is used; times below count from its start"
    )


def cut(trial: Trial, holdout: float) -> int:
    """Sample from which on nothing is fitted: a whole number of blocks, to a tenth of a second."""
    tenth = max(1, round(0.1 / trial.block_s)) * trial.block
    return round(len(trial) * (1.0 - holdout) / tenth) * tenth


def _valve_driven(
    recordings: Sequence[Recording], held_out: Sequence[Recording], rig: Rig, settings: Settings
) -> Prepared:
    def trial_of(recording: Recording) -> Trial:
        lock = settings.lock_angle if settings.joint == "locked" else None
        state = joint_condition(recording, settings.joint, lock, rig.joint.stop)
        name = bag_name(recording.path)
        if state.source != "stop":
            refuse_other_condition(recording, state.condition, name)
        return make_trial(recording, rig, state.condition, state.lock_angle, name)

    trials = [trial_of(recording) for recording in recordings]
    others = [trial_of(recording) for recording in held_out]
    for trial in (*trials, *others):
        check(trial, rig.drive)
        _check_duration(trial, thresholds.SHORTEST, "with both valves moving all the time")
    check_distinct(recordings, held_out, [trial.name for trial in others])
    experiments, held = valve_driven_experiments(trials, others, rig, settings.holdout, settings.seed, settings.jobs)
    group = Group(WHOLE, experiments, tuple(range(len(trials))), held)
    return Prepared(rig, rig, (*recordings, *held_out), (*trials, *others), (group,), len(trials))


def _check_duration(trial: Trial, least: float, what: str) -> None:
    duration = len(trial) * trial.dt
    if duration < least:
        raise BadInput(
            f"{trial.name}: {unlike(duration, least, 1)} s is too short to distinguish an effect from chance; "
            f"expected at least {least:g} s {what}"
        )


def check_distinct(recordings: Sequence[Recording], others: Sequence[Recording], names: Sequence[str]) -> None:
    """Refuse held-out recordings that are also fitted, or given twice."""
    for k, (other, name) in enumerate(zip(others, names, strict=True)):
        for seen in (*recordings, *others[:k]):
            if np.array_equal(other.stamp_ns, seen.stamp_ns) and np.array_equal(
                other.pressure, seen.pressure, equal_nan=True
            ):
                what = "given twice" if any(seen is one for one in others) else "also among those that are fitted"
                raise BadInput(f"{name}: held out, but {what}; expected a recording that no fit uses")


def valve_driven_experiments(
    trials: Sequence[Trial], others: Sequence[Trial], rig: Rig, share: float, seed: int, jobs: int = 1
) -> tuple[tuple[ValveDriven, ...], tuple[ValveDriven, ...]]:
    """Recordings that are fitted, and those that are held out as a whole.

    A fitted recording is judged by those that are held out with the joint in the same condition. Where no condition is
    in common, each is judged by all.

    `share`: of each recording that is held out where no whole one is.
    """
    free = (trial for trial in trials if trial.joint == "free" and trial.has(ANGLE))
    at_stop = any(shows_stop(rig, trial.measured[:, ANGLE]) for trial in free)
    experiment = partial(ValveDriven, rig, seed=seed, jobs=jobs, at_stop=at_stop)
    if not others:
        return tuple(experiment(trial, cut(trial, share)) for trial in trials), ()
    held = tuple(experiment(trial, round(START / trial.block_s) * trial.block) for trial in others)
    common = {trial.joint for trial in trials} & {trial.joint for trial in others}
    return tuple(
        experiment(
            trial, trial.whole_blocks(len(trial)),
            tuple(other for other in held if not common or other.trial.joint == trial.joint),
        )
        for trial in trials
    ), held  # fmt: skip


def _angle_driven(recordings: Sequence[Recording], rig: Rig, settings: Settings) -> Prepared:
    trials = [driven_trial(recording, rig, settings.joint, settings.holdout) for recording in recordings]
    named = [(recording, trial.name) for recording, trial in zip(recordings, trials, strict=True)]
    base = base_without_friction(named, rig, settings.holdout, settings.progress)
    groups = []
    for part, name in _PARTS:
        numbers = tuple(k for k, trial in enumerate(trials) if part == AIR or trial.has(TORQUE))
        experiments = tuple(
            AngleDriven(
                base, replace(trials[k], name=f"{trials[k].name}, {name}"), cut(trials[k], settings.holdout),
                seed=settings.seed, jobs=settings.jobs, part=part,
            )
            for k in numbers
        )  # fmt: skip
        if experiments:
            groups.append(Group(name, experiments, numbers))
    return Prepared(rig, base, tuple(recordings), tuple(trials), tuple(groups), len(trials))


def driven_trial(recording: Recording, rig: Rig, joint: str, holdout: float) -> Trial:
    """A recording of a sealed joint on an even grid, the torque from outside in the place of a torque meter's."""
    name = bag_name(recording.path)
    refuse_moving_valves([(recording, name)], rig)
    state = joint_condition(recording, joint)
    if state.condition != "free":
        raise BadInput(f"{name}: the joint is {state.condition}; expected a sealed joint that is moved from outside")
    trial = make_trial(recording, rig, "free", 0.0, name)
    _check_duration(trial, thresholds.SHORTEST_DRIVEN, "of a joint that is driven to and fro")
    sealed_trial(recording, name, 1.0 - holdout)
    measured = trial.measured.copy()
    known = trial.external is not None and np.isfinite(trial.external).any()
    measured[:, TORQUE] = trial.external if known else np.nan
    ready = replace(trial, measured=measured, joint=DRIVEN)
    fitted, held = sweeps(ready, 0, round(len(trial) * (1.0 - holdout))), sweeps(ready, cut(ready, holdout), len(trial))
    for what, count in (("that is fitted", fitted), ("that is held out", held)):
        if count < 1:
            raise BadInput(
                f"{name}: the joint nowhere slides in the part {what}; expected a joint that is driven to and fro"
            )
    return ready


def base_without_friction(
    recordings: Sequence[tuple[Recording, str]], rig: Rig, holdout: float, progress: Callable[[str], None]
) -> Rig:
    """A sealed rig with the base parameters that ``identify`` finds in what may be fitted, without Coulomb friction.

    ``identify`` explains the loop of the torque by friction of the shaft. But friction of the drive, dry friction of
    the muscles and hysteresis all cause such a loop. A base model with friction would choose between them before
    anything is tested. So Coulomb friction is removed, and the cause of the loop is found by the tests.
    """
    if rig.model.friction != "kikuuwe":
        raise BadInput(
            f"model.friction of rig {rig.name} is {rig.model.friction}; expected kikuuwe, since the rig is sealed"
        )
    trials: list[SealedTrial] = [sealed_trial(recording, name, 1.0 - holdout) for recording, name in recordings]
    # Effects that noise drives and learned laws stay. Other effects that a sealed rig declares have to be found.
    kept = random_part(rig.effects) | {name: own for name, own in rig.effects.items() if name == "learned"}
    # Free viscous friction would imitate the Coulomb friction that is removed.
    without = {"friction.shaft": 0.0, "friction.muscle": 0.0, "joint.viscous_friction": 0.0}
    # A parameter that is removed is not uncertain either.
    uncertain = {name: std for name, std in rig.uncertainty.items() if name not in without}
    now = moved(rig.replaced(effects=kept, uncertainty=uncertain), without)
    progress("recalibrating: closed chambers")
    for muscle in (0, 1):
        now = moved(now, closed_chambers(trials, now, muscle).values)
    if any(trial.external is not None for trial in trials):
        progress("recalibrating: balance of torques")
        now = moved(now, balance(trials, now).values)
    viscous = {name: rig.uncertainty[name] for name in ("joint.viscous_friction",) if name in rig.uncertainty}
    now = now.replaced(uncertainty={**now.uncertainty, **viscous})
    return moved(now, {"joint.viscous_friction": rig.joint.viscous_friction})
