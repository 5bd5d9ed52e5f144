"""How long each step took."""

from __future__ import annotations

import time


class Timings:
    """A stopwatch; ``seconds`` holds what took how long, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._begin = time.perf_counter()

    def end(self, name: str) -> None:
        """The step of that name is over, the next one begins."""
        now = time.perf_counter()
        self.seconds[name] = now - self._begin
        self._begin = now
