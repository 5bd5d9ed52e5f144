"""The report of a planned experiment: its voltages, and how well it determines the parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.design import Plan, standard_errors
from pam_antagonist.report.document import Block, Document, Table, Text, number, percent
from pam_antagonist.report.figure import ESTIMATE, MODEL, TIME, Axis, Figure, Line, Panel
from pam_antagonist.report.result import Result
from pam_antagonist.rig import Rig
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
