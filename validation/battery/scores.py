"""How often a diagnosis is right, with 95 % intervals: in all, and against the size of an effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from pam_antagonist.model.effects import CATALOGUE
from validation.battery.draw import LARGE, LEVELS
from validation.battery.outcomes import Outcome
from validation.battery.plants import KINDS
from validation.battery.remainders import group_of

FOUND = 0.9
"""Share of the cases of a size that have to be found for the size to count as found."""


@dataclass(frozen=True)
class Share:
    """So many of so many.

    Attributes:
        hits: how many.
        count: of how many.
    """

    hits: int
    count: int

    @property
    def value(self) -> float | None:
        """The share; None of no case."""
        return self.hits / self.count if self.count else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """Its 95 % interval by Clopper and Pearson (1934); None of no case."""
        if not self.count:
            return None
        # It takes a third of a second to import, which --help need not.
        from scipy.stats import binomtest

        found = binomtest(self.hits, self.count).proportion_ci(0.95, "exact")
        return float(found.low), float(found.high)


def share(values: Sequence[bool]) -> Share:
    """The share of values that are true."""
    return Share(sum(values), len(values))


@dataclass(frozen=True)
class Score:
    """A figure of a battery.

    Attributes:
        what: is counted.
        value: the share or the median, None where there was no such case.
        count: of how many cases.
        interval: 95 % interval of a share.
        bound: the value that is wanted.
        at_most: whether ``bound`` is the most, not the least.
    """

    what: str
    value: float | None
    count: int
    interval: tuple[float, float] | None = None
    bound: float | None = None
    at_most: bool = False

    @classmethod
    def of(cls, what: str, values: Sequence[bool], bound: float | None = None, at_most: bool = False) -> Score:
        """A share as a figure.

        Args:
            what: is counted.
            values: whether it was so, case by case.
            bound: the share that is wanted.
            at_most: whether that is the most, not the least.
        """
        found = share(values)
        return cls(what, found.value, found.count, found.interval, bound, at_most)

    @property
    def wanted(self) -> str:
        """The bound in words."""
        return "" if self.bound is None else f"at {'most' if self.at_most else 'least'} {100.0 * self.bound:.0f} %"

    @property
    def holds(self) -> bool | None:
        """Whether it is what was wanted; None where nothing was, or there is nothing to count."""
        if self.bound is None or self.value is None:
            return None
        return self.value <= self.bound if self.at_most else self.value >= self.bound


def sizes(outcome: Outcome) -> tuple[float, ...]:
    """The sizes that the effects had; as they were asked for where that is not known."""
    return outcome.reached or outcome.sizes


def level(size: float) -> float:
    """The level that is nearest to a size, by ratio."""
    return min(LEVELS, key=lambda one: abs(float(np.log(max(size, 1e-9) / one))))


def is_large(outcome: Outcome) -> bool:
    """Whether all effects have a size at which the figures count."""
    return all(level(size) >= LARGE for size in sizes(outcome))


def scores(outcomes: Sequence[Outcome]) -> list[Score]:
    """The figures that a battery is for."""
    by_kind = {kind: [item for item in outcomes if item.kind == kind] for kind in KINDS}
    variations = [item for item in by_kind["single"] if group_of(item.form) == "variation"]
    every = [item for item in by_kind["single"] if item not in variations]
    single, small = [item for item in every if is_large(item)], [item for item in every if not is_large(item)]
    others = [item for item in single if group_of(item.form) == "other"]
    pairs, foreign = ([item for item in by_kind[kind] if is_large(item)] for kind in ("pair", "foreign"))
    on_muscle = [item.right_muscle for item in single if item.right_muscle is not None]
    leads = [
        item.right or [candidate.effect for candidate in item.leading[:1]] == [item.effects[0][0]] for item in single
    ]
    reductions = [item.reduction for item in single if item.right and item.reduction is not None]
    return [
        Score.of("single effect: the right one first", [item.right for item in single], 0.95),
        Score.of("single effect in a form with a remainder above 10 %: the right one first",
                 [item.right for item in others]),
        Score.of("single effect: and on its muscle", on_muscle),
        Score.of("single effect: first, or among those it cannot be told from",
                 [item.right or item.effects[0][0] in item.ambiguous_with for item in single]),
        Score.of("single effect: named, or the first of the candidates where none explains enough", leads),
        Score.of("single effect of a smaller size: the right one first", [item.right for item in small]),
        Score.of("single effect of a smaller size: another one first", [is_confused(item) for item in small]),
        Score.of("variation of the catalogue's law, of any size: the right one first",
                 [item.right for item in variations]),
        Score.of("two effects: both found", [item.right for item in pairs], 0.85),
        Score.of("two effects: one of them first",
                 [bool(item.names) and item.names[0] in dict(item.effects) for item in pairs]),
        Score.of("one or two effects, some found: none named that is not there",
                 [not item.superfluous for item in (*by_kind["single"], *by_kind["pair"]) if item.names]),
        Score.of("one or two effects, some found: no calibration named, which is not there",
                 [not item.calibrations for item in (*by_kind["single"], *by_kind["pair"]) if item.names]),
        Score.of("nothing: false alarm", [not item.right for item in by_kind["none"]], 0.02, at_most=True),
        Score.of("a calibration and nothing else: named, and no effect",
                 [item.right for item in by_kind["calibration"]], 0.95),
        Score.of("in no catalogue: unexplained", [item.right for item in foreign], 0.95),
        Score("error that a true model takes away, taken away (median)",
              median(reductions) if reductions else None, len(reductions), None, 0.7),
    ]  # fmt: skip


def is_confused(outcome: Outcome) -> bool:
    """Whether an effect was named first that is not there."""
    return bool(outcome.names) and outcome.names[0] not in dict(outcome.effects)


@dataclass(frozen=True)
class Detection:
    """How often an effect was found, against its size.

    Attributes:
        effect: its name; empty for all.
        found: right one first, for each of ``LEVELS``.
        confused: another one first, likewise.
    """

    effect: str
    found: tuple[Share, ...]
    confused: tuple[Share, ...]

    @property
    def smallest(self) -> float | None:
        """The smallest level from which on nine of ten cases are found, in every level that has cases."""
        least = None
        for one, found in zip(reversed(LEVELS), reversed(self.found), strict=True):
            if found.value is None:
                continue
            if found.value < FOUND:
                break
            least = one
        return least

    @property
    def confusion(self) -> float | None:
        """The largest level at which another effect was named first; None where that never happened."""
        return max((one for one, part in zip(LEVELS, self.confused, strict=True) if part.hits), default=None)


def detections(outcomes: Sequence[Outcome]) -> list[Detection]:
    """Detection against size of each effect that was alone, and of all; variations of a law are left out."""
    single = [item for item in outcomes if item.kind == "single" and group_of(item.form) != "variation"]

    def of(effect: str, items: Sequence[Outcome]) -> Detection:
        by_level = [[item for item in items if level(sizes(item)[0]) == one] for one in LEVELS]
        found = tuple(share([item.right for item in part]) for part in by_level)
        return Detection(effect, found, tuple(share([is_confused(item) for item in part]) for part in by_level))

    there = [name for name in CATALOGUE if any(item.effects[0][0] == name for item in single)]
    rows = [of(name, [item for item in single if item.effects[0][0] == name]) for name in there]
    return [*rows, of("", single)] if rows else []


def confusion(outcomes: Sequence[Outcome]) -> tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]:
    """What was there against what was found first.

    Returns:
        Header and rows of text; a row is an effect that was alone, ``none``, or what is in no catalogue; a column the
        first effect that was found, ``none`` or ``unexplained``.
    """
    counts: dict[str, dict[str, int]] = {}
    for item in outcomes:
        if item.kind not in ("pair", "calibration"):
            row = "none" if item.kind == "none" else item.effects[0][0]
            row = f"({item.form[0]})" if item.kind == "foreign" else row
            first = item.names[0] if item.names else item.verdict
            counts.setdefault(row, {})
            counts[row][first] = counts[row].get(first, 0) + 1
    order = [*CATALOGUE, "none", *sorted(row for row in counts if row.startswith("("))]
    rows = [row for row in order if row in counts]
    columns = [c for c in (*CATALOGUE, "none", "unexplained", "refused") if any(c in counts[row] for row in rows)]
    body = tuple((row, *(str(counts[row][c]) if c in counts[row] else "·" for c in columns)) for row in rows)
    return ("there \\ found first", *columns), body
