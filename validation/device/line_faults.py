"""Simulated faults of a device, its line and its wiring, at chosen times."""

from __future__ import annotations

import math
import os
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.simulation.plant import Plant, PlantSample

KINDS = {
    "flip": "share of the bytes, in both directions, with one bit flipped",
    "drop": "share of the frames from the device that are left out",
    "silent": "the device sends nothing, and goes on with everything else",
    "deaf": "the device hears nothing",
    "unplug": "the port is gone; afterwards there is a new one",
    "freeze": "pressure sensor 1 or 2 shows what it showed before",
    "nan": "reading of pressure sensor 1 or 2 is no number",
    "broken": "pressure sensor 1 or 2 shows 0",
    "stall": "the device stands still, as while its program is debugged",
    "stop": "the emergency stop at the device is pressed",
    "restart": "the device restarts once, as after a loss of power",
    "swap_valves": "valve 1 is at muscle 2, and valve 2 at muscle 1",
    "swap_sensors": "pressure sensor 1 is at muscle 2, and 2 at muscle 1",
    "flip_encoder": "the encoder counts the other way round",
    "no_supply": "the supply is off",
    "leak": "the fitting of muscle 1 or 2 is not tight",
    "stuck": "valve 1 or 2 stays where it is",
}
"""Name -> description."""

_PROBABILITIES = ("flip", "drop")
_CHANNELS = ("freeze", "nan", "broken", "leak", "stuck")


@dataclass(frozen=True)
class LineFault:
    """One fault."""

    kind: str  # one of ``KINDS``
    value: float  # share (0 to 1) or number of the channel; 0 where there is nothing to choose
    begin: float  # [s] after the first command
    end: float  # [s]; infinite: never ends


def parse_fault(text: str) -> LineFault:
    """A fault as written on the command line: ``KIND[=VALUE][@BEGIN[-END]]``, such as ``flip=0.01@2-3``."""
    head, at, times = text.partition("@")
    kind, equals, number = head.partition("=")
    if kind not in KINDS:
        raise BadInput(f"fault {text!r}: expected one of {', '.join(KINDS)}")
    value = _number(text, number) if equals else 0.0
    if (kind in _PROBABILITIES or kind in _CHANNELS) != bool(equals):
        raise BadInput(f"fault {text!r}: expected {kind}{'' if equals else '=VALUE'}: {KINDS[kind]}")
    if kind in _PROBABILITIES and not 0.0 <= value <= 1.0:
        raise BadInput(f"fault {text!r}: expected a share from 0 to 1")
    if kind in _CHANNELS and value not in (1.0, 2.0):
        raise BadInput(f"fault {text!r}: expected muscle 1 or 2")
    first, _, last = times.partition("-")
    begin = _number(text, first) if at else 0.0
    end = _number(text, last) if last else math.inf
    if not 0.0 <= begin < end:
        raise BadInput(f"fault {text!r}: expected times [s] from 0, the end after the begin")
    return LineFault(kind, value, begin, end)


def _number(text: str, number: str) -> float:
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInput(f"fault {text!r}: {number!r} is no number")
    return value


class FaultOrders:
    """A named pipe for orders that begin and end faults while the device runs.

    Each line is an order: ``+KIND`` or ``+KIND=VALUE`` begins a fault, ``-KIND`` ends all of that kind.
    """

    def __init__(self, path: Path) -> None:
        try:
            os.mkfifo(path)
            # Opened for writing as well, so that there is no end of file when a writer closes the pipe.
            self._pipe = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        except OSError as error:
            raise BadInput(f"{path}: a named pipe cannot be made: {error.strerror}; expected a new name") from None
        self._path = path
        self._rest = b""

    def take(self) -> list[str]:
        """The orders that have come since the last call."""
        try:
            self._rest += os.read(self._pipe, 4096)
        except BlockingIOError:
            return []
        *lines, self._rest = self._rest.split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines if line.strip()]

    def close(self) -> None:
        """Remove the pipe."""
        os.close(self._pipe)
        self._path.unlink(missing_ok=True)


