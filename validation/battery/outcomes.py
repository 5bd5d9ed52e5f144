"""What a diagnosis says of each joint of a battery, beside what is so."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from pam_antagonist.diagnosis.errors import Errors
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.rig import load_rig
from pam_antagonist.strict_json import write_json
from validation.battery.plants import DURATION, JOINTS, RIG, Case

HOLDOUT = 1.0 / 3.0
CHANNELS = ("angle", "torque", "pressure_1", "pressure_2")


class Candidate(NamedTuple):
    """A candidate of the first round.

    Attributes:
        effect: its name.
        delta_bic: evidence where it was fitted.
        held_out_evidence: evidence on the held-out part.
        held: share of the excess that it removes there.
        fitted: share that it removes where it was fitted.
    """

    effect: str
    delta_bic: float
    held_out_evidence: float
    held: float
    fitted: float


@dataclass(frozen=True)
class Outcome:
    """What a diagnosis said of one case.

    Attributes:
        name: of the case.
        kind: of the case.
        effects: what is there: name, muscle.
        form: how it is written.
        seed: of the case.
        sizes: of its effects, as they were asked for.
        duration: of each recording [s].
        verdict: ``effect``, ``none`` or ``unexplained``; ``refused`` where the recordings were.
        found: name, muscle of each effect that was found, the strongest first.
        ambiguous_with: names that the diagnosis could not tell from these.
        leading: the best candidates of the first round, whatever the verdict was.
        channel: that the effects move most.
        errors: held-out RMSE of that channel [deg, N m or Pa]: recalibrated, extended, and of the true model.
        seconds: that the diagnosis took.
        threads: that it had.
        reached: sizes that the effects really had.
        code: fingerprint of the program that made the diagnosis.
        calibrations: that were found.
    """

    name: str
    kind: str
    effects: tuple[tuple[str, int | None], ...]
    form: tuple[str, ...]
    seed: int
    sizes: tuple[float, ...]
    duration: float
    verdict: str
    found: tuple[tuple[str, int | None], ...]
    ambiguous_with: tuple[str, ...]
    leading: tuple[Candidate, ...]
    channel: str | None
    errors: Mapping[str, float | None]
    seconds: float
    threads: int
    reached: tuple[float, ...] = ()
    code: str = ""
    calibrations: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was found; nothing unless the verdict is that there is an effect."""
        return tuple(name for name, _ in self.found) if self.verdict == "effect" else ()

    @property
    def right(self) -> bool:
        """Single: the right effect first. Pair: both found. None: nothing. Foreign: unexplained. Calibration: named."""
        if self.kind == "single":
            return self.names[:1] == (self.effects[0][0],)
        if self.kind == "pair":
            return {name for name, _ in self.effects} <= set(self.names)
        if self.kind == "calibration":
            return self.verdict == "none" and self.calibrations == self.form
        return self.verdict == {"none": "none", "foreign": "unexplained"}[self.kind]

    @property
    def superfluous(self) -> bool:
        """Whether an effect was named that is not there."""
        return not set(self.names) <= {name for name, _ in self.effects}

    @property
    def right_muscle(self) -> bool | None:
        """Whether the first effect was found on its muscle; None where it has none, or was not found."""
        if self.kind != "single" or not self.right or self.effects[0][1] is None:
            return None
        return self.found[0][1] == self.effects[0][1]

    @property
    def reduction(self) -> float | None:
        """Of the error that a true model takes away, the share that the extended one took away."""
        before, after, true = (self.errors.get(key) for key in ("recalibrated", "extended", "true"))
        if before is None or after is None or true is None or before <= 1.05 * true:
            return None
        return (before - after) / (before - true)


Diagnose = Callable[[tuple[Recording, Recording]], Any]
"""Takes the recordings; the result has ``verdict``, ``effects``, ``ambiguous_with``, ``errors``, ``ranking`` and
``calibrations``."""


_LEADING = 3
_REFUSAL = SimpleNamespace(verdict="refused", effects=(), ambiguous_with=(), errors=None, ranking=(), calibrations=())


