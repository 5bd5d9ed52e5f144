"""What was on the valves and when, and the times that follow from it (no ROS in here)."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pam_antagonist.hardware.emulator import LOG_HEADER

BRIDGE_SAFE = (5.0, 5.25)
"""Safe voltages of the bridge, which tells them to the device, and of the plant; exact as float32."""
CONTROLLER_SAFE = (5.25, 5.0)
"""Those of the controller: whose they are tells who acted."""
FIRST_SAFE = (5.5, 5.5)
"""What the emulated device has from its start until a bridge greets it."""
SAFE = frozenset((BRIDGE_SAFE, CONTROLLER_SAFE, FIRST_SAFE))

_LEAST_SUM, _LARGEST_SUM = 10.25 - 1e-3, 11.0 + 1e-3  # of both voltages, between the safe ones and twice the bias [V]
_LARGEST_DIFFERENCE = 6.0  # that the controller asks for when the joint is 20 degrees off, and some more [V]


class Row(NamedTuple):
    """Something that happened: a change of the voltages, or another event at which they stayed as they were."""

    time_ns: int  # since 1970 [ns]
    event: str  # ``voltage``, or a fault of the device that begins or ends (``+flip``, ``-flip``)
    voltage: tuple[float, float]  # on the valves from then on (2,) [V]
    by_itself: bool  # whether these are the device's own safe voltages, for want of a valid command

    @property
    def safe(self) -> bool:
        """Whether these are safe voltages, whoever's."""
        return self.by_itself or self.voltage in SAFE

    @property
    def source(self) -> str:
        """Whose safe voltages these are; empty where they are not safe."""
        if self.by_itself:
            return "device"
        return {BRIDGE_SAFE: "bridge", CONTROLLER_SAFE: "controller", FIRST_SAFE: "device"}.get(self.voltage, "")


class ValveLog:
    """The device emulator's log, read while it is being written.

    Attributes:
        rows: what has been read so far.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = 0
        self.rows: list[Row] = []

    def update(self) -> list[Row]:
        """Read what has come; all rows so far."""
        if self._path.is_file():
            with self._path.open("rb") as file:
                file.seek(self._read)
                data = file.read()
            whole = data[: data.rfind(b"\n") + 1]  # the last line may be half written
            self._read += len(whole)
            for cells in csv.reader(whole.decode().splitlines()):
                if ",".join(cells) != LOG_HEADER:
                    voltage = (float(cells[3]), float(cells[4]))
                    self.rows.append(Row(int(cells[0]), cells[2], voltage, cells[5] == "1"))
        return self.rows


def safe_since(rows: Sequence[Row], begin_ns: int, at_ns: int) -> Row | None:
    """The row that began the safe voltages that are on the valves at a time.

    Returns the first row of the stretch without any other voltages that reaches to ``at_ns``, with the time not
    before ``begin_ns``; None where the voltages are not safe then.
    """
    first: Row | None = None
    for row in rows:
        if row.time_ns > at_ns:
            break
        first = None if not row.safe else first or row
    return None if first is None else first._replace(time_ns=max(first.time_ns, begin_ns))


def first_obeyed(rows: Sequence[Row], after_ns: int) -> int | None:
    """When the valves first had other than safe voltages after a time, or had them then [ns]; None: never."""
    before = [row for row in rows if row.time_ns <= after_ns]
    if before and not before[-1].safe:
        return after_ns
    return next((row.time_ns for row in rows if row.time_ns > after_ns and not row.safe), None)


def share_safe(rows: Sequence[Row], begin_ns: int, end_ns: int) -> float:
    """Share of a time for which the voltages were safe (0 to 1)."""
    ends = [*(row.time_ns for row in rows[1:]), end_ns]
    spans = ((min(end, end_ns) - max(row.time_ns, begin_ns), row) for row, end in zip(rows, ends, strict=True))
    return sum(span for span, row in spans if row.safe and span > 0) / (end_ns - begin_ns)


def wrong_voltages(rows: Sequence[Row], begin_ns: int, end_ns: int) -> list[Row]:
    """Rows with voltages that neither the controller nor any safe action can have meant.

    The controller moves both valves by the same amount, in opposite directions, from twice 5.5 V.
    """

    def meant(row: Row) -> bool:
        first, second = row.voltage
        return _LEAST_SUM <= first + second <= _LARGEST_SUM and abs(first - second) <= _LARGEST_DIFFERENCE

    return [row for row in rows if begin_ns <= row.time_ns <= end_ns and not (row.safe or meant(row))]
