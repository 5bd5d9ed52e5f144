"""From recordings to a verdict: prepare, recalibrate, select, judge, describe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis.agreement import check_same_rig
from pam_antagonist.diagnosis.description import describe
from pam_antagonist.diagnosis.hypotheses import Work
from pam_antagonist.diagnosis.judgement import judge
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import Group, Prepared, Settings, Timings, prepare
from pam_antagonist.diagnosis.result import Diagnosis, Judged
from pam_antagonist.diagnosis.search import hypotheses, search
from pam_antagonist.diagnosis.splits import by_itself_or_in_turn
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig


@one_blas_thread
def diagnose(
    recordings: Sequence[Recording],
    rig: Rig,
    *,
    held_out: Sequence[Recording] = (),
    first: Model | None = None,
    **settings: Any,
) -> Diagnosis:
    """Trace what a model lacks to a physical effect, if possible.

    Args:
        recordings: of one rig; a free and a locked one show most. Of a sealed rig, its joint driven to and fro.
        rig: as configured.
        held_out: whole recordings of the same rig that no fit sees; the others are then fitted to their ends.
        first: the model without a law that was learned since; the law then counts as the first effect, and any
            beside it has to remove enough of what was there before the law.
        settings: fields of :class:`~pam_antagonist.diagnosis.preparation.Settings`.

    Returns:
        The verdict and everything behind it.

    Raises:
        BadInput: recordings from which nothing can be learned.
    """
    how, timings = Settings(**settings), Timings()
    prepared = prepare(recordings, held_out, rig, how)
    return describe(prepared, verdicts(prepared, how, timings, first), how, timings)


def verdicts(prepared: Prepared, settings: Settings, timings: Timings, first: Model | None = None) -> list[Judged]:
    """The verdict on each group, the one with the strongest effect first."""
    judged = []
    for group in prepared.groups:
        settings.progress("recalibrating the base parameters")
        base = by_itself_or_in_turn(group)
        check_same_rig(group.held_out, base)
        timings.end("recalibration")
        ranking = search(base, Work(settings.about(group), settings.store), hypotheses(), first=_of_group(first, group))
        timings.end("selection")
        judged.append(judge(prepared, group, ranking, Work(settings.progress, settings.store)))
        timings.end("judgement")
    return sorted(judged, key=lambda j: -max((effect.delta_bic for effect in j.effects), default=0.0))


def _of_group(model: Model | None, group: Group) -> Model | None:
    """What of a model of all groups belongs to one of them."""
    if model is None:
        return None
    names = {experiment.trial.name for experiment in group.experiments}
    return model.of([k for k, experiment in enumerate(model.experiments) if experiment.trial.name in names])
