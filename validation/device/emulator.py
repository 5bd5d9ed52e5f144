"""Emulated device: the reference firmware on a pseudo-terminal, with a simulated joint behind its sensors.

To the host it behaves like a microcontroller on a serial port, without the delay of USB.
"""

from __future__ import annotations

import math
import os
import select
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.simulation.plant import Plant
from validation.device.firmware import Firmware, Readings
from validation.device.line_faults import FaultPlan, Miswired

_LONGEST_CATCH_UP = 1.0  # [s] of late samples that are caught up; with more, all are skipped with the overrun flag
_LOG_FLUSH = 0.05  # [s]
LOG_HEADER = "time_ns,device_us,event,voltage_1,voltage_2,safe"


class Port:
    """A pseudo-terminal, with a link of a fixed name.

    `link`: path of the link, which is removed with the port; None: no link.
    """

    def __init__(self, link: Path | None) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._link = link
        if link is not None:
            self._make_link(link)

    def _make_link(self, link: Path) -> None:
        if link.exists() and not link.is_symlink():
            raise BadInput(f"{link}: exists, but is no link; expected the name of a new link")
        try:
            link.unlink(missing_ok=True)
            link.symlink_to(self.path)
        except OSError as error:
            raise BadInput(f"{link}: cannot be made: {error.strerror}") from None

    def wait(self, seconds: float) -> bytes:
        """Bytes from the host, as soon as there are some; empty after the time [s]."""
        ready, _, _ = select.select([self._master], [], [], max(seconds, 0.0))
        if ready:
            with suppress(OSError):
                return os.read(self._master, 65_536)
        return b""

    def send(self, data: bytes) -> None:
        """Send to the host; bytes that do not fit into the buffer are lost."""
        with suppress(OSError):
            os.write(self._master, data)

    def close(self) -> None:
        """Close the port, as if it were unplugged."""
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self.path:
            self._link.unlink()
        os.close(self._slave)
        os.close(self._master)


class VoltageLog:
    """Log of the voltages on the valves: a CSV file with a row for every change.

    Columns: time since 1970 [ns], device's clock [µs], event (``voltage``, or a fault that begins or ends, as ``+flip``
    and ``-flip``), both voltages [V], 1 where they are the safe ones for lack of a valid command.
    """

    def __init__(self, file: TextIO | None) -> None:
        self._file = file
        self._last: tuple[tuple[float, float], bool] | None = None
        self._waiting, self._flushed = False, 0.0
        if file is not None:
            file.write(LOG_HEADER + "\n")

    def voltage(self, device_us: int, voltage: tuple[float, float], safe: bool) -> None:
        """Log the voltages on the valves. `device_us`: time of the device [µs]. `voltage`: on the valves (2,) [V]."""
        if (voltage, safe) != self._last:
            safe_changed = self._last is None or self._last[1] != safe
            self._last = voltage, safe
            self._row(device_us, "voltage", safe_changed)
        elif self._waiting and time.monotonic() - self._flushed > _LOG_FLUSH:
            self._flush()

    def event(self, device_us: int, name: str) -> None:
        """Log another event."""
        self._row(device_us, name, at_once=True)

    def _row(self, device_us: int, event: str, at_once: bool) -> None:
        if self._file is None:
            return
        voltage, safe = self._last or ((math.nan, math.nan), False)
        self._file.write(f"{time.time_ns()},{device_us},{event},{voltage[0]!r},{voltage[1]!r},{int(safe)}\n")
        self._waiting = True
        if at_once or time.monotonic() - self._flushed > _LOG_FLUSH:
            self._flush()

    def _flush(self) -> None:
        assert self._file is not None
        self._file.flush()
        self._waiting, self._flushed = False, time.monotonic()


