"""Frames on the line, and a device on a serial port with the reference firmware at its end."""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pam_antagonist.hardware import protocol
from pam_antagonist.hardware.device import DeviceLost
from pam_antagonist.hardware.protocol import (
    LONGEST_PAYLOAD,
    Command,
    FrameReader,
    Goodbye,
    Hello,
    Result,
    Telemetry,
    Welcome,
    frame,
)
from pam_antagonist.hardware.serial_device import SerialDevice, SerialTransport
from pam_antagonist.safety import SafeAction
from validation.device.firmware import Firmware, Readings

payloads = st.binary(min_size=1, max_size=LONGEST_PAYLOAD)


# the examples of the paper, by Cheshire and Baker, and those that everybody uses
@pytest.mark.parametrize(
    ("data", "encoded"),
    [
        ("", "01"), ("00", "0101"), ("0000", "010101"), ("11220033", "0311220233"), ("11223344", "0511223344"),
        ("11000000", "0211010101"),
    ],
)  # fmt: skip
def test_stuffing_is_that_of_its_authors(data: str, encoded: str) -> None:
    assert protocol.stuffed(bytes.fromhex(data)).hex() == encoded
    assert protocol.unstuffed(bytes.fromhex(encoded)) == bytes.fromhex(data)


def test_what_is_too_long_to_stuff_is_refused() -> None:
    with pytest.raises(ValueError, match="254 bytes"):
        protocol.stuffed(bytes(254))
    assert protocol.unstuffed(b"\x01" * 255) is None


def test_check_sum_is_the_one_that_is_written_down() -> None:
    # "123456789" is what check sums are compared by
    assert zlib.crc32(b"123456789") == 0xCBF43926
    assert frame(b"123456789") == b"\x0e123456789" + bytes.fromhex("2639f4cb") + b"\0"


@given(st.lists(payloads, max_size=8), st.lists(st.integers(1, 40), min_size=1, max_size=50))
def test_frames_come_out_of_a_stream_in_any_portions(sent: list[bytes], portions: list[int]) -> None:
    reader = FrameReader()
    stream = b"".join(frame(payload) for payload in sent)
    got, position = [], 0
    while position < len(stream):
        for portion in portions:
            got += reader.feed(stream[position : position + portion])
            position += portion
    assert got == sent
    assert reader.damaged == 0


@settings(max_examples=300)
@given(st.lists(st.binary(max_size=400), max_size=5))
def test_no_bytes_are_taken_for_a_frame(noise: list[bytes]) -> None:
    reader = FrameReader()
    for data in noise:
        assert reader.feed(data) == []
    # and the next good frame is found, behind a zero
    assert reader.feed(b"\0" + frame(b"good")) == [b"good"]


