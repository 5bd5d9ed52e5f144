"""A device kept going, with doubles of hardware, and its clock mapped to that of the host."""

from __future__ import annotations

import math
import re
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist.hardware import protocol
from pam_antagonist.hardware.calibration import Converter, load_calibration
from pam_antagonist.hardware.device import DeviceInfo, DeviceLost, RawSample
from pam_antagonist.hardware.link import SILENCE, ClockMap, DeviceSample, Link, RequiredDevice, Unwrapped
from pam_antagonist.hardware.protocol import Status
from pam_antagonist.safety import SafeAction

DOCS = Path(__file__).resolve().parents[2] / "docs"
DRIVER, PROTOCOL = DOCS.parent / "examples" / "drivers" / "daq_card.py", DOCS / "reference" / "protocol.md"
MS = 1_000_000
ACTION = SafeAction((5.0, 5.25))
WANTED = RequiredDevice(MS, 0.0, 10.0, ACTION)
INFO = DeviceInfo("double", "V", True, True, MS, 20 * MS, 0.0, 10.0)


class Double:
    """A device that samples by the test's wishes."""

    def __init__(self, info: DeviceInfo = INFO) -> None:
        self.info = info
        self.starts = 0
        self.commands: list[tuple[float, float]] = []
        self.silent = False
        self.lost = False
        self.skip = 0
        self.status = Status(0)
        self.closed = 0

    def start(self, action: SafeAction) -> DeviceInfo:
        assert action is ACTION
        self.starts += 1
        self.lost = False
        self._count = 0
        self._begin = time.monotonic_ns()
        return self.info

    def samples(self, timeout_s: float) -> list[RawSample]:
        if self.lost:
            raise DeviceLost("pulled out")
        time.sleep(timeout_s)
        out = []
        while not self.silent and self._begin + (self._count + 1) * MS <= time.monotonic_ns():
            self._count += 1
            if self.skip:
                self.skip -= 1
                continue
            at = self._count * MS
            reading = (1.0, 2.0)
            out.append(
                RawSample(self._count % 65536, at, time.monotonic_ns(), reading, (5.0, 6.0), 64, 3.0, self.status)
            )
        return out

    def command(self, voltage: tuple[float, float]) -> None:
        self.commands.append(voltage)

    def close(self) -> None:
        self.closed += 1

    def counters(self) -> Mapping[str, float]:
        return {}


@contextmanager
def running(
    device: Any, now_ns: Callable[[], int] = time.time_ns, calibration: str | Path = "example"
) -> Iterator[tuple[Link, list[DeviceSample]]]:
    got: list[DeviceSample] = []
    converter = Converter(load_calibration(calibration))
    link = Link(device, converter, WANTED, now_ns, got.append, lambda: device.command((6.0, 5.0)))
    link.start()
    try:
        yield link, got
    finally:
        link.stop()
    link.check()


def until(condition: Callable[[], object], limit: float = 5.0) -> None:
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_samples_come_in_si_units_with_even_stamps_of_the_host() -> None:
    with running(Double()) as (link, got):
        until(lambda: len(got) > 100)
        assert link.trouble == ""
    sample = got[-1]
    assert sample.pressure == pytest.approx((226.3e3, 476.3e3))
    assert sample.voltage == (5.0, 6.0)
    assert sample.angle == pytest.approx(64 * 2 * math.pi / 16384) and sample.torque == pytest.approx(1.0)
    steps = {second.stamp_ns - first.stamp_ns for first, second in zip(got, got[1:], strict=False)}
    assert steps == {MS}
    assert abs(time.time_ns() - sample.stamp_ns) < 10**9
    assert link.counts.lost == 0


def test_lost_samples_are_counted_by_their_numbers() -> None:
    device = Double()
    with running(device) as (link, got):
        until(lambda: len(got) > 20)
        device.skip = 7
        until(lambda: link.counts.lost == 7)


@pytest.mark.parametrize("way", ["lost", "silent"])
def test_a_lost_device_is_started_again_and_nothing_is_made_up(way: str) -> None:
    device = Double()
    with running(device) as (link, got):
        until(lambda: len(got) > 20)
        setattr(device, way, True)
        until(lambda: link.info is None)
        count = len(got)
        assert ("pulled out" if way == "lost" else "silent for") in link.trouble
        device.silent = False
        until(lambda: len(got) > count + 20)
        assert device.starts >= 2 and link.counts.lost_devices >= 1
        assert link.trouble == ""
    stamps = [sample.stamp_ns for sample in got]
    assert stamps == sorted(set(stamps))
    assert device.closed == 1
    assert stamps[count] - stamps[count - 1] > 0.2 * SILENCE * 1e9


