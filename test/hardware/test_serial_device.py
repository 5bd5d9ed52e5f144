"""A device on a serial port, with the reference firmware at its end, and the port itself."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.hardware import protocol
from pam_antagonist.hardware.firmware import Firmware, Readings
from pam_antagonist.hardware.serial_device import SerialDevice
from pam_antagonist.hardware.transport import DeviceLost, SerialTransport
from pam_antagonist.safety import SafeAction

MS = 1_000_000
ACTION = SafeAction((5.0, 5.25))


class Wire:
    """A transport with the reference firmware at its end; time passes by a millisecond a read."""

    def __init__(self, spoil: Callable[[bytes], bytes] = lambda data: data) -> None:
        self.firmware = Firmware()
        self.now = 0
        self.spoil = spoil
        self.waiting = b""
        self.closed = False

    def read(self, timeout_s: float) -> bytes:
        if self.closed:
            raise DeviceLost("closed")
        self.now += 1000
        data = self.waiting + self.firmware.tick(self.now, Readings(1.0, 2.0))
        self.waiting = b""
        return self.spoil(data)

    def write(self, data: bytes) -> None:
        self.waiting += self.firmware.receive(data, self.now)

    def close(self) -> None:
        self.closed = True


def test_greeting_samples_commands_and_goodbye() -> None:
    wire = Wire()
    device = SerialDevice(lambda: wire, seed=1)
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda firmware: setattr(firmware, "_allowed", lambda voltage: False), "refuses the safe voltages"),
        (lambda firmware: setattr(firmware, "receive", lambda data, now: b""), "no answer to the greeting"),
    ],
)
def test_a_device_that_cannot_be_used_is_lost_with_a_reason(change: Callable[[Firmware], None], words: str) -> None:
    wire = Wire()
    change(wire.firmware)
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


def test_another_version_is_lost_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire()
    answer = wire.firmware._welcome(0, 1)
    monkeypatch.setattr(protocol, "VERSION", 2)
    wire.firmware.receive = lambda data, now: answer  # type: ignore[method-assign]
    with pytest.raises(DeviceLost, match="speaks version 1 of the protocol, expected 2"):
        SerialDevice(lambda: wire).start(ACTION)


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
