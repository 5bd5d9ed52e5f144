"""What a diagnosis says of each joint of a battery, beside what is so."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.rig import load_rig
from validation import frame
from validation.battery.places import LEARNED, Found, are_arguments, found, is_place
from validation.battery.plants import CHANNELS, DURATION, JOINTS, RIG, Case, values_of

HOLDOUT = 1.0 / 3.0
Diagnose = Callable[[tuple[Recording, Recording]], Any]
"""Takes the recordings; the result has ``verdict``, ``effects``, ``ambiguous_with``, ``errors``, ``ranking`` and
``calibrations``."""
_LEADING = 3
_REFUSAL = SimpleNamespace(verdict="refused", effects=(), ambiguous_with=(), errors=None, ranking=(), calibrations=())


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis said of one case."""

    name: str
    kind: str
    effects: tuple[tuple[str, int | None], ...]  # what is there: name, muscle
    form: tuple[str, ...]
    seed: int
    sizes: tuple[float, ...]  # of the effects, as they were asked for
    duration: float  # of each recording [s]
    verdict: str  # ``refused`` where the recordings were
    found: tuple[tuple[str, int | None], ...]  # name, muscle of each effect that was found, the strongest first
    ambiguous_with: tuple[str, ...]
    leading: tuple[str, ...]  # the best candidates of the first round, whatever the verdict was
    channel: str | None  # that the effects move most
    errors: Mapping[str, float | None]  # held-out RMSE of it [deg, N m or Pa], and of the angle; ``true``: the sensors'
    seconds: float  # that the diagnosis took
    threads: int
    reached: tuple[float, ...] = ()  # sizes that the effects really had
    code: str = ""  # commit of the program that made the diagnosis
    calibrations: tuple[str, ...] = ()
    where: tuple[Found, ...] = ()  # the place of each effect that was found

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was found; nothing unless the verdict is that there is an effect."""
        return tuple(name for name, _ in self.found) if self.verdict == "effect" else ()

    @property
    def right(self) -> bool:
        """Single: the right effect first. Pair: both found. None: nothing. Calibration: named.

        Foreign: unexplained, or a law that was learned, in the right place.
        """
        if self.kind == "single":
            return self.names[:1] == (self.effects[0][0],)
        if self.kind == "pair":
            return {name for name, _ in self.effects} <= set(self.names)
        if self.kind == "calibration":
            return self.verdict == "none" and self.calibrations == self.form
        if self.kind == "foreign" and set(self.names) == {LEARNED}:
            return self.places_right
        return self.verdict == {"none": "none", "foreign": "unexplained"}[self.kind]

    @property
    def places_right(self) -> bool:
        """Whether each effect was found in its place, each by another one; one that is alone has to come first."""
        first = self.where if self.kind == "pair" else self.where[:1]
        each = (zip(found, self.effects, strict=True) for found in permutations(first, len(self.effects)))
        return bool(self.names) and any(all(is_place(*pair) for pair in pairs) for pairs in each)

    @property
    def arguments_right(self) -> bool:
        """Whether the first that was found is in its place and depends on what the effect depends on."""
        return self.places_right and are_arguments(self.where[0], self.effects[0])

    @property
    def superfluous(self) -> bool:
        """Whether an effect was named that is not there."""
        return not set(self.names) <= {LEARNED, *(name for name, _ in self.effects)}

    @property
    def confused(self) -> bool:
        """Whether an effect was named first that is not there."""
        return bool(self.names) and self.names[0] not in dict(self.effects)

    @property
    def right_muscle(self) -> bool | None:
        """Whether the first effect was found on its muscle; None where it has none, or was not found."""
        if self.kind != "single" or not self.right or self.effects[0][1] is None:
            return None
        return self.found[0][1] == self.effects[0][1]

    def taken_away(self, since: str) -> float | None:
        """Of the error that a true model takes away, the share that the extended one took away."""
        before, after, true = (self.errors.get(key) for key in (since, "extended", "true"))
        if before is None or after is None or true is None or before <= 1.05 * true:
            return None
        return (before - after) / (before - true)

    @property
    def angle_left(self) -> float | None:
        """The angle's held-out error of the extended model, as a share of the configured one's."""
        before, after = (self.errors.get(f"angle_{key}") for key in ("as_configured", "extended"))
        return after / before if before and after is not None else None


def judge(case: Case, diagnose: Diagnose, duration: float = DURATION, threads: int = 1) -> Outcome:
    """Make a case's recordings, have them diagnosed, and note what was said beside what is so."""
    recordings = case.recordings(duration)
    begin = time.monotonic()
    try:
        said = diagnose(recordings)
    except BadInput:
        # Recordings like a laboratory's that are refused are an answer too, and a wrong one.
        said = _REFUSAL
    seconds = time.monotonic() - begin
    moved = case.moved(duration) if case.effects else {}
    # The larger of both recordings; a locked joint's angle tells nothing.
    channel = max(CHANNELS, key=lambda name: max(moved[f"{joint} {name}"] for joint in JOINTS)) if moved else None
    errors: dict[str, float | None] = {}
    if channel is not None:
        errors = {"true": true_error(case, recordings, channel)}
        for key in ("as_configured", "recalibrated", "extended"):
            for name, one in ((key, channel), (f"angle_{key}", "angle")):
                errors[name] = None if said.errors is None else _error(getattr(said.errors, key), one)
    return Outcome(
        case.name, case.kind, case.effects, case.form, case.seed, case.sizes, duration, str(said.verdict),
        tuple((str(effect.name), effect.muscle) for effect in said.effects), tuple(map(str, said.ambiguous_with)),
        tuple(t.effect for t in said.ranking if t.round == 1 and t.shares is not None)[:_LEADING],
        channel, errors, seconds, threads, case.reached, frame.commit(),
        tuple(str(item.name) for item in said.calibrations), tuple(found(effect) for effect in said.effects),
    )  # fmt: skip


