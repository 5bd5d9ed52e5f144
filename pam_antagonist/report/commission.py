"""The report of ``commission``: result of each step, so that a second person can follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_antagonist.recording import Recording
from pam_antagonist.report import figures, html
from pam_antagonist.report.document import Block, Document, Finding, Findings, Links, Text, background
from pam_antagonist.report.figure import TIME, Axis, Figure, Line, Panel, Reference
from pam_antagonist.report.style import MEASURED, MODEL, SECOND
from pam_antagonist.report.table import Table
from pam_antagonist.rig import Rig

_DEFINITIONS = (
    ("Rig time", "How long the joint was driven. The remaining time is design, fits and waiting."),
    (
        "Margins",
        "They are those of the loop with the linearised model. Nonlinear behaviour of the joint is not included.",
    ),
)


@dataclass(frozen=True)
class Step:
    """A step of a commissioning.

    Attributes:
        seconds: its duration [s].
        rig_seconds: part of the duration in which the joint was driven [s].
        folder: of a report of its own, beside this one.
    """

    name: str
    done: bool
    said: str
    seconds: float
    rig_seconds: float
    folder: str = ""


@dataclass(frozen=True)
class CommissionReport:
    """Content of ``report.json``.

    Attributes:
        rig_seconds: total time in which the joint was driven [s].
    """

    rig: str
    steps: tuple[Step, ...]
    rig_seconds: float
    left: tuple[str, ...]


@dataclass(frozen=True)
class Driven:
    """A recording of a step in which the joint was driven.

    Attributes:
        pressure_limits: least and largest [Pa].
        angle_limit: [rad].
    """

    name: str
    recording: Recording
    pressure_limits: tuple[float, float]
    angle_limit: float


def write_report(
    folder: Path,
    rig: Rig,
    steps: Sequence[Step],
    command: str,
    left: Sequence[str] = (),
    driven: Sequence[Driven] = (),
    next_line: str = "",
) -> None:
    """Write ``report.json`` and ``report.html``.

    Args:
        next_line: what to type when all is done.
    """
    report = CommissionReport(rig.name, tuple(steps), sum(step.rig_seconds for step in steps), tuple(left))
    findings = Findings(tuple(Finding("good" if step.done else "warn", f"{step.name}: {step.said}") for step in steps))
    rows = tuple((step.name, f"{step.seconds:.0f}", f"{step.rig_seconds:.0f}") for step in steps)
    table = Table(("step", "took [s]", "rig time [s]"), rows, "How long each step took")
    pages = [(f"{step.name}: its report", f"{step.folder}/report.html") for step in steps if step.folder]
    blocks: list[Block] = [Text(_lede(steps, left), "lede"), findings]
    if next_line and not left and all(step.done for step in steps):
        blocks.append(Text(f"Next, type: {next_line}"))
    if pages:
        blocks.append(Links(tuple(pages)))
    blocks += [table, *map(figure_of, driven), *background(_DEFINITIONS, [("Rig", rig.name), ("Command", command)])]
    html.write(folder, Document("Commissioning", rig.name, tuple(blocks)), report)


def figure_of(driven: Driven) -> Figure:
    """What a step asked of the joint, and what it did."""
    recording = driven.recording
    x = figures.seconds(recording.stamp_ns, int(recording.stamp_ns[0]))
    pressure = recording.pressure * 1e-3
    bounds = tuple(Reference(value * 1e-3) for value in driven.pressure_limits)
    both = (Line("P1", x, pressure[:, 0], MODEL), Line("P2", x, pressure[:, 1], SECOND))
    panels = [Panel(TIME, Axis("Pressure [kPa abs]"), (*bounds, *both), 200)]
    if recording.angle is not None:
        limit = float(np.degrees(driven.angle_limit))
        angle = Line("angle", x, np.degrees(recording.angle), MEASURED, quiet=True)
        panels.append(Panel(TIME, Axis("Angle [°]"), (Reference(-limit), Reference(limit, "limit"), angle), 200))
    return Figure(f"Step {driven.name}", "Measured values; dashed: the limits of the experiment.", tuple(panels))


def _lede(steps: Sequence[Step], left: Sequence[str]) -> str:
    """What failed, else what is left, else that all is done."""
    failed = [f"Step {step.name} failed: {step.said.rstrip('.')}." for step in steps if not step.done]
    if failed or left:
        rest = [f"Not begun: {', '.join(left)}."] if left else []
        return " ".join([*failed, *rest, "Do what it says, then type the command again." if failed else ""]).strip()
    return "All is done."
