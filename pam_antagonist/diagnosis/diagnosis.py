"""From recordings to a verdict: recalibrate, test, select, judge."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from pam_antagonist.diagnosis import errors, findings, outside, quality, rigs, rules
from pam_antagonist.diagnosis.advice import experiments_that_tell
from pam_antagonist.diagnosis.experiment import Experiment
from pam_antagonist.diagnosis.profiles import profile_sizes
from pam_antagonist.diagnosis.remaining import describe
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect, Ranked
from pam_antagonist.diagnosis.select import (
    STRONG,
    Model,
    Selection,
    excess_squares,
    recalibrated,
    refitted_without,
    removed,
    select,
)
from pam_antagonist.diagnosis.sentence import sentence
from pam_antagonist.diagnosis.store import Store
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.trial import Trial, make_trial
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.report.software import bag_name
from pam_antagonist.rig import Rig

Verdict = Literal["effect", "none", "unexplained"]


def diagnose(
    recordings: Sequence[Recording],
    rig: Rig,
    *,
    joint: str = "auto",
    lock_angle: float | None = None,
    holdout: float = 1.0 / 3.0,
    jobs: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    profiles: bool = True,
    estimator: bool = True,
    store: Store | None = None,
) -> Diagnosis:
    """Trace what a model lacks to a physical effect, if it can be.

    Args:
        recordings: of one rig; a free and a locked one tell most.
        rig: as configured.
        joint: ``free``, ``locked`` or ``auto`` (told from the recordings).
        lock_angle: angle of a locked joint [rad], where it is known.
        holdout: share at the end of each recording that no fit sees.
        jobs: threads.
        seed: kept in the report; the search itself draws nothing.
        progress: told what is being done.
        profiles: whether to work out profile likelihoods.
        estimator: whether to run the estimator before and after.
        store: keeps finished candidates; default: nowhere.

    Returns:
        The verdict and everything behind it.

    Raises:
        BadInput: recordings from which nothing can be told.
    """
    if not recordings:
        raise BadInput("no recording: expected one at least")
    said = progress or (lambda message: None)
    clock, seconds = time.perf_counter(), {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[name] = now - clock
        clock = now

    trials = [_trial(recording, rig, joint, lock_angle) for recording in recordings]
    quality.check_trials(trials, holdout)
    experiments = tuple(Experiment(rig, trial, round(len(trial) * (1.0 - holdout) / 100.0) * 100) for trial in trials)
    said("recalibrating the base parameters")
    base = recalibrated(experiments, jobs)
    lap("recalibration")
    selection = select(experiments, base, jobs, rules.worth, said, store or Store())
    lap("selection")
    verdict, share = _judge(experiments, selection)
    model = _pruned(experiments, selection, jobs) if verdict == "effect" else base
    found, values, warnings = _found(experiments, base, model, jobs)
    lap("backward step")
    warnings += quality.implausible(experiments, base)
    if verdict == "unexplained":
        said("looking for pushes from outside")
        pushed = outside.explain(experiments, base, jobs)
        if pushed is not None:
            verdict, model, found, share = "effect", pushed.model, (pushed.effect,), pushed.share
            values = dict(pushed.values)
            warnings.append(outside.NOTE)
        lap("pushes")
    profiled = () if not profiles else profile_sizes(experiments, model, found, jobs, said)
    flat = [item["parameter"] for item in profiled if item["flat"]]
    if flat:
        warnings.append(f"the likelihood of {', '.join(flat)} is flat: not determined by these recordings")
    lap("profiles")
    ambiguous = _ambiguous(selection) if verdict == "effect" and selection.model.effects else ()
    said("errors before and after")
    parts = _by_recording(recordings, experiments, base, model, estimator)
    samples = [len(e.trial) - e.fitted for e in experiments]
    totals = {
        name: errors.together([part["errors"][name] for part in parts], samples)
        for name in ("as_configured", "recalibrated", "extended")
    }
    lap("errors")
    remaining = tuple(describe(experiments, model)) if verdict != "none" else ()
    lap("remaining residual")
    unseen = quality.unseen(trials)
    taken = set(model.effects)
    ranking = tuple(
        Ranked(
            trial.effect, trial.round, trial.score, trial.delta_bic,
            None if trial.shares is None else trial.shares[0],
            trial.model is not None and trial.effect in taken and trial.model.effects == model.effects[: trial.round],
        )
        for trial in selection.trials
    )  # fmt: skip
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(verdict, found, share, totals, ranking),
        effects=found,
        ambiguous_with=ambiguous,
        experiment=experiments_that_tell(model.effects, ambiguous, {trial.joint for trial in trials}),
        ranking=ranking,
        share=share,
        errors=totals,
        by_recording=parts,
        remaining=remaining,
        unseen=unseen,
        warnings=tuple(warnings),
        profiles=profiled,
        rig_recalibrated=rigs.common_rig(experiments, base, {}),
        rig_extended=rigs.common_rig(experiments, model, values),
        own=tuple((e.trial.name, rigs.own_rig(e, f.point)) for e, f in zip(experiments, model.fits, strict=True)),
        experiments=experiments,
        recalibrated=base,
        extended=model,
        trials=selection.trials,
        held_from=tuple(e.fitted * e.trial.dt for e in experiments),
        seconds=seconds,
    )


def _trial(recording: Recording, rig: Rig, joint: str, lock_angle: float | None) -> Trial:
    told = joint_condition(recording, joint, lock_angle if joint == "locked" else None)
    return make_trial(recording, rig, told.condition, told.lock_angle, bag_name(recording.path))


def _judge(experiments: Sequence[Experiment], selection: Selection) -> tuple[Verdict, float]:
    """The verdict, and the share of the held-out excess that is explained."""
    base, model = selection.recalibrated, selection.model
    share = removed(*(excess_squares(experiments, m, held=True) for m in (base, model)))
    if not model.effects:
        return ("unexplained" if rules.could_pay(experiments, base.fits) else "none"), 0.0
    if share >= rules.EXPLAINED[len(model.effects) - 1] or rules.at_noise(experiments, model):
        return "effect", share
    return ("unexplained" if rules.could_pay(experiments, base.fits) else "none"), share


def _pruned(experiments: Sequence[Experiment], selection: Selection, jobs: int) -> Model:
    """The chosen model without effects and sizes that do not pay beside the others: the backward step."""
    base, model = selection.recalibrated, selection.model
    for effect in model.effects[:-1]:
        without = refitted_without(experiments, model, effect, jobs)
        if findings.evidence_of(experiments, without, model) < STRONG:
            model = without
    fits = []
    for experiment, before, fitted in zip(experiments, base.fits, model.fits, strict=True):
        smaller = fitted
        for effect in model.effects:
            smaller = findings.pruned(experiment, before, smaller, effect)
        fits.append(smaller)
    return Model(model.effects, tuple(fits))


def _found(
    experiments: Sequence[Experiment], base: Model, model: Model, jobs: int
) -> tuple[tuple[FoundEffect, ...], dict[str, float], list[str]]:
    gains, shares = {}, {}
    whole = excess_squares(experiments, model, held=True)
    before = excess_squares(experiments, base, held=True)
    for effect in model.effects:
        without = base if len(model.effects) == 1 else refitted_without(experiments, model, effect, jobs)
        gains[effect] = findings.evidence_of(experiments, without, model)
        lost = excess_squares(experiments, without, held=True)
        shares[effect] = float(np.sum(lost - whole) / max(np.sum(before), 1e-12)) if len(model.effects) > 1 else (
            removed(lost, whole)
        )  # fmt: skip
    return findings.found_effects(experiments, model, gains, shares)


def _ambiguous(selection: Selection) -> tuple[str, ...]:
    """Candidates of the first round that do as well as the chosen one, by evidence and on held-out data."""
    first = [t for t in selection.trials if t.round == 1 and t.shares is not None]
    best = next((t for t in first if t.effect == selection.model.effects[0]), None)
    if best is None:
        return ()
    return tuple(
        t.effect for t in first if t is not best and t.shares is not None
        and best.standing - t.standing < STRONG and t.shares[0] >= rules.FIRST_SHARE
    )  # fmt: skip


def _by_recording(
    recordings: Sequence[Recording],
    experiments: Sequence[Experiment],
    base: Model,
    model: Model,
    estimator: bool,
) -> tuple[Mapping[str, Any], ...]:
    """Errors of the three models on each recording's held-out part, model alone and estimator."""
    parts = []
    for recording, experiment, old, new in zip(recordings, experiments, base.fits, model.fits, strict=True):
        trial = experiment.trial
        points = {"as_configured": experiment.origin, "recalibrated": old.point, "extended": new.point}
        entry: dict[str, Any] = {
            "recording": trial.name,
            "joint": trial.joint,
            "lock_angle_rad": trial.lock_angle if trial.joint == "locked" else None,
            "held_out_from_s": experiment.fitted * trial.dt,
            "errors": {name: errors.held_out(experiment, point) for name, point in points.items()},
        }
        if estimator:
            entry["ukf"] = {}
            for name, point in points.items():
                own = rigs.own_rig(experiment, point)
                entry["ukf"][name] = errors.of_estimator(recording, own, experiment)
        parts.append(entry)
    return tuple(parts)
