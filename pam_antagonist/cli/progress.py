"""How far a long command is: a bar on a terminal, a line every ten seconds elsewhere.

What is done is counted (samples, bytes), or comes in phases whose shares of the time are known from other recordings.
The time that is left is estimated from the expected time and from how much slower or faster than that it went so far.
What is shown of it never grows: a command that turns out slower counts down more slowly.
"""

from __future__ import annotations

import math
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pam_antagonist.recording import Recording

_DELAY = 2.0
"""What takes less than this [s] shows no bar."""
_TICK, _LINES = 0.5, 10.0
"""Time between two changes of the bar, and between two lines off a terminal [s]."""
_TRUST = 0.2
"""Part of the expected time after which the measured pace counts as much as the expected one."""
_SMOOTH = 2.5, 0.05
"""What is shown too much fades with this time constant [s], or this part of the first estimate, whichever is longer."""
_BEHIND = 2.5
"""Where the estimate is so many times what is shown, no time is shown."""
_BUSY = 1.6
"""From this load a core on, what was measured on idle cores is no guide."""
_COUNT = re.compile(r"(\d+) of at most (\d+)$")
"""How far a phase is, at the end of its report."""


@dataclass(frozen=True)
class Plan:
    """What a command does, as far as its progress is concerned.

    Attributes:
        low: least time that it takes for a second of a recording [s], measured on two cores.
        high: largest time, likewise.
        phases: in their order: words that a phase's report contains, and its share of the time, in any unit.
    """

    low: float
    high: float
    phases: Mapping[str, float]

    @property
    def middle(self) -> float:
        """Expected time for a second of a recording [s]."""
        return math.sqrt(self.low * self.high)


# Times of the recordings of rig A (1 kHz, 2 x 60 s) and of the sealed joint; shares from examples/recordings.
# What begins or ends is looked for by rounds of its own: in nothing of the time to two thirds of it.
CLOSE_LOOP = Plan(0.1, 1.0, {
    "recalibrating": 1, "round 1: score": 8, "round 1: refitting": 8, "round 2: score": 4, "round 2: refitting": 7,
    "round 3": 4, "something begins": 20, "disturbance torque": 1, "effects are needed": 1, "splits agree": 3,
    "profile": 2, "errors before and after": 5,
})  # fmt: skip
IDENTIFY = Plan(0.1, 0.5, {
    "force map": 5, "valve curve": 1, "flow": 34, "joint refinement": 32, "profile": 35, "inner fit": 16,
    "uncertain directions": 21, "process noise": 15, "scale of the uncertainty": 12, "own values": 50, "held-out": 30,
})  # fmt: skip
SEALED_CLOSE_LOOP = Plan(0.8, 2.5, {
    "recalibrating": 5, "round 1": 8, "round 2": 6, "effects are needed": 8, "profile": 4, "tuning": 60, "errors": 8,
})  # fmt: skip
SEALED_IDENTIFY = Plan(0.8, 2.5, {
    "closed chamber of muscle 1": 1, "closed chamber of muscle 2": 1, "balance": 1, "tuning": 40,
})  # fmt: skip


class Counted:
    """Progress that is counted.

    Args:
        total: units to do.
    """

    text = ""

    def __init__(self, total: float) -> None:
        self._total = max(total, 1e-9)
        self._done = 0.0

    def add(self, amount: float) -> None:
        """So much more is done, in units."""
        self._done = min(self._done + amount, self._total)

    def fraction(self, elapsed: float) -> float:
        """Part that is done, 0 to 1, after `elapsed` seconds."""
        return self._done / self._total

    def left(self, elapsed: float) -> float:
        """Time that is left after `elapsed` seconds [s]; NaN as long as nothing is done."""
        done = self.fraction(elapsed)
        return elapsed * (1.0 - done) / done if done else math.nan


