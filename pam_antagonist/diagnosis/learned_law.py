"""What no law of the catalogue explains gets a learned one: its place, what it depends on, and a table in the rig.

The search (:mod:`~pam_antagonist.diagnosis.law_search`) works on the recordings as they are. The rig that has its law
is then diagnosed like any other, so that errors, further effects and calibrations come from the same judge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import law_simulation
from pam_antagonist.diagnosis.errors import ModelErrors
from pam_antagonist.diagnosis.law_search import (
    LEAST_GAIN,
    LEAST_SHARE,
    LawSearch,
    Simulated,
    Subject,
    is_further,
    law_search,
)
from pam_antagonist.diagnosis.result import Diagnosis, FoundEffect, Size
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.stamps import LONGEST_GAP_NS
from pam_antagonist.recording import Recording, bag_name
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, with_law

Floats = NDArray[np.float64]

_SHORTEST_S = 10.0
_SLOWEST_S = 5e-3
"""[s] With fewer samples the acceleration is too blurred to tell friction from inertia."""
LIKE: Mapping[tuple[str, str], tuple[str, ...]] = {
    ("flow", "pressure"): ("leak", "pressure_sensor"),
    ("flow", "length"): ("leak",),
    ("valve", "none"): ("valve_offset",),
    ("valve", "open_rate"): ("valve_offset", "valve_lag", "valve_play"),
    ("supply", "draw"): ("supply_droop",),
    ("supply", "none"): ("supply_droop",),
    ("force", "length"): ("hysteresis", "creep"),
    ("strength", "length"): ("hysteresis", "creep"),
    ("strength", "time"): ("warm_up",),
    ("sensor", "pressure"): ("pressure_sensor",),
    ("sensor", "none"): ("pressure_sensor",),
    ("torque", "angle"): ("load_torque",),
    ("friction", "speed"): ("friction",),
    ("friction", "none"): ("friction",),
}
"""Effects of the catalogue that act at a place by an argument."""
_WHERE = {
    "flow": "the flow into muscle {}", "valve": "the opening of valve {}", "force": "the force of muscle {}",
    "strength": "the strength of muscle {}", "sensor": "the pressure sensor of muscle {}",
    "line": "the line of muscle {}",
    "volume": "the volume of muscle {}", "supply": "the supply", "exchange": "a flow from muscle 1 to muscle 2",
    "encoder": "the encoder", "meter": "the torque meter", "torque": "a torque on the joint",
    "friction": "the joint's friction",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Learned:
    """A law that was learned, and the rig that has it.

    Attributes:
        searches: how each law was found; the last one may have found none.
        laws: with standard deviations of their values.
        rig: with the laws, or as it was where the law is an error of readings.
        sentence: where the model errs, if no law was taken.
    """

    searches: tuple[LawSearch, ...]
    laws: tuple[Law, ...]
    rig: Rig
    sentence: str = ""

    def corrected(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Recordings without the error of readings that was found; as they are, if it is another law."""
        out = list(recordings)
        for law in self.laws:
            out = [_corrected(recording, law) for recording in out] if law.is_of_readings else out
        return out


def _corrected(recording: Recording, law: Law) -> Recording:
    assert recording.angle is not None
    pressure, angle = np.nan_to_num(recording.pressure), np.nan_to_num(recording.angle)
    width = law_simulation.smoothing(recording.sample_period_s)
    smooth = np.column_stack([law_simulation.smoothed(column, width) for column in pressure.T])
    turned = law_simulation.smoothed(angle, width)
    raised, turned = law_simulation.misread(law, smooth, turned, recording.sample_period_s)
    return replace(recording, pressure=recording.pressure - raised, angle=recording.angle - turned)


def where(name: str) -> str:
    """A place in words, such as ``flow_2``.

    Args:
        name: of the place.
    """
    kind, _, end = name.rpartition("_")
    if end in ("1", "2", "both") and kind:
        return _WHERE[kind].format("1 and 2" if end == "both" else end)
    return _WHERE[name]


def refusal(recordings: Sequence[Recording], rig: Rig) -> str:
    """Why no law can be looked for; empty if one can."""
    if rig.valves.sealed or rig.drive != "valve":
        return "a law is looked for in joints with moving valves only"
    if any(one.sample_period_s > _SLOWEST_S for one in recordings):
        return f"a law is looked for in recordings with {1.0 / _SLOWEST_S:g} samples a second at least"
    if rig.units.pressure != "pascal":
        return "a law is looked for where pressures are known in pascals only"
    if any(one.angle is None or not np.isfinite(one.angle).any() for one in recordings):
        return "a law is looked for where the angle was measured only"
    return ""


