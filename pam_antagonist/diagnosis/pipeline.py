"""From recordings to a diagnosis: prepare, recalibrate, select, judge, learn laws, and describe it all once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis.description import describe
from pam_antagonist.diagnosis.hypotheses import Work
from pam_antagonist.diagnosis.judged import Judged, JudgedJoint
from pam_antagonist.diagnosis.judgement import judge
from pam_antagonist.diagnosis.learned_law import Verdicts, with_laws
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import Prepared, Settings, Timings, prepare
from pam_antagonist.diagnosis.result import Diagnosis
from pam_antagonist.diagnosis.search import CALIBRATIONS, hypotheses, search
from pam_antagonist.diagnosis.splits import by_itself_or_in_turn, parted
from pam_antagonist.diagnosis.verdicts import EFFECT, UNEXPLAINED
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

_ONLY_AT_THE_END = "only the end of the recordings shows what the model lacks"
_NOT_TO_THE_END = "no law that was learned from their begin holds to the end of the recordings"
IN_TURN = "so every third stretch of about 5 s was held out, and the errors are those in these stretches"


@one_blas_thread
def diagnose(
    recordings: Sequence[Recording], rig: Rig, *, held_out: Sequence[Recording] = (), **settings: Any
) -> Diagnosis:
    """Trace what a model lacks to a physical effect, if possible.

    Args:
        recordings: of one rig; a free and a locked one show most. Of a sealed rig, its joint driven to and fro.
        rig: as configured.
        held_out: whole recordings of the same rig that no fit sees; the others are then fitted to their ends.
        settings: fields of :class:`~pam_antagonist.diagnosis.preparation.Settings`.

    Returns:
        The verdict and everything behind it.

    Raises:
        BadInput: recordings from which nothing can be learned.
    """
    how, timings = Settings(**settings), Timings()
    given, verdict = (recordings, held_out, rig), partial(_verdict, timings, how)
    if not how.laws:
        return describe(verdict(*given), how, timings)
    found = with_laws(verdict, *given, how.progress, verdict(*given))
    if found.verdict == UNEXPLAINED and not held_out and all(one.runs_by_itself for one in found.model.experiments):
        found = _in_turn(found, partial(_verdict, timings), recordings, rig, how)
    timings.end("laws")
    return describe(found, how, timings)


def _in_turn(
    found: JudgedJoint, verdict: Verdicts, recordings: Sequence[Recording], rig: Rig, settings: Settings
) -> JudgedJoint:
    """A joint with stretches held out in turn, where laws hold there; as it is, where none does.

    What begins to act at the end of a recording leaves nothing where a model is fitted, so nothing is looked for. What
    changes from the begin to the end, as rubber that gets warm, has no law that holds at the end. There,
    effects of the catalogue were asked, and are not asked again.
    """
    settings.progress("stretches are held out in turn, in place of the end")
    at_the_end, turns = not found.base.has_significant_excess, replace(settings, in_turn=True)
    begin = verdict(replace(turns, catalogue=at_the_end), recordings, (), rig)
    if not at_the_end:
        begin = replace(begin, ranking=found.ranking)
    again = with_laws(partial(verdict, turns), recordings, (), rig, settings.progress, begin)
    if again.verdict != EFFECT or not (at_the_end or again.laws):
        return found
    return replace(again, notes=(f"{_ONLY_AT_THE_END if at_the_end else _NOT_TO_THE_END}, {IN_TURN}", *again.notes))


def _verdict(
    timings: Timings, settings: Settings, recordings: Sequence[Recording], held_out: Sequence[Recording], rig: Rig,
    first: Model | None = None,
) -> JudgedJoint:  # fmt: skip
    """The verdict on a joint.

    `first`: the model without a law that was learned since; the law then counts as the first effect, and any beside it
    has to remove enough of what was there before the law.
    """
    if timings.seconds:  # between two verdicts, laws were looked for
        timings.end("laws")
    prepared = prepare(recordings, held_out, rig, settings)
    if settings.in_turn:
        groups = (replace(one, experiments=tuple(map(parted, one.experiments))) for one in prepared.groups)
        prepared = replace(prepared, groups=tuple(groups))
    return JudgedJoint.of(prepared, verdicts(prepared, settings, timings, first))


def verdicts(prepared: Prepared, settings: Settings, timings: Timings, first: Model | None = None) -> list[Judged]:
    """The verdict on each group. `first`: the model without a law that was learned since; None: there is none."""
    judged = []
    for group in prepared.groups:
        settings.progress("recalibrating the base parameters")
        base = by_itself_or_in_turn(group)
        timings.end("recalibration")
        names = {experiment.trial.name for experiment in group.experiments}
        before = [] if first is None else [k for k, e in enumerate(first.experiments) if e.trial.name in names]
        work = Work(settings.about(group), settings.store)
        asked = hypotheses() if settings.catalogue else CALIBRATIONS
        ranking = search(base, work, asked, first=None if first is None else first.of(before))
        timings.end("selection")
        work = Work(settings.progress, settings.store)
        judged.append(judge(prepared, group, ranking, work, settings.catalogue))
        timings.end("judgement")
    return judged