def true_error(case: Case, recordings: Iterable[Recording], channel: str) -> float:
    """Held-out RMSE [deg, N m or Pa] of the joint's own equations with its own numbers: what the sensors add."""
    squares = []
    for joint, recording in zip(JOINTS, recordings, strict=True):
        if channel == "angle" and joint == "locked":
            continue
        true = case.channels(joint, len(recording) * load_rig(RIG).sample_period)
        difference = values_of(recording, channel) - values_of(true, channel)
        squares.append(difference[round(len(recording) * (1.0 - HOLDOUT)) :] ** 2)
    rmse = float(np.sqrt(np.mean(np.concatenate(squares))))
    return float(np.degrees(rmse)) if channel == "angle" else rmse


def _error(errors: Any, channel: str) -> float | None:
    """RMSE of a channel [deg, N m or Pa], None where it was not measured."""
    if channel.startswith("pressure_"):
        return float(errors.rmse_pa[int(channel[-1]) - 1])
    known = getattr(errors, channel)
    return None if known is None else float(known.rmse)


def path_of(folder: Path, number: int) -> Path:
    """Where a case's outcome is."""
    return folder / f"case_{number:03d}.json"


def load(folder: Path, number: int, case: Case, duration: float) -> Outcome | None:
    """The outcome of a case that is done, None of one that is not; one of another battery is refused."""
    path = path_of(folder, number)
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        for key, value in content.items():
            if isinstance(value, list):
                content[key] = tuple(tuple(item) if isinstance(item, list) else item for item in value)
        content["where"] = tuple(Found(tuple(a), muscle, tuple(b)) for a, muscle, b in content["where"])
        outcome = Outcome(**content)
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{path}: no outcome of a battery ({error}); expected one, or no such file") from None
    asked = (case.name, case.seed, case.form, case.sizes, duration)
    if (outcome.name, outcome.seed, outcome.form, outcome.sizes, outcome.duration) != asked:
        raise BadInput(
            f"{path}: is of another battery ({outcome.name}, seed {outcome.seed}, {outcome.duration:g} s); expected "
            f"{case.name}, seed {case.seed}, {duration:g} s: choose a new --out"
        )
    return outcome
