"""What a log book tells: every value over time, what has changed, and when a limit will be reached."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.trend import FEWEST, Trend, significant, trend
from pam_antagonist.program import versions
from pam_antagonist.report.document import Block, Document, Findings, Section, Statement, Table, good, note, page, warn
from pam_antagonist.report.figure import BAND, ESTIMATE, MODEL, Axis, Band, Figure, Line, Panel, Points, Reference
from pam_antagonist.report.result import Result
from pam_antagonist.rig import Rig
from pam_antagonist.rig.logbook import Entry, Logbook
from pam_antagonist.shown import MISSING, number

_LOSS = 0.8
"""Share of a muscle's first force that is its limit, if none is given."""
_LONGEST = 10.0
"""A limit is forecast no further than so many times the span of the log book."""
_MONTH = 30.44
FORCE = "force of muscle"
Floats = NDArray[np.float64]


class Limit(NamedTuple):
    """A value at which something has to be done: in the value's unit, or as a share of its first one."""

    value: float
    relative: bool = False

    def of(self, first: float) -> float:
        """In the value's unit."""
        return self.value * first if self.relative else self.value


@dataclass(frozen=True, eq=False)
class ValueOverTime:
    """One value over time."""

    name: str
    unit: str
    days: Floats  # since the first entry (N,)
    value: Floats  # (N,)
    std: Floats  # standard errors (N,)
    line: Trend | None  # per day; None with too few values
    changed: bool = False
    limit: float | None = None

    @property
    def span(self) -> float:
        """Days from the first to the last value."""
        return float(self.days[-1] - self.days[0])

    @property
    def change(self) -> tuple[float, float]:
        """Change from the first to the last value along the line, and its standard error."""
        assert self.line is not None
        return self.line.change(self.span)

    @property
    def forecast(self) -> tuple[float, float, float] | None:
        """Days until the line meets the limit: best, earliest, latest, from the first entry; None if not in sight."""
        if self.limit is None or self.line is None or not self.changed:
            return None
        met = self.line.reaches(self.limit)
        return None if met is None or not self.days[-1] < met[0] < self.days[-1] + _LONGEST * self.span else met

    @property
    def words(self) -> str:
        """What has changed, in a sentence without its end."""
        change, std = self.change
        level = self.line.at(self.days[:1])[0][0] if self.line else math.nan
        grown = (change > 0.0) is (level >= 0.0)
        verb = "has grown by" if grown else "has lost" if FORCE in self.name else "has fallen by"
        name = self.name.replace(FORCE, "muscle") if verb == "has lost" else self.name
        if level and abs(change / level) < 2.0:
            size = f"{100.0 * abs(change / level):.2g} ± {100.0 * std / abs(level):.1g} %"
        else:
            size = f"{number(abs(change))} ± {number(std, 2)} {self.unit}".rstrip()
        return f"{name} {verb} {size}{' of its force' if verb == 'has lost' else ''} in {time_words(self.span)}"


def time_words(days: float) -> str:
    """A length of time in words, from hours to months."""
    for unit, size in (("months", _MONTH), ("weeks", 7.0), ("days", 1.0), ("hours", 1.0 / 24.0)):
        if days >= 2.0 * size:
            return f"{days / size:.0f} {unit}"
    return f"{days * 1440.0:.0f} minutes"


