"""Who may command the valves: one commander at a time.

A subscriber in ROS 2 gets neither a publisher's name nor its identifier with a message, but the number that the
publisher gave to it (``publication_sequence_number``): every publisher counts its own messages. Messages whose numbers
go on from one another come from one publisher, and that is all that is needed to keep two of them apart.
"""

from __future__ import annotations

from enum import Enum

LONGEST_STEP = 100
"""Largest difference between the numbers of two messages that follow one another. A commander sends one command a
sample, at 1 kHz 20 within the time-out; five times that is left for bursts. Two publishers whose numbers are closer
than this cannot be told apart."""


class Verdict(Enum):
    """What becomes of a command."""

    ACCEPTED = "accepted"
    LISTENING = "its publisher has not been heard alone for long enough"
    REFUSED = "from a second commander"
    UNCLEAR = "two commanders, and nothing says which of them is the right one"


class Authority:
    """Admits the commands of one publisher and refuses those of any other.

    Whoever is heard first holds the valves until it is silent for ``timeout``; then they are free for the next one: a
    controller that was killed and started again is obeyed. As long as there are several publishers on the topic (one
    that was killed is still counted for some seconds), the next one has to be heard alone for ``timeout`` first. And
    whoever was refused so far does not inherit the valves: a second commander must not get hold of a joint because
    the first one stumbled. Where two are heard and none has a right, the verdict is ``UNCLEAR``: a reason to stop.

    Args:
        timeout: silence after which the valves are free [s].

    Attributes:
        refused: commands of second commanders so far.
    """

    def __init__(self, timeout: float) -> None:
        self.refused = 0
        self._timeout = round(timeout * 1e9)
        self.release()

    def release(self) -> None:
        """Nobody holds the valves any more, and whoever was refused may try again."""
        self._last: int | None = None  # number of the last message of whoever holds the valves, or may do so soon
        self._heard_ns = self._since_ns = 0
        self._holds = False
        self._rival_ns: int | None = None

    def admit(self, sequence: int | None, publishers: int, now_ns: int) -> Verdict:
        """Judge one command.

        Args:
            sequence: number that its publisher gave to it; None where the middleware gives none: then two publishers
                cannot be told apart, and more than one on the topic is ``UNCLEAR``.
            publishers: how many there are on the topic now (``subscription.get_publisher_count()``).
            now_ns: [ns], of one clock throughout.
        """
        if publishers <= 1:
            self._rival_ns = None  # whoever else there was is gone
            self._holds = True
            return self._follow(sequence, now_ns)
        if sequence is None:
            return Verdict.UNCLEAR
        step = None if self._last is None else sequence - self._last
        if step is not None and 0 < step <= LONGEST_STEP:
            return self._follow(sequence, now_ns)
        if step is None or not 0 <= now_ns - self._heard_ns <= self._timeout:  # silent, or the clock was set back
            if self._rival_ns is not None and self._rival_ns >= self._heard_ns - self._timeout:
                return Verdict.UNCLEAR  # it was refused until the other one fell silent
            self._holds, self._since_ns = False, now_ns
            return self._follow(sequence, now_ns)
        if not self._holds or -LONGEST_STEP <= step <= 0:  # no publisher gives a number twice
            return Verdict.UNCLEAR
        self.refused += 1
        self._rival_ns = now_ns
        return Verdict.REFUSED

    def _follow(self, sequence: int | None, now_ns: int) -> Verdict:
        self._last, self._heard_ns = sequence, now_ns
        self._holds = self._holds or now_ns - self._since_ns > self._timeout
        return Verdict.ACCEPTED if self._holds else Verdict.LISTENING
