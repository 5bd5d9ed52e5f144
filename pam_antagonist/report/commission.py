"""The report of ``commission``: result of each step, so that a second person can follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Document, Finding, Findings, Text, background
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
    """

    name: str
    done: bool
    said: str
    seconds: float
    rig_seconds: float


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


def write_report(folder: Path, rig: Rig, steps: Sequence[Step], command: str, left: Sequence[str] = ()) -> None:
    """Write ``report.json`` and ``report.html``."""
    report = CommissionReport(rig.name, tuple(steps), sum(step.rig_seconds for step in steps), tuple(left))
    findings = Findings(tuple(Finding("good" if step.done else "warn", f"{step.name}: {step.said}") for step in steps))
    rows = tuple((step.name, f"{step.seconds:.0f}", f"{step.rig_seconds:.0f}") for step in steps)
    table = Table(("step", "took [s]", "rig time [s]"), rows, "How long each step took")
    blocks: tuple[Block, ...] = (
        Text(_lede(steps, left), "lede"),
        findings,
        table,
        *background(_DEFINITIONS, [("Rig", rig.name), ("Command", command)]),
    )
    html.write(folder, Document("Commissioning", rig.name, blocks), report)


def _lede(steps: Sequence[Step], left: Sequence[str]) -> str:
    """What failed, else what is left, else that all is done."""
    failed = [f"Step {step.name} failed: {step.said.rstrip('.')}." for step in steps if not step.done]
    if failed or left:
        rest = [f"Not begun: {', '.join(left)}."] if left else []
        return " ".join([*failed, *rest, "Do what it says, then type the command again." if failed else ""]).strip()
    return "All is done."