def stretches(recording: Recording, begin_s: float = -math.inf, end_s: float = math.inf) -> list[dict[str, Floats]]:
    """The stretches of a recording without holes, as the search takes them.

    Args:
        recording: the recording.
        begin_s: of the part [s].
        end_s: of the part [s].
    """
    time = recording.time_s
    torque = np.full(len(time), np.nan) if recording.torque is None else recording.torque
    angle = np.full(len(time), np.nan) if recording.angle is None else recording.angle
    known = (
        np.isfinite(recording.pressure).all(axis=1) & np.isfinite(recording.voltage).all(axis=1) & np.isfinite(angle)
    )
    rows = np.flatnonzero(known & (time >= begin_s) & (time < end_s))
    holes = (
        np.flatnonzero(np.diff(recording.stamp_ns[rows]) > max(LONGEST_GAP_NS, 2.5e9 * recording.sample_period_s)) + 1
    )
    columns = {
        "time": time, "pressure": recording.pressure, "command": recording.voltage, "angle": angle, "torque": torque,
    }  # fmt: skip
    return [{key: values[part] for key, values in columns.items()} for part in np.split(rows, holes) if len(part) > 1]


def learn(
    recordings: Sequence[tuple[Recording, JointCondition]],
    rig: Rig,
    holdout: float,
    progress: Callable[[str], None],
    whole: int = 0,
) -> Learned:
    """Look for the law that a rig lacks.

    Args:
        recordings: each with the condition of its joint.
        rig: as configured.
        holdout: share at the end of each recording that is not seen.
        progress: called with what is being done.
        whole: number of recordings at the end that are held out as a whole, in place of the share.

    Raises:
        BadInput: recordings in which no law can be looked for.
    """
    reason = refusal([one for one, _ in recordings], rig)
    if reason:
        raise BadInput(reason)
    subjects = []
    for number, (recording, state) in enumerate(recordings):
        if number >= len(recordings) - whole:
            continue
        end = recording.duration_s * (1.0 if whole else 1.0 - holdout)
        seen = stretches(recording, end_s=end)
        if sum(float(part["time"][-1] - part["time"][0]) for part in seen) < _SHORTEST_S:
            continue
        subjects.append(
            Subject(
                bag_name(recording.path), seen, recording.sample_period_s, state.condition == "locked", rig.parameters()
            )
        )
    if not subjects:
        raise BadInput(f"a law is looked for in recordings of {_SHORTEST_S:g} s at least")
    found = law_search(subjects, rig, lambda text: progress(f"a law that nobody wrote: {text}"))
    if found.found is None:
        place = found.places[0] if found.places else None
        if place is None or place.gain < LEAST_GAIN:
            return Learned((found,), (), rig)
        text = f"The model errs most likely in {where(place.name)}, by nothing that was measured."
        return Learned((found,), (), rig, text)
    searches, laws = [found], [_with_std(found.found)]
    if not laws[0].is_of_readings:
        points = zip(subjects, found.found.points, strict=True)
        further = [replace(subject, p=p) for subject, p in points]
        second = law_search(further, rig, lambda text: progress(f"a second law: {text}"), 2)
        if is_further(found, second) and second.found is not None:
            searches, laws = [found, second], [*laws, _with_std(second.found)]
    for law, search in zip(laws, searches, strict=True):
        if not law.is_of_readings and search.found is not None:
            rig = with_law(rig, law, covariance=search.found.covariance)
    return Learned(tuple(searches), tuple(laws), rig)


def _with_std(found: Simulated) -> Law:
    assert found.law is not None
    return replace(found.law, std=tuple(map(float, np.sqrt(np.maximum(np.diag(found.covariance), 0.0)))))


def effect_of(law: Law, found: LawSearch, recordings: Sequence[str]) -> FoundEffect:
    """A learned law as an effect of a diagnosis.

    Args:
        law: the law.
        found: how it was found.
        recordings: names of those that show it.
    """
    sizes = {
        ("everywhere" if len(law.nodes) == 1 else f"at {node:.4g} {law.argument_unit}"): Size(value, std, law.unit)
        for node, value, std in zip(law.nodes, law.values, law.std or (0.0,) * len(law.nodes), strict=True)
    }
    return FoundEffect(
        "learned", law.muscle if isinstance(law.muscle, int) else None, sizes, 2.0 * found.gain, found.share,
        tuple(recordings), law=law, like=LIKE.get((law.place, law.argument), ()),
    )  # fmt: skip


