"""Who may give references: one publisher at a time.

A subscriber gets a number with each message, and every publisher counts its own messages (see
:mod:`pam_antagonist.safety.authority`, which is as strict as valves need it). References are limited and slewed behind
this, and many of them come once: so one that is heard alone is obeyed at once, and silence frees the joint for others.
"""

from __future__ import annotations

_LONGEST_STEP = 100
"""Largest difference between the numbers of two messages that count as one publisher's."""


class ReferenceOwner:
    """Admits the references of one publisher, and refuses another's while the first one is heard.

    Two publishers whose numbers go on from one another by chance cannot be told apart; that there are two is seen
    nevertheless.

    Args:
        silence: time after which another publisher may take over [s].

    Attributes:
        refused: references of others so far.
    """

    def __init__(self, silence: float = 1.0) -> None:
        self.refused = 0
        self._silence = round(silence * 1e9)
        self._last: int | None = None
        self._heard_ns = 0

    def admit(self, sequence: int | None, publishers: int, now_ns: int) -> bool:
        """Judge one reference.

        Args:
            sequence: its number by publisher; None where the middleware gives none: then all are admitted, and that
                there are several is only seen.
            publishers: how many there are on the topic now.
            now_ns: steady time [ns].
        """
        if publishers > 1 and self._last is not None and 0 <= now_ns - self._heard_ns <= self._silence:
            if sequence is not None and not 0 < sequence - self._last <= _LONGEST_STEP:
                self.refused += 1
                return False
        self._last, self._heard_ns = sequence, now_ns
        return True
