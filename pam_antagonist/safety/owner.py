"""Who may give references: one publisher at a time.

Publishers are distinguished by the numbers of their messages, as in :mod:`pam_antagonist.safety.authority`. The rule
for valves there is stricter. References are limited and slewed later, and many are sent only once. So the first
publisher is obeyed at once, and silence frees the joint for others.
"""

from __future__ import annotations

_LONGEST_STEP = 100
"""Largest difference between the numbers of two messages that count as one publisher's."""


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
            if sequence is not None and not 0 < sequence - self._last <= _LONGEST_STEP:
                self.refused += 1
                return False
        self._last, self._heard_ns = sequence, now_ns
        return True
