"""What the catalogue does not explain gets a learned law: its place, what it depends on, and a table in the rig.

The rig that has the law of the search (:mod:`~pam_antagonist.diagnosis.law_search`) is judged like any other. Held-out
data decide between both verdicts, by the rules of a further effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pam_antagonist.diagnosis import held_out, law_evidence, thresholds
from pam_antagonist.diagnosis.judged import Judged, JudgedJoint
from pam_antagonist.diagnosis.judgement import base_along_motion
from pam_antagonist.diagnosis.law_evidence import misread, parts, with_it
from pam_antagonist.diagnosis.law_findings import law_effects
from pam_antagonist.diagnosis.law_forms import LawForm
from pam_antagonist.diagnosis.law_search import LawSearch, better, leaves_more, search
from pam_antagonist.diagnosis.models import Model, held_share, recalibrated, share_of_all
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED
from pam_antagonist.diagnosis.warnings import slides
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]

MOST_LAWS = 2
_SMOOTHED_S = 0.010
"""[s] Time over which readings are averaged before an error of other readings is worked out from them."""


Verdicts = Callable[..., JudgedJoint]
"""Makes the verdict on a joint: of recordings, of those that are held out as a whole, and of a rig; where the rig has a
learned law, of the model without it as well.
"""


def with_laws(
    verdict: Verdicts, recordings: Sequence[Recording], kept: Sequence[Recording], rig: Rig,
    progress: Callable[[str], None], now: JudgedJoint,
) -> JudgedJoint:  # fmt: skip
    """A judged joint; where the verdict leaves a clear excess, with the laws that are missing.

    `now`: without laws. `kept`: recordings that are held out as a whole.
    """
    fitted, others, beside = list(recordings), list(kept), None
    while len(now.laws) < MOST_LAWS and leaves_excess(now) and not (now.laws and _explains_well(now)):
        before, moving = now, _moving(now)
        if moving is not None:
            free = None if moving is now else now.base
            along = _along_the_motion(moving, verdict, fitted, others, rig, progress, free)
            if along is not moving or (free is None and not _friction_fails(now)):
                return along
            before = _in_free_run(now) if free is None else now
        try:
            learned = _looked_for(before, beside, rig, progress)
        except BadInput as reason:
            # The catalogue's verdict needs less of the recordings, and it stands.
            return replace(now, why=f"No law was looked for: {reason}.")
        if not learned.laws:
            return replace(now, why=place_in_words(learned, ", by nothing that was measured"))
        why = []
        for choice in learned.choices:
            tried = _tried(before, beside, choice, verdict, fitted, others, rig)
            if not isinstance(tried, str):
                now, beside, rig, fitted, others = tried
                break
            why.append(tried)
        else:
            return replace(now, why=why[0])
    return now


def _explains_well(now: JudgedJoint) -> bool:
    """Whether a law leaves no more than an imperfect table does: a further one would only follow that."""
    return share_of_all(now.base, now.model) >= thresholds.EXPLAINED_WELL


class _Tried(NamedTuple):
    """A joint with laws, and what a further law is looked for in."""

    now: JudgedJoint
    beside: Model  # with the laws, without effects of the catalogue
    rig: Rig
    fitted: list[Recording]
    others: list[Recording]


def _tried(
    before: JudgedJoint, beside: Model | None, learned: LawSearch, verdict: Verdicts, fitted: Sequence[Recording],
    others: Sequence[Recording], rig: Rig,
) -> _Tried | str:  # fmt: skip
    """The joint with laws; in a sentence why there is none, where they do not hold. `beside`: as of the search."""
    right, also = (corrected(some, learned.laws) for some in (fitted, others))
    try:
        own = learned.in_rig(rig)
        may = may_be_better(before, learned, beside)
        after = verdict(right, also, own, before.base) if may else None
    except BadInput as reason:
        return f"{_was_learned(learned)} cannot be tried: {reason}."
    if after is None or not is_better(before, after.model, learned.laws):
        words = f"{_was_learned(learned)} does not hold on data that no fit used."
        return f"{place_in_words(learned)} {words}".strip()
    return _Tried(replace(after, base=before.base, before=before, learned=learned), after.base, own, right, also)


def _looked_for(before: JudgedJoint, beside: Model | None, rig: Rig, progress: Callable[[str], None]) -> LawSearch:
    """The laws that a joint lacks.

    `beside`: the model with the law that was found before; None: there is none.

    Raises:
        BadInput: recordings in which none can be looked for.
    """
    if rig.units.pressure != "pascal":
        raise BadInput("pressures are not known in pascals")
    if rig.valves.sealed:
        _refuse_few_sweeps(before)
    # Effects of the catalogue imitate a law that is missing; on a sealed joint few of them can.
    return search(beside or (before.model if rig.valves.sealed else before.base), progress)


def _was_learned(learned: LawSearch) -> str:
    """What was learned, as the beginning of a sentence that says what is wrong with it."""
    words = "; ".join(law.in_words() for law in learned.laws)
    return (
        f"A law was learned ({words}), but it"
        if len(learned.laws) == 1
        else f"Two laws were learned ({words}), but this"
    )


def _friction_fails(now: JudgedJoint) -> bool:
    """Whether a joint that sticks is predicted worse with what explains the balance of its torques than without."""
    parts = held_out.comparisons(now, held_out.ended(now))
    errors = held_out.total_errors(parts, held_out.by_recording(parts, {}, False, now.base.jobs))
    before, after = errors.recalibrated.angle, errors.extended.angle
    return before is not None and after is not None and after.rmse > before.rmse


def _moving(now: JudgedJoint) -> JudgedJoint | None:
    """A joint that sticks, with models along its motion; None where none does, or an effect was found.

    What nothing explains in a free run, or a torque of any course alone, may be friction.
    """
    if any(isinstance(one, MeasuredMotion) for one in now.model.experiments):
        return now
    if now.verdict != UNEXPLAINED and not _is_a_torque_alone(now):
        return None
    base = base_along_motion(now.base)
    return None if base is None else replace(now, base=base, model=base)


def _in_free_run(now: JudgedJoint) -> JudgedJoint:
    """A joint that sticks, with the models that get the commands only; they have no effect."""
    base = recalibrated([one.free_run for one in now.base.experiments])
    return replace(now, base=base, model=base)


def _along_the_motion(
    now: JudgedJoint, verdict: Verdicts, fitted: Sequence[Recording], others: Sequence[Recording], rig: Rig,
    progress: Callable[[str], None], free: Model | None,
) -> JudgedJoint:  # fmt: skip
    """A joint that sticks, with a law in the place of its friction, or beside it; or as it is.

    Held-out data decide along the measured motion: a free run of a joint that sticks says little of any model.

    `free`: the model in a free run, where that was not explained; then the law has to be one of friction.
    """
    for about in dict.fromkeys((now.base, now.model)):
        # A rig with the law may be one that no command would take: then the catalogue's verdict stands.
        with suppress(BadInput):
            found = better(now.base, now.model, about, progress)
            if found is not None and (free is None or _is_friction(free, found[0].laws)):
                learned, model = found
                after = verdict(fitted, others, learned.in_rig(rig), now.base)
                return replace(after, base=now.base, before=now, learned=learned, by=model)
    return now


def _is_friction(free: Model, laws: Sequence[Law]) -> bool:
    """Whether laws are of friction, and make no free run worse: all other laws show in a free run of all recordings."""
    if any(law.place != "friction" for law in laws):
        return False
    return law_evidence.evidence_held_out(free, with_it(free, *laws)) >= 0.0


def _refuse_few_sweeps(joint: JudgedJoint) -> None:
    """Refuse recordings of a sealed joint in which it hardly moves: all samples of a sweep have nearly one error."""
    for count, words in zip(slides(joint.prepared), ("what is fitted", "what is held out"), strict=True):
        if count < thresholds.FEW_SWEEPS:
            raise BadInput(
                f"in {words} the joint slides {count} times to or fro, expected at least {thresholds.FEW_SWEEPS} times"
            )


def of_part(judged: Judged, progress: Callable[[str], None]) -> tuple[Judged, LawSearch | None]:
    """The verdict on a part of a model with a law that takes what effects leave; as it is, where none does."""
    base, before = judged.base, judged.base if judged.verdict == UNEXPLAINED else judged.model
    if judged.verdict == NONE or not before.has_significant_excess:
        return judged, None
    found = better(base, before, before, progress)
    if found is None:
        return judged, None
    learned, model = found
    names = [one.trial.name for one in base.experiments]
    laws = law_effects(base, model, [learned], names, judged.ranking.tried)
    effects = (*(judged.effects if before is judged.model else ()), *laws)
    share = held_share(base, model)
    return replace(judged, verdict=EFFECT, model=model, effects=effects, share=share), learned


def corrected(recordings: Sequence[Recording], laws: Sequence[Law]) -> list[Recording]:
    """Recordings without the errors of readings that some of the laws are."""
    errors = [law for law in laws if law.is_of_readings]
    return [_corrected(one, errors) for one in recordings] if errors else list(recordings)


def _corrected(one: Recording, errors: Sequence[Law]) -> Recording:
    nothing, period = np.zeros(len(one.time_s)), one.sample_period_s
    others = [nothing if each is None else each for each in (one.angle, one.torque)]
    size = 2 * int(0.5 * _SMOOTHED_S / period) + 1
    readings = uniform_filter1d(np.nan_to_num(np.column_stack([*others, one.pressure])), size, axis=0, mode="nearest")
    high = misread(errors, readings, period)
    angle, torque = (
        read if read is None else read - error for read, error in zip((one.angle, one.torque), high.T[:2], strict=True)
    )
    return replace(one, pressure=one.pressure - high[:, 2:], angle=angle, torque=torque)


def leaves_excess(found: JudgedJoint) -> bool:
    """Whether what was found leaves so much that a law could be a further effect.

    What begins or ends is no law, nor a torque that comes and goes beside effects. Such a torque alone may be a law
    that acts in a part of the range.
    """
    events = any(one.onset_s is not None or one.end_s is not None for one in found.effects)
    # One that turned out to act throughout was judged on other stretches than a law would be.
    events = events or any(one.spans for one in found.model.experiments)
    if found.verdict == NONE or events:
        return False
    if any(one.name == DISTURBANCE for one in found.effects):
        return _is_a_torque_alone(found)
    if any(one.is_kept_near for one in found.model.experiments):
        return any(part.has_significant_excess for part in parts(found.model))
    return leaves_more(found.base, found.model)


def may_be_better(before: JudgedJoint, learned: LawSearch, beside: Model | None) -> bool:
    """Whether laws are worth a verdict with them: alone, or beside the effects that were found, they do better.

    `beside`: the model with the law that was found before; None: there is none.
    """
    base = beside or before.base
    own = with_it(Model(base.experiments, base.fits), *learned.laws).experiments
    if is_better(before, recalibrated(own, base), learned.laws):
        return True
    if not (before.effects or before.laws) or _is_a_torque_alone(before):
        return False
    return is_better(before, with_it(before.model, *learned.laws), learned.laws)


def is_better(before: JudgedJoint, model: Model, laws: Sequence[Law]) -> bool:
    """Whether a model with laws does better where nothing was fitted, by the rules of a further effect.

    A law that predicts held-out data comes before a torque of any course, if the law is the explanation.
    """
    if _is_a_torque_alone(before):
        before = replace(before, model=before.base)
        if share_of_all(before.base, model) < thresholds.EXPLAINED:
            return False
    return law_evidence.is_better(before.base, before.model, model, laws[0])


def _is_a_torque_alone(found: JudgedJoint) -> bool:
    """Whether what was found is a torque from outside and nothing else."""
    return not found.laws and [one.name for one in found.effects] == [DISTURBANCE]


def place_in_words(found: LawSearch, reason: str = "") -> str:
    """Where the model errs most likely, with a reason; empty if that is not known."""
    place = found.places[0] if found.places else None
    if place is None or place.gain < thresholds.STRONG:
        return ""
    group = LawForm(place.name)
    return f"The model errs most likely in {Law(group.kind, (), (), group.muscle).where}{reason}."
