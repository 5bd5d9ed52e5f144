"""What a fault is, what is expected of it, and what came of it (no ROS in here)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple

from validation.faults import valve_log
from validation.faults.valve_log import Row

if TYPE_CHECKING:
    from validation.faults.bench import Bench

LIMIT_MS = 50.0
"""Longest time from a fault to safe voltages at the device [ms]."""

_MOSTLY = 0.5  # share of the time that valves which are to be controlled may have safe voltages


class Ended(NamedTuple):
    """When a fault began or was over."""

    time_ns: int  # [ns since 1970]
    note: str = ""  # what else is to be said, in a few words


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
    cause: Callable[[Bench], Iterator[Ended]]  # makes it, and ends it
    valves: Valves  # what they are expected to do
    expected: tuple[Wanted, ...]  # what is expected on ``/diagnostics``
    recovery: Recovery = Recovery.ITSELF  # how control is expected to come back
    lasts: float = 0.4  # [s]
    clear: tuple[str, ...] = ()  # nodes whose stop has to be cleared, in this order
    bench: str = "device"  # name of the pipeline that it needs


@dataclass(frozen=True)
class Observed:
    """What happened."""

    begin_ns: int  # of the fault [ns since 1970]
    over_ns: int  # when it was over
    cleared_ns: int | None  # when the stop was cleared; None: nobody cleared one
    end_ns: int  # when nothing was looked at any more
    rows: Sequence[Row]  # what was on the valves, in the order of time, from before the fault on
    statuses: Sequence[Status]  # on ``/diagnostics``, from shortly before the fault on
    note: str = ""  # what else is to be said


@dataclass(frozen=True)
class Outcome:
    """What a fault came to."""

    fault: Fault  # the fault
    # from the fault to the safe voltages that lasted until it was over [ms]; None: there were none
    safe_ms: float | None = None
    by: str = ""  # whose safe voltages these were first
    share_safe: float = 0.0  # share of the fault's time with safe voltages (0 to 1)
    wrong: int = 0  # number of voltages that nobody can have meant
    statuses: tuple[str, ...] = ()  # what was expected on ``/diagnostics`` and was said
    # from the end of the fault, or of the stop, to control [s]; None: it did not come back
    control_s: float | None = None
    note: str = ""  # what else is to be said
    failures: tuple[str, ...] = field(default=())  # expectations that did not hold, in words

    @property
    def held(self) -> bool:
        """Whether all that was expected came about."""
        return not self.failures


def judge(fault: Fault, seen: Observed) -> Outcome:
    """Compare what happened with what was expected."""
    rows, failures = seen.rows, []
    held_until = seen.over_ns if seen.cleared_ns is None else seen.cleared_ns
    since = valve_log.safe_since(rows, seen.begin_ns, held_until)
    safe_ms = None if since is None else (since.time_ns - seen.begin_ns) * 1e-6
    share = valve_log.share_safe(rows, seen.begin_ns, max(held_until, seen.begin_ns + 1))
    wrong = len(valve_log.wrong_voltages(rows, seen.begin_ns, seen.end_ns))
    if fault.valves is Valves.SAFE:
        if safe_ms is None:
            failures.append("the valves did not have safe voltages until the fault was over")
        elif safe_ms > LIMIT_MS:
            failures.append(f"safe voltages after {safe_ms:.0f} ms, expected {LIMIT_MS:g} ms at most")
    elif share > _MOSTLY:
        failures.append(f"safe voltages for {100.0 * share:.0f} % of the time, expected control")
    if wrong:
        failures.append(f"{wrong} wrong voltages")
    found = [heard(item, seen) for item in fault.expected]
    failures += [
        f"no status of {item.part}: {item.words!r}"
        for item, text in zip(fault.expected, found, strict=True)
        if not text
    ]
    regained = valve_log.first_obeyed(rows, held_until)
    if regained is None:
        failures.append("control did not come back")
    return Outcome(
        fault,
        safe_ms if fault.valves is Valves.SAFE else None,
        since.source if since is not None and fault.valves is Valves.SAFE else "",
        share,
        wrong,
        tuple(text for text in found if text),
        None if regained is None else (regained - held_until) * 1e-9,
        seen.note,
        tuple(failures),
    )


def heard(wanted: Wanted, seen: Observed) -> str:
    """The status that was wanted, in words; empty if it did not come."""
    before: dict[str, float] = {}
    for status in seen.statuses:
        if status.part != wanted.part:
            continue
        if wanted.counted:
            for name in wanted.words.split(" or "):
                value = float(status.values.get(name, "nan"))
                if status.time_ns <= seen.begin_ns:
                    before[name] = value
                elif value > before.get(name, 0.0):
                    return f"{status.part}: {name} counted"
        elif status.time_ns > seen.begin_ns and status.level == wanted.level and wanted.words in status.message:
            return f"{status.part} {_LEVELS[status.level]}: {status.message}"
    return ""


_LEVELS = ("OK", "WARN", "ERROR", "STALE")
