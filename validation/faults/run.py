"""Making every fault, one after the other, in as few pipelines as possible."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import ProcessFailed, free_domain
from pam_antagonist.nodes.spin import stay_on_this_machine
from validation.faults.bench import Bench
from validation.faults.fault import Fault, Observed, Outcome, Recovery, judge

_STAYS = 0.3  # time for which a stop is watched after its cause is gone [s]
_CLEAR = 3.0  # for a stop to be cleared [s]
_BACK = 25.0  # for control to come back [s]
_AFTER = 0.25  # for diagnostics that belong to the fault [s]


def run_faults(
    faults: Sequence[Fault], rig: str, done: Callable[[Outcome], object] = lambda outcome: None
) -> list[Outcome]:
    """Make faults in pipelines of device emulator (or plant), bridge, estimator and controller, in the given order."""
    stay_on_this_machine()
    outcomes: list[Outcome] = []
    bench: Bench | None = None
    current = ""
    with tempfile.TemporaryDirectory(prefix="pam_faults_") as name:
        try:
            for number, fault in enumerate(faults):
                if bench is None or current != fault.bench:
                    if bench is not None:
                        bench.__exit__()
                        bench = None
                    bench, current = _start(fault.bench, Path(name) / str(number), rig), fault.bench
                try:
                    outcome = judge(fault, make(fault, bench))
                except ProcessFailed as error:
                    outcome = Outcome(fault, failures=(str(error),))
                    bench.__exit__()  # the next one begins with a pipeline of which everything is known
                    bench = None
                outcomes.append(outcome)
                done(outcome)
        finally:
            if bench is not None:
                bench.__exit__()
    return outcomes


def _start(kind: str, folder: Path, rig: str) -> Bench:
    try:
        return Bench(folder, free_domain(), rig=rig, kind=kind).__enter__()
    except ProcessFailed as error:
        raise BadInput(f"faults: the pipeline {kind!r} does not start: {error}") from None


def make(fault: Fault, bench: Bench) -> Observed:
    """Make one fault in a running pipeline, end it, and look on until control is back."""
    bench.ready()
    first = len(bench.watcher.statuses)
    first_row = max(0, len(bench.rows()) - 1)
    before = list({status.part: status for status in bench.watcher.statuses[:first]}.values())
    cause = fault.cause(bench)
    begin, _ = next(cause)
    bench.wait(fault.lasts)
    over, note = next(cause)
    cleared = None
    if fault.recovery is Recovery.CLEAR:
        bench.wait(_STAYS)
        cleared = _clear(fault, bench)
    bench.back(_BACK)
    bench.wait(_AFTER)
    rows = bench.rows()[first_row:]
    return Observed(begin, over, cleared, rows[-1].time_ns, rows, [*before, *bench.watcher.statuses[first:]], note)


def _clear(fault: Fault, bench: Bench) -> int:
    """Clear the stops; the time right before the last one, which gives the valves back [ns since 1970]."""
    refused = ""
    for node in fault.clear:
        end = time.monotonic() + _CLEAR
        while True:
            now = time.time_ns()
            good, refused = bench.watcher.clear(node)
            if good:
                break
            if time.monotonic() > end:
                raise ProcessFailed(f"{node} does not clear its stop: {refused}")
            bench.wait(0.1)
    return now
