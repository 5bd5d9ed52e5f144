"""The device's logic: what it obeys, and when it falls to its safe voltages by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pam_antagonist.hardware import protocol
from pam_antagonist.hardware.protocol import (
    Command,
    FrameReader,
    Goodbye,
    Hello,
    Result,
    Status,
    Telemetry,
    Welcome,
    frame,
)
from validation.device.firmware import DeviceSettings, Firmware, Readings

SAFE = (5.0, 5.25)
MS = 1000
READINGS = Readings(1.0, 2.0, 3, 4.0)


class Bench:
    """A device with a clock, and a host that knows what to say."""

    def __init__(self, first_us: int = 0, session: int = 77) -> None:
        self.firmware = Firmware(DeviceSettings(safe_voltage=(5.5, 5.5)))
        self.now = first_us
        self.session = session
        self.sequence = 0
        self.reader = FrameReader()
        self.newest: Telemetry | None = None

    def hear(self, message: protocol.Message) -> list[protocol.Message | None]:
        answer = self.firmware.receive(frame(protocol.pack(message)), self.now % 2**32)
        return [protocol.unpack(payload) for payload in self.reader.feed(answer)]

    def hello(
        self,
        voltage: tuple[float, float] = SAFE,
        version: int = protocol.VERSION,
        vent: tuple[float, float] = SAFE,
        rate: float = 0.0,
    ) -> Welcome:
        (answer,) = self.hear(Hello(version, self.session, *voltage, *vent, rate))
        assert isinstance(answer, Welcome)
        return answer

    def tick(self, count: int = 1, fault: int = 0) -> Telemetry | None:
        for _ in range(count):
            self.now += MS
            readings = replace(READINGS, fault=Status(fault))
            self.newest = None
            for payload in self.reader.feed(self.firmware.tick(self.now % 2**32, readings)):
                message = protocol.unpack(payload)
                assert isinstance(message, Telemetry)
                self.newest = message
        return self.newest

    def command(self, first: float, second: float, **changes: int) -> None:
        self.sequence = (self.sequence + 1) % 65536
        seen = self.newest.sequence if self.newest else 0
        fields = {"session": self.session, "sequence": self.sequence, "seen": seen, **changes}
        self.hear(Command(fields["session"], fields["sequence"], fields["seen"], first, second))

    def started(self, commanded: bool = False) -> Bench:
        assert self.hello().result == Result.ACCEPTED
        self.tick()
        if commanded:
            self.command(7.0, 4.0)
        return self


def test_a_device_is_silent_and_safe_until_a_hello_sets_the_safe_voltages_and_starts_the_samples() -> None:
    bench = Bench()
    assert bench.tick(50) is None
    assert bench.firmware.voltage == (5.5, 5.5)
    bench = Bench()
    welcome = bench.hello()
    assert welcome == Welcome(1, 77, 0, 7, 1000, 20_000, 0.0, 10.0, protocol.padded_name("reference"))
    assert bench.tick(2) == Telemetry(1, 2 * MS, 1.0, 2.0, 3, 4.0, *SAFE, Status.SAFE, 0, 65535, 0, 0, 0)


def test_commands_take_effect_with_the_next_sample_and_are_told_as_they_were() -> None:
    bench = Bench().started(commanded=True)
    bench.now += 300
    bench.command(6.0, 4.5)
    assert bench.firmware.voltage == SAFE
    first, second = bench.tick(), bench.tick()
    assert first is not None and second is not None
    assert (first.voltage_1, first.voltage_2, first.status) == (*SAFE, Status.SAFE)
    assert (second.voltage_1, second.voltage_2, second.status) == (6.0, 4.5, 0)
    assert (first.command, first.command_age_us) == (2, 1000)


@pytest.mark.parametrize("first_us", [0, 2**32 - 10_000, 2**32 - 1, 2**31 - 10_000])
def test_twenty_milliseconds_without_a_command_are_safe_voltages_also_across_the_wrap_of_the_clock(
    first_us: int,
) -> None:
    bench = Bench(first_us).started(commanded=True)
    for k in range(1, 60):
        bench.tick()
        assert bench.firmware.voltage == ((7.0, 4.0) if k < 20 else SAFE), k
    assert bench.firmware.watchdog_trips == 1
    newest = bench.newest
    assert newest is not None and newest.watchdog_trips == 1 and newest.status == Status.SAFE
    bench.command(6.0, 6.5)
    bench.tick()
    assert bench.firmware.voltage == (6.0, 6.5)


def test_a_command_of_71_minutes_ago_is_not_new_again() -> None:
    bench = Bench().started(commanded=True)
    bench.tick(30)
    bench.firmware.settings = DeviceSettings(session_us=2**32 - 1)
    bench.now += 2**32 - 30_000
    bench.tick()
    assert bench.firmware.voltage == SAFE


def test_a_command_that_comes_while_a_tick_is_due_counts_as_new() -> None:
    """The clock of the tick is read before, that of the bytes after it: the difference is not 71 minutes."""
    bench = Bench().started()
    bench.now += 900
    bench.command(7.0, 4.0)
    bench.now -= 1000
    bench.tick()
    assert bench.firmware.running and bench.firmware.voltage == (7.0, 4.0)


def test_a_hello_does_not_keep_the_voltages() -> None:
    bench = Bench().started(commanded=True)
    for _ in range(20):
        assert bench.hello().result == Result.ACCEPTED
        bench.tick()
    assert bench.firmware.voltage == SAFE


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -0.01, 10.01, 3.4e38])
def test_voltages_that_are_none_are_refused(bad: float) -> None:
    bench = Bench().started(commanded=True)
    bench.tick(10)
    bench.command(bad, 4.0)
    bench.command(4.0, bad)
    telemetry = bench.tick()
    assert telemetry is not None and telemetry.refused == 2
    assert bench.firmware.voltage == (7.0, 4.0)
    bench.tick(9)  # they do not count for the watchdog
    assert bench.firmware.voltage == SAFE
    for hello in ({"voltage": (bad, 5.0)}, {"vent": (5.0, bad)}, {"rate": math.nan}, {"rate": -1.0}):
        assert bench.hello(**hello).result == Result.SAFE_VOLTAGE_REFUSED
    assert bench.firmware.safe_voltage == SAFE


def test_muscles_are_vented_slowly_where_that_is_wanted() -> None:
    bench = Bench()
    assert bench.hello(vent=(0.0, 10.0), rate=100.0).result == Result.ACCEPTED
    bench.tick()
    bench.command(7.0, 4.0)
    bench.tick(20)
    assert bench.firmware.voltage == SAFE
    bench.tick(5)
    assert bench.firmware.voltage == pytest.approx((4.5, 5.75))
    bench.hear(Goodbye(77))
    bench.tick(1)
    assert bench.firmware.voltage == pytest.approx((4.4, 5.85))  # goes on without a host
    bench.tick(100)
    assert bench.firmware.voltage == (0.0, 10.0)


def test_another_version_is_told_ours_and_not_obeyed() -> None:
    bench = Bench()
    welcome = bench.hello(version=2)
    assert (welcome.version, welcome.result) == (1, Result.OTHER_VERSION)
    assert bench.tick() is None


@pytest.mark.parametrize(
    "changes",
    [{"session": 78}, {"sequence": 1}, {"sequence": 0}, {"sequence": 65000}, {"seen": 65516}],
    ids=["other session", "twice", "overtaken", "overtaken by far", "20 ms old"],
)
def test_commands_that_are_not_the_newest_of_this_session_are_refused(changes: dict[str, int]) -> None:
    bench = Bench().started(commanded=True)
    bench.command(1.0, 1.0, **changes)
    telemetry = bench.tick()
    assert telemetry is not None and telemetry.refused == 1
    assert bench.firmware.voltage == (7.0, 4.0)


def test_numbers_of_commands_begin_anew_after_65536() -> None:
    bench = Bench().started()
    bench.sequence = 65533
    for k in range(6):
        bench.command(6.0 + 0.5 * k, 4.0)
        bench.tick()
        assert bench.firmware.voltage == (6.0 + 0.5 * k, 4.0)
    assert bench.firmware.refused == 0


def test_a_goodbye_is_safe_at_once_and_the_end() -> None:
    bench = Bench().started(commanded=True)
    bench.tick()
    bench.hear(Goodbye(78))
    assert bench.firmware.voltage == (7.0, 4.0)
    bench.hear(Goodbye(77))
    assert bench.firmware.voltage == SAFE
    assert bench.tick() is None


def test_a_host_that_is_gone_for_a_second_has_to_say_hello_again() -> None:
    bench = Bench().started()
    assert bench.tick(998) is not None
    assert bench.tick(5) is None
    bench.command(7.0, 4.0)
    bench.tick()
    assert bench.firmware.voltage == SAFE
    bench.session = 5
    bench.started(commanded=True)
    bench.tick()
    assert bench.firmware.voltage == (7.0, 4.0)


def test_a_new_session_begins_safe() -> None:
    bench = Bench().started(commanded=True)
    bench.tick()
    bench.session = 5
    bench.hello((3.0, 3.0))
    bench.tick()
    assert bench.firmware.voltage == (3.0, 3.0)
    bench.command(7.0, 4.0, session=77)
    bench.tick()
    assert bench.firmware.voltage == (3.0, 3.0)


def test_the_emergency_stop_is_stronger_than_commands() -> None:
    bench = Bench().started(commanded=True)
    bench.tick(2)
    telemetry = bench.tick(2, Status.STOPPED)
    assert telemetry is not None and telemetry.status == Status.STOPPED | Status.SAFE
    assert bench.firmware.voltage == SAFE


@settings(max_examples=300)
@given(st.lists(st.one_of(st.binary(max_size=60), st.builds(frame, st.binary(min_size=1, max_size=60))), max_size=10))
def test_no_bytes_make_it_crash_or_leave_its_safe_voltages(received: list[bytes]) -> None:
    bench = Bench().started()
    for data in received:
        bench.firmware.receive(data, bench.now)
        bench.tick()
        assert bench.firmware.voltage in (SAFE, (5.5, 5.5)) or _is_command(data, bench)


def _is_command(data: bytes, bench: Bench) -> bool:
    """Whether chance made a command that is right in every respect."""
    return any(isinstance(protocol.unpack(payload), (Command, Hello)) for payload in FrameReader().feed(data))


def test_damaged_frames_are_counted_and_told() -> None:
    bench = Bench().started()
    good = frame(protocol.pack(Command(77, 1, 0, 7.0, 4.0)))
    for place in range(len(good) - 1):
        bench.firmware.receive(good[:place] + bytes((good[place] ^ 0x10,)) + good[place + 1 :], bench.now)
    telemetry = bench.tick()
    assert telemetry is not None and telemetry.damaged >= len(good) - 1
    assert bench.firmware.voltage == SAFE
