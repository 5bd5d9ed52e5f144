"""``peers``: our filter and our diagnosis beside what others would use, on joints that others recorded."""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist import BadInput
from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.optional import available, install
from validation.peers import joints, page, residuals, soft_sensors, with_model
from validation.peers.joints import ARM, NAMES, Joint

_DESCRIPTION = """\
Compare soft sensors without physics, other filters, and laws that are fitted to residuals with ours.

DATA is the folder of the recordings at hand. Each peer is fitted to what a laboratory may fit, and judged on what is
held out: whole recordings or the last third. The folder --out gets peers.jsonl, a line for each peer that is finished;
the same command again continues. --docs writes the page and its figure. Peers whose library is missing are left out.
"""
_EXAMPLES = """\
examples:
  {run} peers --data ../shared/data --out result --docs docs/evidence/peers.md
  {run} peers --data ../shared/data --out result --only elbow
"""
_SHORTEST = 10.0
_LIBRARY = {"gp": "sklearn", "gru": "torch", "sindy": "pysindy", "gp_residual": "sklearn", "filterpy": "filterpy"}
"""Libraries that are no part of this package."""

Entry = dict[str, Any]


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("peers", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--data", required=True, type=Path, metavar="DATA", help="folder of the recordings at hand")
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the results; may exist")
    out.add_argument("--only", default="", metavar="TEXT", help="only joints or peers whose name contains this")
    out.add_argument("--whole", action="store_true", help="leave the learning curves out")
    out.add_argument("--docs", type=Path, metavar="FILE", help="write the page; FILE is replaced")
    return out


def _run(arguments: argparse.Namespace) -> int:
    arguments.out.mkdir(parents=True, exist_ok=True)
    file = arguments.out / "peers.jsonl"
    done = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()] if file.exists() else []
    have = {(entry["joint"], entry["peer"], entry["part"]) for entry in done}
    work = [(name, peer, part) for name in NAMES for peer in PEERS for part in _parts(peer, arguments.whole)
            if arguments.only in f"{name} {peer}" and (name, peer, part) not in have and _may(peer, name)]  # fmt: skip
    work.sort(key=lambda item: item[2] is not None)  # the table first, then the learning curves
    with counted(len(work), "peers") as advance, tempfile.TemporaryDirectory() as scratch:
        read: dict[str, Joint] = {}
        for name, peer, part in work:
            if name not in read:
                read = {name: joints.joint(name, arguments.data, Path(scratch))}
            entry = _entry(read[name], peer, part)
            with file.open("a", encoding="utf-8") as out:
                out.write(json.dumps(entry, ensure_ascii=False) + "\n")
            done.append(entry)
            advance(1)
    done.sort(key=lambda entry: NAMES.index(entry["joint"]))
    print("\n\n".join([*page.texts(done), *missing()]))
    if arguments.docs is not None:
        page.write(done, arguments.docs)
    return common.DONE


def _parts(peer: str, whole: bool) -> tuple[float | None, ...]:
    """Lengths of what is fitted [s], None for all; filters with a rig that is known fit nothing."""
    curve = () if whole or peer not in page.CURVES else (10.0, 20.0, 40.0, 80.0)
    return (None, *curve)


def _may(peer: str, name: str) -> bool:
    if peer in _LIBRARY and not available(_LIBRARY[peer]):
        return False
    # Other filters and residual equations need voltages; the arm has episodes.
    by_valves = peer in ("identified", "ekf", "filterpy", "sindy", "gp_residual")
    return not (by_valves and (name == ARM or name.endswith("wrist")))


