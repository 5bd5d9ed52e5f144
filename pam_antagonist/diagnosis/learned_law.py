"""What the catalogue does not explain gets a learned law: its place, what it depends on, and a table in the rig.

The rig that has the law of the search (:mod:`~pam_antagonist.diagnosis.law_search`) is diagnosed like any other.
Held-out data decide between both diagnoses, by the rules of a further effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pam_antagonist.diagnosis import law_evidence, thresholds
from pam_antagonist.diagnosis.errors import ModelErrors
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.judgement import base_along_motion
from pam_antagonist.diagnosis.law_evidence import all_acting, misread, parts, with_it
from pam_antagonist.diagnosis.law_forms import LawForm
from pam_antagonist.diagnosis.law_search import LawSearch, better, leaves_more, search
from pam_antagonist.diagnosis.models import Model, held_share, likelier, price, recalibrated, share_of_all
from pam_antagonist.diagnosis.pipeline import change_in_words
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect, Judged, RecordingEntry, Residuals, Size
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED
from pam_antagonist.diagnosis.warnings import estimator_worse
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE
from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]

MOST_LAWS = 2
_SMOOTHED_S = 0.010
"""[s] Time over which readings are averaged before an error of other readings is worked out from them."""
_ONLY_AT_THE_END = "only the end of the recordings shows what the model lacks"
_NOT_TO_THE_END = "no law that was learned from their begin holds to the end of the recordings"
IN_TURN = "so every third stretch of about 5 s was held out, and the errors are those in these stretches"


def diagnosed(
    diagnose: Callable[..., Diagnosis], recordings: Sequence[Recording], kept: Sequence[Recording], rig: Rig,
    progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """A diagnosis with laws, see :func:`with_laws`; where none holds, with stretches held out in turn.

    What begins to act at the end of a recording leaves nothing where a model is fitted, so nothing is looked for. What
    changes from the begin to the end, as rubber that gets warm, has no law that holds at the end. There,
    effects of the catalogue were asked, and are not asked again.
    """
    found = with_laws(diagnose, recordings, kept, rig, progress, diagnose(recordings, rig, held_out=kept))
    if found.verdict != UNEXPLAINED or kept or not all(one.runs_by_itself for one in found.experiments):
        return found
    progress("stretches are held out in turn, in place of the end")
    at_the_end, in_turn = not found.recalibrated.has_significant_excess, partial(diagnose, in_turn=True)
    begin = in_turn(recordings, rig, catalogue=at_the_end)
    if not at_the_end:
        begin = replace(begin, ranking=found.ranking)
    again = with_laws(in_turn, recordings, kept, rig, progress, begin)
    if again.verdict != EFFECT or not (at_the_end or any(one.law for one in again.effects)):
        return found
    return replace(
        again, warnings=(f"{_ONLY_AT_THE_END if at_the_end else _NOT_TO_THE_END}, {IN_TURN}", *again.warnings)
    )


def with_laws(
    diagnose: Callable[..., Diagnosis], recordings: Sequence[Recording], kept: Sequence[Recording], rig: Rig,
    progress: Callable[[str], None], now: Diagnosis,
) -> Diagnosis:  # fmt: skip
    """A diagnosis; where it leaves a clear excess, with the laws that are missing.

    ``diagnose`` makes one of recordings and a rig, with some that are ``held_out`` as a whole; the rest are its inputs.
    `now`: the one without laws.
    """
    fitted, others, taken, beside = list(recordings), list(kept), 0, None
    while taken < MOST_LAWS and leaves_excess(now) and not (taken and _explains_well(now)):
        before, moving = now, _moving(now)
        if moving is not None:
            free = None if moving is now else now.recalibrated
            along = _along_the_motion(moving, diagnose, fitted, others, rig, progress, free)
            if along is not moving or (free is None and not _friction_fails(now)):
                return along
            before = _in_free_run(now) if free is None else now
        try:
            learned = _looked_for(before, beside, rig, progress)
        except BadInput as reason:
            # The catalogue's diagnosis needs less of the recordings, and it stands.
            return _saying(now, f"No law was looked for: {reason}.")
        if not learned.laws:
            return _saying(now, place_in_words(learned, ", by nothing that was measured"))
        why = []
        for choice in learned.choices:
            tried = _tried(before, beside, choice, diagnose, fitted, others, rig)
            if not isinstance(tried, str):
                now, beside, rig, fitted, others = tried
                taken += len(choice.laws)
                break
            why.append(tried)
        else:
            return _saying(now, why[0])
    return now


def _explains_well(now: Diagnosis) -> bool:
    """Whether a law leaves no more than an imperfect table does: a further one would only follow that."""
    return share_of_all(now.recalibrated, now.extended) >= thresholds.EXPLAINED_WELL


class _Tried(NamedTuple):
    """A diagnosis with laws, and what a further law is looked for in."""

    now: Diagnosis
    beside: Model  # with the laws, without effects of the catalogue
    rig: Rig
    fitted: list[Recording]
    others: list[Recording]


def _tried(
    before: Diagnosis, beside: Model | None, learned: LawSearch, diagnose: Callable[..., Diagnosis],
    fitted: Sequence[Recording], others: Sequence[Recording], rig: Rig,
) -> _Tried | str:  # fmt: skip
    """The diagnosis with laws; in a sentence why there is none, where they do not hold. `beside`: as of the search."""
    right, also = (corrected(some, learned.laws) for some in (fitted, others))
    try:
        own = learned.in_rig(rig)
        may = may_be_better(before, learned, beside)
        after = diagnose(right, own, held_out=also, first=before.recalibrated) if may else None
    except BadInput as reason:
        return f"{_was_learned(learned)} cannot be tried: {reason}."
    if after is None or not is_better(before, after.extended, learned.laws):
        words = f"{_was_learned(learned)} does not hold on data that no fit used."
        return f"{place_in_words(learned)} {words}".strip()
    return _Tried(joined(before, after, learned), after.recalibrated, own, right, also)


def _looked_for(before: Diagnosis, beside: Model | None, rig: Rig, progress: Callable[[str], None]) -> LawSearch:
    """The laws that a diagnosis lacks.

    `beside`: the model with the law that was found before; None: there is none.

    Raises:
        BadInput: recordings in which none can be looked for.
    """
    if rig.units.pressure != "pascal":
        raise BadInput("pressures are not known in pascals")
    if rig.valves.sealed:
        _refuse_few_sweeps(before)
    # Effects of the catalogue imitate a law that is missing; on a sealed joint few of them can.
    return search(beside or (before.extended if rig.valves.sealed else before.recalibrated), progress)


def _was_learned(learned: LawSearch) -> str:
    """What was learned, as the beginning of a sentence that says what is wrong with it."""
    words = "; ".join(law.in_words() for law in learned.laws)
    return (
        f"A law was learned ({words}), but it"
        if len(learned.laws) == 1
        else f"Two laws were learned ({words}), but this"
    )


def _friction_fails(now: Diagnosis) -> bool:
    """Whether a joint that sticks is predicted worse with what explains the balance of its torques than without."""
    before, after = (one.angle for one in (now.errors.recalibrated, now.errors.extended))
    return before is not None and after is not None and after.rmse > before.rmse


def _moving(now: Diagnosis) -> Diagnosis | None:
    """A diagnosis of a joint that sticks, with models along its motion; None where none does, or an effect was found.

    What nothing explains in a free run, or a torque of any course alone, may be friction.
    """
    if any(isinstance(one, MeasuredMotion) for one in now.experiments):
        return now
    if now.verdict != UNEXPLAINED and not _is_a_torque_alone(now):
        return None
    base = base_along_motion(now.recalibrated)
    return None if base is None else replace(now, recalibrated=base, extended=base)


def _in_free_run(now: Diagnosis) -> Diagnosis:
    """A diagnosis of a joint that sticks, with the models that get the commands only; they have no effect."""
    base = recalibrated([one.free_run for one in now.recalibrated.experiments])
    return replace(now, recalibrated=base, extended=base)


def _along_the_motion(
    now: Diagnosis, diagnose: Callable[..., Diagnosis], fitted: Sequence[Recording], others: Sequence[Recording],
    rig: Rig, progress: Callable[[str], None], free: Model | None,
) -> Diagnosis:  # fmt: skip
    """The diagnosis of a joint that sticks, with a law in the place of its friction, or beside it; or as it is.

    Held-out data decide along the measured motion: a free run of a joint that sticks says little of any model.

    `free`: the model in a free run, where that was not explained; then the law has to be one of friction.
    """
    for about in dict.fromkeys((now.recalibrated, now.extended)):
        # A rig with the law may be one that no command would take: then the catalogue's diagnosis stands.
        with suppress(BadInput):
            found = better(now.recalibrated, now.extended, about, progress)
            if found is not None and (free is None or _is_friction(free, found[0].laws)):
                learned, model = found
                own = learned.in_rig(rig)
                after = diagnose(fitted, own, held_out=others, first=now.recalibrated)
                return joined(now, after, learned, model)
    return now


def _is_friction(free: Model, laws: Sequence[Law]) -> bool:
    """Whether laws are of friction, and make no free run worse: all other laws show in a free run of all recordings."""
    if any(law.place != "friction" for law in laws):
        return False
    return law_evidence.evidence_held_out(free, with_it(free, *laws)) >= 0.0


def _refuse_few_sweeps(found: Diagnosis) -> None:
    """Refuse recordings of a sealed joint in which it hardly moves: all samples of a sweep have nearly one error."""
    for part, words in (("fitted", "what is fitted"), ("held_out", "what is held out")):
        count = sum(entry.sweeps[part] for entry in found.by_recording if entry.sweeps)
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
    laws = law_effects(base, model, learned, names, judged.ranking.tried)
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


def _saying(found: Diagnosis, why: str) -> Diagnosis:
    """A diagnosis that also says why it has no further law, where it explains nothing."""
    return replace(found, sentence=f"{found.sentence} {why}".strip()) if found.verdict == UNEXPLAINED else found


def leaves_excess(found: Diagnosis) -> bool:
    """Whether what a diagnosis found leaves so much that a law could be a further effect.

    What begins or ends is no law, nor a torque that comes and goes beside effects. Such a torque alone may be a law
    that acts in a part of the range.
    """
    events = any(one.onset_s is not None or one.end_s is not None for one in found.effects)
    # One that turned out to act throughout was judged on other stretches than a law would be.
    events = events or any(one.spans for one in found.experiments)
    events = events or (len(found.effects) > 1 and any(one.name == DISTURBANCE for one in found.effects))
    if found.verdict == NONE or events:
        return False
    if _is_a_torque_alone(found):
        return True
    if any(one.is_kept_near for one in found.experiments):
        return any(part.has_significant_excess for part in parts(found.extended))
    return leaves_more(found.recalibrated, found.extended)


def may_be_better(before: Diagnosis, learned: LawSearch, beside: Model | None) -> bool:
    """Whether laws are worth a diagnosis with them: alone, or beside the effects that were found, they do better.

    `beside`: the model with the law that was found before; None: there is none.
    """
    base = beside or before.recalibrated
    own = with_it(Model(base.experiments, base.fits), *learned.laws).experiments
    if is_better(before, recalibrated(own, base), learned.laws):
        return True
    if not before.effects or _is_a_torque_alone(before):
        return False
    return is_better(before, with_it(before.extended, *learned.laws), learned.laws)


def is_better(before: Diagnosis, model: Model, laws: Sequence[Law]) -> bool:
    """Whether a model with laws does better where nothing was fitted, by the rules of a further effect.

    A law that predicts held-out data comes before a torque of any course, if the law is the explanation.
    """
    if _is_a_torque_alone(before):
        before = replace(before, extended=before.recalibrated)
        if share_of_all(before.recalibrated, model) < thresholds.EXPLAINED:
            return False
    return law_evidence.is_better(before.recalibrated, before.extended, model, laws[0])


def _is_a_torque_alone(found: Diagnosis) -> bool:
    """Whether what was found is a torque from outside and nothing else."""
    return [one.name for one in found.effects] == [DISTURBANCE]


def place_in_words(found: LawSearch, reason: str = "") -> str:
    """Where the model errs most likely, with a reason; empty if that is not known."""
    place = found.places[0] if found.places else None
    if place is None or place.gain < thresholds.STRONG:
        return ""
    group = LawForm(place.name)
    return f"The model errs most likely in {Law(group.kind, (), (), group.muscle).where}{reason}."


def like(law: Law, ranking: Sequence[TriedCandidate]) -> tuple[str, ...]:
    """Effects of the catalogue that act where a law does and explain something of the recordings, the best first."""
    scores = {
        item.effect: item.muscles[law.muscle - 1] if item.muscles and isinstance(law.muscle, int) else item.score
        for item in ranking if item.round == 1 and item.effect in CATALOGUE
    }  # fmt: skip
    acts = [name for name in scores if set(TABLE[law.place].alike) & set(CATALOGUE[name].hooks)]
    return tuple(sorted((n for n in acts if scores[n] >= thresholds.LEAST_SCORE), key=lambda name: -scores[name]))


def law_effects(
    base: Model, model: Model, learned: LawSearch, names: Sequence[str], ranking: Sequence[TriedCandidate]
) -> list[FoundEffect]:
    """Learned laws as effects of a diagnosis, each beside the other; its numbers have their price in the evidence.

    `base`, `model`: without effects, and with the laws. `names`: of the recordings that are fitted. `ranking`: all
    candidates without the laws.
    """
    out = []
    for law in learned.laws:
        others = [other for other in learned.laws if other is not law]
        before, after = all_acting(law, with_it(base, *others) if others else base, model)
        pairs = list(zip(before.fits, after.fits, strict=True))
        gain = sum(likelier(old.scale, old.residual, new.residual) for old, new in pairs)
        gain -= price(pairs[0][0], len(law.values) + int(law.operator != "none"))
        sizes = {
            ("everywhere" if len(law.nodes) == 1 else f"at {law.shown(node, 4)}"): Size(value, std, law.unit)
            for node, value, std in zip(law.nodes, law.values, law.std, strict=True)
        }
        out.append(FoundEffect(
            "learned", law.muscle if isinstance(law.muscle, int) else None, sizes, gain, held_share(before, after),
            tuple(names), law=law, like=like(law, ranking),
            alternatives=tuple(other.in_words() for other in learned.alternatives),
        ))  # fmt: skip
    return out


def joined(before: Diagnosis, after: Diagnosis, learned: LawSearch, judged: Model | None = None) -> Diagnosis:
    """The diagnosis with laws, and with the errors before them. An effect that acts where one does names it.

    `judged`: the model by which the laws were taken; default: that of the diagnosis with them.
    """
    model = after.extended if judged is None else judged
    names = [entry.recording for entry in before.by_recording if entry.role != "held out"]
    effects = law_effects(before.recalibrated, model, learned, names, before.ranking)
    both = all_acting(learned.laws[0], before.recalibrated, model)
    share = held_share(*both)
    again = {one.name for one in after.effects}
    first = [one for one in before.effects if one.law is not None]
    namers = {name for one in first for name in one.like} - again
    earlier = [one for one in before.effects if one.law is not None or one.name in namers]
    others = [one for one in before.effects if one not in earlier and one.name not in again]
    # One law has one name: a second effect there only imitates what its form leaves.
    named = list({one.name: one for effect in effects for one in _namers(effect, others)[:1]}.values())
    entries = tuple(
        replace(
            entry,
            errors=_from(first.errors, entry.errors),
            ukf=_from(first.ukf, entry.ukf),
            residuals=_residuals(first, entry),
        )
        for first, entry in zip(before.by_recording, after.by_recording, strict=True)
    )
    errors = _from(before.errors, after.errors)
    assert errors is not None
    parts_after = {(one.number, one.experiment.trial.name): one for one in after.compared}
    # In the order of the parts that miss most without laws.
    without = {(one.number, one.experiment.trial.name): one.before or one for one in before.compared}
    compared = [replace(parts_after[key], before=one) for key, one in without.items()]
    taken = {one.name for one in (*named, *earlier)}
    ranking = [replace(item, taken=item.taken and item.effect in taken) for item in before.ranking]
    shown = [one.trial.name for one in both[1].experiments]
    here = [len(after.parts) == 1 or any(name.endswith(f", {part.name}") for name in shown) for part in after.parts]
    with_law = list(zip(after.parts, here, strict=True))
    effects = [replace(one, part=next((part.name for part, acts in with_law if acts), "")) for one in effects]
    parts = [replace(part, verdict=EFFECT, share_explained=share) if acts else part for part, acts in with_law]
    in_part = share_of_all(*both) < thresholds.EXPLAINED_WELL
    notes = (f"{'the law explains' if len(effects) == 1 else 'both laws explain'} the recordings in part only",)
    return replace(
        after, verdict=EFFECT, sentence=_sentence(learned, effects, named, earlier, before, after), errors=errors,
        effects=(*named, *earlier, *effects, *after.effects), by_recording=entries,
        share=share, parts=tuple(parts),
        ranking=(*ranking, *after.ranking), rig_recalibrated=before.rig_recalibrated,
        warnings=(*(notes if in_part else ()), *after.warnings, *estimator_worse(entries)),
        recalibrated=before.recalibrated, compared=tuple(compared),
        of_one_rig={**before.of_one_rig, "extended": after.of_one_rig["extended"]},
    )  # fmt: skip


def _from(before: ModelErrors | None, after: ModelErrors | None) -> ModelErrors | None:
    """Errors with a law, and those without it as configured and recalibrated; None where they were not worked out."""
    if before is None or after is None:
        return after
    return replace(after, as_configured=before.as_configured, recalibrated=before.recalibrated)


def _residuals(before: RecordingEntry, after: RecordingEntry) -> Residuals | None:
    """What the models leave of a recording: recalibrated without a law, extended with it."""
    if before.residuals is None or after.residuals is None:
        return after.residuals
    return {**before.residuals, "extended": after.residuals["extended"]}


def _namers(law: FoundEffect, others: Sequence[FoundEffect]) -> list[FoundEffect]:
    """Effects that may name a law, the best first: they act where it does, at its muscle."""
    like_it = (one for one in others if one.name in law.like and one.muscle in (None, law.muscle))
    return sorted(like_it, key=lambda one: -one.delta_bic)


def _sentence(
    learned: LawSearch, effects: Sequence[FoundEffect], named: Sequence[FoundEffect], earlier: Sequence[FoundEffect],
    before: Diagnosis, after: Diagnosis,
) -> str:  # fmt: skip
    """The verdict by learned laws, in words."""
    change = change_in_words(before.errors.recalibrated, after.errors.extended, " after recalibration")
    first, *second = learned.laws
    kind = " and ".join(one.name.replace("_", " ") for one in named)
    kind = f": {kind}, in another form than the catalogue's law" if kind else ""
    if second:
        text = f"Two effects are missing. One sits in {first.where} and depends on {first.on}, "
        text += f"the other in {second[0].where} and depends on {second[0].on}{kind}. Their laws were measured as "
        text += f"tables, the first one{first.range_in_words}, the other{second[0].range_in_words}. "
    else:
        text = f"The missing effect sits in {first.where} and depends on {first.on}{kind}. "
        text += f"Its law was measured as a table{first.range_in_words}. "
    text += f"With {'them' if second else 'it'} the model's errors on held-out data {change}."
    names = {one.name for one in named}
    like_them = dict.fromkeys(name for one in effects for name in one.like if name not in names)
    others = [name.replace("_", " ") for name in like_them]
    text += f" Effects of the catalogue that act there, but explain less: {', '.join(others)}." if others else ""
    wrong = [] if named or earlier else [one.name.replace("_", " ") for one in before.effects]
    than = "tables" if second else "table"
    text += f" Of the catalogue alone, {' and '.join(wrong)} explained most, and less than the {than}." if wrong else ""
    alternatives = effects[0].alternatives
    text += f" As good in a simulation: {'; '.join(alternatives)}." if alternatives else ""
    if any(law.is_of_readings for law in learned.laws):
        text += " No rig file holds an error of readings: correct the recordings by it."
    known = [one.law.in_words() for one in earlier if one.law is not None]
    text += f" Another law was found before it: {'; '.join(known)}." if known else ""
    return text + (f" Beside it: {after.sentence}" if after.effects else "")
