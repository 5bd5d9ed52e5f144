"""From recordings to a verdict: recalibrate, test, select, judge."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Literal

from pam_antagonist.diagnosis import (
    agreement,
    errors,
    findings,
    heldout,
    innovations,
    outside,
    quality,
    rigs,
    rules,
    visible,
)
from pam_antagonist.diagnosis.advice import experiments_that_tell
from pam_antagonist.diagnosis.profiles import profile_sizes
from pam_antagonist.diagnosis.remaining import describe
from pam_antagonist.diagnosis.result import Diagnosis, Ranked
from pam_antagonist.diagnosis.sealed import diagnose_sealed
from pam_antagonist.diagnosis.select import STRONG, Selection, recalibrated, select
from pam_antagonist.diagnosis.sentence import sentence
from pam_antagonist.diagnosis.shares import held_share, left_by
from pam_antagonist.diagnosis.store import Store
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.trial import Trial, make_trial
from pam_antagonist.recording import Recording, bag_name
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.rig import Rig

Verdict = Literal["effect", "none", "unexplained"]


def diagnose(
    recordings: Sequence[Recording],
    rig: Rig,
    *,
    joint: str = "auto",
    lock_angle: float | None = None,
    holdout: float = 1.0 / 3.0,
    held_out: Sequence[Recording] = (),
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
        held_out: whole recordings of the same rig that no fit sees; the others are then fitted to their ends.
        jobs: threads.
        seed: draws the starts of fits.
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
    if rig.valves.sealed:
        if held_out:
            raise BadInput(f"rig {rig.name} is sealed: expected a share to be held out, not whole recordings")
        return diagnose_sealed(
            recordings, rig, joint=joint, holdout=holdout, jobs=jobs, seed=seed, progress=progress, profiles=profiles,
            estimator=estimator, store=store,
        )  # fmt: skip
    said = progress or (lambda message: None)
    clock, seconds = time.perf_counter(), {}

    def lap(name: str) -> None:
        nonlocal clock
        now = time.perf_counter()
        seconds[name] = now - clock
        clock = now

    trials = [_trial(recording, rig, joint, lock_angle) for recording in recordings]
    others = [_trial(recording, rig, joint, lock_angle) for recording in held_out]
    quality.check_trials([*trials, *others], holdout)
    heldout.check_distinct(recordings, held_out, [trial.name for trial in others])
    experiments, held = heldout.experiments_of(trials, others, rig, holdout, seed, jobs)
    said("recalibrating the base parameters")
    base = recalibrated(experiments, jobs)
    heldout.check_same_rig(experiments, base, held, jobs)
    lap("recalibration")
    selection = select(experiments, base, jobs, rules.worth, said, store or Store())
    lap("selection")
    verdict, share = _judge(experiments, selection)
    pushed = None
    if verdict != "none":
        said("looking for pushes from outside")
    if verdict == "effect":
        pushed = outside.beside(experiments, selection.model, jobs)
    if verdict == "unexplained":
        pushed = outside.explain(experiments, base, selection.model, jobs, said)
        share = share if pushed is None else pushed.share
    lap("pushes")
    alone = verdict == "effect" and pushed is None
    if alone:
        said("what each effect is needed for")
    model = findings.without_idle(experiments, base, selection.model, jobs) if alone else base
    found, values, warnings = findings.found(experiments, base, model, jobs)
    if model.effects and innovations.decide([*experiments, *held]):
        said("innovations before and after")
        compared = heldout.compared(experiments, held, base, model, values)
        gained = innovations.evidence([*recordings, *held_out], compared, jobs)
        if gained < STRONG:
            verdict, share, model, found, values = "unexplained", 0.0, base, (), {}
        warnings += [quality.decided(selection.model.effects, gained, gained >= STRONG)]
    lap("backward step")
    warnings += quality.implausible(experiments, base) + agreement.of_base(experiments, base)
    warnings += agreement.of_effects(experiments, model, found, values, jobs)
    if pushed is not None:
        verdict, model, found = "effect", pushed.model, pushed.effects
        values = dict(pushed.values)
        warnings += pushed.warnings
    elif verdict == "effect" and rules.explains_in_part(experiments, base, model):
        warnings.insert(0, quality.in_part([effect.name for effect in found]))
    profiled = () if not profiles else profile_sizes(experiments, model, found, jobs, said)
    flat = [item["parameter"] for item in profiled if item["flat"]]
    if flat:
        warnings.append(f"the likelihood of {', '.join(flat)} is flat: not determined by these recordings")
    lap("profiles")
    ambiguous = _ambiguous(selection) if verdict == "effect" and selection.model.effects else ()
    said("errors before and after")
    compared = heldout.compared(experiments, held, base, model, values)
    parts = heldout.by_recording([*recordings, *held_out], compared, estimator, jobs)
    warnings += quality.estimator_worse(parts)
    judging = [(part, c.experiment) for part, c in zip(parts, compared, strict=True) if c.judges]
    samples = [len(e.trial) - e.fitted for _, e in judging]
    totals = {name: errors.together([part["errors"][name] for part, _ in judging], samples) for name in heldout.MODELS}
    lap("errors")
    remaining = tuple(describe(experiments, model)) if verdict != "none" else ()
    lap("remaining residual")
    unseen = quality.unseen(trials, visible.invisible(experiments, base, jobs))
    taken = set(model.effects)
    ranking = tuple(
        Ranked(
            trial.effect, trial.round, trial.score, trial.delta_bic,
            None if trial.shares is None else trial.shares[0],
            trial.model is not None and trial.effect in taken and trial.model.effects == model.effects[: trial.round],
            trial.muscles,
        )
        for trial in selection.trials
    )  # fmt: skip
    return Diagnosis(
        verdict=verdict,
        sentence=sentence(verdict, found, share, totals, ranking, len(experiments)),
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
        compared=compared,
        seconds=seconds,
    )


def _trial(recording: Recording, rig: Rig, joint: str, lock_angle: float | None) -> Trial:
    told = joint_condition(recording, joint, lock_angle if joint == "locked" else None)
    return make_trial(recording, rig, told.condition, told.lock_angle, bag_name(recording.path))


def _judge(experiments: Sequence[Experiment], selection: Selection) -> tuple[Verdict, float]:
    """The verdict, and the share of the held-out excess that is explained."""
    base, model = selection.recalibrated, selection.model
    share = held_share(experiments, *(left_by(experiments, m.fits) for m in (base, model))) if model.effects else 0.0
    if rules.explains(experiments, base, model):
        return "effect", share
    return ("unexplained" if rules.has_significant_excess(experiments, base.fits) else "none"), share


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
