"""Which rig files a diagnosis writes, and which one it proposes: as configured, recalibrated or extended.

All are compared on the same held-out data, by what is above the sensors' noise. The filter decides: a file is proposed
if one of its errors is smaller than with the user's own file and none is larger. The model alone may not become much
worse. A file that is worse in anything, and not better, is not written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pam_antagonist.diagnosis import held_out
from pam_antagonist.diagnosis.agreement import common_point
from pam_antagonist.diagnosis.errors import Errors, RigErrors, total_of
from pam_antagonist.diagnosis.held_out import Ended
from pam_antagonist.diagnosis.judged import JudgedJoint
from pam_antagonist.diagnosis.result import MODELS, Diagnosis, FoundEffect, HeldOutComparison, RecordingEntry
from pam_antagonist.diagnosis.thresholds import ESTIMATOR_WORSE, MARGIN
from pam_antagonist.diagnosis.verdicts import UNEXPLAINED
from pam_antagonist.inference import calibration
from pam_antagonist.inference.point import Point
from pam_antagonist.rig import Rig

_HALF = 0.5
"""Parameters that were fitted without the effect that is there were fitted to anything: an error has to halve."""


@dataclass(frozen=True, eq=False)
class RigFile:
    """A rig file that may be written."""

    name: str
    rig: Rig
    number: int | None  # of the recording whose own values these are; None: it is for all recordings
    before: RigErrors | None  # errors on held-out data as configured; None where nothing of this recording was held out
    now: RigErrors | None

    @property
    def worse(self) -> tuple[str, ...]:
        """Errors that are larger than as configured, in words."""
        return () if self.before is None or self.now is None else self.before.larger(self.now, MARGIN)

    @property
    def ratio(self) -> float:
        """Geometric mean of the errors that decide with this file over those as configured."""
        known = () if self.before is None or self.now is None else self.before.deciding(self.now)
        return float(np.exp(np.mean(np.log(known)))) if len(known) else 1.0

    @property
    def gain(self) -> str:
        """The error that decides and changes most, with this file and as configured, in words."""
        return "" if self.before is None or self.now is None else self.before.in_words(self.now)

    def is_better(self, explained: bool) -> bool:
        """Whether the file may be proposed.

        `explained`: whether it has what explains the recordings: an effect, or nothing more.
        """
        if self.before is None or self.now is None or self.before.larger(self.now, MARGIN, ESTIMATOR_WORSE):
            return False
        best = min(self.before.deciding(self.now))
        return best * MARGIN < 1.0 if explained else best <= _HALF

    def is_fit(self, explained: bool) -> bool:
        """Whether the file may be written: nothing is worse with it, or it is better in all.

        `explained`: as for :meth:`is_better`.
        """
        return not self.worse or self.is_better(explained)


@dataclass(frozen=True, eq=False)
class RigChoice:
    """The rig files of a diagnosis."""

    files: tuple[RigFile, ...]
    proposed: RigFile | None
    no_common: str  # why there is no rig_extended.yaml, in a sentence; empty if there is one


def rig_errors(
    ended: Mapping[str, tuple[JudgedJoint, Sequence[Ended]]],
    rigs: Mapping[str, Rig],
    compared: Sequence[HeldOutComparison],
    entries: Sequence[RecordingEntry],
    estimator: bool,
) -> dict[str, RigErrors]:
    """Errors on held-out data with one rig for all recordings: as configured, recalibrated and extended.

    `ended`: by name the joint that a rig is of, and its parts of :func:`held_out.ended`.
    """
    totals = held_out.total_errors(compared, entries)
    samples = {part.number: int(part.experiment.held_samples.sum()) for part in compared if part.judges}

    def own(name: str) -> RigErrors:
        ukf = [(entries[k].ukf, count) for k, count in sorted(samples.items())]
        each = [(None if errors is None else getattr(errors, name), count) for errors, count in ukf]
        return RigErrors.total(getattr(totals, name), each)

    def common(name: str) -> RigErrors:
        def errors(part: HeldOutComparison) -> tuple[Errors, Errors | None]:
            alone = held_out.model_errors(part, name, rigs[name])
            if not estimator:
                return alone, None
            return alone, held_out.estimator_errors(*held_out.corrected(part, name), rigs[name])[0]

        parts = _parts_of_one_rig(*ended[name], name)
        found = [errors(part) for part in parts]
        counts = [int(part.experiment.held_samples.sum()) for part in parts]
        runs = [(ukf, count) for (_, ukf), count in zip(found, counts, strict=True)]
        return RigErrors.total(total_of([alone for alone, _ in found], counts), runs)

    # One recording's own values are those of the rig for all.
    alone = compared[0].prepared.fitted == 1
    return {name: own(name) if alone or name not in ended else common(name) for name in MODELS}


def _parts_of_one_rig(joint: JudgedJoint, ended: Sequence[Ended], name: str) -> list[HeldOutComparison]:
    """The recordings that are judged, in their order, with a model's values for all of them."""
    parts: dict[int, HeldOutComparison] = {}
    for (group, base, model), judged in zip(ended, joint.parts, strict=True):
        which, effects = (model, judged.values) if name == MODELS[-1] else (base, {})
        common = common_point(which, effects)
        runs = []
        for (experiment, fitted), number in zip(which.pairs, group.numbers, strict=True):
            # Zeros, scales and late stamps belong to a recording, not to the rig.
            own = {path: value for path, value in fitted.point.effects.items() if calibration.is_calibration(path)}
            runs.append((experiment, number, Point(common.theta, {**common.effects, **own})))
        if group.held_out:
            runs = [(other, number, common) for number, other in enumerate(group.held_out, len(group.experiments))]
        for experiment, number, point in runs:
            points = {name: experiment.started(point)}
            parts.setdefault(number, HeldOutComparison(joint.prepared, experiment.free_run, points, "both", number))
    return [parts[number] for number in sorted(parts)]


