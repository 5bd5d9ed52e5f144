"""Make every fault in a running pipeline, and report what the valves did.

Device emulator, bridge, estimator and controller run as processes at the rig's sample rate, in a ROS domain of their
own. Each fault is made and ended, and the pipeline is watched until control is back. The command reports whether the
valves had safe voltages within 50 ms (by the device's own log), what /diagnostics said, and what came back by itself.
All faults take about three minutes. The machine should have nothing else to do in that time.
Status: 0 if everything came out as expected, 1 if something did not, 2 bad input.

examples:
  {run} faults
  {run} faults --only "bridge killed" --only "pressure stuck"
  {run} faults --json faults.json --docs faults.md
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.program import versions
from pam_antagonist.report.document import Table, Text
from validation import frame
from validation.faults.verdict import LIMIT_MS, Fault, Outcome, Recovery, Valves

_LONGEST = 96  # of a status [characters]
_AFTER = {Recovery.ITSELF: "by itself", Recovery.RESTART: "restarted", Recovery.CLEAR: "cleared"}


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("faults", __doc__)
    out.add_argument("--only", action="append", metavar="NAME",
                     help="make this fault alone; may be given several times (see --list)")  # fmt: skip
    out.flag("--list", "list the faults and make none")
    out.option("--rig", "a YAML file, or a rig's name (default: shin2022)", default="shin2022", metavar="RIG")
    frame.add_new_json(out, "the table")
    frame.add_docs(out, "the table")
    return out


def _main(arguments: argparse.Namespace) -> int:
    needs_ros("faults")
    from pam_antagonist.rig import load_rig
    from validation.faults import bench
    from validation.faults.catalogue import FAULTS

    if arguments.list:
        width = max(len(fault.name) for fault in FAULTS)
        print("\n".join(f"{fault.name.ljust(width)}  {fault.what}" for fault in FAULTS))
        return common.DONE
    faults = chosen(FAULTS, arguments.only)
    load_rig(arguments.rig)
    rig = str(Path(arguments.rig).resolve()) if arguments.rig.endswith((".yaml", ".yml")) else arguments.rig
    with common.json_alone(arguments.json), counted(len(faults), "faults") as advance:

        def done(outcome: Outcome) -> None:
            print(line(outcome), flush=True)
            advance(1)

        outcomes = bench.run_faults(faults, rig, done)
    frame.show([Text(f"{summary(outcomes)}."), matrix(outcomes)], arguments, content(outcomes))
    return common.DONE if all(outcome.held for outcome in outcomes) else common.FAILED


def chosen(faults: Sequence[Fault], names: Sequence[str] | None) -> list[Fault]:
    """Those faults that were asked for, in the table's order."""
    known = [fault.name for fault in faults]
    for name in names or ():
        if name not in known:
            raise BadInput(f"--only {name!r}: expected one of {', '.join(known)}")
    return [fault for fault in faults if fault.name in (names or known)]


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
    seconds = outcome.control_s
    if seconds is None:
        return "not back"
    if outcome.fault.recovery is Recovery.NOT_LOST:
        return "not lost"
    if outcome.fault.valves is Valves.CONTROLLED and seconds == 0.0:
        return "by itself, during the fault"
    time = f"{seconds:.1f} s" if seconds >= 1.0 else f"{seconds * 1e3:.0f} ms"
    return f"{_AFTER[outcome.fault.recovery]}, after {time}"


def line(outcome: Outcome) -> str:
    """One outcome for a terminal, with what came on ``/diagnostics``; what did not hold stands below it."""
    said = [text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1].rstrip()}…" for text in outcome.statuses]
    notes = [f"\n     {text}" for text in (outcome.note, *outcome.failures) if text]
    first = "; ".join([f"{outcome.fault.name}: {valves(outcome)}", control(outcome), *said])
    return _plain(f"{'yes' if outcome.held else 'NO':4} {first}{''.join(notes)}")


def _plain(text: str) -> str:
    """A text without the names of folders that are gone by now."""
    return re.sub(rf"{re.escape(tempfile.gettempdir())}/\S*/", "", text)


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


def matrix(outcomes: Sequence[Outcome]) -> Table:
    """The table of the page."""
    rows = []
    for outcome in outcomes:
        then = "; ".join(filter(None, (control(outcome), outcome.note)))
        failed = "" if outcome.held else f"; **not as expected**: {'; '.join(outcome.failures)}"
        rows.append((outcome.fault.name, outcome.fault.what, valves(outcome), _plain(then + failed)))
    return Table(("fault", "how it was made", "valves", "control"), tuple(rows), prose=True)


main = common.command(parser, _main)
