"""The report of ``commission``: result of each step, so that a second person can follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from typing_extensions import override

from pam_antagonist.report.document import Document, Findings, Text, background, good, warn
from pam_antagonist.report.result import Result
from pam_antagonist.report.table import Table

_DEFINITIONS = (
    ("Rig time", "How long the joint was driven. The remaining time is design, fits and waiting."),
    (
        "Margins",
        "They are those of the loop with the linearised model. Nonlinear behaviour of the joint is not included.",
    ),
)


@dataclass(frozen=True)
class Step:
    """A step of a commissioning; `rig_seconds` is the part of its duration in which the joint was driven [s]."""

    name: str
    done: bool
    said: str
    seconds: float
    rig_seconds: float


@dataclass(frozen=True, repr=False)
class CommissionResult(Result):
    """What was done so far; `left` are the steps that were not begun."""

    rig: str
    steps: tuple[Step, ...]
    command: str
    left: tuple[str, ...] = ()

    @override
    def to_json(self) -> dict[str, Any]:
        """The content of ``report.json``."""
        driven = sum(step.rig_seconds for step in self.steps)
        return {"rig": self.rig, "steps": self.steps, "rig_seconds": driven, "left": self.left}

    @override
    def blocks(self) -> tuple[Findings, Table]:
        """What a terminal shows."""
        found = tuple((good if step.done else warn)(f"{step.name}: {step.said}") for step in self.steps)
        rows = tuple((step.name, f"{step.seconds:.0f}", f"{step.rig_seconds:.0f}") for step in self.steps)
        return Findings(found), Table(("step", "took [s]", "rig time [s]"), rows, "How long each step took")

    @override
    def document(self, figures: bool = True) -> Document:
        """What a page shows; it has no figures."""
        ends = background(_DEFINITIONS, [("Rig", self.rig), ("Command", self.command)])
        return Document("Commissioning", self.rig, (Text(self._lede(), "lede"), *self.blocks(), *ends))

    def _lede(self) -> str:
        """What failed, else what is left, else that all is done."""
        failed = [f"Step {step.name} failed: {step.said.rstrip('.')}." for step in self.steps if not step.done]
        if failed or self.left:
            rest = [f"Not begun: {', '.join(self.left)}."] if self.left else []
            return " ".join([*failed, *rest, "Do what it says, then type the command again." if failed else ""]).strip()
        return "All is done."
