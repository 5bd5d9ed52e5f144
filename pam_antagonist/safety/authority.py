"""Who may command the valves, and who may give references: one publisher at a time.

In ROS 2 a subscriber gets neither the name nor the identifier of a message's publisher, only the message's number
(``publication_sequence_number``). Every publisher counts its own messages, so messages with consecutive numbers come
from one publisher. This is enough to distinguish two publishers.

The rule for valves is the stricter one. References are limited and slewed later, and many are sent only once. So the
first publisher is obeyed at once, and silence frees the joint for others.
"""

from __future__ import annotations

from enum import Enum

LONGEST_STEP = 100
"""Largest difference between the numbers of two consecutive messages of one publisher. A commander sends one command a
sample, at 1 kHz 20 within the time-out; the limit allows bursts of five times as many. Two publishers whose numbers are
closer than this cannot be distinguished."""


class Verdict(Enum):
    """Decision about a command."""

    ACCEPTED = "accepted"
    LISTENING = "its publisher has not been the only one for long enough"
    REFUSED = "from a second commander"
    UNCLEAR = "two commanders, and nothing says which of them is the right one"


class Authority:
    """Admits the commands of one publisher and refuses those of any other.

    The first publisher holds the valves until it is silent for ``timeout``. Then another one may take over, so that a
    restarted controller is obeyed. While the topic has several publishers (a killed one is still counted for some
    seconds), a new one must first be heard alone for ``timeout``. A publisher that was refused does not take over when
    the first one fails. If two publishers are heard and none holds the valves, the verdict is ``UNCLEAR``, and the
    valves should stop.

    Args:
        timeout: silence after which the valves are free [s].

    Attributes:
        refused: number of refused commands so far.
    """

    def __init__(self, timeout: float) -> None:
        self.refused = 0
        self._timeout = round(timeout * 1e9)
        self.release()

    def release(self) -> None:
        """Free the valves, and forget refused publishers."""
        self._last: int | None = None  # number of the last message of the publisher that holds the valves, or may soon
        self._heard_ns = self._since_ns = 0
        self._holds = False
        self._rival_ns: int | None = None

    def admit(self, sequence: int | None, publishers: int, now_ns: int) -> Verdict:
        """Judge one command.

        Args:
            sequence: the message's number at its publisher; None where the middleware gives none. Without numbers, more
                than one publisher on the topic is ``UNCLEAR``.
            publishers: number of publishers on the topic now (``subscription.get_publisher_count()``).
            now_ns: time of one clock throughout [ns].
        """
        if publishers <= 1:
            self._rival_ns = None  # any other publisher is gone
            self._holds = True
            return self._follow(sequence, now_ns)
        if sequence is None:
            return Verdict.UNCLEAR
        step = None if self._last is None else sequence - self._last
        if step is not None and 0 < step <= LONGEST_STEP:
            return self._follow(sequence, now_ns)
        if step is None or not 0 <= now_ns - self._heard_ns <= self._timeout:  # silent, or the clock was set back
            if self._rival_ns is not None and self._rival_ns >= self._heard_ns - self._timeout:
                return Verdict.UNCLEAR  # a publisher was refused until the holder fell silent
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


class ReferenceOwner:
    """Admits the references of one publisher, and refuses those of others while the first one is heard.

    Two publishers whose numbers are close by chance cannot be distinguished.

    Args:
        silence: time after which another publisher may take over [s].

    Attributes:
        refused: number of refused references so far.
    """

    def __init__(self, silence: float = 1.0) -> None:
        self.refused = 0
        self._silence = round(silence * 1e9)
        self._last: int | None = None
        self._heard_ns = 0

    def admit(self, sequence: int | None, publishers: int, now_ns: int) -> bool:
        """Judge one reference.

        Args:
            sequence: the message's number at its publisher; None where the middleware gives none: then all are
                admitted.
            publishers: number of publishers on the topic now.
            now_ns: steady time [ns].
        """
        if publishers > 1 and self._last is not None and 0 <= now_ns - self._heard_ns <= self._silence:
            if sequence is not None and not 0 < sequence - self._last <= LONGEST_STEP:
                self.refused += 1
                return False
        self._last, self._heard_ns = sequence, now_ns
        return True
