"""The report of ``commission``: result of each step, so that a second person can follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.recording import Recording
from pam_antagonist.report.document import Block, Document, Findings, Links, Table, Text, background, good, warn
from pam_antagonist.report.figure import MEASURED, MODEL, SECOND, TIME, Axis, Figure, Line, Panel, Reference
from pam_antagonist.report.replay_figures import seconds
from pam_antagonist.report.result import Result


@dataclass(frozen=True)
class Step:
    """A step of a commissioning; `rig_seconds` is the part of its duration in which the joint was driven [s]."""

    name: str
    done: bool
    said: str
    seconds: float
    rig_seconds: float
    folder: str = ""  # of a report of its own, beside this one


@dataclass(frozen=True, eq=False)
class Driven:
    """A recording of a step in which the joint was driven."""

    name: str
    recording: Recording
    pressure_limits: tuple[float, float]  # least and largest [Pa]
    angle_limit: float  # [rad]


@dataclass(frozen=True, repr=False, eq=False)
class CommissionResult(Result):
    """What was done so far; `left` are the steps that were not begun, `next_line` is to be typed when all is done."""

    rig: str
    steps: tuple[Step, ...]
    command: str
    left: tuple[str, ...] = ()
    driven: tuple[Driven, ...] = ()
    next_line: str = ""

    @override
    def to_json(self) -> dict[str, Any]:
        driven = sum(step.rig_seconds for step in self.steps)
        return {"rig": self.rig, "steps": self.steps, "rig_seconds": driven, "left": self.left}

    @override
    def document(self, figures: bool = True) -> Document:
        found = tuple((good if step.done else warn)(f"{step.name}: {step.said}") for step in self.steps)
        rows = tuple((step.name, f"{step.seconds:.0f}", f"{step.rig_seconds:.0f}") for step in self.steps)
        blocks: list[Block] = [Text(self._lede(), "lede"), Findings(found)]
        if self.next_line and not self.left and all(step.done for step in self.steps):
            blocks.append(Text(f"Next, type: {self.next_line}"))
        pages = tuple((f"{step.name}: its report", f"{step.folder}/report.html") for step in self.steps if step.folder)
        if pages:
            blocks.append(Links(pages))
        table = Table(("step", "took [s]", "rig time [s]"), rows, "How long each step took")
        blocks += [table, *map(figure_of, self.driven if figures else ())]
        ends = background("commission", [("Rig", self.rig), ("Command", self.command)])
        return Document("Commissioning", self.rig, (*blocks, *ends))

    def _lede(self) -> str:
        """What failed, else what is left, else that all is done."""
        failed = [f"Step {step.name} failed: {step.said.rstrip('.')}." for step in self.steps if not step.done]
        if failed or self.left:
            rest = [f"Not begun: {', '.join(self.left)}."] if self.left else []
            return " ".join([*failed, *rest, "Do what it says, then type the command again." if failed else ""]).strip()
        return "All is done."


def figure_of(driven: Driven) -> Figure:
    """What a step asked of the joint, and what it did."""
    recording = driven.recording
    x = seconds(recording.stamp_ns, int(recording.stamp_ns[0]))
    pressure = recording.pressure * 1e-3
    bounds = tuple(Reference(value * 1e-3) for value in driven.pressure_limits)
    both = (Line("P1", x, pressure[:, 0], MODEL), Line("P2", x, pressure[:, 1], SECOND))
    panels = [Panel(TIME, Axis("Pressure [kPa abs]"), (*bounds, *both), 200)]
    if recording.angle is not None:
        limit = float(np.degrees(driven.angle_limit))
        angle = Line("angle", x, np.degrees(recording.angle), MEASURED, quiet=True)
        panels.append(Panel(TIME, Axis("Angle [°]"), (Reference(-limit), Reference(limit, "limit"), angle), 200))
    return Figure(f"Step {driven.name}", "Measured values; dashed: the limits of the experiment.", tuple(panels))