class Planned:
    """Progress through phases, some of which may be left out or repeated.

    Within a phase the fraction grows with time and does not leave the phase's share before the next one begins.

    Args:
        expected: time for all of it [s].
        plan: of the command.
    """

    def __init__(self, expected: float, plan: Plan) -> None:
        whole = sum(plan.phases.values())
        self._expected, self._names = expected, list(plan.phases)
        self._shares = [share / whole for share in plan.phases.values()]
        self._phase, self._begun, self._pace, self._counted = -1, 0.0, 1.0, 0.0
        self.text = ""

    def begin(self, text: str, elapsed: float) -> None:
        """A phase begins, or another part of the present one, after `elapsed` seconds; `text` says which."""
        self.text = text
        for number in range(self._phase + 1, len(self._names)):
            if self._names[number] in text:
                self._phase, self._begun, self._counted = number, elapsed, 0.0
                self._pace = self._slower(sum(self._shares[:number]), elapsed)
                break
        if count := _COUNT.search(text):
            self._counted = int(count[1]) / int(count[2])

    def _slower(self, done: float, elapsed: float) -> float:
        """Times as long as expected it takes, by what is done after `elapsed` seconds."""
        return (elapsed / self._expected + _TRUST) / (done + _TRUST)

    def fraction(self, elapsed: float) -> float:
        """Part that is done, 0 to 1, after `elapsed` seconds."""
        if self._phase < 0:
            return 0.0
        share = self._shares[self._phase]
        if self._counted:
            return sum(self._shares[: self._phase]) + share * self._counted
        part = (elapsed - self._begun) / max(share * self._expected * self._pace, 1e-9)
        # A phase that takes longer than expected creeps through the last tenth of its share.
        within = 0.9 * part if part < 1.0 else 1.0 - 0.1 * math.exp(1.0 - part)
        return sum(self._shares[: self._phase]) + share * within

    def left(self, elapsed: float) -> float:
        """Time that is left after `elapsed` seconds [s]."""
        done = self.fraction(elapsed)
        return self._expected * (1.0 - done) * self._slower(done, elapsed)


class Steady:
    """A time that is left, as it is shown: it only counts down, faster or slower as the estimate of it demands."""

    def __init__(self) -> None:
        self._shown, self._at, self._fades = math.nan, 0.0, 0.0

    def left(self, now: float, estimate: float) -> float:
        """The time left [s]; NaN where it is not known, or is much longer than what was shown last.

        Args:
            now: of a clock [s].
            estimate: of the time left [s]; NaN: not known.
        """
        if math.isnan(estimate):
            return estimate
        if math.isnan(self._shown):
            self._shown, self._at, self._fades = estimate, now, max(_SMOOTH[0], _SMOOTH[1] * estimate)
        passed = now - self._at
        self._shown -= passed * min(self._shown / max(estimate, 1e-9), 1.0)
        self._shown -= max(self._shown - estimate, 0.0) * -math.expm1(-passed / self._fades)
        self._shown = max(self._shown, 0.0)
        self._at = now
        return self._shown if estimate <= _BEHIND * max(self._shown, 1.0) else math.nan


def load() -> float:
    """Times as long as on an idle machine that a command takes, by what else this machine computes; 1 if unknown."""
    try:
        others, cores = os.getloadavg()[0], len(os.sched_getaffinity(0))
    except (OSError, AttributeError):
        return 1.0
    return max((others + 1.0) / cores, 1.0)


_ROUGH = (1, 2, 3, 5, 10, 15, 20, 30, 45, 60, 90)
"""Times left that are shown, up to a minute and a half [s]."""


def roughly(seconds: float) -> str:
    """A time that is left, as roughly as it is known: a small change of it is not shown.

    Args:
        seconds: the time [s].
    """
    if seconds > 105.0:
        return in_words(max(seconds, 120.0))
    return in_words(min(_ROUGH, key=lambda step: abs(math.log(step / max(seconds, 0.1)))))


def in_words(seconds: float) -> str:
    """A time for people: 8 s, 40 s, 3 min, 1.5 h."""
    if seconds < 10.0:
        return f"{max(seconds, 1.0):.0f} s"
    if seconds < 90.0:
        return f"{5.0 * round(seconds / 5.0):.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


