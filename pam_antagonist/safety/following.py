"""Whether the valves follow the commands, according to ``valve_state``."""

from __future__ import annotations

from pam_antagonist.safety.supervision import Persistent

_PATIENCE = 0.06  # longer than the latency of a command, and than slewing over the whole range [s]
_SAMPLES = 5  # of the rig; the longer of both times counts
_LOOK = 0.025  # longest time between two checks that count as consecutive [s]
_OLD = 0.05  # age at which the last known voltages are no longer used [s]


class Following:
    """Compares commands with the voltages on the valves.

    The node that owns the valves may have stopped them, or may obey another commander. A controller that does not
    notice would go on integrating, and would jerk the joint when it is obeyed again.

    Args:
        start: initial voltages of the valves (2,) [V]; for pressure regulators the commanded pressures [Pa].
        tolerance: largest normal difference between command and valve [V] or [Pa].
        period: between two samples [s]; the valves follow a sample or two behind.

    Attributes:
        astray_count: how often the valves did not follow.
    """

    def __init__(self, start: tuple[float, float], tolerance: float = 0.25, period: float = 1e-3) -> None:
        self.astray_count = 0
        self._tolerance = tolerance
        self._voltage = start
        self._old = 1e9 * max(_OLD, _SAMPLES * period)
        self._seen_ns: int | None = None
        self._apart = Persistent(max(_PATIENCE, _SAMPLES * period), max(_LOOK, period) / 2.0)

    def saw(self, voltage: tuple[float, float], now_ns: int) -> None:
        """Store the voltages on the valves (2,) [V] at a steady time [ns]."""
        self._voltage, self._seen_ns = voltage, now_ns

    def on_valves(self, now_ns: int) -> tuple[float, float] | None:
        """The voltages on the valves (2,) [V] now [ns]; None where not known."""
        if self._seen_ns is None or now_ns - self._seen_ns > self._old:
            return None
        return self._voltage

    def astray(self, command: tuple[float, float], now_ns: int) -> bool:
        """Whether the valves have differed from the command for too long; the time then starts anew.

        Args:
            command: the last one (2,) [V].
            now_ns: steady time [ns]; calls come often.
        """
        valves = self.on_valves(now_ns)
        if valves is None or max(abs(valves[0] - command[0]), abs(valves[1] - command[1])) <= self._tolerance:
            self._apart.gone()
            return False
        if not self._apart.seen(now_ns):
            return False
        self._apart.gone()
        self.astray_count += 1
        return True
