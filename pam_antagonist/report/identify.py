"""The result of ``identify`` with its page: a section is there if its data are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.estimation.metrics import ChannelErrors
from pam_antagonist.identification.held_out import COLUMNS, errors_of, known, rigs_of
from pam_antagonist.identification.identified import Identified, ParameterEntry
from pam_antagonist.identification.result import FromPressures, HeldRecording, Step
from pam_antagonist.identification.sealed import ASSUMED, SealedIdentified
from pam_antagonist.replays.result import CHANNELS
from pam_antagonist.report.document import (
    Block,
    Comparison,
    Document,
    Findings,
    Section,
    Table,
    Text,
    Tile,
    Tiles,
    in_first_lines,
    page,
    sentence,
)
from pam_antagonist.report.figure import FAINT, MODEL, Axis, Figure, Panel, Points
from pam_antagonist.report.identify_findings import findings, verdict
from pam_antagonist.report.replay_figures import replay_figures
from pam_antagonist.report.result import DataFrame, Result, frame_of
from pam_antagonist.rig import Rig
from pam_antagonist.rig.units import assumption, readable, unit_of
from pam_antagonist.shown import MISSING, number, percent


@dataclass(frozen=True, eq=False, repr=False)
class IdentifyResult(Identified, Result):
    """An identified rig.

    Attributes:
        rig: with the identified parameters, noise and tuning.
        own: with several recordings, a rig with each one's own values; otherwise empty.
        found: all results; those of a sealed joint have fewer steps and values.
        held: errors on the part of each recording that no step used, with the compared rigs.
        recordings: each with its joint condition and name.
        seed: of further starts.
    """

    @override
    def document(self, figures: bool = True) -> Document:
        what = f"{len(self.held)} recordings" if len(self.held) > 1 else "one recording"
        lede = (
            f"Parameters with error bars, sensor noise and filter tuning, judged on {what}: on the end of each, or on "
            "whole ones, which no step used."
        )
        title = "Identification of a pneumatic muscle joint"
        if self.adapts:
            title = "What has changed in a joint"
            lede = "Each number may walk a little from the rig file's value. The recording's end judges the new values."
        if isinstance(self.found, SealedIdentified):
            title = "Identification of a sealed muscle joint"
            lede = f"The muscles are sealed: no air flows, an external torque moves the joint. {lede}"
        drawn = (parameters_figure(self.parameters),) if figures else ()
        parts: list[Block] = [
            Tiles(_tiles(self)),
            Findings(findings(self)),
            *in_first_lines(assumption(self.found.start, identified=True)),
            *_angles(self),
            _held_out(self, figures),
            Section("Parameters", (*drawn, parameters_table(self)), 2, "parameters", brief=True),
            *_between(self),
            *(_of_sealed(self.found) if isinstance(self.found, SealedIdentified) else _steps(self.found)),
        ]
        return page(title, f"Rig {self.found.start.name}", parts, "identify", _provenance(self), lede, verdict(self))

    def to_dataframe(self) -> DataFrame:
        """A row for each identified parameter: start value, identified value, standard error (needs pandas)."""
        rows = [(item.name, item.start, item.value, item.std) for item in self.parameters]
        return frame_of(rows, ("parameter", "start", "value", "std"), "parameter")


def _angles(result: Identified) -> tuple[Block, ...]:
    """Error of the angle by what gives it, on all held-out data of free joints."""
    if not result.errors_deg:
        return ()
    each = [(held.name, errors) for held in result.held if (errors := errors_of(held))]
    out = Comparison("Error of the angle on held-out data, RMS [°]", *(name for name, _ in each), "all")
    for key, title in COLUMNS.items():
        out.values(title, [*(errors.get(key) for _, errors in each), result.errors_deg.get(key)], best=None)
    return (out.table(),)


def _tiles(result: Identified) -> tuple[Tile, ...]:
    out = []
    for channel in CHANNELS:
        for held in result.held:
            if errors := known(held, channel):
                before, now, *_ = errors
                shares = f"{channel.write(before.rmse)} as configured; {percent(now.coverage95)} in the 95 % interval"
                out.append(Tile(f"UKF {channel.name} error (RMS)", channel.write(now.rmse), f"{held.name}; {shares}"))
    for held in result.held:
        external = held.identified.ukf.external_torque
        if external is not None and math.isfinite(external.rmse):
            about = f"{held.name}; estimated by the filter; where the joint sticks, friction hides it"
            out.append(Tile("External torque (RMS)", f"{external.rmse:.2f} N m", about))
    return tuple(out)


def _held_out(result: Identified, with_figures: bool) -> Section:
    content: list[Block] = [Text("Errors on data that were neither fitted nor used for tuning. The best is bold.")]
    for held in result.held:
        figures = held_out_figures(held) if with_figures else ()
        content.append(Section(held.name, (held_out_table(held), *figures), brief=True))
    return Section("On held-out data", tuple(content), 2, "held-out", brief=True)


def held_out_figures(held: HeldRecording) -> tuple[Figure, ...]:
    """A recording before and after; the held-out part is shaded."""
    return replay_figures(held.whole, held.from_s, held.replays["as_configured"])


def held_out_table(held: HeldRecording) -> Table:
    """Errors on one recording's held-out part, for all compared rigs."""
    titles, figures = zip(*rigs_of(held), strict=True)
    out = Comparison(f"{held.name}, from {held.from_s:.4g} s on", *titles)
    out.heading("Model alone")
    for channel in CHANNELS:
        _rows(out, channel.name, channel.unit, known(held, channel, "model_alone"))
    for muscle in (0, 1):
        values = [item.model_alone.pressure.rmse_pa[muscle] for item in figures]
        out.pressures(f"  pressure {muscle + 1} RMSE", values)
    out.heading("UKF")
    for channel in CHANNELS:
        errors = known(held, channel)
        _rows(out, channel.name, channel.unit, errors)
        if errors:
            shares = [item.coverage95 for item in errors]
            out.values(f"  {channel.name} in the 95 % interval", shares, percent, best=None)
    external = [item.ukf.external_torque for item in figures]
    if all(external):
        out.values("  external torque RMSE [N m]", [None if item is None else item.rmse for item in external])
    out.values("  mean NIS (2 is right)", [item.innovation.nis_mean for item in figures], best=None)
    return out.table()


