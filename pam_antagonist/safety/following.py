"""Whether the valves get what was commanded, as their owner tells it (``valve_state``)."""

from __future__ import annotations

from pam_antagonist.safety.supervision import Persistent

_PATIENCE = 0.06  # longer than slewing over the whole range takes, and than a command is under way [s]
_LOOK = 0.025  # longest time between two looks that are counted as one after the other [s]
_OLD = 0.05  # age beyond which nobody knows what is on the valves [s]


class Following:
    """Compares commands with what is on the valves.

    Who owns the valves may have stopped them, or may obey somebody else. A controller that does not notice goes on
    adding up, and throws the joint when it is obeyed again.

    Args:
        start: voltages (2,) that the valves have at first [V]; of pressure regulators what these are asked for [Pa].
        tolerance: between command and valve; commands of neighbouring samples differ by less.

    Attributes:
        astray_count: how often the valves were found astray.
    """

    def __init__(self, start: tuple[float, float], tolerance: float = 0.25) -> None:
        self.astray_count = 0
        self._tolerance = tolerance
        self._voltage = start
        self._seen_ns: int | None = None
        self._apart = Persistent(_PATIENCE, _LOOK / 2.0)

    def saw(self, voltage: tuple[float, float], now_ns: int) -> None:
        """What is on the valves (2,) [V] at a steady time [ns]."""
        self._voltage, self._seen_ns = voltage, now_ns

    def on_valves(self, now_ns: int) -> tuple[float, float] | None:
        """The voltages (2,) [V] that the valves have now [ns]; None where that is not known."""
        if self._seen_ns is None or now_ns - self._seen_ns > _OLD * 1e9:
            return None
        return self._voltage

    def astray(self, command: tuple[float, float], now_ns: int) -> bool:
        """Whether the valves have had something else than the command for too long; then it starts to count anew.

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
