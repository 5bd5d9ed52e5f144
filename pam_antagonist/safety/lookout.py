"""When a planned experiment has to end: a limit that is broken by more than noise."""

from __future__ import annotations

TICK = 0.004
"""[s] Between two looks."""
RETREAT = 1.0
"""[s] Resting voltages after a limit was reached."""
_TIMES = 3
"""So many looks in a row have to find a limit broken: one is noise."""


class Lookout:
    """Watches over an experiment, look by look."""

    def __init__(self) -> None:
        self._times = 0

    def ends(self, broken: str) -> str:
        """Why the experiment has to end, in words; empty where it goes on.

        Args:
            broken: what this look found broken, in words; empty for nothing.
        """
        self._times = self._times + 1 if broken else 0
        return broken if self._times >= _TIMES else ""
