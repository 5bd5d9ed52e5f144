"""Figures of the diagnostics, and how processes are started."""

from __future__ import annotations

import math

import pytest

from pam_antagonist.nodes.health import Level, Rate, Rises, Window, judged
from pam_antagonist.nodes.processes import ros_arguments
from pam_antagonist.nodes.wire import Gaps, number_of


def test_window_gives_order_statistics_of_so_many_values_and_starts_anew() -> None:
    window = Window()
    for value in range(1, 40_001):
        window.add(float(value))
    spread = window.take()
    assert (spread.size, spread.median, spread.largest) == (20_000, 10_000.0, 20_000.0)
    assert 19_800.0 <= spread.p99 <= 19_801.0
    empty = window.take()
    assert empty.size == 0 and math.isnan(empty.median) and math.isnan(empty.largest)


def test_rate_is_per_second() -> None:
    rate = Rate()
    assert math.isnan(rate.take(5, 10**9))
    assert rate.take(505, 10**9 + 500_000_000) == pytest.approx(1000.0)
    assert rate.take(505, 3 * 10**9) == 0.0


def test_counters_rise_from_0_or_from_what_they_were_first() -> None:
    from_0, since = Rises(), Rises(None)
    assert from_0.take(lost=3) == {"lost": 3} and since.take(lost=3) == {"lost": 0}
    assert from_0.take(lost=4, late=2) == {"lost": 1, "late": 2} and since.take(lost=4, late=2) == {
        "lost": 1,
        "late": 0,
    }


def test_the_first_case_that_holds_is_the_health() -> None:
    assert judged({"a": 1}, "well").message == "well"
    cases = ((0, Level.ERROR, "none"), ("words", Level.WARN, "some"), (1, Level.ERROR, "later"))
    health = judged({"a": 1}, "well", *cases)
    assert (health.level, health.message, health.values) == (Level.WARN, "some", {"a": 1})


def fed(numbers: list[int | None], publishers: int = 1) -> Gaps:
    """Messages with these numbers of a publisher."""
    gaps = Gaps(lambda: publishers)
    for number in numbers:
        gaps.add(number)
    return gaps


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        ([5, 6, 7, 8], 0),  # what came before the recorder is not missing
        ([1, 2, 5, 6, 10], 2 + 3),
        ([7, 8, 1, 2, 4], 1),  # the publisher starts anew
        ([None, None], 0),
    ],
)
def test_messages_that_never_came_are_counted_by_their_numbers(numbers: list[int | None], missing: int) -> None:
    assert fed(numbers).missing == missing
    several = fed([*numbers, *numbers], publishers=2)  # their numbers cannot be told apart
    assert several.missing == 0 and several.countable == (None in numbers)


def test_the_graph_is_asked_for_gaps_only_and_numbers_may_be_missing() -> None:
    asked = []
    gaps = Gaps(lambda: asked.append(1) or 1)
    for number in [*range(1, 1000), 1005]:
        gaps.add(number)
    assert gaps.missing == 5 and len(asked) == 1
    for information in ({}, {"publication_sequence_number": 0}, {"publication_sequence_number": 2**64 - 1}):
        assert number_of(information) is None
    assert number_of({"publication_sequence_number": 1}) == 1


def test_ros_arguments_keep_the_types_of_values() -> None:
    values = {"a": True, "b": 2, "c": 2.0, "d": 'x "ü"', "e": [1, 2.5], "f": 1e-05}
    assert ros_arguments(values, {"__ns": "/two"}) == [
        "--ros-args", "-p", "a:=true", "-p", "b:=2", "-p", "c:=2.0", "-p", 'd:="x \\"ü\\""', "-p", "e:=[1.0, 2.5]",
        "-p", "f:=1e-05", "-r", "__ns:=/two",
    ]  # fmt: skip
