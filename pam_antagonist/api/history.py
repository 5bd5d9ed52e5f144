"""``history``: what a rig's log book tells, and entries from results."""

from __future__ import annotations

import datetime
import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.api.diagnose import EpisodesIdentifyResult, IdentifyResult
from pam_antagonist.api.replay import CheckResult
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.result import FromPressures
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.unknown import parameters
from pam_antagonist.model import muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording, bag_name, recording_hash
from pam_antagonist.recording.csv_import import began_ns
from pam_antagonist.report import identify_episodes
from pam_antagonist.report.history import FORCE, HistoryResult, Limit, values_of
from pam_antagonist.report.result import Result
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.logbook import Entry, RecordingSpan, append, book_of, identity, measured, read

__all__ = ["HistoryResult", "Limit", "history", "log"]

_STEP = 0.05
"""Of a fitted value, for a slope, in standard deviations of its prior."""
_ROUND = 0.5e5  # [Pa]


def history(
    rig: str | Path, logs: Sequence[str | Path] = (), limits: Mapping[str, Limit] | None = None
) -> HistoryResult:
    """What has changed in a rig, from its log book.

    Args:
        rig: its file; the log book is the file ``NAME.log.jsonl`` beside it.
        logs: further log books, or rig files with one beside them.
        limits: of values, by name: at which value something has to be done.

    Returns:
        Every value over time, with trends and forecasts.

    Raises:
        BadInput: no log book, none with an entry of this rig, or a limit of a value that is not in it.

    Example:
        >>> from pam_antagonist import history
        >>> history("examples/wear/my_rig.yaml").changed[0].name
        'force of muscle 2'
    """
    known, books = load_rig(rig, regulators=True), []
    for path in (rig, *logs):
        book = Path(path) if str(path).endswith(".jsonl") else book_of(path)
        if book is None or (not book.exists() and path == rig and not logs):
            where = "rigs of the package have none" if book is None else f"{book} does not exist"
            raise BadInput(
                f"{path}: no log book ({where}); identify, close_loop, check and commission write it beside a rig file"
            )
        if book.exists() or path != rig:
            books.append(book)
    found = read(books, known)
    if not found.entries:
        raise BadInput(f"{books[0]}: no entry of rig {known.name}; {'; '.join(found.notes) or 'the file is empty'}")
    given = dict(limits or {})
    names = values_of(found.entries)
    for name in given.keys() - names:
        close = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean {close[0]!r}?" if close else f"it has {', '.join(sorted(names)[:8])}"
        raise BadInput(f"limit of {name!r}: the log book has no such value; {hint}")
    return HistoryResult(known, found, given)


def log(
    command: str,
    rig_file: str | Path,
    recordings: Sequence[Recording],
    rig: Rig,
    result: object,
    written: Path | None = None,
) -> None:
    """Write what a command found into the log book of its rig.

    The rig file that came out of it gets a log book too, which begins with the entries of the rig it came from. So the
    log book goes on, whichever of the two files is used next.

    Args:
        command: ``identify``, ``close_loop``, ``check`` or ``commission``.
        rig_file: that was given.
        recordings: that were used.
        rig: that was given.
        result: the result.
        written: the rig file that came out of it.

    Raises:
        BadInput: it cannot be written.
    """
    books = [book for book in (book_of(rig_file), None if written is None else book_of(written)) if book is not None]
    made = None if written is None else load_rig(written, regulators=True)
    append(books, entry(command, recordings, rig, result, made), book_of(rig_file))


def entry(command: str, recordings: Sequence[Recording], rig: Rig, result: object, made: Rig | None = None) -> Entry:
    """What a command found, as an entry. `made`: the rig that came out of it."""
    spans = tuple(
        RecordingSpan.of(bag_name(one.path), began_ns(one), one.duration_s, recording_hash(one)) for one in recordings
    )
    return Entry(
        at=datetime.datetime.now(datetime.timezone.utc).replace(microsecond=0), command=command, rig=identity(rig),
        recordings=spans, made="" if made is None else identity(made), **_content(result),
    )  # fmt: skip


def _content(result: object) -> dict[str, Any]:
    if isinstance(result, IdentifyResult):
        return _identified(result)
    if isinstance(result, EpisodesIdentifyResult):
        return _of_episodes(result)
    if isinstance(result, CheckResult):
        worst = result.findings[0]
        return {"verdict": worst.status, "said": worst.text}
    return _diagnosed(result.report) if isinstance(result, Result) else {}


