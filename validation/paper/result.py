"""What an experiment gives back: numbers beside the paper's, tables and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pam_antagonist.report.figure import Figure
from pam_antagonist.report.table import Table, number
from validation.paper.seed_work import SeedWork


@dataclass(frozen=True)
class Spread:
    """Median and range of a number over virtual rigs.

    Attributes:
        median: of the finite values, NaN where there is none.
        low: least of them.
        high: largest of them.
        count: how many there are.
    """

    median: float
    low: float
    high: float
    count: int

    @classmethod
    def of(cls, values: ArrayLike) -> Spread:
        """The spread of some values; those that are not finite are left out."""
        known = np.asarray(values, dtype=np.float64).ravel()
        known = known[np.isfinite(known)]
        if not known.size:
            return cls(math.nan, math.nan, math.nan, 0)
        return cls(float(np.median(known)), float(known.min()), float(known.max()), int(known.size))

    def text(self, scale: float = 1.0, digits: int = 3) -> str:
        """Median, and the range behind it where there is more than one value."""
        middle = number(self.median * scale, digits)
        if self.count < 2:
            return middle
        return f"{middle} ({number(self.low * scale, digits)} … {number(self.high * scale, digits)})"


@dataclass(frozen=True)
class Beside:
    """A number of ours, the paper's, and a sentence on the difference.

    Attributes:
        what: the quantity, with the condition it holds for.
        ours: on the virtual rig.
        paper: the paper's, None where it gives none.
        unit: of both; ``%`` for fractions, which are shown a hundred times as large.
        why: a sentence.
    """

    what: str
    ours: Spread
    paper: float | None
    unit: str
    why: str

    @property
    def cells(self) -> tuple[str, str, str, str]:
        """What the tables show of it."""
        scale = 100.0 if self.unit == "%" else 1.0
        unit = "" if self.unit == "-" else f" {self.unit}" if self.unit != "°" else "°"
        paper = "–" if self.paper is None else f"{self.paper * scale:.6g}{unit}"
        return self.what, f"{self.ours.text(scale)}{unit}", paper, self.why


HEADER = ("What", "Virtual rig (ours): median (range)", "Paper (real rig)", "On the difference")


@dataclass(frozen=True)
class Result:
    """One experiment.

    Attributes:
        name: as given to ``--only``.
        title: heading.
        question: what was done, in a sentence or two.
        beside: numbers beside the paper's.
        tables: further tables.
        findings: what they say, one sentence each.
        figures: plots.
        numbers: for ``report.json``.
    """

    name: str
    title: str
    question: str
    beside: tuple[Beside, ...] = ()
    tables: tuple[Table, ...] = ()
    findings: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def table(self) -> Table:
        """The numbers beside the paper's as a table."""
        return Table(HEADER, tuple(item.cells for item in self.beside))

    def document(self) -> dict[str, Any]:
        """The experiment's entry in ``report.json``."""
        beside = [
            {
                "what": item.what,
                "ours": {"median": item.ours.median, "range": [item.ours.low, item.ours.high], "n": item.ours.count},
                "paper": item.paper,
                "unit": "fraction" if item.unit == "%" else item.unit,
                "difference": item.why,
            }
            for item in self.beside
        ]
        return {
            "title": self.title,
            "question": self.question,
            "beside_the_paper": beside,
            "findings": list(self.findings),
            "numbers": dict(self.numbers),
        }


@dataclass(frozen=True)
class Context:
    """What an experiment is given.

    Attributes:
        work: the virtual rig of the first seed, which figures show.
        of_seeds: what the experiment's ``of_seed`` gave for each seed.
        seeds: the seeds.
        with_figures: False saves their time.
        short: live runs are short ones.
        force_map: CSV file of a real muscle's force map, None where there is none.
        folder: for recordings of live runs.
        log: called with a line for the user now and then.
    """

    work: SeedWork
    of_seeds: Sequence[Mapping[str, Any]]
    seeds: Sequence[int]
    with_figures: bool
    short: bool
    force_map: Path | None
    folder: Path
    log: Callable[[str], None]

    def spread(self, *path: str) -> Spread:
        """The spread over the seeds of a number that ``of_seed`` gave, by its path of keys."""
        return Spread.of(self.values(*path))

    def values(self, *path: str) -> list[float]:
        """That number of each seed."""
        out = []
        for entry in self.of_seeds:
            node: Any = entry
            for key in path:
                node = node[key]
            out.append(float(node))
        return out
