"""The matrix as lines for a terminal, as a page of the documentation, and as JSON (no ROS in here)."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from collections.abc import Sequence
from datetime import datetime, timezone
from typing import Any

from pam_antagonist.software import versions
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
    return {
        "faults": [
            {
                "name": outcome.fault.name,
                "what": outcome.fault.what,
                "expected": outcome.fault.valves.value,
                "recovery": outcome.fault.recovery.value,
                "held": outcome.held,
                "safe_ms": outcome.safe_ms,
                "by": outcome.by,
                "share_safe": outcome.share_safe,
                "wrong_voltages": outcome.wrong,
                "control_s": outcome.control_s,
                "diagnostics": list(outcome.statuses),
                "note": outcome.note,
                "failures": list(outcome.failures),
            }
            for outcome in outcomes
        ],
        "limit_ms": LIMIT_MS,
        "machine": {"architecture": platform.machine(), "cores": os.cpu_count()},
        "software": versions(),
    }


_PAGE = """\
# The fault matrix

{summary}.

Machine: {cores} cores, {machine}, not idle otherwise; {month}. `./run faults --docs docs/faults.md` writes this page:
do not edit it by hand.

Each line is one fault that was made on purpose in a running pipeline. Device emulator, bridge, estimator and controller
ran as processes of their own at 1 kHz. The reference was 10°.

* **Safe after** is the time from the fault to the safe voltages, by the device's own log of its valves. These lasted
  until the fault was over or, after a stop, until the stop was cleared.
* **By** says whose safe voltages these were: of the device, the bridge or the controller. Each has values of its own.
* **Control** is back when the valves have other voltages again. After a restart this includes the start of the process.
* **A wrong voltage** is one that neither the controller nor any safe action can have meant. None occurred unless the
  line says so.
* A line that is not as expected says so. What came on `/diagnostics` is expected as well; `--json` shows it.

Where messages are lost, twice or late, a relay stands between the nodes. Where `/clock` is set back, the plant in
simulated time takes the place of device and bridge. Where the machine's clock is set, the nodes add an offset to it.

| fault | how it was made | valves | control |
|---|---|---|---|
{rows}

[Safety](how-to/safety.md) says what each stop does and why, [hardware](how-to/hardware.md) what device and bridge do.

Not in the table: a device that stands still for good. Its valves keep their voltages, and no program elsewhere can
change that. The microcontroller's own watchdog has to restart it ([firmware](reference/protocol.md#firmware)).
"""


def page(outcomes: Sequence[Outcome]) -> str:
    """The page of the documentation."""
    rows = []
    for outcome in outcomes:
        then = "; ".join(filter(None, (control(outcome), _plain(outcome.note))))
        failed = "" if outcome.held else "; **not as expected**: " + _plain("; ".join(outcome.failures))
        cells = (outcome.fault.name, outcome.fault.what, valves(outcome), then + failed)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return _PAGE.format(
        cores=os.cpu_count(),
        machine=platform.machine(),
        month=datetime.now(timezone.utc).strftime("%B %Y"),
        summary=summary(outcomes).capitalize(),
        rows="\n".join(rows),
    )