def _rows(out: Comparison, name: str, unit: str, errors: Sequence[ChannelErrors]) -> None:
    if errors:
        out.values(f"  {name} RMSE [{unit}]", [item.rmse for item in errors])
        out.values(f"  {name} largest error over measured range", [item.ratio for item in errors], percent)


def parameters_figure(parameters: Sequence[ParameterEntry]) -> Figure:
    """Change of each parameter with its 95 % interval, and the prior's interval."""
    items = [item for item in parameters if item.start]
    rows = np.arange(len(items), dtype=np.float64)
    change, prior, now = (
        np.array([100.0 * value / abs(item.start) for value, item in zip(values, items, strict=True)])
        for values in (
            [item.value - item.start for item in items], [1.96 * item.prior_std for item in items],
            [1.96 * item.std for item in items],
        )
    )  # fmt: skip
    parts = (
        Points("before: prior, 95 %", 0.0 * rows, rows, FAINT, size=1.0, half_width=prior, bar_width=7.0),
        Points("identified, 95 %", change, rows, MODEL, half_width=now),
    )
    across = Axis("Change from the configured value [%]")
    panel = Panel(across, Axis(labels=tuple(item.name for item in items)), parts, 12 + 24 * len(items))
    about = "Where a blue bar is as wide as the grey one, the recordings do not determine that parameter."
    return Figure("Parameters with 95 % intervals", about, (panel,), "parameters")


def parameters_table(result: Identified) -> Table:
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
        for item in result.parameters
        for unit in [readable(item.unit)]
    )
    header = ("Parameter", "configured", "identified", "std error", "change", "± 95 %", "determined")
    return Table(header, rows, "All free parameters")


def change(value: float) -> str:
    """A relative change in per cent, with its sign."""
    return f"{round(100.0 * value, 2) + 0.0:+.2f} %" if math.isfinite(value) else MISSING


def _between(result: Identified) -> list[Section]:
    if not result.between:
        return []
    text = (
        "Each recording may deviate a little from the common values, by about a per cent. The common values lie "
        "between them."
    )
    rows = tuple(
        (
            item.name, *map(change, item.deviations), change(item.largest).lstrip("+"),
            change(1.96 * item.std).lstrip("+"), "yes" if item.certain else "no",
        )
        for item in result.between
    )  # fmt: skip
    header = ("Direction", *(held.name for held in result.held), "difference", "± 95 %", "certain")
    table = Table(header, rows, "Deviation of each recording from the common value")
    return [Section("How the recordings differ", (Text(text), table), 2, "between", folded=True)]


def _steps(fit: FromPressures) -> list[Section]:
    content: list[Block] = [
        Text(
            "The measured pressures drive joint and muscles, so no valve has to be known for these. Then the measured "
            "motion drives the chambers, so that the air does not depend on the joint."
        )
    ]
    for step in fit.steps:
        note = f" {sentence(step.note)}" if step.note else ""
        table = (_step_table(step, fit.start),) if step.values else ()
        content.append(Section(step.name, (Text(f"From {step.source}.{note}"), *table)))
    text = (
        f"The filter considers a constant torque that is not known, {number(fit.covered.torque, 2)} N m (one "
        "standard deviation), and the directions in which the values are uncertain."
    )
    rows = tuple(
        (name, ", ".join(f"{path} {number(value, 2)}" for path, value in changes.items() if value))
        for name, changes in fit.rig.directions.items()
    )
    directions = (Table(("Direction", "changes by one standard deviation [SI]"), rows, prose=True),) if rows else ()
    noise = (_noise_table(fit.start, fit.rig), Text(text), *directions)
    return [
        Section("Step by step", tuple(content), 2, "steps", folded=True),
        Section("Noise and tuning", noise, 2, "noise", folded=True),
    ]


