"""The page of ``identify``: sentences, tables and figures of its result."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from pam_antagonist.identification.result import Step
from pam_antagonist.report import identify_figures as drawn
from pam_antagonist.report.assumption import assumption, in_first_lines
from pam_antagonist.report.channels import CHANNELS
from pam_antagonist.report.document import Block, Document, Findings, Section, Text, Tile, Tiles, background
from pam_antagonist.report.held_out import COLUMNS, errors_of, held_out_table, known
from pam_antagonist.report.identify_findings import findings, undetermined, verdict
from pam_antagonist.report.table import MISSING, Comparison, Table, number, percent
from pam_antagonist.report.units import readable, unit_of
from pam_antagonist.rig import Rig

if TYPE_CHECKING:
    from pam_antagonist.report.identify import IdentifyResult


def summary(found: IdentifyResult) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    return (
        Text(verdict(found), "verdict"),
        *_angles(found),
        parameters_table(found),
        *map(held_out_table, found.held),
        Findings(findings(found)),
        *in_first_lines(assumption(found.found.start, identified=True)),
    )


def document(found: IdentifyResult, with_figures: bool = True) -> Document:
    """The page."""
    what = f"{len(found.held)} recordings" if len(found.held) > 1 else "one recording"
    lede = (
        f"Parameters with error bars, sensor noise and filter tuning, judged on {what}: on the end of each, or on "
        "whole ones, which no step used."
    )
    parts: list[Block] = [
        Text(lede, "lede"),
        Text(verdict(found), "verdict"),
        Tiles(_tiles(found)),
        Findings(findings(found)),
        *in_first_lines(assumption(found.found.start, identified=True)),
        *_angles(found),
        _held_out(found, with_figures),
        _parameters(found, with_figures),
        *_between(found),
        _stages(found),
        _noise(found),
        *background("identify", _provenance(found)),
    ]
    return Document("Identification of a pneumatic muscle joint", f"Rig {found.found.start.name}", tuple(parts))


def _angles(found: IdentifyResult) -> tuple[Block, ...]:
    """Error of the angle by what gives it, on all held-out data of free joints."""
    if not found.errors_deg:
        return ()
    each = [(held.name, errors) for held in found.held if (errors := errors_of(held))]
    out = Comparison("Error of the angle on held-out data, RMS [°]", *(name for name, _ in each), "all")
    for key, title in COLUMNS.items():
        out.values(title, [*(errors.get(key) for _, errors in each), found.errors_deg.get(key)], best=None)
    return (out.table(),)


def _tiles(found: IdentifyResult) -> tuple[Tile, ...]:
    out = []
    for channel in CHANNELS:
        for held in found.held:
            if errors := known(held, channel):
                before, now, *_ = errors
                shares = f"{channel.write(before.rmse)} as configured; {percent(now.coverage95)} in the 95 % interval"
                out.append(Tile(f"UKF {channel.name} error (RMS)", channel.write(now.rmse), f"{held.name}; {shares}"))
    return tuple(out)


def _held_out(found: IdentifyResult, with_figures: bool) -> Section:
    content: list[Block] = [Text("Errors on data that were neither fitted nor used for tuning. The best is bold.")]
    for held in found.held:
        figures = drawn.held_out_figures(held, found.rig) if with_figures else []
        content.append(Section(held.name, (held_out_table(held), *figures)))
    return Section("On held-out data", tuple(content), 2, "held-out")


def _parameters(found: IdentifyResult, with_figures: bool) -> Section:
    content: list[Block] = [drawn.parameters_figure(found.parameters)] if with_figures else []
    content.append(parameters_table(found, "All free parameters"))
    left = undetermined(found)
    if left:
        rows = tuple((", ".join(names), text) for text, names in left.items())
        content.append(Table(("Not determined", "What to record to determine it"), rows, prose=True))
    if found.correlations:
        pairs = tuple((first, second, f"{value:+.3f}") for first, second, value in found.correlations)
        content.append(Table(("Parameter", "with", "correlation"), pairs, "Strongly correlated parameters"))
    return Section("Parameters", tuple(content), 2, "parameters")


def _between(found: IdentifyResult) -> list[Section]:
    if not found.between:
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
        for item in found.between
    )
    header = ("Direction", *(held.name for held in found.held), "difference", "± 95 %", "certain")
    table = Table(header, rows, "Deviation of each recording from the common value")
    return [Section("How the recordings differ", (Text(text), table), 2, "between", folded=True)]


def _stages(found: IdentifyResult) -> Section:
    content: list[Block] = [
        Text(
            "The measured pressures drive joint and muscles, so no valve has to be known for these. Then the measured "
            "motion drives the chambers, so that the air does not depend on the joint."
        )
    ]
    for step in found.full.steps:
        note = f" {step.note[:1].upper()}{step.note[1:]}." if step.note else ""
        inner: list[Block] = [Text(f"From {step.source}.{note}")]
        if step.values:
            inner += [_stage_residuals(step), _stage_values(step, found.full.start)]
        content.append(Section(step.name, tuple(inner)))
    return Section("Step by step", tuple(content), 2, "steps", folded=True)


def _noise(found: IdentifyResult) -> Section:
    rows = tuple(
        (name, ", ".join(f"{path} {number(value, 2)}" for path, value in changes.items() if value))
        for name, changes in found.full.rig.directions.items()
    )
    text = (
        f"The filter considers a constant torque that is not known, {number(found.full.covered.torque, 2)} N m (one "
        "standard deviation), and the directions in which the values are uncertain."
    )
    directions = (Table(("Direction", "changes by one standard deviation [SI]"), rows, prose=True),) if rows else ()
    return Section("Noise and tuning", (_noise_table(found), Text(text), *directions), 2, "noise", folded=True)


def _provenance(found: IdentifyResult) -> list[tuple[str, str]]:
    asked = found.full.options
    rows = [
        ("Rig at the start", found.full.start.name),
        ("Freed in addition", ", ".join(asked.free) or "none"),
        ("Kept as configured", ", ".join(asked.frozen) or "none"),
        ("Held out", percent(asked.holdout)),
        ("Starts and seed", f"{asked.starts}, {asked.seed}"),
    ]
    for item in found.to_json()["recordings"]:
        rows.append((f"Recording {item['name']}", f"SHA-256 {item['sha256']}"))
        rows.append(("Its joint", f"{item['condition']}; source: {item['source']}"))
        until = f"of which {item['fitted_until_s']:.1f} s were fitted"
        rows.append(("Its length", f"{item['duration_s']:.1f} s, {until}"))
        rows += [("Remark", issue) for issue in item["issues"][:3]]
    return rows


def change(value: float) -> str:
    """A relative change in per cent, with its sign."""
    return f"{100.0 * value:+.2f} %" if math.isfinite(value) else MISSING


def parameters_table(found: IdentifyResult, caption: str = "") -> Table:
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
        for item in found.parameters
        for unit in [readable(item.unit)]
    )
    header = ("Parameter", "configured", "identified", "std error", "change", "± 95 %", "determined")
    return Table(header, rows, caption)


def _stage_values(step: Step, rig: Rig) -> Table:
    rows = []
    for name, (before, after) in step.values.items():
        unit = readable(unit_of(rig, name))
        moved = (after - before) / abs(before) if before else math.nan
        values = number(before * unit.scale, 4), number(after * unit.scale, 5)
        rows.append((f"{name} [{unit.name}]", *values, change(moved)))
    return Table(("Parameter", "before", "after", "change"), tuple(rows))


def _stage_residuals(step: Step) -> Table:
    """Residuals of the simulated model before and after one step."""
    units = (("angle", "angle [°]", math.degrees(1.0)), ("torque", "torque [N m]", 1.0),
             ("pressure", "pressure, over a second [kPa]", 1e-3))  # fmt: skip
    rows = tuple(
        (title, number(step.before[key] * scale), number(step.after[key] * scale))
        for key, title, scale in units
        if key in step.before and key in step.after
    )
    return Table(("RMS error", "before", "after"), rows)


def _noise_table(found: IdentifyResult) -> Table:
    """Sensor noise, Q and R before and after."""
    rigs = (found.full.start, found.full.rig)
    old, new = (rig.tuning("default") for rig in rigs)
    rows = [
        (title, *(number(scale * float(getattr(rig.sensors, name))) for rig in rigs))
        for title, name, scale in (
            ("pressure sensor [Pa]", "pressure_std", 1.0), ("encoder [°]", "angle_std", math.degrees(1.0)),
            ("encoder, resolution [°]", "angle_step", math.degrees(1.0)), ("torque meter [N m]", "torque_std", 1.0),
            ("torque meter, resolution [N m]", "torque_step", 1.0),
        )
    ]  # fmt: skip
    for k, name in enumerate(("angle [rad²]", "velocity [rad²/s²]", "pressure 1 [Pa²]", "pressure 2 [Pa²]")):
        rows.append((f"Q a step, {name}", number(old.process[k], 2), number(new.process[k], 2)))
    for k in (0, 1):
        rows.append((f"R, pressure {k + 1} [Pa²]", number(old.measurement[k]), number(new.measurement[k])))
    return Table(("", "configured", "identified"), tuple(rows), "Sensor noise, process noise Q and measurement noise R")
