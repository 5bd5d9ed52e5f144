"""Ages of samples and silences by the clock of a node, and whether that clock can be trusted (without ROS).

With ``use_sim_time`` a node's clock is ``/clock``. Where nobody publishes it, it reads 0. When the simulation ends, it
stands still. Every sample would then look young, and no silence would ever be noticed. So the clock is compared with
the steady one, which always runs:

* An age that this clock cannot tell is infinite. So whoever refuses old samples refuses these as well.
* A silence lasts at least as long as the steady clock says, less the time that a tick of ``/clock`` may take.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

from pam_antagonist.nodes.health import Health, Level, judged

PATIENCE_NS = 1_000_000_000
"""[ns] Longest time between two ticks of ``/clock``. Common are 1 ms to 0.1 s, in a slow simulation several times that.
A stamp may be ahead of the node's clock by as much, since the next tick has not come yet."""
LOOK = 0.2
"""[s] Time between two calls of :meth:`Ages.look`."""


class NodeClock(Protocol):
    """The clock of a node."""

    @property
    def simulated(self) -> bool:
        """Whether it is ``/clock`` now."""

    def now_ns(self) -> int:
        """Its time [ns]; 0 as long as no ``/clock`` has come."""


class Moment(NamedTuple):
    """A time on both clocks."""

    clock_ns: int  # of the node [ns]
    steady_ns: int  # [ns]


class Ages:
    """Judges ages and silences. Call :meth:`look` every :data:`LOOK`.

    `clock`: that of the node. `steady_ns`: steady time [ns].

    Example:
        >>> from types import SimpleNamespace
        >>> clock = SimpleNamespace(simulated=True, now_ns=lambda: 0)
        >>> ages = Ages(clock)
        >>> ages.of(0)  # no /clock has come yet
        inf
        >>> clock.now_ns = lambda: 5_000_000
        >>> ages.of(2_000_000)
        3000000
    """

    def __init__(self, clock: NodeClock, steady_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._clock, self._steady_ns = clock, steady_ns
        self._simulated = clock.simulated
        self._moved = self.now()
        self._looked_ns = self._moved.steady_ns
        self._stands = False
        self._ahead_ns = 0

    def now(self) -> Moment:
        """The present time."""
        return Moment(self._clock.now_ns(), self._steady_ns())

    def of(self, stamp_ns: int) -> float:
        """Age of a stamp [ns]; infinite where the clock cannot tell it.

        This is so as long as no ``/clock`` has come, while it stands still, and for a stamp of another clock, which is
        far ahead of this one.
        """
        age = self._clock.now_ns() - stamp_ns
        self._ahead_ns = -age if age < -PATIENCE_NS else 0
        return age if self.known and not self._ahead_ns else math.inf

    @property
    def known(self) -> bool:
        """Whether the clock tells the time now."""
        return not self._stands and not (self._simulated and not self._clock.now_ns())

    def since(self, moment: Moment) -> int:
        """Time that has passed since a moment [ns].

        In a simulation that runs it is simulated time. A slow one is not silent.
        """
        clock_ns, steady_ns = self.now()
        passed = steady_ns - moment.steady_ns
        if not self._simulated or not clock_ns:
            return passed
        return max(clock_ns - moment.clock_ns, passed - PATIENCE_NS)

    def look(self) -> None:
        """Look whether the clock runs."""
        self._simulated = self._clock.simulated
        now = self.now()
        stalled = now.steady_ns - self._looked_ns > PATIENCE_NS // 2  # so the node has heard no tick meanwhile
        if now.clock_ns != self._moved.clock_ns or not self._simulated or stalled:
            self._moved = now
        self._looked_ns = now.steady_ns
        self._stands = now.steady_ns - self._moved.steady_ns > PATIENCE_NS

    @property
    def clock_fails(self) -> str:
        """Why the clock tells no time, in words; empty where it does."""
        if not self._stands:
            return ""
        advice = "No age can be judged. Publish /clock, or set use_sim_time to false"
        if not self._moved.clock_ns:
            return f"use_sim_time is true, but no /clock has come. {advice}"
        stood = (self._steady_ns() - self._moved.steady_ns) * 1e-9
        return f"use_sim_time is true, but /clock has stood still for {stood:.0f} s. {advice}"

    @property
    def trouble(self) -> str:
        """Why ages cannot be judged now, in words; empty where they can."""
        if self.clock_fails or not self._ahead_ns:
            return self.clock_fails
        clock = "/clock (use_sim_time is true)" if self._simulated else "this node's clock"
        return (
            f"stamps are {self._ahead_ns * 1e-9:.3g} s ahead of {clock}. Their age cannot be judged. Stamp the samples "
            "by the clock of the nodes"
        )

    def health(self) -> Health:
        """Part ``time`` for ``/diagnostics``."""
        values = {
            "clock": "/clock" if self._simulated else "of the system",
            "now [s]": f"{self._clock.now_ns() * 1e-9:.3f}",
        }
        return judged(values, "the clock runs", (self.trouble, Level.ERROR, self.trouble))