def choose(found: Diagnosis, name: str, refusal: Callable[[RigFile], str]) -> RigChoice:
    """Decide which rig files are written, and which one is proposed."""
    errors, explained = found.of_one_rig, found.verdict != UNEXPLAINED
    given = errors["as_configured"]
    extended = RigFile("rig_extended.yaml", found.rig_extended, None, given, errors["extended"])
    recalibrated = RigFile("rig_recalibrated.yaml", found.rig_recalibrated, None, given, errors["recalibrated"])
    own = _own(found)
    no_common = _apart(found) if own else ""
    common = [] if no_common else [extended, recalibrated] if found.effects else [extended]
    if common and not extended.is_fit(explained):
        what = "the recalibrated rig" if not found.effects else "one rig for all recordings" if own else "this rig"
        no_common = f"{what} would be worse than {name} ({'; '.join(extended.worse)})"
    elif common and (why := refusal(extended)):
        no_common = f"no command would read it ({why})"
    elif common and not explained and not extended.is_better(explained):
        no_common = f"nothing is explained, and the recalibrated rig halves no error of {name} that is above noise"
    common = [file for file in common if not (no_common if file is extended else refusal(file))]
    # A law by the time since the start is of these recordings: who goes on with the rig begins with another joint.
    lasting = [file for file in common if not (file is extended and by_time(found.effects))]
    better = [file for file in lasting if file.is_better(explained and file is extended)]
    proposed = min(better, key=lambda file: file.ratio, default=None)
    own = [file for file in own if file.is_fit(explained) and not refusal(file)] if explained or not no_common else []
    if proposed is None and no_common:
        shows = {recording for effect in found.effects for recording in effect.recordings}
        alone = (file for file in own if file.is_better(explained))
        proposed = next((file for file in alone if found.by_recording[file.number or 0].recording in shows), None)
    written = [file for file in common if file in (extended, proposed)]
    return RigChoice((*written, *own), proposed, no_common)


def by_time(effects: Sequence[FoundEffect]) -> bool:
    """Whether one of some effects is a law by the time since the start of a recording."""
    return any(one.law is not None and one.law.argument == "time" for one in effects)


def _own(found: Diagnosis) -> list[RigFile]:
    """The rig of each of several recordings."""
    out = []
    for number, (_, rig) in enumerate(found.own if len(found.own) > 1 else ()):
        entry = found.by_recording[number]
        before, now = (
            None if entry.errors is None else RigErrors(
                getattr(entry.errors, model), None if entry.ukf is None else getattr(entry.ukf, model)
            )
            for model in ("as_configured", "extended")
        )  # fmt: skip
        out.append(RigFile(f"rig_extended_{number + 1}.yaml", rig, number, before, now))
    return out


def _apart(found: Diagnosis) -> str:
    """Why no rig can have what was found, since the recordings show an effect on different muscles; else empty."""
    for number, one in enumerate(found.effects):
        for other in found.effects[number + 1 :]:
            if one.name == other.name and not set(one.recordings) & set(other.recordings):
                each = (f"on muscle {item.muscle} in {', '.join(item.recordings)}" for item in (one, other))
                return f"no rig suits all recordings: {one.name} is {' and '.join(each)}"
    return ""