@settings(max_examples=300)
@given(payloads, st.data())
def test_a_frame_with_damaged_bits_is_not_taken(payload: bytes, data: st.DataObject) -> None:
    whole = bytearray(frame(payload))
    for place in data.draw(st.sets(st.integers(0, 8 * len(whole) - 1), min_size=1, max_size=6)):
        whole[place // 8] ^= 1 << place % 8
    reader = FrameReader()
    assert reader.feed(bytes(whole) + b"\0") == []
    assert reader.feed(frame(b"next")) == [b"next"]


def test_a_line_that_never_ends_a_frame_takes_no_memory() -> None:
    reader = FrameReader()
    for _ in range(1000):
        assert reader.feed(b"\x55" * 1000) == []
    assert reader.damaged == 1
    assert len(reader._rest) < 1000
    assert reader.feed(b"\x55\0" + frame(b"good")) == [b"good"]


ONE_TO_FIVE = "0000803f" + "00000040" + "00004040" + "00008040" + "0000a040"
"""1.0 to 5.0 as the line has them."""


@pytest.mark.parametrize(
    ("message", "written"),
    [
        (Hello(1, 0x0302, 1.0, 2.0, 3.0, 4.0, 5.0), "01010203" + ONE_TO_FIVE),
        (Welcome(1, 0x0302, 0, 7, 1000, 20000, 0.0, 10.0, b"a".ljust(16, b"\0")),
         "02010203" + "0007" + "e8030000" + "204e0000" + "00000000" + "00002041" + "61" + 15 * "00"),
        (Telemetry(0x0201, 0x06050403, 1.0, 2.0, -1, 3.0, 4.0, 5.0, 1, 2, 3, 4, 5, 6),
         "03010203040506" + ONE_TO_FIVE[:16] + "ffffffff" + ONE_TO_FIVE[16:] + "010002000300040005000600"),
        (Command(0x0201, 0x0403, 0x0605, 1.0, 2.0), "04010203040506" + ONE_TO_FIVE[:16]),
        (Goodbye(0x0201), "050102"),
    ],
    ids=lambda value: type(value).__name__,
)  # fmt: skip
def test_bytes_are_where_the_tables_say_and_make_the_message_again(message: protocol.Message, written: str) -> None:
    """docs/reference/protocol.md, byte by byte."""
    payload = protocol.pack(message)
    assert payload.hex() == written
    assert protocol.unpack(payload) == message
    assert protocol.unpack(payload + b"\0") is None
    assert protocol.unpack(payload[:-1]) is None


@given(st.binary(max_size=80))
def test_any_payload_is_a_message_or_none(payload: bytes) -> None:
    protocol.version_of(payload)
    message = protocol.unpack(payload)
    assert message is None or protocol.pack(message)[0] == payload[0]


def test_names_of_devices_are_printable() -> None:
    assert protocol.text_name(protocol.padded_name("my rig")) == "my rig"
    assert protocol.text_name(b"\x1b[31m\xff\0hidden") == "?[31m?"
    assert len(protocol.padded_name("x" * 40)) == 16


MS = 1_000_000
ACTION = SafeAction((5.0, 5.25))


class Wire:
    """A transport with the reference firmware at its end; time passes by a millisecond a read."""

    def __init__(self) -> None:
        self.firmware = Firmware()
        self.now = 0
        self.waiting = b""
        self.closed = False

    def read(self, timeout_s: float) -> bytes:
        if self.closed:
            raise DeviceLost("closed")
        self.now += 1000
        data = self.waiting + self.firmware.tick(self.now, Readings(1.0, 2.0))
        self.waiting = b""
        return data

    def write(self, data: bytes) -> None:
        self.waiting += self.firmware.receive(data, self.now)

    def close(self) -> None:
        self.closed = True


def test_greeting_samples_commands_and_goodbye() -> None:
    wire = Wire()
    device = SerialDevice(lambda: wire)
    info = device.start(ACTION)
    assert (info.name, info.unit, info.period_ns, info.watchdog_ns) == ("reference", "V", MS, 20 * MS)
    assert device.samples(0.1)[0].voltage == ACTION.hold
    device.command((7.0, 4.0))
    device.samples(0.1)
    (sample,) = device.samples(0.1)
    assert sample.voltage == (7.0, 4.0) and sample.status == 0
    assert device.counters()["round trip median [ms]"] < 100.0
    device.close()
    assert wire.firmware.voltage == ACTION.hold and not wire.firmware.running and wire.closed


def test_vent_reaches_the_device() -> None:
    wire = Wire()
    SerialDevice(lambda: wire).start(SafeAction((5.0, 5.25), (0.0, 10.0), 100.0))
    wire.now += 100_000
    for _ in range(20):
        wire.read(0.1)
    assert wire.firmware.voltage == pytest.approx((3.0, 7.25), abs=0.2)


OTHER = Welcome(2, 0, Result.OTHER_VERSION, 7, 1000, 20_000, 0.0, 10.0, protocol.padded_name("newer"))


@pytest.mark.parametrize(
    ("method", "answer", "words"),
    [
        ("_allowed", False, "refuses the safe voltages"),
        ("receive", b"", "no answer to the greeting"),
        ("receive", frame(protocol.pack(OTHER)), "speaks version 2 of the protocol, expected 1"),
    ],
)
def test_a_device_that_cannot_be_used_is_lost_with_a_reason(method: str, answer: object, words: str) -> None:
    wire = Wire()
    setattr(wire.firmware, method, lambda *_: answer)
    with pytest.raises(DeviceLost, match=words):
        SerialDevice(lambda: wire, hello_for_s=0.2).start(ACTION)


@pytest.mark.parametrize("way", ["read", "write"])
def test_a_port_that_is_gone_is_opened_anew_whoever_finds_out(way: str) -> None:
    wires: list[Wire] = []

    def open_transport() -> Wire:
        wires.append(Wire())
        return wires[-1]

    def gone(*_: Any) -> bytes:
        raise DeviceLost("gone")

    device = SerialDevice(open_transport)
    device.start(ACTION)
    device.samples(0.1)
    setattr(wires[0], way, gone)
    with pytest.raises(DeviceLost, match="gone"):
        device.command((6.0, 5.0))
        device.samples(0.1)
    assert wires[0].closed
    device.start(ACTION)
    assert len(wires) == 2 and len(device.samples(0.1)) == 1


def test_a_device_that_restarts_is_lost() -> None:
    wire = Wire()
    wire.now = 50_000_000
    device = SerialDevice(lambda: wire)
    device.start(ACTION)
    device.samples(0.1)
    wire.now = 0
    with pytest.raises(DeviceLost, match="started anew"):
        device.samples(0.1)


def test_a_port_that_is_none_is_lost_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(DeviceLost, match="cannot be opened: No such file"):
        SerialTransport(str(tmp_path / "none"))
    (tmp_path / "file").write_text("no port")
    with pytest.raises(DeviceLost, match="cannot be opened"):
        SerialTransport(str(tmp_path / "file"))


def test_a_port_is_opened_by_one_program_only() -> None:
    master, slave = os.openpty()
    first = SerialTransport(os.ttyname(slave))
    with pytest.raises(DeviceLost, match="cannot be opened"):
        SerialTransport(os.ttyname(slave))
    first.write(b"abc\0")
    assert os.read(master, 10) == b"abc\0"
    os.write(master, b"\0\xff\r\n\x03")
    assert first.read(1.0) == b"\0\xff\r\n\x03"  # raw: nothing is translated
    assert first.read(0.0) == b""
    os.close(slave)
    os.close(master)
    with pytest.raises(DeviceLost, match="is gone"):
        first.read(1.0)
    first.close()
