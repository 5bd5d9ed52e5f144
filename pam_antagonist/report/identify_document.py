"""The report of an identification as a document: sentences, tables and figures of its typed numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.report import html
from pam_antagonist.report import identify_figures as drawn
from pam_antagonist.report.assumption import in_first_lines
from pam_antagonist.report.channels import CHANNELS
from pam_antagonist.report.document import Block, Document, Findings, Section, Text, Tile, Tiles, background
from pam_antagonist.report.held_out import Judged, held_out_table
from pam_antagonist.report.identify_entries import IdentifyReport, StageEntry
from pam_antagonist.report.identify_findings import DEFINITIONS, findings, undetermined, verdict
from pam_antagonist.report.table import MISSING, Comparison, Table, number, percent
from pam_antagonist.report.units import readable, unit_of
from pam_antagonist.rig import Rig

COLUMNS = {
    "identified": "UKF, identified rig",
    "as_configured": "UKF, rig file as configured",
    "model_alone": "model alone, from the commands",
    "pressures_alone": "joint driven by the measured pressures",
    "linear": "linear map of the two pressures",
}
"""What gives an angle that is compared on held-out data."""


def write_report(
    folder: Path, report: IdentifyReport, judged: Sequence[Judged], rig: Rig, with_figures: bool = True
) -> None:
    """Write ``report.json`` and ``report.html`` into an existing folder.

    Args:
        report: of :func:`pam_antagonist.report.identify.report`.
    """
    html.write(folder, document(report, judged, rig, with_figures), report)


def summary(report: IdentifyReport) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    return (
        Text(verdict(report), "verdict"),
        *_angles(report),
        parameters_table(report),
        *map(held_out_table, report.held_out),
        Findings(findings(report)),
        *in_first_lines(report.assumption),
    )


def document(report: IdentifyReport, judged: Sequence[Judged], rig: Rig, with_figures: bool = True) -> Document:
    """The report as a document.

    Args:
        report: of :func:`pam_antagonist.report.identify.report`.
    """
    what = f"{len(judged)} recordings" if len(judged) > 1 else "one recording"
    lede = (
        f"Parameters with error bars, sensor noise and filter tuning, judged on {what}: on the end of each, or on "
        "whole ones, which no step used."
    )
    parts: list[Block] = [
        Text(lede, "lede"),
        Text(verdict(report), "verdict"),
        Tiles(_tiles(report)),
        Findings(findings(report)),
        *in_first_lines(report.assumption),
        *_angles(report),
        _held_out(report, judged, rig, with_figures),
        _parameters(report, with_figures),
        *_between(report),
        _stages(report, rig),
        _noise(report),
        *background(DEFINITIONS, _provenance(report)),
    ]
    return Document("Identification of a pneumatic muscle joint", f"Rig {report.settings.rig}", tuple(parts))


def _angles(report: IdentifyReport) -> tuple[Block, ...]:
    """Error of the angle by what gives it, on all held-out data of free joints."""
    if not report.errors_deg:
        return ()
    known = [entry for entry in report.held_out if entry.errors_deg]
    out = Comparison("Error of the angle on held-out data, RMS [°]", *(entry.name for entry in known), "all")
    for key, title in COLUMNS.items():
        out.values(title, [*(entry.errors_deg.get(key) for entry in known), report.errors_deg.get(key)], best=None)
    return (out.table(),)


def _tiles(report: IdentifyReport) -> tuple[Tile, ...]:
    out = []
    for channel in CHANNELS:
        for entry in report.held_out:
            known = entry.known(channel)
            if known:
                before, now, *_ = known
                note = (
                    f"{entry.name}; {channel.write(before.rmse)} as configured; {percent(now.coverage95)} in the 95 % "
                    "interval"
                )
                out.append(Tile(f"UKF {channel.name} error (RMS)", channel.write(now.rmse), note))
    return tuple(out)


# ------------------------------------------------------------------ sections


def _held_out(report: IdentifyReport, judged: Sequence[Judged], rig: Rig, with_figures: bool) -> Section:
    content: list[Block] = [Text("Errors on data that were neither fitted nor used for tuning. The best is bold.")]
    for entry, item in zip(report.held_out, judged, strict=True):
        figures = drawn.held_out_figures(item, rig) if with_figures else []
        content.append(Section(item.name, (held_out_table(entry), *figures)))
    return Section("On held-out data", tuple(content), 2, "held-out")


def _parameters(report: IdentifyReport, with_figures: bool) -> Section:
    content: list[Block] = [drawn.parameters_figure(report.parameters)] if with_figures else []
    content.append(parameters_table(report, "All free parameters"))
    left = undetermined(report)
    if left:
        rows = tuple((", ".join(names), text) for text, names in left.items())
        content.append(Table(("Not determined", "What to record to determine it"), rows, prose=True))
    if report.correlations:
        pairs = tuple((pair.first, pair.second, f"{pair.correlation:+.3f}") for pair in report.correlations)
        content.append(Table(("Parameter", "with", "correlation"), pairs, "Strongly correlated parameters"))
    return Section("Parameters", tuple(content), 2, "parameters")


def _between(report: IdentifyReport) -> list[Section]:
    between = report.between
    if between is None:
        return []
    text = (
        "Each recording may deviate a little from the common values, by about a per cent. The common values lie "
        "between them."
    )
    rows = tuple(
        (
            item.name,
            *(change(value) for value in item.deviations),
            change(item.largest).lstrip("+"),
            change(1.96 * item.std).lstrip("+"),
            "yes" if item.certain else "no",
        )
        for item in between.differences
    )
    header = ("Direction", *(entry.name for entry in report.held_out), "difference", "± 95 %", "certain")
    table = Table(header, rows, "Deviation of each recording from the common value")
    return [Section("How the recordings differ", (Text(text), table), 2, "between", folded=True)]


def _stages(report: IdentifyReport, rig: Rig) -> Section:
    content: list[Block] = [
        Text(
            "The measured pressures drive joint and muscles, so no valve has to be known for these. Then the measured "
            "motion drives the chambers, so that the air does not depend on the joint."
        )
    ]
    for entry in report.stages:
        note = f" {entry.note[:1].upper()}{entry.note[1:]}." if entry.note else ""
        inner: list[Block] = [Text(f"From {entry.source}.{note}")]
        if entry.values:
            inner += [_stage_residuals(entry), _stage_values(entry, rig)]
        content.append(Section(entry.name, tuple(inner)))
    return Section("Step by step", tuple(content), 2, "steps", folded=True)


def _noise(report: IdentifyReport) -> Section:
    tuning = report.tuning
    rows = tuple(
        (name, ", ".join(f"{path} {number(value, 2)}" for path, value in changes.items() if value))
        for name, changes in tuning.directions.items()
    )
    text = (
        f"The filter considers a constant torque that is not known, {number(tuning.unknown_torque_nm, 2)} N m (one "
        "standard deviation), and the directions in which the values are uncertain."
    )
    directions = (Table(("Direction", "changes by one standard deviation [SI]"), rows, prose=True),) if rows else ()
    return Section("Noise and tuning", (_noise_table(report), Text(text), *directions), 2, "noise", folded=True)


def _provenance(report: IdentifyReport) -> list[tuple[str, str]]:
    settings = report.settings
    rows = [
        ("Rig at the start", settings.rig),
        ("Freed in addition", ", ".join(settings.free) or "none"),
        ("Kept as configured", ", ".join(settings.frozen) or "none"),
        ("Held out", percent(settings.holdout)),
        ("Starts and seed", f"{settings.starts}, {settings.seed}"),
    ]
    for item in report.recordings:
        rows.append((f"Recording {item.name}", f"SHA-256 {item.sha256}"))
        rows.append(("Its joint", f"{item.condition}; source: {item.source}"))
        rows.append(("Its length", f"{item.duration_s:.1f} s, of which {item.fitted_until_s:.1f} s were fitted"))
        rows += [("Remark", issue) for issue in item.issues[:3]]
    return rows


# ------------------------------------------------------------------ tables


def change(value: float) -> str:
    """A relative change in per cent, with its sign."""
    return f"{100.0 * value:+.2f} %" if math.isfinite(value) else MISSING


def parameters_table(report: IdentifyReport, caption: str = "") -> Table:
    """Configured and identified value of each parameter."""
    rows = tuple(
        (
            f"{item.name} [{unit.name}]",
            number(item.start * unit.scale, 4),
            number(item.value * unit.scale, 5),
            number(item.std * unit.scale, 2),
            change(item.relative_change),
            change(1.96 * item.std / (abs(item.start) or math.nan)).lstrip("+"),
            f"no: {item.reason}" if item.reason else "yes",
        )
        for item in report.parameters
        for unit in [readable(item.unit)]
    )
    header = ("Parameter", "configured", "identified", "std error", "change", "± 95 %", "determined")
    return Table(header, rows, caption)


def _stage_values(stage: StageEntry, rig: Rig) -> Table:
    rows = []
    for name, item in stage.values.items():
        unit = readable(unit_of(rig, name))
        moved = (item.after - item.before) / abs(item.before) if item.before else math.nan
        values = number(item.before * unit.scale, 4), number(item.after * unit.scale, 5)
        rows.append((f"{name} [{unit.name}]", *values, change(moved)))
    return Table(("Parameter", "before", "after", "change"), tuple(rows))


def _stage_residuals(stage: StageEntry) -> Table:
    """Residuals of the simulated model before and after one step."""
    units = (("angle", "angle [°]", math.degrees(1.0)), ("torque", "torque [N m]", 1.0),
             ("pressure", "pressure, over a second [kPa]", 1e-3))  # fmt: skip
    rows = []
    for key, title, scale in units:
        if key in stage.before and key in stage.after:
            rows.append((title, number(stage.before[key] * scale), number(stage.after[key] * scale)))
    return Table(("RMS error", "before", "after"), tuple(rows))


def _noise_table(report: IdentifyReport) -> Table:
    """Sensor noise, Q and R before and after."""
    both, tuning = (report.noise.declared, report.noise.found), report.tuning
    rows: list[tuple[str, ...]] = [
        ("pressure sensor [Pa]", *(number(item.pressure_std) for item in both)),
        ("encoder [°]", *(number(math.degrees(item.angle_std)) for item in both)),
        ("encoder, resolution [°]", *(number(math.degrees(item.angle_step)) for item in both)),
        ("torque meter [N m]", *(number(item.torque_std) for item in both)),
        ("torque meter, resolution [N m]", *(number(item.torque_step) for item in both)),
    ]
    for k, name in enumerate(("angle [rad²]", "velocity [rad²/s²]", "pressure 1 [Pa²]", "pressure 2 [Pa²]")):
        rows.append((f"Q a step, {name}", number(tuning.process_before[k], 2), number(tuning.process[k], 2)))
    for k in (0, 1):
        before, now = tuning.measurement_before[k], tuning.measurement[k]
        rows.append((f"R, pressure {k + 1} [Pa²]", number(before), number(now)))
    caption = "Sensor noise, process noise Q and measurement noise R"
    return Table(("", "configured", "identified"), tuple(rows), caption)