class _Shown:
    """Draws progress from a thread of its own, so that it goes on while a fit computes."""

    def __init__(self, what: str, state: Counted | Planned) -> None:
        self._what, self._state = what, state
        self._start, self._steady, self._stop = time.monotonic(), Steady(), threading.Event()
        self._bar: Any = None
        self._line, self._lines = _LINES, 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def elapsed(self) -> float:
        return time.monotonic() - self._start

    def end(self, complete: bool) -> None:
        self._stop.set()
        self._thread.join()
        if self._bar is not None:
            if complete:
                self._bar.n = 100.0
                self._bar.set_description_str(self._what, refresh=False)
                self._bar.set_postfix_str(in_words(self.elapsed()), refresh=True)
            self._bar.close()
        elif complete and self._lines:
            print(f"{self._what}: 100 %, took {in_words(self.elapsed())}", file=sys.stderr, flush=True)

    def _run(self) -> None:
        terminal = sys.stderr.isatty()
        while not self._stop.wait(_TICK):
            elapsed = self.elapsed()
            counted = self._state.fraction(elapsed)
            done = min(counted, 0.99)  # 100 % is for the end
            estimate = self._state.left(elapsed)
            left = self._steady.left(elapsed, estimate)
            late = "" if math.isnan(estimate) else "longer than expected"
            rest = late if math.isnan(left) else "finishing" if counted >= 1.0 else f"about {roughly(left)} left"
            if not (done or self._state.text):  # compiling, most likely: there is nothing to say yet
                self._line = elapsed + _LINES
            if terminal and elapsed >= _DELAY:
                self._draw(100.0 * done, rest)
            elif not terminal and elapsed >= self._line:
                self._line += _LINES
                self._lines += 1
                text = ", ".join(part for part in (f"{100.0 * done:.0f} %", self._state.text, rest) if part)
                print(f"{self._what}: {text}", file=sys.stderr, flush=True)

    def _draw(self, percent: float, rest: str) -> None:
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(total=100.0, bar_format="{desc} {percentage:3.0f} % |{bar:24}| {postfix}", leave=True)
        text = f"{self._what}: {self._state.text}" if self._state.text else self._what
        self._bar.n = percent
        self._bar.set_description_str(text, refresh=False)
        self._bar.set_postfix_str(rest, refresh=True)


@contextmanager
def _shown(what: str, state: Counted | Planned) -> Iterator[_Shown]:
    shown = _Shown(what, state)
    complete = False
    try:
        yield shown
        complete = True
    finally:
        shown.end(complete)


@contextmanager
def counted(total: float, what: str) -> Iterator[Callable[[float], None]]:
    """Progress that is counted.

    Args:
        total: units to do.
        what: is done.

    Yields:
        Takes how many units more are done.
    """
    state = Counted(total)
    with _shown(what, state):
        yield state.add


@contextmanager
def planned(what: str, recordings: Sequence[Recording], plan: Plan) -> Iterator[Callable[[str], None]]:
    """Progress through phases. When the first one begins, it is said how long all of it will take.

    Args:
        what: is done.
        recordings: from whose length the time follows.
        plan: of the command.

    Yields:
        Takes what begins now.
    """
    seconds = sum(recording.duration_s for recording in recordings)
    slower = load()
    state = Planned(slower * plan.middle * seconds, plan)
    with _shown(what, state) as shown:

        def report(text: str) -> None:
            # Not before: a recording that is refused gets a line that names the reason, and no other.
            if not state.text and plan.high * seconds >= _LINES:
                told = _how_long(len(recordings), seconds, plan, slower)
                print(f"{what}: {told}", file=sys.stderr, flush=True)
            state.begin(text, shown.elapsed())

        yield report


def said_by(what: str) -> Callable[[str], None]:
    """Says each thing that is being done in a line, for work whose time nobody knows.

    Args:
        what: is done.
    """
    return lambda text: print(f"{what}: {text}", file=sys.stderr, flush=True)


def _how_long(count: int, seconds: float, plan: Plan, slower: float) -> str:
    """The time that a command takes for recordings of so many seconds, where it is `slower` than on idle cores."""
    one = "1 recording" if count == 1 else f"{count} recordings"
    low, high = in_words(slower * plan.low * seconds), in_words(slower * plan.high * seconds)
    where = f"while the machine is busy (load {slower:.1f} a core)" if slower >= _BUSY else "on two cores"
    return f"{one} of {in_words(seconds)} together, about {low} to {high} {where}"
