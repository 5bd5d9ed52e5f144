"""What was on the valves and when, what a fault is and what is expected of it, and what came of it (no ROS in here)."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from validation.device.emulator import LOG_HEADER

if TYPE_CHECKING:
    from validation.faults.bench import Bench

BRIDGE_SAFE = (5.0, 5.25)
"""Safe voltages of the bridge, which tells them to the device, and of the plant; exact as float32."""
CONTROLLER_SAFE = (5.25, 5.0)
"""Those of the controller: whose they are tells who acted."""
_WHOSE = {BRIDGE_SAFE: "bridge", CONTROLLER_SAFE: "controller", (5.5, 5.5): "device"}
"""The last ones are what the emulated device has from its start until a bridge greets it."""
LIMIT_MS = 50.0
"""Longest time from a fault to safe voltages at the device [ms]."""
_MOSTLY = 0.5
"""Share of the time that valves which are to be controlled may have safe voltages."""
_LEAST_SUM, _LARGEST_SUM = 10.25 - 1e-3, 11.0 + 1e-3  # of both voltages, between the safe ones and twice the bias [V]
_LARGEST_DIFFERENCE = 6.0  # that the controller asks for when the joint is 20 degrees off, and some more [V]
_LEVELS = ("OK", "WARN", "ERROR", "STALE")


class Row(NamedTuple):
    """Something that happened: a change of the voltages, or another event at which they stayed as they were."""

    time_ns: int  # since 1970 [ns]
    event: str  # ``voltage``, or a fault of the device that begins or ends (``+flip``, ``-flip``)
    voltage: tuple[float, float]  # on the valves from then on (2,) [V]
    by_itself: bool  # whether these are the device's own safe voltages, for want of a valid command

    @property
    def safe(self) -> bool:
        """Whether these are safe voltages, whoever's."""
        return self.source != ""

    @property
    def source(self) -> str:
        """Whose safe voltages these are; empty where they are not safe."""
        return "device" if self.by_itself else _WHOSE.get(self.voltage, "")


class ValveLog:
    """The device emulator's log, read while it is being written."""

    def __init__(self, path: Path) -> None:
        self._path, self._read = path, 0
        self.rows: list[Row] = []  # what has been read so far

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


def wrong_voltages(rows: Sequence[Row], begin_ns: int) -> int:
    """Number of rows since a time with voltages that neither the controller nor any safe action can have meant.

    The controller moves both valves by the same amount, in opposite directions, from twice 5.5 V.
    """

    def meant(first: float, second: float) -> bool:
        return _LEAST_SUM <= first + second <= _LARGEST_SUM and abs(first - second) <= _LARGEST_DIFFERENCE

    return sum(row.time_ns >= begin_ns and not (row.safe or meant(*row.voltage)) for row in rows)


class Valves(Enum):
    """What is expected of the valves."""

    SAFE = "safe voltages within 50 ms, until the fault is over"
    CONTROLLED = "controlled throughout, no wrong voltage"


class Recovery(Enum):
    """How control comes back."""

    ITSELF = "by itself"
    RESTART = "when it is started again"
    CLEAR = "when the stop is cleared"
    NOT_LOST = "nothing to recover"


class Wanted(NamedTuple):
    """Something expected on ``/diagnostics``."""

    part: str  # node and part, such as ``bridge: safety``
    level: int  # of the status, 0 to 3
    words: str  # in its message; or, with ``counted``, the value that has to have grown, one of several between " or "
    counted: bool = False  # whether ``words`` are names of values


class Status(NamedTuple):
    """A status on ``/diagnostics``."""

    time_ns: int  # of reception [ns since 1970]
    part: str  # node and subcomponent
    level: int  # of ``DiagnosticStatus``
    message: str  # in words
    values: dict[str, str]  # by key


