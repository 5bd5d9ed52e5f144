"""Messages that never came, by the publisher's numbering."""

from __future__ import annotations

from pam_antagonist.nodes.wire import Gaps, number_of


def fed(numbers: list[int | None], publishers: int = 1) -> Gaps:
    gaps = Gaps(lambda: publishers)
    for number in numbers:
        gaps.add(number)
    return gaps


def test_what_is_missing_is_counted() -> None:
    assert fed([5, 6, 7, 8]).missing == 0  # what came before the recorder is not missing
    assert fed([1, 2, 5, 6, 10]).missing == 2 + 3


def test_a_publisher_that_starts_anew_loses_nothing() -> None:
    assert fed([7, 8, 1, 2, 4]).missing == 1


def test_several_publishers_cannot_be_counted() -> None:
    gaps = fed([100, 5, 101, 6, 102], publishers=2)
    assert gaps.missing == 0 and not gaps.countable


def test_a_middleware_without_numbers() -> None:
    assert fed([None, None]).missing == 0
    for information in ({}, {"publication_sequence_number": 0}, {"publication_sequence_number": 2**64 - 1}):
        assert number_of(information) is None
    assert number_of({"publication_sequence_number": 1}) == 1


def test_the_graph_is_asked_for_gaps_only() -> None:
    asked = []
    gaps = Gaps(lambda: asked.append(1) or 1)
    for number in [*range(1, 1000), 1005]:
        gaps.add(number)
    assert gaps.missing == 5 and len(asked) == 1
