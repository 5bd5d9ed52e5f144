"""``monitor``: the node; what it can see (``--explain``); and the search in what it has kept (``--search``).

``monitor --explain RIG`` says which sizes a monitor finds within a minute, on a short simulated run.
``monitor --search ORDER.json`` is a process of its own, which the node starts: it writes the buffer as a bag and the
report of ``close_loop`` beside it, adds an entry to the rig's log book, and prints ``{"verdict", "effects",
"calibration", "ambiguous_with"}`` as one line.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pam_antagonist.api.simulate import simulate
from pam_antagonist.cli import common
from pam_antagonist.diagnosis.monitor import THRESHOLD, Monitor
from pam_antagonist.diagnosis.monitor_responses import SHARE
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs_ros
from pam_antagonist.report.document import Table
from pam_antagonist.report.terminal import render
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.physical import rest_pressure, rest_voltage

_SETTLING, _SECONDS = 95, 60
"""[s] Before the minute that counts, and that minute."""
_ENCODER = {"std": 5e-4}
"""Where the rig file has none."""
_LARGE = 20.0
"""Sizes above this many typical ones count as not seen."""


def smallest(rig: Rig, moving: bool, encoder: bool) -> dict[tuple[str, str], float]:
    """Size of each hypothesis that has the evidence of an alarm after a minute, by name and unit; else infinite."""
    if encoder and rig.encoder is None:
        rig = rig.with_value("encoder", _ENCODER)
    seconds = _SETTLING + _SECONDS + 1
    voltage = None
    if not moving:
        rest = (rest_pressure(rig),) * 2 if rig.drive == "regulator" else rest_voltage(rig)
        voltage = np.tile(rest, (round(seconds / rig.sample_period), 1))
    run = simulate(rig, voltage, duration=float(seconds), seed=1)
    monitor = Monitor(rig, encoder=encoder)
    monitor.add(run.stamp_ns, run.pressure, run.voltage, run.angle_sensor if encoder else None)
    stds = monitor.blocks.stds(_SECONDS)
    out = {}
    for item, std in zip(monitor.watched, stds, strict=True):
        size = math.sqrt(2.0 * THRESHOLD) * float(std)
        seen = size <= min(max(item.high, -item.low), _LARGE * item.step / SHARE)
        out[item.label, item.unit] = size if seen else math.inf
    return out


def explain(name: str) -> str:
    """The table of a rig."""
    rig = load_rig(name, regulators=True)
    if rig.valves.sealed:
        raise BadInput(f"rig {rig.name} is sealed: expected a joint that valves or regulators drive")
    ways = [(moving, encoder) for encoder in (False, True) for moving in (True, False)]
    found = [smallest(rig, *way) for way in ways]
    rows = []
    for label, unit in dict.fromkeys(key for each in found for key in each):
        sizes = [each.get((label, unit), math.inf) for each in found]
        rows.append((label, *(f"{size:.2g} {unit}" if math.isfinite(size) else "not seen" for size in sizes)))
    heads = ("effect", "moving", "at rest", "moving, encoder", "at rest, encoder")
    caption = f"smallest sizes that monitor finds within a minute: {rig.name}, one simulated run, nothing else wrong"
    return render([Table(heads, tuple(rows), caption)])


def _explain(arguments: argparse.Namespace) -> int:
    print(explain(arguments.explain))
    return common.DONE


def parser() -> common.Parser:
    """The arguments of ``--explain``."""
    out = common.Parser("monitor", "Which sizes monitor finds within a minute, on a short simulated run.")
    out.option("--explain", "name or file of a rig", metavar="RIG")
    return out


def search(order: dict[str, object]) -> dict[str, object]:
    """Carry out an order.

    Its keys: ``buffer`` (a file of numpy with ``stamps`` and ``rows``, as of a feed), ``rig``, ``begin_ns`` from which
    on the joint is searched, ``folder`` for bag and report (empty: none), ``namespace``, ``joint``, ``lock_angle``,
    ``log``.
    """
    from pam_antagonist.api.diagnose import diagnose
    from pam_antagonist.api.history import log
    from pam_antagonist.recording import Recording, write_bag

    rig = load_rig(str(order["rig"]), regulators=True)
    with np.load(str(order["buffer"])) as kept:
        stamps, rows = kept["stamps"], kept["rows"]
    known = np.isfinite(rows[:, 4]).any()
    zero = rig.encoder.offset if rig.encoder is not None else 0.0
    folder = Path(str(order["folder"])) if order["folder"] else None
    buffer = Recording(
        path=Path("buffer") if folder is None else folder / "buffer", stamp_ns=stamps, pressure=rows[:, :2],
        voltage=rows[:, 2:4], angle=rows[:, 4] - zero if known else None, angle_sensor=rows[:, 4] if known else None,
        drive=rig.drive,
    )  # fmt: skip
    if folder is not None:
        made = [one for one in (folder, *folder.parents) if not one.exists()]
        try:
            # Beside the buffer at first: a search that is ended leaves nothing that is half written.
            written = Path(str(order["buffer"])).with_name("bag")
            write_bag(written, buffer, namespace=str(order["namespace"]))
            folder.mkdir(parents=True, exist_ok=True)
            shutil.move(written, folder / "buffer")
        except (OSError, BadInput) as error:
            print(f"the buffer is not kept: {error}", file=sys.stderr)
            shutil.rmtree(folder, ignore_errors=True)
            for one in made[1:]:  # another joint's monitor may have written there
                with contextlib.suppress(OSError):
                    one.rmdir()
            folder = None
    begin = (int(order["begin_ns"]) - int(stamps[0])) * 1e-9  # type: ignore[call-overload]
    since = buffer.slice(max(begin, 0.0), buffer.duration_s)
    joint, lock = str(order["joint"]), float(order["lock_angle"])  # type: ignore[arg-type]
    found = diagnose(
        since, rig, joint=joint, lock_angle=lock if joint == "locked" else None, jobs=1, profiles=False, estimator=False
    )
    if folder is not None:
        try:
            found.save(folder / "report")
        except (OSError, BadInput) as error:
            print(f"the report is not kept: {error}", file=sys.stderr)
    if order["log"]:
        try:
            log("monitor", str(order["rig"]), [since], rig, found)
        except BadInput as error:
            print(str(error), file=sys.stderr)
    report = found.report
    return {key: report.get(key) for key in ("verdict", "effects", "calibration", "ambiguous_with")}


def search_as_ordered(file: str) -> int:
    """Carry out the order in a file; 2 where the buffer allows no search."""
    try:
        found = search(json.loads(Path(file).read_text(encoding="utf-8")))
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(json.dumps(found))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """The node, or ``--explain RIG``."""
    words = list(sys.argv[1:] if argv is None else argv)
    if words[:1] == ["--search"]:
        return search_as_ordered(words[1])
    if any(word.partition("=")[0] == "--explain" for word in words):
        return int(common.command(parser, _explain)(words))
    try:
        needs_ros("monitor")
    except BadInput as error:
        print(f"error: {error}", file=sys.stderr)
        return common.BAD_INPUT
    from pam_antagonist.nodes.monitor import main as node

    return node(words)