def judge(case: Case, diagnose: Diagnose, duration: float = DURATION, threads: int = 1) -> Outcome:
    """Make a case's recordings, have them diagnosed, and note what was said beside what is so.

    Args:
        case: the joint.
        diagnose: the diagnosis.
        duration: of each recording [s].
        threads: that the diagnosis has.
    """
    recordings = case.recordings(duration)
    begin = time.monotonic()
    try:
        diagnosis = diagnose(recordings)
    except BadInput:
        # Recordings like a laboratory's that are refused are an answer too, and a wrong one.
        diagnosis = _REFUSAL
    seconds = time.monotonic() - begin
    moved = _by_channel(case.moved(duration)) if case.effects else {}
    channel = max(moved, key=lambda name: moved[name]) if moved else None
    errors: dict[str, float | None] = {}
    if channel is not None:
        errors = dict.fromkeys(("recalibrated", "extended"))
        if diagnosis.errors is not None:
            errors = {key: _error(getattr(diagnosis.errors, key), channel) for key in errors}
        errors["true"] = true_error(case, recordings, channel)
    return Outcome(
        name=case.name,
        kind=case.kind,
        effects=case.effects,
        form=case.form,
        seed=case.seed,
        sizes=case.sizes,
        duration=duration,
        verdict=str(diagnosis.verdict),
        found=tuple((str(effect.name), effect.muscle) for effect in diagnosis.effects),
        ambiguous_with=tuple(str(name) for name in diagnosis.ambiguous_with),
        leading=_leading(diagnosis.ranking),
        channel=channel,
        errors=errors,
        seconds=seconds,
        threads=threads,
        reached=case.reached,
        code=fingerprint(),
        calibrations=tuple(str(item.name) for item in diagnosis.calibrations),
    )


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """Of every source file of the program, but for what measures it: equal as long as nothing is changed."""
    package = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        if "validation" not in source.relative_to(package).parts:
            digest.update(source.relative_to(package).as_posix().encode())
            digest.update(source.read_bytes())
    return digest.hexdigest()[:12]


def _leading(ranking: Iterable[Any]) -> tuple[Candidate, ...]:
    first = [t for t in ranking if t.round == 1 and t.shares is not None]
    return tuple(Candidate(t.effect, t.delta_bic, t.held_out_evidence, *t.shares) for t in first[:_LEADING])


def _by_channel(moved: Mapping[str, float]) -> dict[str, float]:
    """The larger of both recordings; a locked joint's angle tells nothing."""
    return {name: max(moved[f"{joint} {name}"] for joint in JOINTS) for name in CHANNELS}


def true_error(case: Case, recordings: Iterable[Recording], channel: str) -> float:
    """Held-out RMSE of the joint's own equations with its own numbers: what the sensors add.

    Args:
        case: the joint.
        recordings: free, locked.
        channel: one of ``CHANNELS``.

    Returns:
        Over the last third of both [deg, N m or Pa]; for the angle, of the free one.
    """
    squares = []
    for joint, recording in zip(JOINTS, recordings, strict=True):
        if channel == "angle" and joint == "locked":
            continue
        true = case.channels(joint, len(recording) * load_rig(RIG).sample_period)
        first = round(len(recording) * (1.0 - HOLDOUT))
        difference = (_values(recording, channel) - _values(true, channel))[first:]
        squares.append(difference**2)
    rmse = float(np.sqrt(np.mean(np.concatenate(squares))))
    return float(np.degrees(rmse)) if channel == "angle" else rmse


def _values(source: Any, channel: str) -> np.ndarray:
    if channel.startswith("pressure_"):
        return np.asarray(source.pressure[:, int(channel[-1]) - 1])
    return np.asarray(getattr(source, channel))


def _error(errors: Errors, channel: str) -> float | None:
    """RMSE of a channel [deg, N m or Pa], None where it was not measured."""
    if channel.startswith("pressure_"):
        return errors.rmse_pa[int(channel[-1]) - 1]
    known = errors.angle if channel == "angle" else errors.torque
    return None if known is None else known.rmse


def save(folder: Path, number: int, outcome: Outcome) -> None:
    """Write an outcome, whole or not at all.

    Args:
        folder: of the battery.
        number: of the case.
        outcome: what is written.
    """
    path = _path(folder, number)
    aside = path.with_suffix(".part")
    write_json(aside, asdict(outcome))
    aside.rename(path)


def load(folder: Path, number: int, case: Case, duration: float) -> Outcome | None:
    """Read the outcome of a case that is done.

    Args:
        folder: of the battery.
        number: of the case.
        case: what it has to be.
        duration: likewise [s].

    Raises:
        BadInput: the file is of another battery, or no outcome.
    """
    path = _path(folder, number)
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        for key in ("effects", "found"):
            content[key] = tuple((str(name), muscle) for name, muscle in content[key])
        content["leading"] = tuple(Candidate(*values) for values in content["leading"])
        for key in ("form", "sizes", "reached", "ambiguous_with", "calibrations"):
            content[key] = tuple(content.get(key, ()))
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


def _path(folder: Path, number: int) -> Path:
    return folder / f"case_{number:03d}.json"
