"""How far a long command is: a bar on a terminal, a line every ten seconds elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_DELAY = 2.0
"""What takes less than this [s] shows nothing."""
_TICK, _LINES = 0.5, 10.0
"""Time between two changes of the bar, and between two lines off a terminal [s]."""
_COUNTED = "{desc} {percentage:3.0f} % |{bar:24}| {elapsed}, {remaining} left"
_PHASES = "{desc}, {elapsed}"


class _Shown:
    """Draws progress from a thread of its own, so that it goes on while a fit computes.

    `total`: units to do; 0: what is done comes in phases that nobody can count.
    """

    def __init__(self, what: str, total: float = 0.0) -> None:
        self._what, self._total = what, total
        self._done, self._phase = 0.0, ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def add(self, amount: float) -> None:
        """So many more units are done."""
        self._done = min(self._done + amount, self._total)

    def begin(self, phase: str) -> None:
        """A phase begins."""
        self._phase = phase

    def end(self) -> None:
        """Draw no more; the bar stays as it is now."""
        self._stop.set()
        self._thread.join()

    @property
    def _begun(self) -> bool:
        return bool(self._done or self._phase)  # before, kernels are compiled, most likely

    def _run(self) -> None:
        if sys.stderr.isatty():
            self._draw()
            return
        start = time.monotonic()
        while not self._stop.wait(_LINES):
            if self._begun:
                far = f"{100.0 * self._done / self._total:.0f} %" if self._total else self._phase
                print(f"{self._what}: {far}, {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)

    def _draw(self) -> None:
        if self._stop.wait(_DELAY):
            return
        from tqdm import tqdm

        form, began = _COUNTED if self._total else _PHASES, time.time() - _DELAY
        with tqdm(total=self._total or None, bar_format=form, desc=self._what) as bar:
            bar.start_t = began
            waiting = True
            while waiting:
                waiting = not self._stop.wait(_TICK)
                bar.n = self._done
                bar.set_description_str(f"{self._what}: {self._phase}" if self._phase else self._what)


@contextmanager
def counted(total: float, what: str) -> Iterator[Callable[[float], None]]:
    """Progress that is counted."""
    shown = _Shown(what, max(total, 1e-9))
    try:
        yield shown.add
    finally:
        shown.end()


@contextmanager
def phases(what: str) -> Iterator[Callable[[str], None]]:
    """Progress through phases whose time nobody knows."""
    shown = _Shown(what)
    try:
        yield shown.begin
    finally:
        shown.end()
