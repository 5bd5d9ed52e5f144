"""How wide the intervals of the proposed rigs are: as wide as the filter's errors ask for.

The uncertainty that a file gives to its values is not that of the values that were fitted in their place. So the width
is found by the errors where the model was fitted. What is said of held-out data is said of these intervals. A model
that was chosen among hundreds by the recordings errs more on the next one. So the files get intervals that hold what no
fit has seen as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from pam_antagonist.diagnosis import held_out
from pam_antagonist.diagnosis.models import in_threads
from pam_antagonist.diagnosis.preparation import START, Settings
from pam_antagonist.diagnosis.result import HeldOutComparison
from pam_antagonist.identification.filter_stage import Given, Unseen, wider, with_unknown_force, with_unknown_torque
from pam_antagonist.identification.parts import is_free
from pam_antagonist.identification.sealed_tuning import EVALUATIONS
from pam_antagonist.identification.sealed_tuning import tuned as tuned_sealed
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.rig import Rig

_COVERED_S = 30.0
"""[s] So much of a recording says how wide the intervals are: each width that is tried takes a run of the filter."""


def tuned(
    common: Mapping[str, Rig], compared: Sequence[HeldOutComparison], names: Sequence[str], settings: Settings
) -> dict[str, Rig]:
    """Rigs whose tuning and uncertainty the estimator uses, by model; each is fitted to what may be fitted.

    In an angle-driven joint most of the innovations come from slow deviations of the muscles, which no fit knows.

    `names`: models that are tuned, the last one in place of others; none: the estimator does not run.
    """
    if not names:
        return {}
    settings.progress("tuning the estimators")
    if compared[0].prepared.angle_driven:
        rigs = _sealed(common, compared[0], names, settings)
    else:
        rigs = {name: _covered(common[name], compared, name, settings) for name in names}
    return {**dict.fromkeys(("recalibrated", "extended"), rigs[names[-1]]), **rigs}


def _sealed(
    common: Mapping[str, Rig], compared: HeldOutComparison, names: Sequence[str], settings: Settings
) -> dict[str, Rig]:
    """The rigs of a sealed joint, tuned side by side."""
    tried, most = itertools.count(1), EVALUATIONS * len(names)

    def report(text: str) -> None:
        settings.progress(f"tuning the estimators, {min(next(tried), most)} of at most {most}")

    def tuning(name: str) -> Rig:
        prepared = compared.of(name).prepared
        named = [(recording, trial.name) for recording, trial in zip(prepared.recordings, prepared.trials, strict=True)]
        return tuned_sealed(common[name], named, 1.0 - settings.holdout, report)[0]

    return dict(zip(names, in_threads(tuning, ((name,) for name in names), settings.jobs), strict=True))


def _covered(rig: Rig, compared: Sequence[HeldOutComparison], model: str, settings: Settings) -> Rig:
    """A rig whose intervals hold 95 % of what was measured in the fitted parts."""
    parts: list[Given] = []
    for part in compared:
        if part.number < part.prepared.fitted:
            until = min((part.experiment.fitted - 0.5) * part.experiment.trial.dt, _COVERED_S)
            parts.append(_given(part, model, 0.0, until))
    free = [given for given in parts if is_free(given)]
    if not free:
        return rig
    moved_by_fit = {
        path
        for part in compared
        for direction in part.of(model).experiment.directions
        for path in (*direction.paths, *direction.adds)
    }
    kept = {path: std for path, std in rig.uncertainty.items() if path not in moved_by_fit}
    report, jobs = settings.progress, settings.jobs
    turned = {name: steps for name, steps in rig.directions.items() if moved_by_fit.isdisjoint(steps)}
    covered = with_unknown_torque(rig.replaced(uncertainty=kept, directions=turned), free, jobs, report).rig
    return with_unknown_force(covered, parts, jobs, report)


def of_files(rigs: Mapping[str, Rig], compared: Sequence[HeldOutComparison], settings: Settings) -> dict[str, Rig]:
    """Rigs of :func:`tuned` with the intervals that the files get, by model."""
    if not rigs or compared[0].prepared.angle_driven:
        return dict(rigs)

    def found(model: str) -> Rig:
        unseen = []
        for part in (part for part in compared if part.judges):
            for span in part.experiment.held_parts:
                begin = max(span.begin_s - START, 0.0)
                unseen.append(Unseen(_given(part, model, begin, span.end_s), span.begin_s - begin))
        return wider(rigs[model], unseen, settings.jobs, settings.progress)

    extended = found("extended")
    same = rigs["extended"] is rigs["recalibrated"]
    return {"recalibrated": extended if same else found("recalibrated"), "extended": extended}


def _given(part: HeldOutComparison, model: str, begin_s: float, end_s: float) -> Given:
    """A part of a recording, corrected by the calibrations of a model, with the joint's condition."""
    recording, _ = held_out.corrected(part, model)
    trial = part.experiment.trial
    return recording.slice(begin_s, end_s), JointCondition(trial.joint, trial.lock_angle, ""), trial.name
