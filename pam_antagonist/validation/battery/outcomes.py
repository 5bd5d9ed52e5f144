"""A diagnosis on a battery of joints whose effects are known: what it says of each, and how often it is right."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import load_rig
from pam_antagonist.strict_json import write_json
from pam_antagonist.validation.battery.plants import DURATION, JOINTS, KINDS, RIG, Case

HOLDOUT = 1.0 / 3.0
CHANNELS = ("angle", "torque", "pressure_1", "pressure_2")


class Candidate(NamedTuple):
    """A candidate of the first round.

    Attributes:
        effect: its name.
        delta_bic: evidence where it was fitted.
        foretold: evidence on the held-out part.
        held: share of the excess that it removes there.
        fitted: share that it removes where it was fitted.
    """

    effect: str
    delta_bic: float
    foretold: float
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
        sizes: of its effects.
        duration: of each recording [s].
        verdict: ``effect``, ``none`` or ``unexplained``; ``refused`` where the recordings were.
        found: name, muscle of each effect that was found, the strongest first.
        ambiguous_with: names that the diagnosis could not tell from these.
        leading: the best candidates of the first round, whatever the verdict was.
        channel: that the effects move most.
        errors: held-out RMSE of that channel [deg, N m or Pa]: recalibrated, extended, and of the true model.
        seconds: that the diagnosis took.
        threads: that it had.
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

    @property
    def names(self) -> tuple[str, ...]:
        """Names of what was found; nothing unless the verdict is that there is an effect."""
        return tuple(name for name, _ in self.found) if self.verdict == "effect" else ()

    @property
    def right(self) -> bool:
        """Single: the right effect first. Pair: both found. None: nothing. Foreign: unexplained."""
        if self.kind == "single":
            return self.names[:1] == (self.effects[0][0],)
        if self.kind == "pair":
            return {name for name, _ in self.effects} <= set(self.names)
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
"""Takes the recordings; the result has ``verdict``, ``effects``, ``ambiguous_with``, ``errors`` and ``ranking``."""


_LEADING = 3
_REFUSAL = SimpleNamespace(verdict="refused", effects=(), ambiguous_with=(), errors={}, ranking=())


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
        said = diagnose(recordings)
    except BadInput:
        # Recordings like a laboratory's that are refused are an answer too, and a wrong one.
        said = _REFUSAL
    seconds = time.monotonic() - begin
    moved = _by_channel(case.moved(duration)) if case.effects else {}
    channel = max(moved, key=lambda name: moved[name]) if moved else None
    errors: dict[str, float | None] = {}
    if channel is not None:
        errors = {key: _error(said.errors.get(key), channel) for key in ("recalibrated", "extended")}
        errors["true"] = true_error(case, recordings, channel)
    return Outcome(
        name=case.name,
        kind=case.kind,
        effects=case.effects,
        form=case.form,
        seed=case.seed,
        sizes=case.sizes,
        duration=duration,
        verdict=str(said.verdict),
        found=tuple((str(effect.name), effect.muscle) for effect in said.effects),
        ambiguous_with=tuple(str(name) for name in said.ambiguous_with),
        leading=_leading(said.ranking),
        channel=channel,
        errors=errors,
        seconds=seconds,
        threads=threads,
    )


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


def _error(errors: Mapping[str, Any] | None, channel: str) -> float | None:
    """RMSE of a channel among a diagnosis's errors, which are laid out as in its report."""
    if errors is None:
        return None
    if channel.startswith("pressure_"):
        pair = (errors.get("pressure") or {}).get("rmse_pa")
        return None if pair is None else float(pair[int(channel[-1]) - 1])
    value = (errors.get(channel) or {}).get({"angle": "rmse_deg", "torque": "rmse_nm"}[channel])
    return None if value is None else float(value)


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
        for key in ("form", "sizes", "ambiguous_with"):
            content[key] = tuple(content[key])
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


@dataclass(frozen=True)
class Score:
    """How often a diagnosis was right.

    Attributes:
        what: is counted.
        wanted: in words.
        value: the share, None where there was no such case.
        count: of how many.
        bound: the share that is wanted.
        at_most: whether ``bound`` is the most, not the least.
    """

    what: str
    wanted: str
    value: float | None
    count: int
    bound: float | None = None
    at_most: bool = False

    @property
    def holds(self) -> bool | None:
        """Whether it is what was wanted; None where nothing was, or there is nothing to count."""
        if self.bound is None or self.value is None:
            return None
        return self.value <= self.bound if self.at_most else self.value >= self.bound


def scores(outcomes: Sequence[Outcome]) -> list[Score]:
    """The figures that the battery is for."""
    by_kind = {kind: [item for item in outcomes if item.kind == kind] for kind in KINDS}

    def share(values: Sequence[bool]) -> tuple[float | None, int]:
        return (sum(values) / len(values) if values else None), len(values)

    def right(kind: str) -> tuple[float | None, int]:
        return share([item.right for item in by_kind[kind]])

    single, pairs = by_kind["single"], by_kind["pair"]
    on_muscle = [item.right_muscle for item in single if item.right_muscle is not None]
    not_told_apart = [item.right or item.effects[0][0] in item.ambiguous_with for item in single]
    one_first = [bool(item.names) and item.names[0] in dict(item.effects) for item in pairs]
    leads = [
        item.right or [candidate.effect for candidate in item.leading[:1]] == [item.effects[0][0]] for item in single
    ]
    exact = [not item.superfluous for item in (*single, *pairs) if item.names]
    alarms = [not item.right for item in by_kind["none"]]
    reductions = [item.reduction for item in single if item.right and item.reduction is not None]
    reduction = median(reductions) if reductions else None
    return [
        Score("single effect: the right one first", "at least 90 %", *right("single"), 0.9),
        Score("single effect: and on its muscle", "", *share(on_muscle)),
        Score("single effect: first, or among those it cannot be told from", "", *share(not_told_apart)),
        Score("single effect: named, or the first of the candidates where none explains enough", "", *share(leads)),
        Score("two effects: both found", "at least 70 %", *right("pair"), 0.7),
        Score("two effects: one of them first", "", *share(one_first)),
        Score("one or two effects, some found: none named that is not there", "", *share(exact)),
        Score("nothing: false alarm", "at most 5 %", *share(alarms), 0.05, at_most=True),
        Score("in no catalogue: unexplained", "at least 80 %", *right("foreign"), 0.8),
        Score(
            "error that a true model takes away, taken away (median)", "at least 70 %", reduction, len(reductions), 0.7
        ),
    ]


def confusion(outcomes: Sequence[Outcome]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """What was there against what was said first.

    Returns:
        Header and rows of text; a row is an effect that was alone, ``none``, or what is in no catalogue; a column the
        first effect that was found, ``none`` or ``unexplained``.
    """
    counts: dict[str, dict[str, int]] = {}
    for item in outcomes:
        if item.kind != "pair":
            row = "none" if item.kind == "none" else item.effects[0][0]
            row = f"({item.form[0]})" if item.kind == "foreign" else row
            said = item.names[0] if item.names else item.verdict
            counts.setdefault(row, {})
            counts[row][said] = counts[row].get(said, 0) + 1
    order = [*CATALOGUE, "none", *sorted(row for row in counts if row.startswith("("))]
    rows = [row for row in order if row in counts]
    columns = [c for c in (*CATALOGUE, "none", "unexplained", "refused") if any(c in counts[row] for row in rows)]
    body = tuple((row, *(str(counts[row][c]) if c in counts[row] else "·" for c in columns)) for row in rows)
    return ("there \\ said first", *columns), body
