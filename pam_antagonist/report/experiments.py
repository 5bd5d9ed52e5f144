"""The reports of experiments: a planned one, and the steps of a commissioning, so that a second person can follow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.design import Limits, Plan, standard_errors
from pam_antagonist.recording import Recording
from pam_antagonist.report.document import Block, Document, Findings, Links, Table, Text, good, page, warn
from pam_antagonist.report.figure import ESTIMATE, MEASURED, MODEL, SECOND, TIME, Axis, Figure, Line, Panel, Reference
from pam_antagonist.report.replay_figures import seconds
from pam_antagonist.report.result import Result
from pam_antagonist.rig import Rig
from pam_antagonist.shown import number, percent
from pam_antagonist.strict_json import write_json


@dataclass(frozen=True, eq=False, repr=False)
class ExciteResult(Plan, Result):
    """A planned experiment.

    Attributes:
        voltage: (N, 2) [V], a row a sample period.
        period: [s].
        joint: ``free`` or ``locked``.
        lock_angle: [rad], of a locked joint.
        limits: limits that it keeps.
        pressure: of both muscles at rest, where it begins and ends [Pa].
        rest: voltages of both valves that hold this pressure [V].
        rig: that it was designed for.
    """

    rig: Rig

    @override
    def _brief(self) -> str:
        return f"{self.duration:g} s, joint {self.joint}, rig {self.rig.name}; .voltage {self.voltage.shape} [V]"

    @cached_property
    def standard_errors(self) -> dict[str, float]:
        """Expected standard error of each parameter, as a share of its prior's."""
        start = (self.pressure, self.pressure)
        return standard_errors(self.rig, self.voltage, self.period, self.joint, self.lock_angle, start)

    @override
    def to_json(self) -> dict[str, Any]:
        """The content of ``plan.json``."""
        limits = self.limits
        out: dict[str, Any] = {
            "rig": self.rig.name,
            "joint": self.joint,
            "lock_angle_rad": self.lock_angle if self.joint == "locked" else None,
            "limits": {"pressure_pa": limits.pressure, "angle_rad": limits.angle, "rate_rad_s": limits.rate},
        }
        if len(self.voltage):
            out |= {"duration_s": self.duration, "rest_v": self.rest, "standard_errors": self.standard_errors}
        return out

    @override
    def document(self, figures: bool = True) -> Document:
        low, high = (value / 1e3 for value in self.limits.pressure)
        text = (
            f"planned: {self.duration:g} s, joint {self.joint}, {low:.0f} to {high:.0f} kPa, up to "
            f"{number(math.degrees(self.limits.angle), 3)} deg and {self.limits.rate:g} rad/s"
        )
        rows = tuple((name, percent(share)) for name, share in self.standard_errors.items())
        table = Table(("parameter", "standard error, as a share of the prior's"), rows)
        blocks: list[Block] = [Text(text), table]
        if figures:
            seconds = self.period * np.arange(len(self.voltage), dtype=np.float64)
            series = tuple(Line(f"valve {i + 1}", seconds, self.voltage[:, i], (MODEL, ESTIMATE)[i]) for i in (0, 1))
            blocks.append(Figure("Voltages", "", (Panel(TIME, Axis("Voltage [V]"), series, 300),)))
        return Document("A planned experiment", self.rig.name, tuple(blocks))

    @override
    def write(self, folder: Path, figures: bool = True) -> None:
        """Write ``plan.json``, and ``voltages.csv`` where the plan has voltages, into a folder that exists."""
        if len(self.voltage):
            changes = np.flatnonzero(np.any(np.diff(self.voltage, axis=0) != 0.0, axis=1)) + 1
            rows = [0, *changes, len(self.voltage) - 1]
            lines = [f"{k * self.period:.6g},{self.voltage[k, 0]:.4f},{self.voltage[k, 1]:.4f}" for k in rows]
            (folder / "voltages.csv").write_text("\n".join(["t_s,u1,u2", *lines]) + "\n", encoding="utf-8")
        write_json(folder / "plan.json", self.to_json())


@dataclass(frozen=True, repr=False, eq=False)
class CommissionResult(Result):
    """What was done so far."""

    rig: str
    steps: Mapping[str, Mapping[str, Any]]  # of each step that was tried: what ``state.json`` has
    driven: Mapping[str, Recording]  # of the steps in which the joint was driven
    limits: Limits
    command: str
    left: tuple[str, ...]  # steps that were not begun
    next_line: str  # to be typed when all is done

    @override
    def to_json(self) -> dict[str, Any]:
        steps = [
            {
                "name": name, "done": bool(step["done"]), "doubt": bool(step.get("doubt")), "said": step["said"],
                "seconds": step.get("seconds", 0.0),
                "rig_seconds": step.get("rig_s", 0.0), "folder": step.get("folder", ""),
            }
            for name, step in self.steps.items()
        ]  # fmt: skip
        driven = sum(step["rig_seconds"] for step in steps)
        return {"rig": self.rig, "steps": steps, "rig_seconds": driven, "left": self.left}

    @override
    def document(self, figures: bool = True) -> Document:
        steps = self.to_json()["steps"]
        found = tuple(
            (good if step["done"] and not step["doubt"] else warn)(f"{step['name']}: {step['said']}") for step in steps
        )
        rows = tuple((step["name"], f"{step['seconds']:.0f}", f"{step['rig_seconds']:.0f}") for step in steps)
        blocks: list[Block] = [Findings(found)]
        if self.next_line and not self.left and all(step["done"] for step in steps):
            blocks.append(Text(f"Next, type: {self.next_line}"))
        pages = tuple(
            (f"{step['name']}: its report", f"{step['folder']}/report.html") for step in steps if step["folder"]
        )
        if pages:
            blocks.append(Links(pages))
        blocks.append(Table(("step", "took [s]", "rig time [s]"), rows, "How long each step took"))
        if figures:
            blocks += [self._figure(name, recording) for name, recording in self.driven.items()]
        made = [("Rig", self.rig), ("Command", self.command)]
        return page("Commissioning", self.rig, blocks, "commission", made, self._lede())

    def _lede(self) -> str:
        """What failed, else what is left, else that all is done."""
        failed = [
            f"Step {name} failed: {step['said'].rstrip('.')}." for name, step in self.steps.items() if not step["done"]
        ]
        if failed or self.left:
            rest = [f"Not begun: {', '.join(self.left)}."] if self.left else []
            return " ".join([*failed, *rest, "Do what it says, then type the command again." if failed else ""]).strip()
        return "All is done."

    def _figure(self, name: str, recording: Recording) -> Figure:
        """What a step asked of the joint, and what it did."""
        x = seconds(recording.stamp_ns, int(recording.stamp_ns[0]))
        pressure = recording.pressure * 1e-3
        bounds = tuple(Reference(value * 1e-3) for value in self.limits.pressure)
        both = (Line("P1", x, pressure[:, 0], MODEL), Line("P2", x, pressure[:, 1], SECOND))
        panels = [Panel(TIME, Axis("Pressure [kPa abs]"), (*bounds, *both), 200)]
        if recording.angle is not None:
            limit = math.degrees(self.limits.angle)
            angle = Line("angle", x, np.degrees(recording.angle), MEASURED, quiet=True)
            panels.append(Panel(TIME, Axis("Angle [°]"), (Reference(-limit), Reference(limit, "limit"), angle), 200))
        return Figure(f"Step {name}", "Measured values; dashed: the limits of the experiment.", tuple(panels))
