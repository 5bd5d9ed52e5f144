"""The report of one or several replayed recordings: ``report.json`` and ``report.html``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pam_antagonist.report import html, replay_tables, words
from pam_antagonist.report.document import Block, Columns, Definitions, Document, Findings, Section, Text, Tiles
from pam_antagonist.report.replay import Replay
from pam_antagonist.report.replay_figures import replay_figures
from pam_antagonist.report.table import Table
from pam_antagonist.software import versions


def document(replays: Sequence[Replay], **more: Any) -> dict[str, Any]:
    """What goes into ``report.json``.

    One recording gives its entry (:mod:`pam_antagonist.report.replay`) with ``settings`` and ``software`` beside it;
    several give ``{"recordings": [entry, ...], "settings": ..., "software": ...}``.

    Args:
        replays: at least one, all of one rig and tuning.
        more: further keys.
    """
    shared = {"settings": _settings(replays[0]), "software": versions(), **more}
    if len(replays) == 1:
        return {**replays[0].report, **shared}
    return {"recordings": [replay.report for replay in replays], **shared}


def _settings(replay: Replay) -> dict[str, Any]:
    tuning = replay.rig.tuning(replay.tuning)
    return {
        "rig": replay.rig.name,
        "rig_source": replay.rig.source.strip(),
        "sample_period_s": replay.rig.sample_period,
        "tuning": {
            "name": replay.tuning,
            "initial": list(tuning.initial),
            "process": list(tuning.process),
            "measurement": list(tuning.measurement),
            "kappa": tuning.kappa,
            "consider": dict(replay.rig.uncertainty) if tuning.consider else {},
            "gate": tuning.gate,
        },
    }


def page(
    replays: Sequence[Replay], title: str = "", with_figures: bool = True, first: Sequence[Block] = ()
) -> Document:
    """The report as a page.

    Args:
        replays: at least one, all of one rig and tuning.
        title: default: the recording's name.
        with_figures: False leaves the figures (and plotly's 5 MB) out.
        first: blocks of another command that uses a replay, put before the recordings.
    """
    reports = [replay.report for replay in replays]
    name = title or (reports[0]["recording"]["name"] if len(reports) == 1 else f"{len(reports)} recordings")
    seconds = sum(report["duration_s"] for report in reports)
    lede = (
        f"{seconds:.0f} s of recorded muscle pressures and valve voltages went once more through the estimator that "
        "runs live. Does it tell the joint's angle and torque without an encoder or a torque meter?"
    )
    parts: list[Block] = [Text(lede, "lede"), Text(words.overall_verdict(reports), "verdict")]
    if len(reports) == 1:
        parts += [*first, *_recording(replays[0], with_figures)]
    else:
        parts += [replay_tables.overview(reports), *first]
        parts += [
            Section(
                report["recording"]["name"],
                (Text(words.verdict(report)), *_recording(replay, with_figures)),
                2,
                f"r{number}",
            )
            for number, (replay, report) in enumerate(zip(replays, reports, strict=True), 1)
        ]
    parts += [
        Section("What the words mean", (Definitions(words.DEFINITIONS),), folded=True),
        Section("How this report was made", _provenance(replays), folded=True),
    ]
    return Document("Replay of a pneumatic muscle joint", name, tuple(parts))


def _recording(replay: Replay, with_figures: bool) -> list[Block]:
    report = replay.report
    caption = "Errors; the better of the two is bold"
    out: list[Block] = [
        Tiles(replay_tables.tiles(report)),
        Columns(Findings(words.findings(report)), replay_tables.errors_table(report, caption)),
    ]
    return out + list(replay_figures(replay)) if with_figures else out


def _provenance(replays: Sequence[Replay]) -> tuple[Block, ...]:
    replay = replays[0]
    tuning = replay.rig.tuning(replay.tuning)
    rows = [
        ("Rig", replay.rig.name),
        ("Source of its numbers", replay.rig.source.strip()),
        ("Filter tuning", f"{replay.tuning}: κ {tuning.kappa:g}, gate {tuning.gate:g} standard deviations"),
        ("Process noise Q, a step", ", ".join(f"{value:g}" for value in tuning.process) + " [rad², rad²/s², Pa², Pa²]"),
        ("Measurement noise R", ", ".join(f"{value:g}" for value in tuning.measurement) + " [Pa²]"),
    ]
    if tuning.consider:
        known = ", ".join(f"{name} ± {std:g}" for name, std in replay.rig.uncertainty.items())
        rows.append(("Parameters carried as uncertain", known))
    for item in replays:
        report = item.report
        joint = report["joint"]["condition"]
        if report["joint"]["lock_angle_rad"] is not None:
            joint += f" at {math.degrees(report['joint']['lock_angle_rad']):.1f}°"
        rows += [
            (f"Recording {report['recording']['name']}", f"SHA-256 {report['recording']['sha256']}"),
            ("Its joint", f"{joint}; told from: {report['joint']['told_from']}"),
            ("Its length", f"{report['samples']} samples, {report['duration_s']:.3f} s"),
        ]
    return (Table(("What", "Which"), tuple(rows), prose=True),)


def write_report(
    folder: Path,
    replays: Sequence[Replay],
    with_figures: bool = True,
    title: str = "",
    first: Sequence[Block] = (),
    **more: Any,
) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: where to.
        replays: at least one, all of one rig and tuning.
        with_figures: False leaves the figures out of the page.
        title: of the page, as in :func:`page`.
        first: blocks of another command that uses a replay, as in :func:`page`.
        more: further keys for ``report.json``.
    """
    html.write(folder, page(replays, title, with_figures, first), document(replays, **more))
