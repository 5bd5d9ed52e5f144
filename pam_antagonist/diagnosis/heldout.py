"""What no fit sees: the end of each recording, or whole recordings; and the errors there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import errors, residuals, rigs
from pam_antagonist.diagnosis.select import Model
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.trial import BLOCK, Trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

START = 5.0
"""[s] At the beginning of a recording that is held out, from which its first state is told; its errors count later."""
MODELS = ("as_configured", "recalibrated", "extended")


@dataclass(frozen=True, eq=False)
class Compared:
    """A recording beside the three models.

    Attributes:
        experiment: the recording; what is behind its `fitted` samples was held out.
        points: of the three models on it, by name.
        role: ``fitted`` to its end, ``held out`` as a whole, or ``both``: its end was held out.
    """

    experiment: Experiment
    points: Mapping[str, Point]
    role: str

    @property
    def judges(self) -> bool:
        """Whether anything of it was held out."""
        return self.role != "fitted"


def experiments_of(
    trials: Sequence[Trial], others: Sequence[Trial], rig: Rig, share: float, seed: int, jobs: int = 1
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Recordings that are fitted, and those that are held out as a whole.

    A fitted recording foretells those that are held out with the joint in the same condition. Where there are none of
    either condition in common, all foretell all.

    Args:
        trials: to be fitted.
        others: to be held out; none to hold out the end of each.
        rig: as configured.
        share: of each recording that is held out where no whole one is.
        seed: of what is drawn in fits.
        jobs: threads.
    """
    if not others:
        cut = [round(len(trial) * (1.0 - share) / 100.0) * 100 for trial in trials]
        return tuple(
            ValveDriven(rig, trial, end, seed=seed, jobs=jobs) for trial, end in zip(trials, cut, strict=True)
        ), ()
    held = tuple(
        ValveDriven(rig, trial, round(START / trial.dt / BLOCK) * BLOCK, seed=seed, jobs=jobs) for trial in others
    )
    common = {trial.joint for trial in trials} & {trial.joint for trial in others}
    return tuple(
        ValveDriven(
            rig, trial, len(trial) // BLOCK * BLOCK,
            tuple(other for other in held if not common or other.trial.joint == trial.joint), seed, jobs,
        )
        for trial in trials
    ), held  # fmt: skip


def check_distinct(recordings: Sequence[Recording], others: Sequence[Recording], names: Sequence[str]) -> None:
    """Refuse to judge a fit by what was fitted.

    Raises:
        BadInput: a recording that is held out is among the fitted ones, or is given twice.
    """
    for k, (other, name) in enumerate(zip(others, names, strict=True)):
        for seen in (*recordings, *others[:k]):
            if np.array_equal(other.stamp_ns, seen.stamp_ns) and np.array_equal(
                other.pressure, seen.pressure, equal_nan=True
            ):
                what = "given twice" if any(seen is one for one in others) else "also among those that are fitted"
                raise BadInput(f"{name}: held out, and {what}; expected a recording that no fit sees")


def check_same_rig(experiments: Sequence[Experiment], base: Model, held: Sequence[Experiment], jobs: int) -> None:
    """Refuse a held-out recording whose own base parameters are far from those of the fitted ones.

    The fit by which this is told serves nothing else.

    Raises:
        BadInput: one that seems to be of another rig.
    """

    def own(other: Experiment) -> Fitted:
        whole = ValveDriven(other.rig, other.trial, len(other.trial) // BLOCK * BLOCK, jobs=jobs)
        return refit(whole, whole.origin)

    fits = Parallel(n_jobs=jobs, prefer="threads")(delayed(own)(other) for other in held)
    for other, theirs in zip(held, fits, strict=True):
        for experiment, fitted in zip(experiments, base.fits, strict=True):
            alike = experiment.trial.joint == other.trial.joint
            apart = rigs.farthest_apart(experiment, theirs, fitted) if alike else None
            if apart is not None:
                raise BadInput(
                    f"{other.trial.name}: held out, but {apart[0]} is {100 * apart[1]:+.0f} % from that of "
                    f"{experiment.trial.name}: it seems to be of another rig; expected a recording of the same one"
                )


def compared(
    experiments: Sequence[Experiment],
    held: Sequence[Experiment],
    base: Model,
    model: Model,
    effects: Mapping[str, float],
) -> tuple[Compared, ...]:
    """Every recording with the three models, those that were held out behind the others.

    A held-out recording has the parameters that suit the fitted ones together; its start alone is told from itself.

    Args:
        experiments: the fitted ones.
        held: those that were held out.
        base: the recalibrated model.
        model: the extended one.
        effects: values of its effects that suit all recordings, by dotted path.
    """
    out = [
        Compared(
            experiment,
            dict(zip(MODELS, (experiment.origin, old.point, new.point), strict=True)),
            "fitted" if held else "both",
        )
        for experiment, old, new in zip(experiments, base.fits, model.fits, strict=True)
    ]
    if held:
        old, new = (rigs.common_point(experiments, m, values) for m, values in ((base, {}), (model, effects)))
        for other in held:
            points = (other.origin, other.started(old), other.started(new))
            out.append(Compared(other, dict(zip(MODELS, points, strict=True)), "held out"))
    return tuple(out)


def by_recording(
    recordings: Sequence[Recording], parts: Sequence[Compared], estimator: bool, jobs: int
) -> tuple[Mapping[str, Any], ...]:
    """Errors and residuals of the three models on what was held out of each recording, model alone and estimator.

    Args:
        recordings: as read, in the order of `parts`.
        parts: the same with their models.
        estimator: whether to run the estimator as well.
        jobs: threads.
    """

    def one(recording: Recording, part: Compared) -> dict[str, Any]:
        trial = part.experiment.trial
        entry: dict[str, Any] = {
            "recording": trial.name,
            "joint": trial.joint,
            "lock_angle_rad": trial.lock_angle if trial.joint == "locked" else None,
            "role": part.role,
            "held_out_from_s": part.experiment.fitted * trial.dt if part.judges else None,
            "errors": None,
        }
        if not part.judges:
            return entry
        entry["errors"] = {name: errors.held_out(part.experiment, point) for name, point in part.points.items()}
        entry["residuals"] = {
            name: residuals.statistics(part.experiment, part.points[name]) for name in ("recalibrated", "extended")
        }
        if estimator:
            entry["ukf"] = {}
            for name, point in part.points.items():
                run = errors.of_estimator(recording, rigs.own_rig(part.experiment, point), part.experiment)
                entry["ukf"][name] = run.figures
                if name in entry["residuals"]:
                    entry["residuals"][name] += residuals.of_innovations(part.experiment, point, run)
        return entry

    return tuple(
        Parallel(n_jobs=jobs, prefer="threads")(delayed(one)(*pair) for pair in zip(recordings, parts, strict=True))
    )
