"""End a planned experiment when a limit is exceeded by more than noise."""

from __future__ import annotations

TICK = 0.004
"""[s] Time between two checks."""
RETREAT = 1.0
"""[s] Duration of the resting voltages after a limit was exceeded."""
_TIMES = 3
"""Number of consecutive checks that must find a limit exceeded; a single one may be noise."""


class Lookout:
    """Counts consecutive checks of an experiment that found a limit exceeded."""

    def __init__(self) -> None:
        self._times = 0

    def ends(self, broken: str) -> str:
        """Reason to end the experiment, in words; empty while it goes on.

        Args:
            broken: the limit that this check found exceeded, in words; empty for none.
        """
        self._times = self._times + 1 if broken else 0
        return broken if self._times >= _TIMES else ""