class Emulator:
    """The device: its clock, firmware, sensors and port.

    `drift`: relative rate by which its clock is faster than the host's [-]. `first_us`: its counter at power-on [µs].
    `missed`: samples that were skipped because this process stalled for too long.
    """

    def __init__(
        self,
        plant: Plant,
        converter: Converter,
        firmware: Firmware,
        faults: FaultPlan,
        log: VoltageLog,
        open_port: Callable[[], Port],
        drift: float,
        first_us: int,
    ) -> None:
        self._joint = Miswired(plant, faults)
        self._converter = converter
        self._firmware = firmware
        self._faults = faults
        self._log = log
        self._open_port = open_port
        self._drift, self._first_us = drift, first_us
        self._port: Port | None = open_port()
        self._frozen: dict[int, float] = {}
        self._first_command_s: float | None = None
        self.ticks = 0
        self.missed = 0

    @property
    def path(self) -> str:
        """Path of the port; empty while there is none."""
        return "" if self._port is None else self._port.path

    def run(self, stopping: Callable[[], bool]) -> None:
        """Sample in real time until ``stopping`` returns true."""
        period = self._firmware.settings.period_us * 1e-6 / (1.0 + self._drift)
        start = time.monotonic()
        index = 0  # of the last sample; missed samples count
        while not stopping():
            self._listen(start + (index + 1) * period, start)
            overrun = Status(0)
            late = int((time.monotonic() - start) / period) - (index + 1)
            if late * period > _LONGEST_CATCH_UP:
                self.missed += late
                index += late
                overrun = Status.OVERRUN
            index += 1
            self._tick(index, overrun, stopping)
        self.close()

    def close(self) -> None:
        """Pull the port out."""
        if self._port is not None:
            self._port.close()
            self._port = None

    def _us(self, since_start: float) -> int:
        """Counter of the device's clock [µs] at a host time since the start [s]."""
        return (self._first_us + int(since_start * (1.0 + self._drift) * 1e6)) % (1 << 32)

    def _listen(self, until: float, start: float) -> None:
        """Wait for the next tick, and answer the host meanwhile."""
        while (left := until - time.monotonic()) > 0.0:
            if self._port is None:
                time.sleep(left)
                return
            data = self._faults.damaged(self._port.wait(left))
            if data and not self._faults.has("deaf"):
                self._send(self._firmware.receive(data, self._us(time.monotonic() - start)))

    def _tick(self, index: int, overrun: Status, stopping: Callable[[], bool]) -> None:
        period_us = self._firmware.settings.period_us
        if self._plan((self._first_us + index * period_us) % (1 << 32), stopping):
            self._firmware = Firmware(self._firmware.settings)
            self._first_us = -index * period_us % (1 << 32)
        firmware = self._firmware
        now_us = (self._first_us + index * period_us) % (1 << 32)
        if self._port is not None and not self._faults.has("deaf"):
            # Bytes that came while this process stalled.
            data = self._faults.damaged(self._port.wait(0.0))
            if data:
                self._send(firmware.receive(data, now_us))
        sample = self._joint.step(self._converter.asked(firmware.voltage))
        pressures = (float(sample.pressure[0]), float(sample.pressure[1]))
        first, second, counts, torque = self._converter.readings(pressures, float(sample.angle), float(sample.torque))
        fault = overrun | (Status.STOPPED if self._faults.has("stop") else Status(0))
        readings = Readings(self._shown(1, first), self._shown(2, second), counts, torque, fault)
        self._send(firmware.tick(now_us, readings), lossy=True)
        self._log.voltage(now_us, firmware.voltage, firmware.safe)
        if not firmware.safe and self._first_command_s is None:
            self._first_command_s = time.monotonic()
        self.ticks += 1

    def _plan(self, now_us: int, stopping: Callable[[], bool]) -> bool:
        """Begin and end faults, whose time counts from the first command; returns whether the device restarts.

        A stalled device waits here until the stall or the emulator ends; other faults begin and end meanwhile.
        """
        if self._first_command_s is None:
            return False
        restarts = False
        while True:
            begun, ended = self._faults.at(time.monotonic() - self._first_command_s)
            for kind in ended:
                self._log.event(now_us, f"-{kind}")
                self._frozen.clear()
                if kind == "unplug":
                    self._port = self._open_port()
            for kind in begun:
                self._log.event(now_us, f"+{kind}")
                if kind == "unplug":
                    self.close()
            restarts = restarts or "restart" in begun
            if not self._faults.has("stall") or stopping():
                return restarts
            time.sleep(1e-3)

    def _shown(self, channel: int, reading: float) -> float:
        """Reading of a pressure sensor with its faults."""
        if self._faults.hits("nan", channel):
            return math.nan
        if self._faults.hits("broken", channel):
            return 0.0
        if self._faults.hits("freeze", channel):
            return self._frozen.setdefault(channel, reading)
        return reading

    def _send(self, data: bytes, lossy: bool = False) -> None:
        if not data or self._port is None or self._faults.has("silent"):
            return
        if lossy and self._faults.dropped():
            return
        self._port.send(self._faults.damaged(data))
