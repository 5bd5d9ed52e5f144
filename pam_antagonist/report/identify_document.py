"""The report of an identification as a document: sentences, tables and figures of its typed numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from pam_antagonist.identification.session import Identified
from pam_antagonist.identification.stages import MEASURED
from pam_antagonist.report import html
from pam_antagonist.report import identify_figures as drawn
from pam_antagonist.report.assumption import in_first_lines
from pam_antagonist.report.channels import CHANNELS
from pam_antagonist.report.document import Block, Document, Findings, Section, Text, Tile, Tiles, background
from pam_antagonist.report.held_out import Judged, held_out_table
from pam_antagonist.report.identify_entries import IdentifyReport, StageEntry
from pam_antagonist.report.identify_findings import DEFINITIONS, findings, undetermined, verdict
from pam_antagonist.report.table import MISSING, Table, number, percent
from pam_antagonist.report.units import readable, unit_of
from pam_antagonist.rig import Rig


def write_report(
    folder: Path, report: IdentifyReport, found: Identified, judged: Sequence[Judged], with_figures: bool = True
) -> None:
    """Write ``report.json`` and ``report.html`` into an existing folder.

    Args:
        folder: existing folder.
        report: of :func:`pam_antagonist.report.identify.report`.
        found: the identification.
        judged: recordings, replayed with the compared rigs.
        with_figures: False leaves the figures out of the page.
    """
    html.write(folder, document(report, found, judged, with_figures), report)


def summary(report: IdentifyReport) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    return (
        Text(verdict(report)),
        parameters_table(report),
        *map(held_out_table, report.held_out),
        Findings(findings(report)),
        *in_first_lines(report.assumption),
    )


def document(
    report: IdentifyReport, found: Identified, judged: Sequence[Judged], with_figures: bool = True
) -> Document:
    """The report as a document.

    Args:
        report: of :func:`pam_antagonist.report.identify.report`.
        found: the identification.
        judged: recordings, replayed with the compared rigs.
        with_figures: False leaves the figures out.
    """
    what = f"{len(judged)} recordings" if len(judged) > 1 else "one recording"
    lede = (
        f"Parameters with error bars, sensor noise and filter tuning from {what}. The end of each recording was held "
        "out: it was not fitted, and the result is judged on it."
    )
    parts: list[Block] = [
        Text(lede, "lede"),
        Text(verdict(report), "verdict"),
        Tiles(_tiles(report)),
        Findings(findings(report)),
        *(drawn.held_out_figures(judged[0], found, 0)[:1] if with_figures else ()),
        *in_first_lines(report.assumption),
        _held_out(report, found, judged, with_figures),
        _parameters(report, found, with_figures),
        *_between(report),
        _stages(report, found, with_figures),
        _noise(report),
        *background(DEFINITIONS, _provenance(report)),
    ]
    return Document("Identification of a pneumatic muscle joint", f"Rig {found.start.name}", tuple(parts))


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


def _held_out(report: IdentifyReport, found: Identified, judged: Sequence[Judged], with_figures: bool) -> Section:
    content: list[Block] = [
        Text("Errors on the part of each recording that was neither fitted nor used for tuning. The best is bold.")
    ]
    for index, (entry, item) in enumerate(zip(report.held_out, judged, strict=True)):
        figures = drawn.held_out_figures(item, found, index) if with_figures else []
        figures = figures if index else figures[1:]  # the first figure is at the top of the report
        content.append(Section(item.name, (held_out_table(entry), *figures)))
    return Section("On held-out data", tuple(content), 2, "held-out")


def _parameters(report: IdentifyReport, found: Identified, with_figures: bool) -> Section:
    content: list[Block] = [drawn.parameters_figure(report.parameters)] if with_figures else []
    content.append(parameters_table(report, "All free parameters"))
    left = undetermined(report)
    if left:
        rows = tuple((", ".join(names), text) for text, names in left.items())
        content.append(Table(("Not determined", "What to record to determine it"), rows, prose=True))
    if report.correlations:
        pairs = tuple((pair.first, pair.second, f"{pair.correlation:+.3f}") for pair in report.correlations)
        content.append(Table(("Parameter", "with", "correlation"), pairs, "Strongly correlated parameters"))
    if with_figures:
        profile = drawn.profiles_figure(found)
        content += [*([profile] if profile else []), drawn.correlation_figure(found)]
    content.append(_profiles_table(report))
    return Section("Parameters", tuple(content), 2, "parameters")


def _between(report: IdentifyReport) -> list[Section]:
    between = report.between
    if between is None:
        return []
    spread = ", ".join(f"{group} {100 * value:.2f} %" for group, value in between.spread.items())
    text = (
        "Each recording may deviate a little from the common values. The standard deviation of these deviations was "
        f"estimated with the parameters: {spread}. They raise the logarithm of the evidence by "
        f"{between.evidence_gain:.0f} against equal values for all recordings."
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


def _stages(report: IdentifyReport, found: Identified, with_figures: bool) -> Section:
    free = {item.name for item in found.free}
    known = ", ".join(f"{name} {found.start.value(name):.4g}" for name in MEASURED if name not in free)
    content: list[Block] = [
        Text(
            "The order is that of Proposition 1. Steady states depend on neither orifice areas nor polytropic indices, "
            "so they come first. Each step gives the start values of the joint refinement, which is the last."
        ),
        Section("measured directly", (Text(f"Taken from the rig file: {known}."),)),
    ]
    fitted = [trial.part(0.0, until) for trial, until in zip(found.trials, found.held_from, strict=True)]
    for stage, entry in zip(found.stages, report.stages, strict=True):
        note = f" {entry.note[:1].upper()}{entry.note[1:]}." if entry.note else ""
        inner: list[Block] = [Text(f"From {entry.source}.{note}")]
        if entry.values or entry.balance_nm is not None:
            inner.append(_stage_residuals(entry))
        if entry.values and entry.name != "joint refinement":
            inner.append(_stage_values(entry, found.start))
        figure = drawn.stage_figure(stage, fitted) if with_figures else None
        content.append(Section(entry.name, (*inner, *([figure] if figure else []))))
    if len(report.starts) > 1:
        rows = tuple((start.name, number(start.cost, 6), "best" if start.best else "") for start in report.starts)
        content.append(Table(("Start", "cost", ""), rows, "The joint refinement from several starts"))
    return Section("Step by step", tuple(content), 2, "steps", folded=True)


def _noise(report: IdentifyReport) -> Section:
    tuning = report.tuning
    size = (
        f"Their size is {tuning.scale:.2f} times that of the fit: with it, the errors of the measured angle and torque "
        "in the fitted part are most likely."
        if tuning.scale_from_reference
        else "No angle or torque was measured, so their size could not be checked."
    )
    rows = tuple(
        (
            item.name,
            f"{item.angle_deg:.3f}°",
            f"{item.torque_nm:.4f} N m",
            ", ".join(f"{part.name} {_percent_or_zero(part.relative)}" for part in item.largest),
        )
        for item in tuning.directions
    )
    header = ("Direction", "moves the angle by", "the torque by", "largest changes")
    text = f"The filter's covariance includes the uncertainty of the parameters as directions. {size}"
    tables = (_noise_table(report), Text(text), Table(header, rows, prose=True))
    return Section("Noise and tuning", tables, 2, "noise", folded=True)


def _percent_or_zero(value: float) -> str:
    return change(value if math.isfinite(value) else 0.0)


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


def _profiles_table(report: IdentifyReport) -> Table:
    units = {item.name: readable(item.unit) for item in report.parameters}

    def end(value: float | None, scale: float) -> str:
        return "beyond 3 standard errors" if value is None else number(value * scale, 4)

    rows = tuple(
        (f"{item.name} [{unit.name}]", end(item.low95, unit.scale), end(item.high95, unit.scale))
        for item in report.profiles
        for unit in [units[item.name]]
    )
    return Table(("Parameter", "95 % from", "to"), rows, "Intervals by profile likelihood")


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
             ("pressure_1", "pressure 1 [kPa]", 1e-3), ("pressure_2", "pressure 2 [kPa]", 1e-3))  # fmt: skip
    rows = []
    for key, title, scale in units:
        before, after = stage.before[key], stage.after[key]
        if before is not None and after is not None:
            rows.append((title, number(before * scale), number(after * scale)))
    if stage.balance_nm is not None:
        both = stage.balance_nm
        rows.append(("torque at measured pressures [N m]", number(both.before), number(both.after)))
    return Table(("RMS residual", "before", "after"), tuple(rows))


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
    like = tuning.log_likelihood_a_sample
    rows.append(("log-likelihood of the innovations a sample", number(like.before, 5), number(like.after, 5)))
    caption = "Sensor noise, process noise Q and measurement noise R"
    return Table(("", "configured", "identified"), tuple(rows), caption)