class FaultPlan:
    """The faults that are present at a time.

    `orders`: returns new orders, see :class:`FaultOrders`; None: no orders.
    """

    def __init__(
        self, faults: Sequence[LineFault], seed: int, orders: Callable[[], Sequence[str]] | None = None
    ) -> None:
        self._faults = tuple(faults)
        self._orders = orders
        self._random = random.Random(seed)
        self._now: dict[str, tuple[float, ...]] = {}

    def _obey(self, order: str) -> None:
        """Begin or end a fault by order."""
        sign, text = order[0], order[1:]
        if sign == "+":
            self._faults = (*self._faults, parse_fault(text.partition("@")[0]))
        elif sign == "-" and text in KINDS:
            self._faults = tuple(fault for fault in self._faults if fault.kind != text)
        else:
            raise BadInput(f"order {order!r}: expected +KIND, +KIND=VALUE or -KIND, with one of {', '.join(KINDS)}")

    def at(self, time: float) -> tuple[list[str], list[str]]:
        """Advance to a time [s]; returns the names of faults that begin, and of those that end."""
        for order in () if self._orders is None else self._orders():
            self._obey(order)
        now: dict[str, tuple[float, ...]] = {}
        for fault in self._faults:
            if fault.begin <= time < fault.end:
                now[fault.kind] = (*now.get(fault.kind, ()), fault.value)
        before, self._now = self._now, now
        return [kind for kind in now if kind not in before], [kind for kind in before if kind not in now]

    def has(self, kind: str) -> bool:
        """Whether a fault of this kind is present now."""
        return kind in self._now

    def hits(self, kind: str, channel: int) -> bool:
        """Whether a channel (1 or 2) has a fault of this kind now."""
        return channel in self._now.get(kind, ())

    def dropped(self) -> bool:
        """Whether the next frame is lost."""
        return self._random.random() < max(self._now.get("drop", (0.0,)))

    def damaged(self, data: bytes) -> bytes:
        """Bytes after the faults of the line."""
        share = max(self._now.get("flip", (0.0,)))
        if share == 0.0:
            return data
        chance = self._random.random
        return bytes(byte ^ (1 << self._random.randrange(8)) if chance() < share else byte for byte in data)


_LEAK = 2.5e-8
"""[m²] Area of a leaking fitting: half of a valve's inflow area."""
_OFF = 1.001
"""Pressure of a supply that is off, relative to the atmosphere [-]."""


class Miswired:
    """A simulated joint behind faulty wiring."""

    def __init__(self, plant: Plant, faults: FaultPlan) -> None:
        self._plant, self._faults = plant, faults
        self._held: dict[int, float] = {}
        self._changed: dict[str, float] = {}
        self._right = plant.named(("supply.pressure", "effects.leak.area_1", "effects.leak.area_2"))
        self._off = _OFF * plant.named(("atmosphere.pressure",))["atmosphere.pressure"]

    def step(self, voltage: tuple[float, float]) -> PlantSample:
        """Advance one sample period. `voltage`: outputs of the device (2,) [V]."""
        faults = self._faults
        if (wanted := self._wanted()) != self._changed:
            self._plant.change({**self._right, **wanted})
            self._changed = wanted
        given = list(reversed(voltage)) if faults.has("swap_valves") else list(voltage)
        for i in (1, 2):
            if faults.hits("stuck", i):
                given[i - 1] = self._held.setdefault(i, given[i - 1])
            else:
                self._held.pop(i, None)
        sample = self._plant.step((given[0], given[1]))
        if faults.has("swap_sensors"):
            sample = sample._replace(pressure=np.asarray(sample.pressure[::-1].copy()))
        if faults.has("flip_encoder"):
            sample = sample._replace(angle=-sample.angle)
        return sample

    def _wanted(self) -> dict[str, float]:
        """Parameters of the joint that faults change, by dotted path."""
        out = {f"effects.leak.area_{i}": _LEAK for i in (1, 2) if self._faults.hits("leak", i)}
        if self._faults.has("no_supply"):
            out["supply.pressure"] = self._off
        return out
