"""How often a diagnosis is right, with 95 % intervals: in all, and against the size of an effect."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pam_antagonist.report.document import MISSING, Table, number, percent
from validation.battery.forms import REMAINDERS, group_of
from validation.battery.outcomes import Outcome
from validation.battery.places import LEARNED
from validation.battery.plants import LARGE, LEVELS

FOUND = 0.9
"""Share of the cases of a size that have to be found for the size to count as found."""
Where = Callable[[Outcome], bool]
Of = Callable[[Outcome], Any]


def interval(hits: int, count: int) -> tuple[float, float] | None:
    """95 % interval of a share by Clopper and Pearson (1934); None of no case."""
    if not count:
        return None
    # It takes a third of a second to import, which --help need not.
    from scipy.stats import binomtest

    found = binomtest(hits, count).proportion_ci(0.95, "exact")
    return float(found.low), float(found.high)


def level(size: float) -> float:
    """The level that is nearest to a size, by ratio."""
    return min(LEVELS, key=lambda one: abs(float(np.log(max(size, 1e-9) / one))))


def _large(one: Outcome) -> bool:
    """Whether all effects have a size at which the figures count."""
    return all(level(size) >= LARGE for size in one.reached or one.sizes)


def _variation(one: Outcome) -> bool:
    return group_of(one.form) == "variation"


def _kind(*kinds: str, large: bool = True) -> Where:
    return lambda one: one.kind in kinds and (not large or _large(one))


def _single(one: Outcome) -> bool:
    return one.kind == "single" and not _variation(one) and _large(one)


def _small(one: Outcome) -> bool:
    return one.kind == "single" and not _variation(one) and not _large(one)


def _alone(one: Outcome) -> bool:
    return one.kind in ("single", "foreign") and _large(one)


def _named(one: Outcome) -> bool:
    return one.kind in ("single", "pair") and bool(one.names)


class Figure(NamedTuple):
    """A figure of a battery: of which cases, what is counted (None: the case does not count), and the bound."""

    what: str
    cases: Where
    of: Of
    bound: float | None = None
    at_most: bool = False
    median: bool = False  # of a number, in place of the share of cases for which something is so


FIGURES = (
    Figure("single effect: the right one first", _single, lambda one: one.right, 0.95),
    Figure("single effect in a form with a remainder above 10 %: the right one first",
           lambda one: _single(one) and group_of(one.form) == "other", lambda one: one.right),
    Figure("single effect: and on its muscle", _single, lambda one: one.right_muscle),
    Figure("single effect: first, or among those it cannot be told from", _single,
           lambda one: one.right or one.effects[0][0] in one.ambiguous_with),
    Figure("single effect: named, or the first of the candidates where none explains enough", _single,
           lambda one: one.right or one.leading[:1] == (one.effects[0][0],)),
    Figure("single effect of a smaller size: the right one first", _small, lambda one: one.right),
    Figure("single effect of a smaller size: another one first", _small, lambda one: one.confused),
    Figure("variation of the catalogue's law, of any size: the right one first",
           lambda one: one.kind == "single" and _variation(one), lambda one: one.right),
    Figure("two effects: both found", _kind("pair"), lambda one: one.right, 0.85),
    Figure("two effects: one of them first", _kind("pair"), lambda one: bool(one.names) and not one.confused),
    Figure("one or two effects, some found: none named that is not there", _named, lambda one: not one.superfluous),
    Figure("one or two effects, some found: no calibration named, which is not there", _named,
           lambda one: not one.calibrations),
    Figure("nothing: false alarm", _kind("none"), lambda one: not one.right, 0.02, at_most=True),
    Figure("a calibration and nothing else: named, and no effect", _kind("calibration", large=False),
           lambda one: one.right, 0.95),
    Figure("in no catalogue: unexplained, or learned in its place", _kind("foreign"), lambda one: one.right, 0.95),
    Figure("error that a true model takes away, taken away (median)", lambda one: _single(one) and one.right,
           lambda one: one.taken_away("recalibrated"), 0.7, median=True),
    Figure("one effect, in any form or in no catalogue: its place", _alone, lambda one: one.places_right, 0.95),
    Figure("one effect, in any form or in no catalogue: and its arguments", _alone,
           lambda one: one.arguments_right, 0.9),
    Figure("one effect: held-out excess of the configured rig, removed (median)", _alone,
           lambda one: one.taken_away("as_configured"), 0.9, median=True),
    Figure("two effects: both places", _kind("pair"), lambda one: one.places_right, 0.85),
    Figure("in no catalogue: its place", _kind("foreign"), lambda one: one.places_right, 0.9),
    Figure("in no catalogue: held-out error of the angle, of the configured one (median)", _kind("foreign"),
           lambda one: one.angle_left, 0.1, at_most=True, median=True),
    Figure("nothing: a law added", _kind("none"), lambda one: LEARNED in one.names, 0.01, at_most=True),
    Figure("pushes: a law added", lambda one: _alone(one) and one.effects[0][0] == "external_torque",
           lambda one: LEARNED in one.names, 0.0, at_most=True),
)  # fmt: skip


def scores(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """The figures: what, value (None of no case), cases, low, high, wanted, holds."""
    rows = []
    for one in FIGURES:
        values = [value for item in outcomes if one.cases(item) and (value := one.of(item)) is not None]
        value = float(np.median(values) if one.median else np.mean(values)) if values else None
        low, high = (None if one.median else interval(sum(values), len(values))) or (None, None)
        holds = None
        if one.bound is not None and value is not None:
            holds = value <= one.bound if one.at_most else value >= one.bound
        wanted = "" if one.bound is None else f"at {'most' if one.at_most else 'least'} {100.0 * one.bound:.0f} %"
        rows.append((one.what, value, len(values), low, high, wanted, holds))
    frame = pd.DataFrame(rows, columns=["what", "value", "cases", "low", "high", "wanted", "holds"], dtype=object)
    return frame.set_index("what")


def detections(outcomes: Sequence[Outcome]) -> pd.DataFrame:
    """Single effects by level, variations of a law left out: found, another one first, cases."""
    rows = [(one.effects[0][0], level((one.reached or one.sizes)[0]), one.right, one.confused) for one in outcomes
            if one.kind == "single" and not _variation(one)]  # fmt: skip
    frame = pd.DataFrame(rows, columns=["effect", "size", "found", "another"])
    both = pd.concat([frame, frame.assign(effect="all")])
    groups = both.groupby(["effect", "size"], sort=False)
    return groups.agg(found=("found", "sum"), another=("another", "sum"), cases=("found", "count"))


def _interval(low: float | None, high: float | None) -> str:
    return MISSING if low is None or high is None else f"{100.0 * low:.1f} to {100.0 * high:.1f} %"


def figures_table(outcomes: Sequence[Outcome]) -> Table:
    """The figures, with their intervals and what is wanted."""
    mark = {True: "yes", False: "NO", None: ""}
    rows = tuple(
        (str(what), percent(one.value), _interval(one.low, one.high), str(one.cases), one.wanted, mark[one.holds])
        for what, one in scores(outcomes).iterrows()
    )
    return Table(("figure", "measured", "95 % interval", "cases", "wanted", "holds"), rows)


def detection_table(outcomes: Sequence[Outcome]) -> Table:
    """Right one first, of how many, against the size in noises; sizes from which on nine of ten are found."""
    counts, rows = detections(outcomes), []
    for effect in dict.fromkeys(counts.index.get_level_values("effect")):
        mine = counts.loc[effect].reindex(LEVELS).fillna(0).astype(int)
        enough = [one for one in reversed(LEVELS) if mine.cases[one]]
        short = [one for one in enough if mine.found[one] < FOUND * mine.cases[one]]
        smallest = min([one for one in enough if not short or one > short[0]], default=None)
        largest = max([one for one in LEVELS if mine.another[one]], default=None)
        cells = (f"{mine.found[one]}/{mine.cases[one]}" if mine.cases[one] else "·" for one in LEVELS)
        rows.append((str(effect), *cells, number(smallest, 2), number(largest, 2)))
    return Table(("effect", *(f"{one:g}" for one in LEVELS), "found from", "another one first up to"), tuple(rows))


def misses_table(outcomes: Sequence[Outcome]) -> Table:
    """What was not right, or had something beside it that was not there."""
    rows = []
    for one in outcomes:
        if not one.right or one.superfluous:
            left = " + ".join(percent(REMAINDERS.get(name)) for name in one.form) or MISSING
            sizes = " + ".join(f"{size:.{1 if one.effects else 3}f}" for size in one.reached or one.sizes) or MISSING
            found = " + ".join(f"{name} {muscle}" if muscle else name for name, muscle in one.found)
            said = ", ".join([found if one.verdict == "effect" else one.verdict, *one.calibrations])
            rows.append((one.name, " + ".join(one.form) or MISSING, left, sizes, said))
    return Table(("case", "form", "remainder", "size", "said"), tuple(rows))