def _identified(result: IdentifyResult) -> dict[str, Any]:
    said = f"rejected: {result.rejected}" if result.rejected else ""
    if not said and "identified" in result.errors_deg:
        said = f"the filter's angle errs by {result.errors_deg['identified']:.2g}° on held-out data"
    out: dict[str, Any] = {"verdict": "rejected" if result.rejected else "identified", "said": said}
    fitted = result.found
    if result.rejected or not isinstance(fitted, FromPressures):  # a sealed joint has no covariance
        return out
    values, blocks = dict[str, tuple[float, float, str]](), []
    for fit in fitted.fits:
        if fit.lost:
            continue
        common = [k for k, item in enumerate(fit.unknowns) if not item.recording]
        names = tuple(fit.unknowns[k].name for k in common)
        amounts = fit.covariance[np.ix_(common, common)]
        scale = np.array([fit.stds[name] for name in names]) / np.sqrt(np.diag(amounts))
        matrix = amounts * np.outer(scale, scale)
        blocks.append((names, tuple(tuple(float(f"{x:.4g}") for x in row) for row in matrix)))
        values |= _forces(fitted.rig, fit)
    # What the data do not determine follows the prior, which says nothing of a change.
    values |= {item.name: (item.value, item.std, item.unit) for item in result.parameters if item.determined}
    return out | {"values": measured(values), "covariance": tuple(blocks)}


def _of_episodes(result: EpisodesIdentifyResult) -> dict[str, Any]:
    """Values by episode: a standard error is that of a normal distribution with the same 95 % interval.

    What the episodes do not determine has no interval, and says nothing of a change.
    """
    if result.rejected:
        return {"verdict": "rejected", "said": f"rejected: {result.rejected}"}
    rig, values = result.rig, {}
    for name, interval in result.found.values.items():
        if not interval.is_known:
            continue
        unit, factor = identify_episodes.unit(rig, name)
        std = factor * interval.std
        values[identify_episodes.value_name(rig, name)] = (factor * interval.value, std, unit)
    errs = result.found.errors["identified"][0].value
    said = f"the model's angle errs by {errs:.2g}° on later episodes"
    return {"verdict": "identified", "said": said, "values": measured(values)}


def _forces(rig: Rig, fit: Fit) -> dict[str, tuple[float, float, str]]:
    """What half of the supply's pressure adds to the forces at angle 0; their coefficients are fitted together."""
    middle = 0.5 * (rig.atmosphere.pressure + rig.supply.pressure)
    pressure = round(middle / _ROUND) * _ROUND if rig.units.pressure == "pascal" else middle
    base = rig.parameters()

    def force(amounts: Any, index: int) -> float:
        values = {item.name: item.value(float(x)) for item, x in zip(fit.unknowns, amounts, strict=True)}
        p = base.copy()
        for path, value in parameters(fit.unknowns, values).items():
            if path in par.INDEX:
                p[par.INDEX[path]] = value
        length = p[par.INDEX["geometry.length"]]
        return float(muscle.force(index, length, pressure, p) - muscle.force(index, length, rig.atmosphere.pressure, p))

    out = {}
    for index in (0, 1):
        steps = _STEP * np.eye(len(fit.unknowns))
        slope = np.array([
            (force(fit.amounts + step, index) - force(fit.amounts - step, index)) / (2.0 * _STEP) for step in steps
        ])  # fmt: skip
        if slope.any():
            std = float(np.sqrt(slope @ fit.covariance @ slope))
            unit = "N" if rig.units.force == "newton" else ""
            out[f"{FORCE} {index + 1}"] = (force(fit.amounts, index), std, unit)
    return out


def _diagnosed(report: Mapping[str, Any]) -> dict[str, Any]:
    """What is in the ``report.json`` of a diagnosis: sizes of effects, and calibrations."""
    values = {}
    for effect in report.get("effects") or ():
        where = f", muscle {effect['muscle']}" if effect.get("muscle") else ""
        for name, size in (effect.get("parameters") or {}).items():
            values[f"{effect['name']}: {name}{where}"] = (size["value"], size["std"], size["unit"] or "")
    for item in report.get("calibration") or ():
        values[f"calibration: {item['name']}"] = (item["value"], item["std"], item["unit"])
    known = {name: size for name, size in values.items() if None not in size[:2] and np.isfinite(size[:2]).all()}
    return {
        "verdict": report.get("verdict") or "", "said": report.get("sentence") or "", "values": measured(known)
    }  # fmt: skip