@dataclass(frozen=True)
class Fault:
    """One line of the matrix."""

    name: str  # short, for ``--only``
    what: str  # how it is made, in words
    # makes it, gives the time [ns since 1970] at which it began, ends it, gives the time at which it was over
    cause: Callable[[Bench], Iterator[int]]
    valves: Valves  # what they are expected to do
    expected: tuple[Wanted, ...]  # what is expected on ``/diagnostics``
    recovery: Recovery = Recovery.ITSELF  # how control is expected to come back
    lasts: float = 0.4  # [s]
    clear: tuple[str, ...] = ()  # nodes whose stop has to be cleared, in this order
    bench: str = "device"  # name of the pipeline that it needs


@dataclass(frozen=True)
class Outcome:
    """What a fault came to."""

    fault: Fault
    # from the fault to the safe voltages that lasted until it was over [ms]; None: there were none
    safe_ms: float | None = None
    by: str = ""  # whose safe voltages these were first
    share_safe: float = 0.0  # share of the fault's time with safe voltages (0 to 1)
    wrong: int = 0  # number of voltages that nobody can have meant
    statuses: tuple[str, ...] = ()  # what was expected on ``/diagnostics`` and was said
    # from the end of the fault, or of the stop, to control [s]; None: it did not come back
    control_s: float | None = None
    note: str = ""  # what else is to be said
    failures: tuple[str, ...] = ()  # expectations that did not hold, in words

    @property
    def held(self) -> bool:
        """Whether all that was expected came about."""
        return not self.failures


def judge(
    fault: Fault, begin_ns: int, over_ns: int, cleared_ns: int | None, rows: Sequence[Row], statuses: Sequence[Status],
    note: str = "",
) -> Outcome:  # fmt: skip
    """Compare what happened with what was expected; times in ns since 1970.

    No `cleared_ns`: nobody cleared a stop. Rows and statuses begin before the fault; nobody looked after the last row.
    """
    failures = []
    held_until = over_ns if cleared_ns is None else cleared_ns
    since = safe_since(rows, begin_ns, held_until)
    safe_ms = None if since is None else (since.time_ns - begin_ns) * 1e-6
    share = share_safe(rows, begin_ns, max(held_until, begin_ns + 1))
    wrong = wrong_voltages(rows, begin_ns)
    if fault.valves is Valves.SAFE:
        if safe_ms is None:
            failures.append("the valves did not have safe voltages until the fault was over")
        elif safe_ms > LIMIT_MS:
            failures.append(f"safe voltages after {safe_ms:.0f} ms, expected {LIMIT_MS:g} ms at most")
    elif share > _MOSTLY:
        failures.append(f"safe voltages for {100.0 * share:.0f} % of the time, expected control")
    if wrong:
        failures.append(f"{wrong} wrong voltages")
    found = {item: heard(item, statuses, begin_ns) for item in fault.expected}
    failures += [f"no status of {item.part}: {item.words!r}" for item, text in found.items() if not text]
    regained = first_obeyed(rows, held_until)
    if regained is None:
        failures.append("control did not come back")
    kept = since if fault.valves is Valves.SAFE else None
    return Outcome(
        fault, None if kept is None else safe_ms, "" if kept is None else kept.source, share, wrong,
        tuple(filter(None, found.values())), None if regained is None else (regained - held_until) * 1e-9, note,
        tuple(failures),
    )  # fmt: skip


def heard(wanted: Wanted, statuses: Sequence[Status], begin_ns: int) -> str:
    """The status that was wanted, in words; empty if it did not come."""
    before: dict[str, float] = {}
    for status in statuses:
        if status.part != wanted.part:
            continue
        if wanted.counted:
            for name in wanted.words.split(" or "):
                value = float(status.values.get(name, "nan"))
                if status.time_ns <= begin_ns:
                    before[name] = value
                elif value > before.get(name, 0.0):
                    return f"{status.part}: {name} counted"
        elif status.time_ns > begin_ns and status.level == wanted.level and wanted.words in status.message:
            return f"{status.part} {_LEVELS[status.level]}: {status.message}"
    return ""