def sentence(learned: Learned, before: Diagnosis, after: Diagnosis) -> str:
    """The verdict by learned laws, in words.

    Args:
        learned: the laws.
        before: the diagnosis without them.
        after: the diagnosis with them.
    """
    errors = [
        f"the {name}'s held-out error falls from {a.rmse:.3g} to {b.rmse:.3g} {unit}"
        for name, unit in (("angle", "deg"), ("torque", "N m"))
        if (a := getattr(before.errors.recalibrated, name)) and (b := getattr(after.errors.recalibrated, name))
        and b.rmse < a.rmse
    ]  # fmt: skip
    a, b = max(before.errors.recalibrated.rmse_pa), max(after.errors.recalibrated.rmse_pa)
    errors += [f"the larger pressure error from {a / 1e3:.3g} to {b / 1e3:.3g} kPa"] if b < a else []
    said = []
    for law in learned.laws:
        like = LIKE.get((law.place, law.argument), ())
        named = f" (like {' or '.join(name.replace('_', ' ') for name in like)})" if like else ""
        said.append(law.in_words() + named)
    rivals = [item.law.in_words() for item in learned.searches[0].alternatives if item.law is not None]
    also = f" As good in a simulation: {'; '.join(rivals)}." if rivals else ""
    if any(law.is_of_readings for law in learned.laws):
        also += " No rig file holds an error of readings: correct the recordings by it."
    fallen = ", ".join(errors) or "no error falls"
    return f"What is missing: {'; and '.join(said)}. Measured as a table; {fallen}.{also}"


def falls(before: ModelErrors, after: ModelErrors) -> bool:
    """Whether the held-out errors of recalibrated models are less with a law than without it, all channels together.

    Args:
        before: errors without the law.
        after: errors with it.
    """
    pairs = [(a, b) for a, b in zip(before.recalibrated.rmse_pa, after.recalibrated.rmse_pa, strict=True)]
    for name in ("angle", "torque"):
        first, second = getattr(before.recalibrated, name), getattr(after.recalibrated, name)
        pairs += [] if first is None or second is None else [(first.rmse, second.rmse)]
    return float(np.mean([math.log(b / a) for a, b in pairs])) < math.log(1.0 - LEAST_SHARE)


def joined(before: Diagnosis, after: Diagnosis, learned: Learned) -> Diagnosis:
    """The diagnosis of the rig as configured, explained by a law: errors before, and those of the rig that has it.

    A law that does not lower the errors on held-out data leaves the verdict as it was.

    Args:
        before: of the rig as configured.
        after: of the rig with the law.
        learned: the law.
    """
    if not falls(before.errors, after.errors):
        words = "; ".join(law.in_words() for law in learned.laws)
        text = f"{before.sentence} A law was learned ({words}), but no held-out error falls by it."
        return replace(before, sentence=text)
    names = [entry.recording for entry in before.by_recording if entry.role != "held out"]
    effects = [effect_of(law, search, names) for law, search in zip(learned.laws, learned.searches, strict=True)]
    text = sentence(learned, before, after)
    if after.effects:
        text += f" Beside it: {after.sentence}"
    notes = ("the law explains the recordings in part only",) if after.verdict == "unexplained" else ()
    entries = tuple(
        replace(entry, errors=_from(first.errors, entry.errors), ukf=_from(first.ukf, entry.ukf))
        for first, entry in zip(before.by_recording, after.by_recording, strict=True)
    )
    errors = _from(before.errors, after.errors)
    assert errors is not None
    rigs = {**before.of_one_rig, "extended": after.of_one_rig["extended"]}
    return replace(
        after, verdict="effect", sentence=text, effects=(*effects, *after.effects), errors=errors, by_recording=entries,
        share=learned.searches[0].share, ranking=(*before.ranking, *after.ranking),
        rig_recalibrated=before.rig_recalibrated, warnings=(*notes, *after.warnings), recalibrated=before.recalibrated,
        of_one_rig=rigs,
    )  # fmt: skip


def _from(before: ModelErrors | None, after: ModelErrors | None) -> ModelErrors | None:
    """Errors with a law, and those without it as configured and recalibrated; None where they were not worked out."""
    if before is None or after is None:
        return after
    return replace(after, as_configured=before.as_configured, recalibrated=before.recalibrated)
