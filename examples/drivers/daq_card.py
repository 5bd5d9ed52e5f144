"""A DAQ card as the hardware of the bridge: samples in, voltages out."""

import time
from collections.abc import Mapping

from pam_antagonist.hardware.device import SEQUENCES, DeviceInfo, DeviceLost, RawSample
from pam_antagonist.nodes import bridge
from pam_antagonist.safety import SafeAction


class DaqCard:
    """Two analog inputs and two outputs; ``card`` is the driver's own object, with the calls that are used here."""

    def __init__(self, open_card):
        self._open_card = open_card
        self._card = None

    def start(self, action: SafeAction) -> DeviceInfo:
        """Set the safe voltages, and say what the card is."""
        if self._card is not None:  # lost before
            self._card.close()
        try:
            self._card = self._open_card()
            self._hold = self._now = action.hold
            self._card.write(self._hold)
        except OSError as error:
            raise DeviceLost(f"card: {error}") from None
        self._count = 0
        # a card that does not fall to safe voltages by itself has watchdog_ns=None: /diagnostics warns of it
        return DeviceInfo("my card", "V", False, False, 1_000_000, None, 0.0, 10.0)

    def samples(self, timeout_s: float) -> list[RawSample]:
        """Readings since the last call."""
        try:
            rows = self._card.read(timeout_s)  # [(volts of channel 1, of channel 2), ...], sampled by its own clock
        except OSError as error:
            raise DeviceLost(f"card: {error}") from None
        arrival, voltage = time.monotonic_ns(), self._now
        out = []
        for row in rows:
            self._count += 1
            out.append(RawSample(self._count % SEQUENCES, self._count * 1_000_000, arrival, row, voltage))
        return out

    def command(self, voltage: tuple[float, float]) -> None:
        """Put voltages on the valves."""
        try:
            self._card.write(voltage)
        except OSError as error:
            raise DeviceLost(f"card: {error}") from None
        self._now = voltage

    def close(self) -> None:
        """Leave the safe voltages."""
        card, self._card = self._card, None
        if card is not None:
            card.write(self._hold)
            card.close()

    def counters(self) -> Mapping[str, float]:
        """Nothing that /diagnostics could show."""
        return {}


def main(open_card) -> int:
    """The bridge with this card."""
    return bridge.main(device=lambda: DaqCard(open_card))
