"""Messages that were lost, by the publisher's own numbering (no ROS in here)."""

from __future__ import annotations

from collections.abc import Callable


class Gaps:
    """Counts what is missing between the messages of one topic.

    The middleware numbers the messages of a publisher, but does not say which publisher a message is from. So gaps are
    counted while there is one publisher only. With a second one, counting ends.

    Args:
        publishers: number of publishers now; asked only where a number is not the next one.

    Attributes:
        missing: messages so far.
        countable: whether there has never been more than one publisher when it mattered.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._last: int | None = None
        self.missing = 0
        self.countable = True

    def add(self, number: int | None) -> None:
        """Take the number of a message in the order of reception; None where the middleware has none."""
        if number is None or number <= 0 or not self.countable:
            return
        last, self._last = self._last, number
        if last is None or number == last + 1:
            return
        if self._publishers() > 1:
            self.countable = False
        elif number > last:  # else the publisher was started anew
            self.missing += number - last - 1