def test_readings_that_the_device_itself_doubts_are_no_pressures() -> None:
    device = Double()
    device.status = Status.PRESSURE_2_FAULT
    with running(device) as (_, got):
        until(lambda: len(got) > 5)
    assert got[0].pressure[0] == pytest.approx(226.3e3) and math.isnan(got[0].pressure[1])


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_the_hosts_clock_is_followed_at_once(step_s: float) -> None:
    step = [0]
    with running(Double(), lambda: time.time_ns() + step[0]) as (link, got):
        until(lambda: len(got) > 20)
        step[0] = round(step_s * 1e9)
        until(lambda: got[-1].stamp_ns * 1e-9 - time.time() == pytest.approx(step_s, abs=1.0))
        assert link.counts.clock_steps == 1
    jumps = [b.stamp_ns - a.stamp_ns for a, b in zip(got, got[1:], strict=False) if b.stamp_ns - a.stamp_ns != MS]
    assert len(jumps) == 1


@pytest.mark.parametrize(
    ("info", "words"),
    [
        (DeviceInfo("slow", "V", True, True, 2 * MS, None, 0.0, 10.0), "slow samples every 2 ms, the rig every 1 ms"),
        (
            DeviceInfo("weak", "V", True, True, MS, None, 0.0, 5.0),
            "weak gives 0 to 5 V, the rig's valves get 0 to 10 V",
        ),
        (DeviceInfo("coded", "code", True, True, MS, None, 0.0, 10.0), "readings in V, not in code"),
    ],
)
def test_a_device_that_does_not_fit_the_rig_gets_no_commands(info: DeviceInfo, words: str) -> None:
    device = Double(info)
    with running(device) as (link, got):
        until(lambda: words in link.trouble)
        assert not got and not device.commands


def test_a_defect_is_not_swallowed_with_the_thread() -> None:
    class Defective(Double):
        def samples(self, timeout_s: float) -> list[RawSample]:
            raise ZeroDivisionError("a defect")

    device = Defective()
    with pytest.raises(ZeroDivisionError), running(device) as (link, _):
        until(lambda: "defect" in link.trouble)
    assert device.closed


# ----------------------------------------------------------------------------------------- examples/drivers


class Card:
    """A driver as that of the documentation's card."""

    def __init__(self) -> None:
        self.written: list[tuple[float, float]] = []
        self.broken = threading.Event()
        self.rows = 0
        self.begin = time.monotonic()

    def read(self, timeout_s: float) -> list[tuple[float, float]]:
        time.sleep(timeout_s)
        if self.broken.is_set():
            raise OSError("card: no answer")
        due = int((time.monotonic() - self.begin) * 1000) - self.rows
        self.rows += due
        return [(1.0, 2.0)] * due

    def write(self, voltage: tuple[float, float]) -> None:
        self.written.append(voltage)

    def close(self) -> None:
        self.written.append((math.nan, math.nan))


def test_daq_card_of_the_documentation_works(tmp_path: Path) -> None:
    names: dict[str, Any] = {}
    exec(compile(DRIVER.read_text(encoding="utf-8"), str(DRIVER), "exec"), names)
    cards: list[Card] = []

    def open_card() -> Card:
        cards.append(Card())
        return cards[-1]

    text = (Path(__file__).resolve().parents[2] / "config/hardware/example.yaml").read_text(encoding="utf-8")
    own = tmp_path / "card.yaml"
    own.write_text(text[: text.index("# For validation only")], encoding="utf-8")
    with running(names["DaqCard"](open_card), calibration=own) as (link, got):
        until(lambda: len(got) > 50)
        assert got[-1].pressure == pytest.approx((226.3e3, 476.3e3))
        assert got[-1].voltage == (6.0, 5.0) and got[-1].angle is None
        assert cards[0].written[0] == ACTION.hold
        cards[0].broken.set()
        until(lambda: len(cards) == 2)
        assert "no answer" in link.trouble or link.trouble == ""
    assert cards[-1].written[-2] == ACTION.hold


def test_tables_of_the_documentation_are_the_bytes() -> None:
    sizes = {"u8": 1, "u16": 2, "u32": 4, "i32": 4, "f32": 4, "f32 ×2": 8, "16 bytes": 16}
    text = PROTOCOL.read_text(encoding="utf-8")
    for message in (protocol.Hello, protocol.Welcome, protocol.Telemetry, protocol.Command):
        name, (_, layout) = message.__name__, protocol.LAYOUTS[message]
        table = text[text.index(f"**{name}**, ") :].split("\n\n")[1]
        end = 0
        for offset, kind in re.findall(r"^\| (\d+) \| ([^|]+) \|", table, re.MULTILINE):
            assert int(offset) == end, (name, offset)
            end += sizes[kind.strip()]
        assert end == layout.size == struct.calcsize(layout.format), name


