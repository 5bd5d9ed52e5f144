"""What the catalogue does not explain gets a learned law: its place, what it depends on, and a table in the rig.

The rig that has the law of the search (:mod:`~pam_antagonist.diagnosis.law_search`) is diagnosed like any other.
Held-out data decide between both diagnoses, by the rules of a further effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pam_antagonist.diagnosis import law_evidence, thresholds
from pam_antagonist.diagnosis.errors import ModelErrors
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.law_evidence import all_acting, parts, with_it
from pam_antagonist.diagnosis.law_forms import LawForm
from pam_antagonist.diagnosis.law_search import LawSearch, search
from pam_antagonist.diagnosis.models import Model, held_share, likelier, price, recalibrated, share_of_all
from pam_antagonist.diagnosis.pipeline import change_in_words
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect, Judged, Size
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.measured_motion import MeasuredMotion
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE
from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, laws_of, with_law

Floats = NDArray[np.float64]

MOST_LAWS = 2
IN_TURN = (
    "only the end of the recordings shows what the model lacks, so every third stretch of about 5 s was held out, and "
    "the errors are those in these stretches"
)
_SMOOTHED_S = 0.010
"""[s] Time over which readings are averaged before an error of other readings is worked out from them."""


def diagnosed(
    diagnose: Callable[..., Diagnosis], recordings: Sequence[Recording], kept: Sequence[Recording], rig: Rig,
    progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """A diagnosis with laws, see :func:`with_laws`; with stretches held out in turn where only the end shows something.

    What begins to act at the end of a recording leaves nothing where a model is fitted, so nothing is looked for.
    """
    found = with_laws(diagnose, recordings, kept, rig, progress)
    base = found.recalibrated
    at_the_end = found.verdict == UNEXPLAINED and not kept and not base.has_significant_excess
    if not at_the_end or not all(one.runs_by_itself for one in base.experiments):
        return found
    progress("what only the end shows: stretches are held out in turn")
    again = with_laws(partial(diagnose, in_turn=True), recordings, kept, rig, progress)
    if again.verdict != EFFECT:
        return found
    return replace(again, warnings=(IN_TURN, *again.warnings))


def with_laws(
    diagnose: Callable[..., Diagnosis], recordings: Sequence[Recording], kept: Sequence[Recording], rig: Rig,
    progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """A diagnosis; where it leaves a clear excess, with the law that is missing, and then perhaps with a second one.

    ``diagnose`` makes one of recordings and a rig, with some that are ``held_out`` as a whole; the rest are its inputs.
    """
    now = diagnose(recordings, rig, held_out=kept)
    fitted, others = list(recordings), list(kept)
    for _ in range(MOST_LAWS):
        if not leaves_excess(now):
            break
        before = now
        if any(isinstance(one, MeasuredMotion) for one in now.experiments):
            along = _along_the_motion(now, diagnose, fitted, others, rig, progress)
            if along is not now or not _friction_fails(now):
                return along
            before = _in_free_run(now)
        if rig.units.pressure != "pascal":
            return _saying(now, "No law was looked for: pressures are not known in pascals.")
        learned = None
        try:
            if rig.valves.sealed:
                _refuse_few_sweeps(now)
            # Effects of the catalogue imitate a law that is missing; on a sealed joint few of them can.
            about = before.extended if rig.valves.sealed else before.recalibrated
            learned = search(about, len(laws_of(rig)) + 1, progress)
            own, after = learned.in_rig(rig), now
            right, also = (corrected(some, learned.law) for some in (fitted, others))
            if may_be_better(before, learned):
                after = diagnose(right, own, held_out=also, first=before.recalibrated)
        except BadInput as reason:
            # The catalogue's diagnosis needs less of the recordings, and it stands.
            if learned is None or learned.law is None:
                return _saying(now, f"No law was looked for: {reason}.")
            return _saying(now, f"A law was learned ({learned.law.in_words()}), but it cannot be tried: {reason}.")
        if learned.law is None:
            return _saying(now, place_in_words(learned, ", by nothing that was measured"))
        if after is now or not is_better(before, after.extended, learned.law):
            words = f"A law was learned ({learned.law.in_words()}), but it does not hold on data that no fit used."
            return _saying(now, f"{place_in_words(learned)} {words}".strip())
        now, rig, fitted, others = joined(before, after, learned), own, right, also
    return now


def _friction_fails(now: Diagnosis) -> bool:
    """Whether a joint that sticks is predicted worse with what explains the balance of its torques than without."""
    before, after = (one.angle for one in (now.errors.recalibrated, now.errors.extended))
    return before is not None and after is not None and after.rmse > before.rmse


def _in_free_run(now: Diagnosis) -> Diagnosis:
    """A diagnosis of a joint that sticks, with the models that get the commands only; they have no effect."""
    base = recalibrated([one.free_run for one in now.recalibrated.experiments])
    return replace(now, recalibrated=base, extended=base)


def _along_the_motion(
    now: Diagnosis, diagnose: Callable[..., Diagnosis], fitted: Sequence[Recording], others: Sequence[Recording],
    rig: Rig, progress: Callable[[str], None],
) -> Diagnosis:  # fmt: skip
    """The diagnosis of a joint that sticks, with a law in the place of its friction, or beside it; or as it is.

    Held-out data decide along the measured motion: a free run of a joint that sticks says little of any model.
    """
    for before in (now.recalibrated, now.extended):
        # A rig with the law may be one that no command would take: then the catalogue's diagnosis stands.
        with suppress(BadInput):
            learned = search(before, len(laws_of(rig)) + 1, progress)
            own = learned.in_rig(rig)
            if learned.law is None or learned.found is None:
                continue
            model = with_it(before, learned.law, learned.found.covariance)
            if law_evidence.is_better(now.recalibrated, now.extended, model, learned.law):
                after = diagnose(fitted, own, held_out=others, first=now.recalibrated)
                return joined(now, after, learned, model)
    return now


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
    learned = search(before, len(laws_of(before.experiments[0].rig)) + 1, progress)
    if learned.law is None or learned.found is None:
        return judged, None
    model = with_it(before, learned.law, learned.found.covariance)
    if not law_evidence.is_better(base, before, model, learned.law):
        return judged, None
    names = [one.trial.name for one in base.experiments]
    effect = law_effect(base, model, learned, names, judged.ranking.tried)
    effects = (*(judged.effects if before is judged.model else ()), effect)
    share = held_share(base, model)
    return replace(judged, verdict=EFFECT, model=model, effects=effects, share=share), learned


def corrected(recordings: Sequence[Recording], law: Law | None) -> list[Recording]:
    """Recordings without the error of readings that a law is; as they are, if it is another one."""
    if law is None or not law.is_of_readings:
        return list(recordings)
    group, out = LawForm.of(law), []
    for one in recordings:
        nothing, period = np.zeros(len(one.time_s)), one.sample_period_s
        others = (nothing if each is None else each for each in (one.angle, one.torque))
        columns = np.nan_to_num(np.column_stack([one.pressure, *others]))
        size = 2 * int(0.5 * _SMOOTHED_S / period) + 1
        first, second, angle, torque = uniform_filter1d(columns, size, axis=0, mode="nearest").T
        seen = {"pressure_1": first, "pressure_2": second, "pressure_difference": first - second, "angle": angle,
                "torque": torque, "time": one.time_s}  # fmt: skip
        high = np.zeros(columns.shape)
        for muscle in group.muscles:
            column = {"pressure": 0, "angle": 2, "torque": 3}[TABLE[group.kind].reads] + muscle - 1
            high[:, column] += np.interp(group.argument_of(seen, muscle, period), law.nodes, law.values)
        angle, torque = (read if read is None else read - error
                         for read, error in zip((one.angle, one.torque), high[:, 2:].T, strict=True))  # fmt: skip
        out.append(replace(one, pressure=one.pressure - high[:, :2], angle=angle, torque=torque))
    return out


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
    left = 1.0 - (share_of_all(found.recalibrated, found.extended) if found.effects else 0.0)
    return left >= thresholds.FURTHER_SHARE and found.extended.has_significant_excess


def may_be_better(before: Diagnosis, learned: LawSearch) -> bool:
    """Whether a law is worth a diagnosis with it: alone, or beside the effects that were found, it does better."""
    law = learned.law
    if law is None or law.is_of_readings:
        # Of what was recorded wrongly, only a diagnosis of the corrected recordings tells.
        return law is not None

    assert learned.found is not None
    covariance = learned.found.covariance

    base = before.recalibrated
    own = [one.of_rig(with_law(one.rig, law, covariance=covariance)) for one in base.experiments]
    if is_better(before, recalibrated(own, base), law):
        return True
    beside = bool(before.effects) and not _is_a_torque_alone(before)
    return beside and is_better(before, with_it(before.extended, law, covariance), law)


def is_better(before: Diagnosis, model: Model, law: Law) -> bool:
    """Whether a model with a law does better where nothing was fitted, by the rules of a further effect.

    A law that predicts held-out data comes before a torque of any course, if the law is the explanation.
    """
    if _is_a_torque_alone(before):
        before = replace(before, extended=before.recalibrated)
        if share_of_all(before.recalibrated, model) < thresholds.EXPLAINED:
            return False
    return law_evidence.is_better(before.recalibrated, before.extended, model, law)


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


def law_effect(
    base: Model, model: Model, learned: LawSearch, names: Sequence[str], ranking: Sequence[TriedCandidate]
) -> FoundEffect:
    """A learned law as an effect of a diagnosis; each of its numbers has its price in the evidence.

    `base`, `model`: without effects, and with the law. `names`: of the recordings that are fitted. `ranking`: all
    candidates without the law.
    """
    law = learned.law
    assert law is not None
    base, model = all_acting(law, base, model)
    pairs = list(zip(base.fits, model.fits, strict=True))
    gain = sum(likelier(old.scale, old.residual, new.residual) for old, new in pairs)
    gain -= price(pairs[0][0], len(law.values) + int(law.operator != "none"))
    sizes = {
        ("everywhere" if len(law.nodes) == 1 else f"at {law.shown(node, 4)}"): Size(value, std, law.unit)
        for node, value, std in zip(law.nodes, law.values, law.std, strict=True)
    }
    return FoundEffect(
        "learned", law.muscle if isinstance(law.muscle, int) else None, sizes, gain, held_share(base, model),
        tuple(names), law=law, like=like(law, ranking),
        alternatives=tuple(law.in_words() for law in learned.alternatives),
    )  # fmt: skip


def joined(before: Diagnosis, after: Diagnosis, learned: LawSearch, judged: Model | None = None) -> Diagnosis:
    """The diagnosis with a law, and with the errors before it. An effect that acts where it does names it.

    `judged`: the model by which the law was taken; default: that of the diagnosis with it.
    """
    assert learned.law is not None
    model = after.extended if judged is None else judged
    names = [entry.recording for entry in before.by_recording if entry.role != "held out"]
    effect = law_effect(before.recalibrated, model, learned, names, before.ranking)
    share = effect.holdout_gain
    again = {one.name for one in after.effects}
    first = [one for one in before.effects if one.law is not None]
    namers = {name for one in first for name in one.like} - again
    earlier = [one for one in before.effects if one.law is not None or one.name in namers]
    others = [one for one in before.effects if one not in earlier and one.name not in again]
    # One law has one name: a second effect there only imitates what its form leaves.
    like_it = (one for one in others if one.name in effect.like and one.muscle in (None, effect.muscle))
    named = sorted(like_it, key=lambda one: -one.delta_bic)[:1]
    entries = tuple(
        replace(entry, errors=_from(first.errors, entry.errors), ukf=_from(first.ukf, entry.ukf))
        for first, entry in zip(before.by_recording, after.by_recording, strict=True)
    )
    errors = _from(before.errors, after.errors)
    assert errors is not None
    taken = {one.name for one in (*named, *earlier)}
    ranking = [replace(item, taken=item.taken and item.effect in taken) for item in before.ranking]
    shown = [one.trial.name for one in law_evidence.acting(learned.law, model).experiments]
    here = [len(after.parts) == 1 or any(name.endswith(f", {part.name}") for name in shown) for part in after.parts]
    with_law = list(zip(after.parts, here, strict=True))
    effect = replace(effect, part=next((part.name for part, acts in with_law if acts), ""))
    parts = [replace(part, verdict=EFFECT, share_explained=share) if acts else part for part, acts in with_law]
    in_part = share_of_all(*all_acting(learned.law, before.recalibrated, model)) < thresholds.EXPLAINED_WELL
    notes = ("the law explains the recordings in part only",) if in_part else ()
    return replace(
        after, verdict=EFFECT, sentence=_sentence(learned, effect, named, earlier, before, after), errors=errors,
        effects=(*named, *earlier, effect, *after.effects), by_recording=entries,
        share=share, parts=tuple(parts),
        ranking=(*ranking, *after.ranking), rig_recalibrated=before.rig_recalibrated,
        warnings=(*notes, *after.warnings), recalibrated=before.recalibrated,
        of_one_rig={**before.of_one_rig, "extended": after.of_one_rig["extended"]},
    )  # fmt: skip


def _from(before: ModelErrors | None, after: ModelErrors | None) -> ModelErrors | None:
    """Errors with a law, and those without it as configured and recalibrated; None where they were not worked out."""
    if before is None or after is None:
        return after
    return replace(after, as_configured=before.as_configured, recalibrated=before.recalibrated)


def _sentence(
    learned: LawSearch, effect: FoundEffect, named: Sequence[FoundEffect], earlier: Sequence[FoundEffect],
    before: Diagnosis, after: Diagnosis,
) -> str:  # fmt: skip
    """The verdict by a learned law, in words."""
    law = learned.law
    assert law is not None
    change = change_in_words(before.errors.recalibrated, after.errors.extended, " after recalibration")
    text = f"The missing effect sits in {law.where} and depends on {law.on}"
    kind = " and ".join(one.name.replace("_", " ") for one in named)
    text += f": {kind}, in another form than the catalogue's law. " if kind else ". "
    text += f"Its law was measured as a table{law.range_in_words}. "
    text += f"With it the model's errors on held-out data {change}."
    others = [name.replace("_", " ") for name in effect.like if name not in {one.name for one in named}]
    text += f" Effects of the catalogue that act there, but explain less: {', '.join(others)}." if others else ""
    wrong = [] if named or earlier else [one.name.replace("_", " ") for one in before.effects]
    text += f" Of the catalogue alone, {' and '.join(wrong)} explained most, and less than the table." if wrong else ""
    text += f" As good in a simulation: {'; '.join(effect.alternatives)}." if effect.alternatives else ""
    text += " No rig file holds an error of readings: correct the recordings by it." if law.is_of_readings else ""
    first = [one.law.in_words() for one in earlier if one.law is not None]
    text += f" Another law was found before it: {'; '.join(first)}." if first else ""
    return text + (f" Beside it: {after.sentence}" if after.effects else "")