def _entry(joint: Joint, peer: str, part: float | None) -> Entry:
    """One peer on one joint: errors, numbers and processor time, or why there are none."""
    begin = time.process_time()
    out: Entry = {"joint": joint.name, "peer": peer, "part": part, "whole_s": joint.seconds, "why": None}
    try:
        if part is not None and not _SHORTEST <= part < 0.9 * joint.seconds:
            raise BadInput("as long as the whole")
        result = PEERS[peer](joint if part is None else joint.shortened(part))
    except (BadInput, ValueError, ArithmeticError) as error:
        result = {"why": " ".join(str(error).split())[:200]}
    return {**out, "cpu_s": time.process_time() - begin, **result}


def _soft(sensor: soft_sensors.Sensor) -> Callable[[Joint], Entry]:
    def run(joint: Joint) -> Entry:
        # A joint that is held teaches a map of its pressures nothing but a wrong one.
        every = [joints.course(one, joint.rig) for one in joint.fit]
        fit = [one for one in every if np.ptp(one.angle) > joints.MOVES]
        held = [joints.course(one, joint.rig, begin) for one, begin in joint.held]
        found = sensor(fit, held)
        pieces = [(one.angle[one.counts], found.angle[k][one.counts], found.std[k][one.counts] if found.std else None)
                  for k, one in enumerate(held)]  # fmt: skip
        return {**asdict(with_model.errors(pieces)), "numbers": found.numbers}

    return run


def _identified(joint: Joint) -> Entry:
    rig = residuals.base(joint)
    numbers = int(np.sum(rig.parameters() != joint.rig.parameters()))
    return {**asdict(with_model.ours(joint, rig)), "numbers": numbers}


def _before(joint: Joint) -> Entry:
    if joint.name == ARM:
        raise BadInput("episodes: together with what close_loop finds")
    return {**asdict(with_model.ours(joint, joint.rig)), "numbers": 0}


_EXTENDED: dict[tuple[str, float], tuple[Any, str, int]] = {}
"""What close_loop found, for the filters that use its rig."""


def _extended(joint: Joint) -> tuple[Any, str, int]:
    key = joint.name, joint.seconds
    if key not in _EXTENDED:
        _EXTENDED[key] = with_model.extended(joint)
    return _EXTENDED[key]


def _after(joint: Joint) -> Entry:
    if joint.name == ARM:
        first, last, numbers, said = with_model.arm(joint)
        return {"alone_deg": last, "before_deg": first, "numbers": numbers, "said": said}
    rig, said, numbers = _extended(joint)
    return {**asdict(with_model.ours(joint, rig)), "numbers": numbers, "said": said}


def _other(how: with_model.Filter) -> Callable[[Joint], Entry]:
    def run(joint: Joint) -> Entry:
        rig, _, numbers = _extended(joint)
        return {**asdict(with_model.filtered(joint, rig, how)), "numbers": numbers}

    return run


def _residual(fitted: Callable[[Any, Any], tuple[residuals.Law, int]]) -> Callable[[Joint], Entry]:
    def run(joint: Joint) -> Entry:
        found, numbers = residuals.free_run(joint, residuals.base(joint), fitted)
        return {"rmse_deg": None, "coverage": None, "alone_deg": found.rmse_deg, "numbers": numbers}

    return run


PEERS: dict[str, Callable[[Joint], Entry]] = {
    "linear": _soft(soft_sensors.linear),
    "lagged": _soft(soft_sensors.lagged),
    "gp": _soft(soft_sensors.gaussian_process),
    "gru": _soft(soft_sensors.recurrent),
    "before": _before,
    "identified": _identified,
    "after": _after,
    "ekf": _other(with_model.extended_kalman),
    "filterpy": _other(with_model.filterpy_ukf),
    "sindy": _residual(residuals.sindy),
    "gp_residual": _residual(residuals.gaussian),
}
"""Peers by name, in the order of the page."""


def missing() -> list[str]:
    """The libraries whose peers are left out, and what installs them."""
    absent = sorted({library for library in _LIBRARY.values() if not available(library)})
    return [f"left out, since not installed: {', '.join(absent)}; to get them: {install('peers')}"] if absent else []


main = common.command(parser, _run)