def _step_table(step: Step, rig: Rig) -> Table:
    """Errors of the simulated model and values, before and after one step."""
    rows = [
        (f"RMS error, {title}", number(step.before[key] * scale), number(step.after[key] * scale), "")
        for key, title, scale in (
            ("angle", "angle [°]", math.degrees(1.0)), ("torque", "torque [N m]", 1.0),
            ("pressure", "pressure, over a second [kPa]", 1e-3),
        )
        if key in step.before and key in step.after
    ]  # fmt: skip
    for name, (before, after) in step.values.items():
        unit = readable(unit_of(rig, name))
        moved = change((after - before) / abs(before) if before else math.nan)
        rows.append((f"{name} [{unit.name}]", number(before * unit.scale, 4), number(after * unit.scale, 5), moved))
    return Table(("", "before", "after", "change"), tuple(rows))


def _of_sealed(sealed: SealedIdentified) -> list[Section]:
    text = (
        "R is the noise of the pressures. The other values maximise the likelihood of the errors of the measured angle "
        "on the fitted part, while the innovations are as large as the filter expects. The drift of the readings is a "
        "state of its own, and not in R."
    )
    further = tuple(
        (name, *(number(sealed.tuning[key][when]) for when in ("before", "after")))
        for name, key in (
            ("Drift of the readings, std. dev. [Pa]", "drift_std_pa"), ("Its time constant [s]", "drift_time_s"),
            ("Random walk of the torque [N m/s^0.5]", "random_walk"),
        )
    )  # fmt: skip
    steps = tuple((stage.name, f"{number(stage.residual)} {stage.unit}", stage.note) for stage in sealed.stages)
    return [
        Section("Step by step", (Table(("Step", "residual (RMS)", "note"), steps, prose=True),), folded=True),
        Section("Noise and tuning", (Text(text), _noise_table(sealed.start, sealed.rig, further)), folded=True),
        Section("What is assumed", tuple(map(Text, ASSUMED)), folded=True),
    ]


def _noise_table(before: Rig, after: Rig, further: Sequence[tuple[str, ...]] = ()) -> Table:
    """Sensor noise, Q and R before and after."""

    def values(rig: Rig) -> list[Any]:
        tuning, sensors = rig.tuning("default"), rig.sensors
        of_sensors = [
            sensors.pressure_std, math.degrees(sensors.angle_std), math.degrees(sensors.angle_step),
            sensors.torque_std, sensors.torque_step,
        ]  # fmt: skip
        return [*of_sensors, *tuning.process, *tuning.measurement]

    titles = (
        "pressure sensor [Pa]", "encoder [°]", "encoder, resolution [°]", "torque meter [N m]",
        "torque meter, resolution [N m]", "Q a step, angle [rad²]", "Q a step, velocity [rad²/s²]",
        "Q a step, pressure 1 [Pa²]", "Q a step, pressure 2 [Pa²]", "R, pressure 1 [Pa²]", "R, pressure 2 [Pa²]",
    )  # fmt: skip
    pairs = zip(titles, values(before), values(after), strict=True)
    rows = (*((title, number(old), number(new)) for title, old, new in pairs), *further)
    return Table(("", "configured", "identified"), rows, "Sensor noise, process noise Q and measurement noise R")


def _provenance(result: Identified) -> list[tuple[str, str]]:
    out, held, numbers = [("Rig at the start", result.found.start.name)], result.held, result.found
    if isinstance(numbers, FromPressures):
        asked = numbers.options
        out += [
            ("Freed in addition", ", ".join(asked.free) or "none"),
            ("Kept as configured", ", ".join(asked.frozen) or "none"),
            ("Held out", percent(asked.holdout)),
            ("Starts and seed", f"{asked.starts}, {asked.seed}"),
        ]
    for one in held:
        report, joint = one.whole.report, one.identified.joint
        length = f"{report.duration_s:.1f} s, of which {min(one.from_s, report.duration_s):.1f} s were fitted"
        out.append((f"Recording {one.name}", f"SHA-256 {report.recording.sha256}"))
        out.append(("Its joint and length", f"{joint.condition}; source: {joint.source}; {length}"))
        out += [("Remark", issue) for issue in report.recording.issues[:3]]
    return out