# ----------------------------------------------------------------------------------------- device time to host time


OFFSET = 1_795_000_000_000_000_000


def arrivals(
    count: int, drift: float, delay_ms: float, jitter_ms: float, seed: int = 0, stalls: tuple[tuple[int, int], ...] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Device times, true host times and arrivals [ns], a millisecond apart; (sample, length [ms]) of stalls."""
    rng = np.random.default_rng(seed)
    device = np.arange(1, count + 1, dtype=np.int64) * MS
    true = OFFSET + device + np.rint(np.arange(1, count + 1) * drift * MS).astype(np.int64)
    late = delay_ms + rng.exponential(jitter_ms, count)
    arrival = true + np.rint(late * MS).astype(np.int64)
    for first, length in stalls:
        end = arrival[first] + length * MS
        held = (np.arange(count) >= first) & (arrival < end)
        arrival[held] = end
    return device, true, np.maximum.accumulate(arrival)


def stamped(device: np.ndarray, arrival: np.ndarray) -> tuple[np.ndarray, np.ndarray, ClockMap]:
    """Stamps, and which samples got one."""
    clock = ClockMap()
    stamps, index = [], []
    for k in range(len(device)):
        clock.add(int(device[k]), int(arrival[k]))
        if clock.ready:
            stamps.append(clock.host_ns(int(device[k])))
            index.append(k)
    return np.array(stamps), np.array(index), clock


@pytest.mark.parametrize("drift", [0.0, 50e-6, -50e-6, 200e-6])
def test_drift_is_followed_without_a_jump(drift: float) -> None:
    device, true, arrival = arrivals(60_000, drift, delay_ms=0.3, jitter_ms=0.3)
    stamps, index, clock = stamped(device, arrival)
    assert len(stamps) > 59_000
    # evenly, and at the host's pace: no more than drift and correction together
    assert np.all(np.abs(np.diff(stamps) - MS) <= 1e-3 * MS + 1)
    settled = index > 20_000
    error = (stamps - true[index])[settled] / MS
    assert abs(error.mean() - 0.3) < 0.02  # the least delay cannot be known
    assert error.std() < 0.02
    assert clock.drift == pytest.approx(drift, abs=2e-6)
    assert np.std(np.diff(stamps)[settled[1:]]) < 50e-6 * MS
    assert clock.restarts == 0


def test_stalls_do_not_move_the_stamps() -> None:
    """0.3 s in which nothing arrives, every two seconds, and one of them right at the start."""
    stalls = tuple((first, 300) for first in range(100, 30_000, 2000))
    device, true, arrival = arrivals(30_000, 50e-6, delay_ms=0.3, jitter_ms=0.1, stalls=stalls)
    stamps, index, clock = stamped(device, arrival)
    error = (stamps - true[index]) / MS
    assert np.all(np.abs(error) < 1.0)
    assert np.all(np.diff(stamps) > 0)
    assert clock.restarts == 0


def test_a_line_that_becomes_slower_for_good_is_followed_slowly() -> None:
    device, true, arrival = arrivals(60_000, 0.0, delay_ms=0.3, jitter_ms=0.1)
    arrival[20_000:] += 5 * MS
    stamps, index, clock = stamped(device, arrival)
    assert np.all(np.abs(np.diff(stamps) - MS) <= 1e-3 * MS + 1)
    assert (stamps - true[index])[-1] / MS == pytest.approx(5.3, abs=0.2)
    assert clock.restarts == 0


def test_what_is_too_far_off_to_follow_begins_anew() -> None:
    device, true, arrival = arrivals(40_000, 0.0, delay_ms=0.3, jitter_ms=0.1)
    arrival[20_000:] -= 100 * MS
    stamps, index, clock = stamped(device, arrival)
    assert clock.restarts == 1
    assert (stamps - true[index])[-1] / MS == pytest.approx(-99.7, abs=0.2)
    assert 300 <= 40_000 - len(stamps) - 300 < 2000


def test_an_hour_and_more_of_a_counter_of_32_bits() -> None:
    unwrapped = Unwrapped()
    first = 2**32 - 5_000_000
    times = [unwrapped((first + k * 100_000_000) % 2**32) for k in range(100)]
    assert times == [k * 100_000_000 for k in range(100)]
    assert 100 * 100_000_000 > 2 * 2**32


def test_a_counter_that_goes_back_is_another_device() -> None:
    unwrapped = Unwrapped()
    assert unwrapped(5_000_000) == 0
    assert unwrapped(5_001_000) == 1000
    assert unwrapped(1_000) is None
    assert unwrapped(5_002_000) == 2000
