"""The report of one or several replayed recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from typing_extensions import override

from pam_antagonist.replays.channels import CHANNELS, joint_text, judged
from pam_antagonist.replays.result import Replay, ReplayReport, columns, numbers, write_estimate
from pam_antagonist.report.document import (
    Block,
    Columns,
    Document,
    Findings,
    Section,
    Text,
    Tile,
    Tiles,
    background,
    in_first_lines,
)
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.replay_figures import filter_figures, replay_figures
from pam_antagonist.report.replay_findings import findings, verdict
from pam_antagonist.report.result import Result, frame_of
from pam_antagonist.report.table import MISSING, Comparison, Table, number, percent
from pam_antagonist.rig.assumption import assumption

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class ReplayResult(Replay, Result):
    """A replayed recording.

    Attributes:
        recording: the recording.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint was free or locked.
        run: M estimates; ``run.index`` are their samples in the recording.
        model: the model alone at the same samples.
        report: the numbers of ``report.json``.
        plan: where the filter was started.
    """

    @override
    def to_json(self) -> dict[str, Any]:
        return numbers([self])

    @override
    def document(self, figures: bool = True) -> Document:
        return document([self], figures)

    @override
    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write the report or the estimates.

        Args:
            path: of a new folder for ``report.html`` and ``report.json``, or of a new file ``*.csv`` or ``*.mcap`` for
                the estimates.
            figures: False leaves the figures out of the page.
            overwrite: True replaces an earlier result there.

        Returns:
            The path.

        Raises:
            BadInput: the path exists, or cannot be written.
        """
        path = Path(path)
        if path.suffix not in (".csv", ".mcap"):
            return super().save(path, figures, overwrite)
        write_estimate(path, self, overwrite)
        return path

    def to_dataframe(self) -> DataFrame:
        """A row for each estimate, with standard deviations and measurements (needs pandas).

        The columns are those of ``replay --save estimate.csv``; each name contains the unit.
        """
        return frame_of(columns(self))


def document(replays: Sequence[Replay], with_figures: bool = True) -> Document:
    """The page of one or several recordings; without figures it lacks plotly's 2 MB."""
    reports, several = [replay.report for replay in replays], len(replays) > 1
    seconds = sum(report.duration_s for report in reports)
    lede = (
        f"The estimator that runs live was run again on {seconds:.0f} s of recorded muscle pressures and valve "
        "voltages. The report compares its angle and torque with the measured ones."
    )
    shown = [replay_figures(replay) if with_figures else () for replay in replays]
    # The first figure comes before all tables, so that it is on the first screen.
    first, shown[0] = shown[0][:1], shown[0][1:]
    parts: list[Block] = [
        Text(lede, "lede"),
        Text(verdict(reports), "verdict"),
        *(replace(one, title=f"{replays[0].name}: {one.title}") if several else one for one in first),
        *in_first_lines(assumption(replays[0].rig, replays[0].tuning)),
        *((overview(reports),) if several else ()),
    ]
    for place, (replay, figures) in enumerate(zip(replays, shown, strict=True), 1):
        own = _recording(replay, figures, with_figures)
        if several:
            above = " Its first figure is at the top of the page." if first and place == 1 else ""
            own = (Section(replay.name, (Text(verdict([replay.report]) + above), *own), 2, f"r{place}"),)
        parts += own
    parts += background("replay", _provenance(replays))
    title = f"{len(reports)} recordings" if several else replays[0].name
    return Document("Replay of a pneumatic muscle joint", title, tuple(parts))


def _recording(replay: Replay, figures: Sequence[Figure], with_figures: bool) -> tuple[Block, ...]:
    report, inside = replay.report, filter_figures(replay) if with_figures else ()
    joint, length = report.joint, f"{report.duration_s:.1f} s, {report.samples} samples"
    about = (
        f"{replay.name}: {length}, joint {joint.condition} (source: {joint.source}); rig {replay.rig.name}, tuning "
        f"{replay.tuning}, {report.realtime_factor:.1f} × real time."
    )
    beside = Columns(Findings(findings(report)), errors_table(report, "Errors. The smaller one is bold."))
    folded = Section("Innovations, valve voltages and active equations", inside, folded=True)
    return Tiles(tiles(report)), Text(about), beside, *figures, *((folded,) if inside else ())


