"""Runs a device in one thread: starts it, converts and stamps its samples, and restarts it after a loss."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter
from pam_antagonist.hardware.clock import ClockMap
from pam_antagonist.hardware.device import SEQUENCES, Device, DeviceInfo, RawSample
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.hardware.transport import DeviceLost
from pam_antagonist.safety import SafeAction

SILENCE = 0.25
"""Time without a sample after which a device is restarted [s]."""
_LOOK = 0.5e-3  # longest wait for a sample before commands are checked [s]
_RETRY = 0.2  # [s]
_CLOCK_STEP = 50_000_000  # step of the host's clock, larger than its normal adjustment [ns]
_JOIN = 0.3  # [s]


class Sample(NamedTuple):
    """One sample in SI units.

    Attributes:
        stamp_ns: host time at which it was taken [ns].
        pressure: of both muscles, absolute, NaN where missing or faulty (2,) [Pa].
        voltage: on the valves over the sample that ends at the stamp (2,) [V].
        angle: [rad], None without an encoder.
        torque: [N m], None without a torque meter.
    """

    stamp_ns: int
    pressure: tuple[float, float]
    voltage: tuple[float, float]
    angle: float | None
    torque: float | None
    status: Status


@dataclass(frozen=True)
class Wanted:
    """Required properties of a device.

    Attributes:
        period_ns: time between two samples [ns].
        voltage_min: lowest voltage of all commands [V].
        voltage_max: highest voltage of all commands [V].
    """

    period_ns: int
    voltage_min: float
    voltage_max: float
    action: SafeAction


@dataclass
class LinkCounts:
    """Counters since the start.

    Attributes:
        backwards: samples left out because their stamps would have decreased.
        safe_by_itself: samples with the device's own safe voltages for lack of a command.
    """

    samples: int = 0
    lost: int = 0
    without_stamp: int = 0
    backwards: int = 0
    clock_steps: int = 0
    sessions: int = 0
    lost_devices: int = 0
    safe_by_itself: int = 0


class Link:
    """Runs a device.

    Args:
        now_ns: the clock of the stamps [ns].
        attend: called on the link's thread after every check for samples, at least every 0.5 ms; it may command the
            device.
    """

    def __init__(
        self,
        device: Device,
        converter: Converter,
        wanted: Wanted,
        now_ns: Callable[[], int],
        deliver: Callable[[Sample], None],
        attend: Callable[[], None],
    ) -> None:
        self._device = device
        self._converter = converter
        self._wanted = wanted
        self._now_ns = now_ns
        self._deliver = deliver
        self._attend = attend
        self.counts = LinkCounts()
        self.info: DeviceInfo | None = None
        self.trouble = "not started"
        self.clock = ClockMap()
        self.clock_restarts = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._offset_ns: int | None = None
        self._last_stamp: int | None = None
        self._last_sequence: int | None = None
        self._failure: BaseException | None = None

    def start(self) -> None:
        """Start the thread. It ends with :meth:`stop`, and does not keep the process alive."""
        self._stop.clear()
        self.trouble = "waits for the device"
        self._thread = threading.Thread(target=self._run, name="device", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop the thread and close the device, with safe voltages on the valves."""
        self._stop.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(_JOIN)
        self._device.close()  # also ends a handshake without an answer
        if thread is not None:
            thread.join(_JOIN)
        self.info, self.trouble = None, "stopped"

    def check(self) -> None:
        """Raise the exception that ended the link's thread, if there was one."""
        if self._failure is not None:
            raise self._failure

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                try:
                    self._accept(self._device.start(self._wanted.action))
                    self._serve()
                except DeviceLost as error:
                    self.counts.lost_devices += self.info is not None
                    self.info, self.trouble = None, str(error)
                    self._stop.wait(_RETRY)
        except BaseException as error:  # a defect, which must not be lost with the thread
            self.info, self.trouble = None, f"defect: {error!r}"
            self._failure = error
            self._device.close()

    def _accept(self, info: DeviceInfo) -> None:
        wanted = self._wanted
        try:
            self._converter.check(info)
        except BadInput as error:
            raise DeviceLost(str(error)) from None
        if info.period_ns != wanted.period_ns:
            raise DeviceLost(
                f"{info.name} samples every {info.period_ns * 1e-6:g} ms, the rig every {wanted.period_ns * 1e-6:g} ms"
            )
        # tolerance for rounding
        if info.voltage_min > wanted.voltage_min + 1e-6 or info.voltage_max < wanted.voltage_max - 1e-6:
            raise DeviceLost(
                f"{info.name} gives {info.voltage_min:g} to {info.voltage_max:g} V, the rig's valves get "
                f"{wanted.voltage_min:g} to {wanted.voltage_max:g} V"
            )
        self.counts.sessions += 1
        self._last_sequence = None
        self._new_clock()
        self.info, self.trouble = info, ""

    def _new_clock(self) -> None:
        self.clock_restarts += self.clock.restarts
        self.clock = ClockMap()

    def _serve(self) -> None:
        last_received = time.monotonic()
        while not self._stop.is_set():
            samples = self._device.samples(_LOOK)
            if samples:
                last_received = time.monotonic()
                offset = self._host_offset()
                for sample in samples:
                    self._take(sample, offset)
            elif time.monotonic() - last_received > SILENCE:
                # a stall of this process is not the cause: samples would be waiting
                raise DeviceLost(f"silent for {time.monotonic() - last_received:.2f} s")
            self._attend()

    def _host_offset(self) -> int:
        """Difference between the clock of the stamps and the steady clock [ns]."""
        steady = time.monotonic_ns()
        offset = self._now_ns() - steady
        if self._offset_ns is not None and abs(offset - self._offset_ns) > _CLOCK_STEP:
            self.counts.clock_steps += 1
            self._last_stamp = None  # stamps may decrease after the step
            self._new_clock()
        self._offset_ns = offset
        return offset

    def _take(self, raw: RawSample, offset_ns: int) -> None:
        if self._last_sequence is not None:
            self.counts.lost += (raw.sequence - self._last_sequence - 1) % SEQUENCES
        self._last_sequence = raw.sequence
        self.counts.safe_by_itself += bool(raw.status & Status.SAFE)
        self.clock.add(raw.device_ns, raw.arrival_ns + offset_ns)
        if not self.clock.ready:
            self.counts.without_stamp += 1
            return
        stamp = self.clock.host_ns(raw.device_ns)
        if self._last_stamp is not None and stamp <= self._last_stamp:
            self.counts.backwards += 1
            return
        self._last_stamp = stamp
        first, second = self._converter.pressure(raw.pressure)
        if raw.status & Status.PRESSURE_1_FAULT:
            first = float("nan")
        if raw.status & Status.PRESSURE_2_FAULT:
            second = float("nan")
        self.counts.samples += 1
        self._deliver(
            Sample(
                stamp,
                (first, second),
                raw.voltage,
                self._converter.angle(raw.encoder),
                self._converter.torque(raw.torque),
                raw.status,
            )
        )
