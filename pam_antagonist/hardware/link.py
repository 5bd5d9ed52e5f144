"""Runs a device in one thread: starts it, converts and stamps its samples, and restarts it after a loss.

The device's clock is mapped to the host's. A sample reaches the host with the least delay of the line, often a little
more, sometimes 300 ms more. So host time over device time has a straight lower bound, whose slope is the ratio of the
clocks' rates. The least delay of each second gives a point, and the map is a robust line under the points of the last
16 s. Stamps approach this line by running slightly faster or slower, without jumps, so that evenly taken samples are
stamped evenly.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from statistics import median
from typing import NamedTuple

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter
from pam_antagonist.hardware.device import SEQUENCES, Device, DeviceInfo, DeviceLost, RawSample
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.safety import SafeAction

_COUNTER = 1 << 32


class Unwrapped:
    """Unwraps a 32-bit counter of microseconds, which wraps around every 71.6 minutes."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._time = 0

    def __call__(self, counter: int) -> int | None:
        """Time since the first call [µs]; None for a counter that went back, as after a restart of the device."""
        if self._last is None:
            self._last = counter
            return 0
        step = (counter - self._last) % _COUNTER
        if step >= _COUNTER // 2:
            return None
        self._last = counter
        self._time += step
        return self._time


_WINDOW_NS = 1_000_000_000  # time over which the least delay is searched [ns]
_WINDOWS = 16
_WARM_UP_NS = 300_000_000  # host time from the first arrival until the map is used for stamps [ns]
_LARGEST_RATE = 1e-3  # largest deviation of the ratio of the clocks' rates from 1 [-]; more is no drift
_LARGEST_ERROR_NS = 20_000_000  # largest error of the map that is corrected smoothly; a larger one restarts it [ns]


class ClockMap:
    """Host time of device times, from the times of arrival of samples."""

    def __init__(self) -> None:
        self._points: deque[tuple[int, int]] = deque(maxlen=_WINDOWS)
        self.restarts = 0
        self._begin()

    def _begin(self) -> None:
        self._points.clear()
        self._best: tuple[int, int] | None = None  # device time and host - device of the least delay in this window
        self._window_end = 0
        self._first_ns: int | None = None
        self._anchor: tuple[int, int] | None = None
        self._rate = self._drift = 0.0

    @property
    def ready(self) -> bool:
        """Whether the warm-up is over."""
        return self._anchor is not None

    @property
    def drift(self) -> float:
        """Relative rate by which the host's clock is faster than the device's [-]; NaN while not known."""
        return self._drift if len(self._points) > 2 else math.nan

    @property
    def offset_s(self) -> float:
        """Host's time minus the device's, now [s]. Only when :attr:`ready`."""
        assert self._anchor is not None
        return (self._anchor[1] - self._anchor[0]) * 1e-9

    def add(self, device_ns: int, host_ns: int) -> None:
        """Take the arrival [ns] at the host of the sample that the device took at a time [ns] of its clock."""
        offset = host_ns - device_ns
        if self._first_ns is None:
            self._first_ns = host_ns
            self._window_end = device_ns + _WINDOW_NS
        if self._best is None or offset < self._best[1]:
            self._best = device_ns, offset
        if self._anchor is None:
            if host_ns - self._first_ns >= _WARM_UP_NS:
                self._anchor = device_ns, device_ns + self._best[1]
        elif device_ns >= self._window_end:
            self._points.append(self._best)
            self._best = None
            self._window_end = device_ns + _WINDOW_NS
            self._steer(device_ns)

    def host_ns(self, device_ns: int) -> int:
        """Host time of a device time [ns]; strictly increasing. Only when :attr:`ready`."""
        assert self._anchor is not None
        device, host = self._anchor
        since = device_ns - device
        return host + since + round(since * self._rate)

    def _steer(self, now_ns: int) -> None:
        """Set the rate so that the map meets the line at the end of the next window."""
        if len(self._points) > 2:
            self._drift = _clipped(
                median((b[1] - a[1]) / (b[0] - a[0]) for a, b in combinations(self._points, 2) if b[0] != a[0])
            )
        target = now_ns + _WINDOW_NS
        below = min(offset + self._drift * (target - at) for at, offset in self._points)
        here = self.host_ns(now_ns)
        error = target + below - (here + _WINDOW_NS)
        if abs(error) > _LARGEST_ERROR_NS:
            self.restarts += 1
            self._begin()
            return
        self._anchor = now_ns, here
        self._rate = _clipped(error / _WINDOW_NS)


def _clipped(rate: float) -> float:
    return min(max(rate, -_LARGEST_RATE), _LARGEST_RATE)


SILENCE = 0.25
"""Time without a sample after which a device is restarted [s]."""
_LOOK = 0.5e-3  # longest wait for a sample before commands are checked [s]
_RETRY = 0.2  # [s]
_CLOCK_STEP = 50_000_000  # step of the host's clock, larger than its normal adjustment [ns]
_JOIN = 0.3  # [s]


class DeviceSample(NamedTuple):
    """One sample in SI units."""

    stamp_ns: int  # host time at which it was taken [ns]
    pressure: tuple[float, float]  # of both muscles, absolute, NaN where missing or faulty (2,) [Pa]
    voltage: tuple[float, float]  # on the valves over the sample that ends at the stamp (2,) [V]
    angle: float | None  # [rad], None without an encoder
    torque: float | None  # [N m], None without a torque meter
    status: Status


@dataclass(frozen=True)
class RequiredDevice:
    """Required properties of a device."""

    period_ns: int  # time between two samples [ns]
    voltage_min: float  # lowest voltage of all commands [V]
    voltage_max: float  # highest voltage of all commands [V]
    action: SafeAction


@dataclass
class LinkCounts:
    """Counters since the start."""

    samples: int = 0
    lost: int = 0
    without_stamp: int = 0
    backwards: int = 0  # samples left out because their stamps would have decreased
    clock_steps: int = 0
    sessions: int = 0
    lost_devices: int = 0
    safe_by_itself: int = 0  # samples with the device's own safe voltages for lack of a command


class Link:
    """Runs a device.

    `now_ns`: the clock of the stamps [ns]. `attend`: called on the link's thread after every check for samples, at
    least every 0.5 ms; it may command the device.
    """

    def __init__(
        self,
        device: Device,
        converter: Converter,
        wanted: RequiredDevice,
        now_ns: Callable[[], int],
        deliver: Callable[[DeviceSample], None],
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
            first = math.nan
        if raw.status & Status.PRESSURE_2_FAULT:
            second = math.nan
        angle, torque = self._converter.angle(raw.encoder), self._converter.torque(raw.torque)
        self.counts.samples += 1
        self._deliver(DeviceSample(stamp, (first, second), raw.voltage, angle, torque, raw.status))
