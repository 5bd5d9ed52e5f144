"""The matrix as lines for a terminal, as a table in Markdown, and as JSON (no ROS in here)."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from pam_antagonist.program import versions
from pam_antagonist.report.document import Table, markdown
from validation.faults.fault import LIMIT_MS, Outcome, Recovery, Valves

_LONGEST = 96  # of a status [characters]
HEADER = f"{'holds':6} {'fault':28} {'valves':36} {'control':30} diagnostics"


def valves(outcome: Outcome) -> str:
    """What the valves did, in words."""
    if outcome.fault.valves is Valves.SAFE:
        text = "not safe" if outcome.safe_ms is None else f"safe after {outcome.safe_ms:.0f} ms, by the {outcome.by}"
    else:
        share = 100.0 * outcome.share_safe
        text = "controlled" + (f", safe {share:.0f} % of the time" if share >= 0.5 else " throughout")
    return f"{text}; {outcome.wrong} wrong voltages" if outcome.wrong else text


def control(outcome: Outcome) -> str:
    """How control came back, in words."""
    if outcome.control_s is None:
        return "not back"
    if outcome.fault.recovery is Recovery.NOT_LOST:
        return "not lost"
    if outcome.fault.valves is Valves.CONTROLLED and outcome.control_s == 0.0:
        return "by itself, during the fault"
    after = {
        Recovery.ITSELF: "by itself, after",
        Recovery.RESTART: "restarted, after",
        Recovery.CLEAR: "cleared, after",
    }
    seconds = outcome.control_s
    return f"{after[outcome.fault.recovery]} " + (f"{seconds:.1f} s" if seconds >= 1.0 else f"{seconds * 1e3:.0f} ms")


def statuses(outcome: Outcome) -> str:
    """What came on ``/diagnostics``, shortened."""
    if not outcome.fault.expected:
        return "nothing" if outcome.held else ""
    texts = [
        text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1].rstrip()}…" for text in map(_plain, outcome.statuses)
    ]
    return "; ".join(texts)


def _plain(text: str) -> str:
    """A text without the names of folders that are gone by now."""
    return re.sub(rf"{re.escape(tempfile.gettempdir())}/\S*/", "", text)


def line(outcome: Outcome) -> str:
    """One outcome for a terminal; what did not hold stands below it."""
    mark = "yes" if outcome.held else "NO"
    text = f"{mark:6} {outcome.fault.name:28} {valves(outcome):36} {control(outcome):30} {statuses(outcome)}".rstrip()
    notes = [f"\n{'':6} {'':28} {note}" for note in map(_plain, (outcome.note, *outcome.failures)) if note]
    return text + "".join(notes)


def summary(outcomes: Sequence[Outcome]) -> str:
    """How many expectations held, and the longest time to safe voltages."""
    held = sum(outcome.held for outcome in outcomes)
    times = [outcome.safe_ms for outcome in outcomes if outcome.safe_ms is not None]
    longest = f"; safe voltages after {max(times):.0f} ms at most" if times else ""
    return f"{held} of {len(outcomes)} as expected{longest}"


def content(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Everything, for JSON."""
    entries = []
    for outcome in outcomes:
        fault, entry = outcome.fault, asdict(outcome)
        del entry["fault"]
        wanted = {"expected": fault.valves.value, "recovery": fault.recovery.value}
        entries.append({"name": fault.name, "what": fault.what, **wanted, "held": outcome.held, **entry})
    machine = {"architecture": platform.machine(), "cores": os.cpu_count()}
    return {"faults": entries, "limit_ms": LIMIT_MS, "machine": machine, "software": versions()}


def matrix(outcomes: Sequence[Outcome]) -> list[str]:
    """The table in Markdown."""
    rows = []
    for outcome in outcomes:
        then = "; ".join(filter(None, (control(outcome), _plain(outcome.note))))
        failed = "" if outcome.held else "; **not as expected**: " + _plain("; ".join(outcome.failures))
        rows.append((outcome.fault.name, outcome.fault.what, valves(outcome), then + failed))
    return markdown(Table(("fault", "how it was made", "valves", "control"), tuple(rows)))
