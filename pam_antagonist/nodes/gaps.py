"""Sequence numbers of messages, and lost messages by their gaps (without ROS)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

_MOST_NUMBER = 2**63  # a larger number means that the middleware gives none


def number_of(information: Mapping[str, Any]) -> int | None:
    """Number of a message at its publisher, from 1; None where the middleware gives none."""
    number: int | None = information.get("publication_sequence_number")
    return number if number is not None and 0 < number < _MOST_NUMBER else None


class Gaps:
    """Counts missing messages of one topic.

    The middleware numbers the messages of each publisher, but does not tell which publisher a message is from. So gaps
    are counted only while there is one publisher. Counting ends with a second one.

    Args:
        publishers: returns the present number of publishers; called only at a gap.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._last: int | None = None
        self.missing = 0
        self.countable = True

    def add(self, number: int | None) -> None:
        """Take the :func:`number_of` a message, in the order of reception."""
        if number is None or not self.countable:
            return
        last, self._last = self._last, number
        if last is None or number == last + 1:
            return
        if self._publishers() > 1:
            self.countable = False
        elif number > last:  # otherwise the publisher restarted
            self.missing += number - last - 1
