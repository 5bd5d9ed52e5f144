"""The report of ``close_loop`` as a document: sentences and tables of its typed numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pam_antagonist.diagnosis.errors import ModelErrors
from pam_antagonist.diagnosis.result import RecordingEntry
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.report import close_loop_figures as drawn
from pam_antagonist.report.assumption import assumption, in_first_lines
from pam_antagonist.report.channels import CHANNELS, TORQUE
from pam_antagonist.report.close_loop_findings import assumed, calibration_findings, definitions, findings, sentence
from pam_antagonist.report.document import (
    Block,
    Definitions,
    Document,
    Finding,
    Findings,
    Section,
    Text,
    Tile,
    Tiles,
    background,
    note,
    warn,
)
from pam_antagonist.report.table import MISSING, Comparison, Table, number, percent
from pam_antagonist.report.units import readable

if TYPE_CHECKING:
    from pam_antagonist.report.close_loop import DiagnoseResult

_FEW_WORDS = 300
"""Longest list of what the recordings cannot show [characters] that a terminal shows."""
_TITLES = {"effect": "An effect was found", "none": "Nothing is missing", "unexplained": "Unexplained"}


def summary(found: DiagnoseResult) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    unseen = _unseen(found)
    if sum(len(item.text) for item in unseen) > _FEW_WORDS:
        unseen = (note("What these recordings cannot show is listed in the report."),)
    notes = (*(warn(sentence(text)) for text in found.warnings), *unseen)
    return (
        Text(found.sentence),
        Findings((*calibration_findings(found), *notes)),
        *in_first_lines(assumption(found.start)),
        errors_table(found),
        sizes_table(found),
        calibration_table(found),
        ranking_table(found),
        Findings(_next_steps(found)),
    )


def document(found: DiagnoseResult, with_figures: bool = True) -> Document:
    """The page."""
    lede = (
        "This report compares the model of the joint with measurements. It traces what the model lacks to a physical "
        "effect, if one explains it on data that no fit used."
    )
    title = _TITLES[found.verdict]
    if found.effects:
        title = "Found: " + ", ".join(dict.fromkeys(effect.in_short.replace("_", " ") for effect in found.effects))
    elif found.calibrations and found.verdict == "none":
        title = "Calibration: " + ", ".join(item.name.replace("_", " ") for item in found.calibrations)
    parts: list[Block] = [Text(lede, "lede"), Text(found.sentence, "verdict")]
    before_and_after = drawn.residuals(found) if with_figures else ()
    parts += [
        Tiles(_tiles(found)),
        Findings((*calibration_findings(found), *findings(found), *_next_steps(found))),
        *before_and_after[:1],
        *in_first_lines(assumption(found.start)),
        errors_table(found),
    ]
    if before_and_after[1:]:
        others = "More residuals before and after"
        parts.append(Section(others, before_and_after[1:], 2, "residual"))
    if found.calibrations:
        parts.append(Section("Calibration", (calibration_table(found),), 2, "calibration"))
    if found.effects:
        figures = (*drawn.laws(found.effects), *drawn.profiles(found.profiles)) if with_figures else ()
        parts.append(Section("Size of the effect", (sizes_table(found), *_laws(found), *figures), 2, "parameters"))
    parts.append(Section("All candidates", (ranking_table(found),), 2, "candidates"))
    if found.remaining:
        parts.append(Section("What is left", drawn.left(found.remaining, with_figures), 2, "left"))
    statistics = drawn.statistics(found, with_figures)
    parts.append(Section("Statistics of the residuals", statistics, 2, "statistics", folded=True))
    if found.unseen:
        parts.append(Section("What these recordings cannot show", (Findings(_unseen(found)),), folded=True))
    parts.append(Section("What was assumed", (Definitions(assumed(found)),), folded=True))
    parts += background(definitions(found), _provenance(found))
    return Document("Closing the loop with measured data", title, tuple(parts))


def _next_steps(found: DiagnoseResult) -> tuple[Finding, ...]:
    return tuple(note(step) for step in found.next_steps)


def _unseen(found: DiagnoseResult) -> tuple[Finding, ...]:
    return tuple(note(text) for text in found.unseen)


# ------------------------------------------------------------------ tables and tiles


def errors_table(found: DiagnoseResult) -> Table:
    """Errors of the three models on held-out data: the model alone, then the estimator."""
    out = Comparison("", "as configured", "recalibrated", "extended")
    errors = found.errors
    if found.driven:
        out.heading("Model driven by the measured angle")
        _channel_rows(out, errors, ("torque",), largest=True)
        for key, name in (("rmse_sliding_nm", "while it slides"), ("rmse_sticking_nm", "while it sticks")):
            values = [getattr(model.sliding, key, None) for model in errors.all]
            if errors.extended.sliding is not None:
                out.values(f"    torque {name}, RMSE [N m]", values)
    else:
        out.heading("Model alone, from what was commanded")
        _channel_rows(out, errors, ("angle", "torque"), largest=True)
    _pressure_rows(out, errors, found.driven)
    if found.driven and errors.extended.angle is not None:
        out.heading("Model alone, driven by the external torque")
        _channel_rows(out, errors, ("angle",))
    for part in found.recordings:
        if part.ukf is not None:
            out.heading(f"Estimator from pressures alone, {part.recording}")
            _channel_rows(out, part.ukf, ("angle", "torque"))
    return out.table("Errors on held-out data")


def _channel_rows(out: Comparison, errors: ModelErrors, names: Sequence[str], largest: bool = False) -> None:
    """Rows of the named channels; with `largest` also the largest errors and channels that were not measured."""
    for channel in CHANNELS:
        known = [item for model in errors.all if (item := getattr(model, channel.name)) is not None]
        if channel.name not in names:
            continue
        if len(known) == len(errors.all):
            out.values(f"  {channel.name} RMSE [{channel.unit}]", [item.rmse for item in known])
            if largest:
                out.values(f"  {channel.name} largest [{channel.unit}]", [item.largest for item in known])
        elif largest:
            out.text(f"  {channel.name}", "not measured", MISSING, MISSING)


def _pressure_rows(out: Comparison, errors: ModelErrors, mean: bool) -> None:
    means = [model.mean_rmse_pa for model in errors.all]
    if mean:
        out.pressures("  mean pressure RMSE", means)
    for muscle in (0, 1):
        out.pressures(f"  pressure {muscle + 1} RMSE", [model.rmse_pa[muscle] for model in errors.all])


def ranking_table(found: DiagnoseResult) -> Table:
    """All candidates of all rounds."""
    rows = tuple(
        (
            item.effect + (" (taken)" if item.taken else ""),
            str(item.round),
            f"{item.score:.1f}",
            " · ".join(f"{value:.1f}" for value in item.muscles or ()) or MISSING,
            MISSING if item.delta_bic is None else f"{item.delta_bic:.1f}",
            percent(None if item.delta_bic is None else item.shares[0] if item.shares else None),
        )
        for item in found.ranking
        if item.round == 1 or item.delta_bic is not None
    )
    header = ("Candidate", "round", "score", "muscle 1 · 2 alone", "ΔBIC", "held-out share")
    caption = (
        "Score: evidence to first order, on both muscles and on each alone. ΔBIC: evidence after a fit in full "
        "simulation, for candidates with a high score."
    )
    return Table(header, rows, caption)


def sizes_table(found: DiagnoseResult) -> Table:
    """Parameters of the detected effects."""
    rows = tuple(
        (
            f"{effect.name}{f', muscle {effect.muscle}' if effect.muscle else ''}: {name} [{unit.name}]",
            number(size.value * unit.scale),
            number(size.std * unit.scale, 2),
        )
        for effect in found.effects
        for name, size in effect.parameters.items()
        for unit in [readable(size.unit, size.value)]
    )
    return Table(("Parameter", "value", "std. error"), rows, "What was found")


def calibration_table(found: DiagnoseResult) -> Table:
    """Zeros, scales and late stamps of the recordings."""
    rows = tuple(
        (
            f"{item.name} [{item.unit}]",
            number(item.value),
            number(item.std, 2),
            number(item.delta_bic, 2),
            " · ".join(f"{name}: {number(value)}" for name, (value, _) in item.by_recording.items()),
        )
        for item in found.calibrations
    )
    caption = "How much too high a sensor reads, or how much too early it is stamped. The joint itself is right."
    return Table(("Calibration", "value", "std. error", "ΔBIC", "by recording"), rows, caption)


def _tiles(found: DiagnoseResult) -> tuple[Tile, ...]:
    out, errors = [], found.errors
    if found.effects:
        evidence = {effect.in_short: effect.delta_bic for effect in found.effects}
        if found.share is not None:
            out.append(Tile("Explained", percent(found.share), "of the excess over noise on held-out data"))
        values = " and ".join(f"{value:.0f}" for value in evidence.values())
        out.append(Tile(f"Evidence for {', '.join(evidence)}".replace("_", " "), values, "ΔBIC; above 6 is strong"))
    splits = min((effect.splits for effect in found.effects if effect.splits is not None), default=None)
    if splits is not None:
        agreeing = f"{splits.agree} of {splits.of}"
        out.append(Tile("How sure", agreeing, "splits into fitted and held-out parts agree"))
    reference = (found.reference or {}).get("angle_and_pressures")
    for channel in CHANNELS:
        before, after = channel_of(errors, channel.name)
        if before is None or after is None or (found.driven and channel is not TORQUE):
            continue
        note = f"as configured {channel.write(before)}"
        if channel is TORQUE and reference is not None:
            note += f"; a straight-line map: {number(reference, 2)}"
        label = "Torque error, measured angle" if found.driven else f"{channel.title} error (RMS)"
        out.append(Tile(label, channel.write(after), note))
    if found.driven:
        out += _estimator_tiles(found.recordings[0])
    both = (errors.as_configured, errors.extended)
    means = [model.mean_rmse_pa for model in both if model.mean_rmse_pa is not None]
    if found.driven and len(means) == len(both):
        label, (was, now) = "Error of the mean pressure", means
    else:
        label, (was, now) = "Larger pressure error", [max(model.rmse_pa) for model in both]
    unit = readable("Pa", min(now, was))
    now, was = now * unit.scale, was * unit.scale
    out.append(Tile(label, f"{number(now, 2)} {unit.name}", f"as configured {number(was, 2)} {unit.name}"))
    return tuple(out)


def _estimator_tiles(part: RecordingEntry) -> list[Tile]:
    out = []
    for channel in CHANNELS if part.ukf is not None else ():
        assert part.ukf is not None
        before, after = channel_of(part.ukf, channel.name)
        if before is not None and after is not None:
            note = f"as configured {number(before, 2)}"
            out.append(Tile(f"{channel.title} error, pressures alone", channel.write(after), note))
    return out


def channel_of(errors: ModelErrors, name: str) -> tuple[float | None, float | None]:
    """RMSE of a channel, as configured and extended; None where it was not measured."""
    known = [getattr(model, name) for model in (errors.as_configured, errors.extended)]
    before, after = (None if item is None else item.rmse for item in known)
    return before, after


def _laws(found: DiagnoseResult) -> tuple[Block, ...]:
    named = [CATALOGUE[name] for name in dict.fromkeys(e.name for e in found.effects) if name in CATALOGUE]
    rows = tuple((item.name, f"{item.law} ({item.source}). {item.signature}") for item in named)
    return (Definitions(rows),) if rows else ()


def _provenance(found: DiagnoseResult) -> list[tuple[str, str]]:
    held = found.kept
    what = (
        f"{percent(held)} at the end of each recording" if isinstance(held, float)
        else f"{', '.join(held)}: whole recordings"
    )  # fmt: skip
    rows = [
        ("Rig", found.start.name),
        ("Source of its values", " ".join(found.start.source.split())),
        ("Seed", str(found.seed)),
        ("Held out", what),
    ]
    for part in found.recordings:
        role = "; held out" if part.role == "held out" else ""
        rows.append((f"Recording {part.recording}", f"{part.joint}{role}; SHA-256 {part.sha256}"))
    return rows + [(f"Time for {name}", f"{value:.1f} s") for name, value in found.seconds.items()]