def _provenance(replays: Sequence[Replay]) -> list[tuple[str, str]]:
    rig, name = replays[0].rig, replays[0].tuning
    tuning = rig.tuning(name)
    rows = [
        ("Rig", rig.name),
        ("Source of its values", rig.source.strip()),
        ("Filter tuning", f"{name}: κ {tuning.kappa:g}, gate {tuning.gate:g} standard deviations"),
        ("Process noise Q, a step", ", ".join(f"{value:g}" for value in tuning.process) + " [rad², rad²/s², Pa², Pa²]"),
        ("Measurement noise R", ", ".join(f"{value:g}" for value in tuning.measurement) + " [Pa²]"),
    ]
    if tuning.consider and rig.uncertainty:
        known = ", ".join(f"{name} ± {std:g}" for name, std in rig.uncertainty.items())
        rows.append(("Parameters carried as uncertain", known))
    for report in (replay.report for replay in replays):
        about = f"{joint_text(report.joint)}; source: {report.joint.source}"
        rows += [
            (f"Recording {report.recording.name}", f"SHA-256 {report.recording.sha256}"),
            ("Its joint and length", f"{about}; {report.samples} samples, {report.duration_s:.3f} s"),
        ]
    return rows


def tiles(report: ReplayReport) -> tuple[Tile, ...]:
    """The most important numbers of one recording."""
    known, right = judged(report), "should be about 95 % or more"
    errors = (
        Tile(f"{channel.title} error (RMS)", channel.write(ukf.rmse), f"model alone {channel.write(model.rmse)}")
        for channel, ukf, model in known
    )
    inside = (Tile(f"{one.channel.title} in the 95 % interval", percent(one.coverage), right) for one in known)
    return *errors, *inside


def errors_table(report: ReplayReport, caption: str = "") -> Table:
    """Errors of the filter and of the model alone, for one recording."""
    out = Comparison("", "UKF", "model alone")
    known = {item.channel: item for item in judged(report)}
    for channel in CHANNELS:
        if channel.of(report.ukf) is None:
            out.heading(f"{channel.title}: not measured")
        elif channel not in known:
            out.heading(f"{channel.title}: {joint_text(report.joint)}")
        else:
            ukf, model = known[channel].ukf, known[channel].model
            out.heading(channel.title)
            out.values(f"  RMSE 𝕀 [{channel.unit}]", (ukf.rmse, model.rmse))
            out.values(f"  largest error 𝕄 [{channel.unit}]", (ukf.largest, model.largest))
            out.values("  𝕄 over measured range, ℚ", (ukf.ratio, model.ratio), percent)
            out.text("  in the 95 % interval", percent(ukf.coverage95), MISSING)
            nees = getattr(report.innovation, f"nees_{channel.name}")
            out.text("  mean NEES (1 is right)", number(nees, 2), MISSING)
    if external := report.ukf.external_torque:
        late = external.delay_s
        out.heading("External torque")
        out.text("  RMSE 𝕀 [N m]", number(external.rmse), "given")
        out.text("  in the 95 % interval", percent(external.coverage95), MISSING)
        out.text("  delay [ms]", MISSING if late is None or math.isnan(late) else f"{1e3 * late:.0f}", MISSING)
    out.heading("Pressure")
    for muscle in (0, 1):
        errors = [model.pressure.rmse_pa[muscle] for model in (report.ukf, report.model_alone)]
        out.pressures(f"  RMSE 𝕀, muscle {muscle + 1}", errors)
    return out.table(caption)


def overview(reports: Sequence[ReplayReport]) -> Table:
    """Errors of all recordings, one row for each."""
    header = ["Recording", "joint"]
    for channel in CHANNELS:
        header += [f"{channel.name} RMSE [{channel.unit}]", "model alone", "in 95 %"]
    rows = []
    for report in reports:
        row, known = [report.recording.name, joint_text(report.joint)], {item.channel: item for item in judged(report)}
        for channel in CHANNELS:
            one = known.get(channel)
            errors = (None, None) if one is None else (one.ukf.rmse, one.model.rmse)
            row += [*map(number, errors), percent(None if one is None else one.coverage)]
        rows.append(tuple(row))
    about = "Errors of the filter and of the model alone; share of measured values in the filter's 95 % interval"
    return Table(tuple(header), tuple(rows), about)
