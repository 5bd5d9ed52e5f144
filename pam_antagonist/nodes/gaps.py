"""Counts lost messages by their sequence numbers (without ROS)."""

from __future__ import annotations

from collections.abc import Callable


class Gaps:
    """Counts missing messages of one topic.

    The middleware numbers the messages of each publisher, but does not tell which publisher a message is from. So gaps
    are counted only while there is one publisher. Counting ends with a second one.

    Args:
        publishers: returns the present number of publishers; called only at a gap.

    Attributes:
        missing: number of missing messages so far.
        countable: False once a gap was found with several publishers.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._last: int | None = None
        self.missing = 0
        self.countable = True

    def add(self, number: int | None) -> None:
        """Take the number of a message, in the order of reception; None where the middleware gives none."""
        if number is None or number <= 0 or not self.countable:
            return
        last, self._last = self._last, number
        if last is None or number == last + 1:
            return
        if self._publishers() > 1:
            self.countable = False
        elif number > last:  # otherwise the publisher restarted
            self.missing += number - last - 1