@dataclass(frozen=True, eq=False, repr=False)
class HistoryResult(Result):
    """The log book of a rig.

    Attributes:
        rig: whose log book it is.
        book: its entries, and what is odd about its files.
        limits: of values, by name.
    """

    rig: Rig
    book: Logbook
    limits: Mapping[str, Limit]

    @cached_property
    def first(self) -> datetime.datetime:
        """Time of the first entry."""
        return self.book.entries[0].when

    @cached_property
    def courses(self) -> tuple[ValueOverTime, ...]:
        """Values that were found more than once, those that changed first."""
        series: dict[str, list[tuple[float, float, float, str]]] = {}
        for entry in self.book.entries:
            days = (entry.when - self.first).total_seconds() / 86400.0
            for name, found in entry.values.items():
                if found.std is not None:
                    series.setdefault(name, []).append((days, found.value, found.std, found.unit))
        plain = []
        for name, rows in series.items():
            if len(rows) > 1:
                days, value, std = np.array([row[:3] for row in rows]).T
                line = trend(days, value, std) if len(rows) >= FEWEST and np.ptp(days) > 0.0 else None
                plain.append(ValueOverTime(name, rows[-1][3], days, value, std, line, limit=self._limit(name, value)))
        lines = {course.name: course.line for course in plain if course.line is not None}
        there = dict(zip(lines, significant([line.p for line in lines.values()]), strict=True))
        out = [replace(course, changed=there.get(course.name, False)) for course in plain]
        return tuple(sorted(out, key=lambda course: (not course.changed, FORCE not in course.name, course.name)))

    def _limit(self, name: str, value: Floats) -> float | None:
        given = self.limits.get(name, Limit(_LOSS, relative=True) if name.startswith(FORCE) else None)
        return None if given is None else given.of(float(value[0]))

    @property
    def changed(self) -> tuple[ValueOverTime, ...]:
        """Values with a trend."""
        return tuple(course for course in self.courses if course.changed)

    def date(self, days: float) -> str:
        """A day, from days since the first entry."""
        return f"{self.first + datetime.timedelta(days=days):%Y-%m-%d}"

    @override
    def _brief(self) -> str:
        return f"{len(self.book.entries)} entries of rig {self.rig.name}; {len(self.changed)} values have changed"

    @override
    def to_json(self) -> dict[str, Any]:
        return {
            "rig": self.rig.name,
            "entries": [entry.model_dump(mode="json", exclude={"covariance"}) for entry in self.book.entries],
            "values": {course.name: self._course(course) for course in self.courses},
            "sentences": [finding.text for finding in self.findings()],
            "warnings": self.book.notes,
            "settings": {"rig": self.rig.name, "limits": {name: list(item) for name, item in self.limits.items()}},
            "software": versions(),
        }

    def _course(self, course: ValueOverTime) -> dict[str, Any]:
        line, met = course.line, course.forecast
        change, std = course.change if line is not None else (None, None)
        return {
            "unit": course.unit, "days": course.days, "value": course.value, "std": course.std,
            "spread": line and line.spread, "change": change, "change_std": std, "p": line and line.p,
            "changed": course.changed, "limit": course.limit,
            "limit_reached": None if met is None else {
                key: None if not math.isfinite(day) else self.date(day)
                for key, day in zip(("best", "earliest", "latest"), met, strict=True)
            },
        }  # fmt: skip

    def findings(self) -> tuple[Statement, ...]:
        """What the log book says, in sentences."""
        out = [warn(text) for text in self.book.notes]
        for course in self.changed:
            met, text = course.forecast, course.words
            if met is not None and course.limit is not None:
                about = f"{number(course.limit)} {course.unit}".rstrip()
                text += f"; if that goes on, it reaches {about} on {self.date(met[0])}"
                text += f" (95 %: {self.date(max(met[1], course.days[-1]))} to {self.date(met[2])})"
            plain = "_" in course.name or "." in course.name  # a dotted name keeps its letters
            out.append(warn(f"{text}." if plain else f"{text[0].upper()}{text[1:]}."))
        tested = sum(course.line is not None for course in self.courses)
        few = len(self.courses) - tested
        if tested and not self.changed:
            out.append(good(f"No trend in {tested} values beside what recordings differ by."))
        if few or not self.courses:
            out.append(note(f"A trend needs {FEWEST} entries at different times: {few} values have fewer."))
        return tuple(out)

    def values_table(self) -> Table:
        """Each value at first and at last, with its spread and its change."""
        rows = []
        for course in self.courses:
            line = course.line
            change = MISSING
            if line is not None:
                size, std = course.change
                change = f"{number(size)} ± {number(std, 2)}"
            rows.append((
                course.name, course.unit or "-", str(len(course.days)), number(course.value[0]),
                f"{number(course.value[-1])} ± {number(course.std[-1], 2)}", number(line and line.spread),
                change, "yes" if course.changed else MISSING if line is None else "no",
            ))  # fmt: skip
        header = ("value", "unit", "entries", "first", "last", "spread", "change", "a trend")
        about = "Spread: standard deviation between recordings beside the errors. Change: along the line, first to last"
        return Table(header, tuple(rows), about)

    def _log(self) -> Table:
        rows = tuple(
            (f"{entry.when:%Y-%m-%d %H:%M}", entry.command, ", ".join(span.name for span in entry.recordings),
             entry.said or entry.verdict)
            for entry in self.book.entries
        )  # fmt: skip
        return Table(("when", "command", "recordings", "found"), rows, "Entries", prose=True, last=8)

    @override
    def document(self, figures: bool = True) -> Document:
        span = f"{self.date(0.0)} to {self.book.entries[-1].when:%Y-%m-%d}"
        changed = self.changed
        lede = f"{len(self.book.entries)} entries from {span}. " + (
            f"{len(changed)} of {len(self.courses)} values change over time." if changed else "Nothing has changed."
        )
        blocks: list[Block] = [Findings(self.findings())]
        if self.courses:
            blocks.append(self.values_table())
        if figures and self.courses:
            drawn = tuple(self._figure(course) for course in self.courses)
            count = max(len(changed), 4)
            blocks.append(Section("Over time", drawn[:count], level=2, anchor="time"))
            if drawn[count:]:
                blocks.append(Section("Other values", drawn[count:], folded=True))
        blocks.append(Section("Log book", (self._log(),), level=2, anchor="log", brief=True))
        return page("Log book", self.rig.name, blocks, "history", [("Rig", self.rig.name)], lede)

    def _figure(self, course: ValueOverTime) -> Figure:
        x, y, half = course.days, course.value, 1.96 * course.std
        bars = np.column_stack([y - half, y + half, np.full(len(y), np.nan)]).ravel()
        series: list[Any] = []
        if course.line is not None:
            days = np.linspace(x[0], x[-1] + (0.25 * course.span if course.changed else 0.0), 60)
            line, std = course.line.at(days)
            width = course.line.quantile * std
            series = [
                Band("95 % of the line", days, line - width, line + width, BAND),
                Line("line", days, line, MODEL),
            ]
        series += [
            Line("95 % of a value", np.repeat(x, 3), bars, ESTIMATE, width=2.0, quiet=True),
            Points("value", x, y, ESTIMATE),
        ]  # fmt: skip
        if course.limit is not None and course.changed:
            series.append(Reference(course.limit, "limit"))
        unit = f"[{course.unit}]" if course.unit else ""
        panel = Panel(Axis(f"Days since {self.date(0.0)}"), Axis(unit), tuple(series), 240)
        return Figure(course.name, course.words + "." if course.changed else "", (panel,))


def values_of(entries: Sequence[Entry]) -> set[str]:
    """Names of all values in entries."""
    return {name for entry in entries for name in entry.values}
