"""Compare soft sensors without physics, other filters, and laws that are fitted to residuals with ours.

DATA is the folder of the recordings at hand. Each peer is fitted to what a laboratory may fit, and judged on what is
held out: whole recordings or the last third. The folder --out gets peers.jsonl, a line for each peer that is finished;
the same command again continues. --docs writes tables and figure. Peers whose library is missing are left out.

examples:
  {run} peers --data ../shared/data --out result --docs peers.md
  {run} peers --data ../shared/data --out result --only elbow
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pam_antagonist import BadInput
from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.optional import available, install
from pam_antagonist.program import versions
from pam_antagonist.report.document import MISSING, Block, Section, Table, Text, number, percent
from pam_antagonist.report.figure import PALETTE
from validation import frame
from validation.peers import joints, soft_sensors, with_model
from validation.peers.joints import ARM, NAMES, Joint

_SHORTEST, _CURVE = 10.0, (10.0, 20.0, 40.0, 80.0)
_SHORT = {"rig_a_lab/supply_droop": "rig A, supply that droops", ARM: "the arm"}
Entry = dict[str, Any]


def _soft(sensor: soft_sensors.Sensor) -> Callable[[Joint], Entry]:
    def run(joint: Joint) -> Entry:
        # A joint that is held teaches a map of its pressures nothing but a wrong one.
        every = [joints.course(one, joint.rig) for one in joint.fit]
        fit = [one for one in every if np.ptp(one.angle) > joints.MOVES]
        held = [joints.course(one, joint.rig, begin) for one, begin in joint.held]
        found = sensor(fit, held)
        pieces = [(one.angle[one.counts], found.angle[k][one.counts], found.std[k][one.counts] if found.std else None)
                  for k, one in enumerate(held)]  # fmt: skip
        return {**with_model.errors(pieces), "numbers": found.numbers}

    return run


_FOUND: dict[tuple[str, float], Any] = {}
"""What close_loop found, by name and length of the joint: shared by the filters that use its rig."""


def _found(joint: Joint) -> Any:
    key = joint.name, joint.seconds
    if key not in _FOUND:
        _FOUND[key] = (with_model.arm if joint.name == ARM else with_model.extended)(joint)
    return _FOUND[key]


def _before(joint: Joint) -> Entry:
    if joint.name == ARM:
        return {"alone_deg": _found(joint)[0], "numbers": 0}
    return {**with_model.ours(joint, joint.rig), "numbers": 0}


def _identified(joint: Joint) -> Entry:
    rig = with_model.base(joint)
    return {**with_model.ours(joint, rig), "numbers": int(np.sum(rig.parameters() != joint.rig.parameters()))}


def _after(joint: Joint) -> Entry:
    if joint.name == ARM:
        _, alone, numbers, said = _found(joint)
        return {"alone_deg": alone, "numbers": numbers, "said": said}
    rig, said, numbers = _found(joint)
    return {**with_model.ours(joint, rig), "numbers": numbers, "said": said}


def _other(how: with_model.Filter) -> Callable[[Joint], Entry]:
    def run(joint: Joint) -> Entry:
        rig, _, numbers = _found(joint)
        return {**with_model.filtered(joint, rig, how), "numbers": numbers}

    return run


def _residual(fitted: Callable[[Any, Any], tuple[with_model.Law, int]]) -> Callable[[Joint], Entry]:
    def run(joint: Joint) -> Entry:
        found, numbers = with_model.free_run(joint, with_model.base(joint), fitted)
        return {"alone_deg": found["rmse_deg"], "numbers": numbers}

    return run


class Peer(NamedTuple):
    """Who is compared."""

    words: str
    run: Callable[[Joint], Entry]
    curve: bool = False  # whether it is fitted to shorter parts as well
    library: str = ""  # that it needs, and which is no part of this package
    valves: bool = False  # whether it needs voltages of valves, and no episodes
    alone: str = ""  # in the table of models alone, where it has another name there


PEERS = {
    "linear": Peer("linear map of the two pressures", _soft(soft_sensors.linear), True),
    "lagged": Peer("ridge regression, half a second of all inputs", _soft(soft_sensors.lagged), True),
    "gp": Peer("Gaussian process, inputs at three times", _soft(soft_sensors.gaussian_process), True, "sklearn"),
    "gru": Peer("recurrent network, GRU, 2 × 64", _soft(soft_sensors.recurrent), True, "torch"),
    "before": Peer("our filter, rig as configured", _before, alone="our model, as configured"),
    "identified": Peer("our filter, rig of identify", _identified, valves=True, alone="our model, after identify"),
    "after": Peer("our filter, rig of close_loop", _after, True, alone="our model, after close_loop"),
    "ekf": Peer("extended Kalman filter, rig of close_loop", _other(with_model.extended_kalman), valves=True),
    "filterpy": Peer("UKF of filterpy, rig of close_loop", _other(with_model.filterpy_ukf), False, "filterpy", True),
    "sindy": Peer("identify, and PySINDy on what it leaves", _residual(with_model.sindy), False, "pysindy", True),
    "gp_residual": Peer("identify, and a Gaussian process on what it leaves", _residual(with_model.gaussian), False,
                        "sklearn", True),
}  # fmt: skip
"""Peers by name, in the order of the page."""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("peers", __doc__)
    out.add_argument("--data", required=True, type=Path, metavar="DATA", help="folder of the recordings at hand")
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the results; may exist")
    out.add_argument("--only", default="", metavar="TEXT", help="only joints or peers whose name contains this")
    out.add_argument("--whole", action="store_true", help="leave the learning curves out")
    frame.add_docs(out, "the tables, with the figure beside them,")
    return out


def _run(arguments: argparse.Namespace) -> int:
    file = frame.made(arguments.out) / "peers.jsonl"
    done = frame.lines(file)
    have = {(entry["joint"], entry["peer"], entry["part"]) for entry in done}
    work = [(name, peer, part) for name in NAMES for peer, about in PEERS.items()
            for part in (None, *(_CURVE if about.curve and not arguments.whole else ()))
            if arguments.only in f"{name} {peer}" and (name, peer, part) not in have and _may(about, name)]  # fmt: skip
    work.sort(key=lambda item: item[2] is not None)  # the table first, then the learning curves
    with counted(len(work), "peers") as advance, tempfile.TemporaryDirectory() as scratch:
        read: dict[str, Joint] = {}
        for name, peer, part in work:
            if name not in read:
                read = {name: joints.joint(name, arguments.data, Path(scratch))}
            done.append(_entry(read[name], peer, part))
            frame.add_line(file, done[-1])
            advance(1)
    done.sort(key=lambda entry: NAMES.index(entry["joint"]))
    frame.show(blocks(done), arguments)
    figure = curves_figure(done)
    if arguments.docs is not None and figure is not None:
        frame.made(arguments.docs.with_suffix(""))
        figure.savefig(arguments.docs.with_suffix("") / "curves.png", dpi=110)
    return common.DONE


def _may(peer: Peer, name: str) -> bool:
    if peer.library and not available(peer.library):
        return False
    return not (peer.valves and (name == ARM or name.endswith("wrist")))


def _entry(joint: Joint, peer: str, part: float | None) -> Entry:
    """One peer on one joint: errors, numbers and processor time, or why there are none."""
    begin = time.process_time()
    out: Entry = {"joint": joint.name, "peer": peer, "part": part, "whole_s": joint.seconds, "why": None}
    try:
        if part is not None and not _SHORTEST <= part < 0.9 * joint.seconds:
            raise BadInput("as long as the whole")
        result = PEERS[peer].run(joint if part is None else joint.shortened(part))
    except (BadInput, ValueError, ArithmeticError) as error:
        result = {"why": " ".join(str(error).split())[:200]}
    return {**out, "cpu_s": time.process_time() - begin, **result}


def _frame(done: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    numbers = ("rmse_deg", "coverage", "alone_deg", "numbers", "said")
    return pd.DataFrame(done).reindex(columns=["joint", "peer", "part", "whole_s", "why", "cpu_s", *numbers])


def _short(joint: str) -> str:
    return _SHORT.get(joint, f"the {Path(joint).name}")


def _range(values: pd.Series) -> str:
    ends = [f"{value:.0f}" if value >= 100.0 else number(value, 2) for value in (values.min(), values.max())]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def _table(first: str, found: pd.DataFrame, error: str) -> Table:
    """A row a peer, a column a joint: errors; of what estimates the angle, coverage, numbers and time as well."""
    estimates = error == "rmse_deg"
    rows, names = [], list(dict.fromkeys(found.joint))
    for peer, about in PEERS.items():
        mine = found[(found.peer == peer) & found[error].notna()].set_index("joint")
        if mine.empty:
            continue
        cells = []
        for name in names:
            known = name in mine.index
            covered = known and estimates and not pd.isna(mine.coverage[name])
            share = f", {percent(float(mine.coverage[name]))}" if covered else ""
            cells.append(f"{number(float(mine[error][name]))}°{share}" if known else MISSING)
        last = (_range(mine.numbers.astype(float)), _range(mine.cpu_s)) if estimates else ()
        rows.append(((not estimates and about.alone) or about.words, *cells, *last))
    last = ("numbers", "processor time [s]") if estimates else ()
    return Table((first, *map(_short, names), *last), tuple(rows))


def blocks(done: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Errors of what estimates the angle, errors of free runs, what close_loop said, and what gave no figure."""
    frame = _frame(done)
    whole = frame[frame.part.isna()]
    said, failed = whole[whole.said.notna()], whole[whole.why.notna()]
    absent = sorted({peer.library for peer in PEERS.values() if peer.library and not available(peer.library)})
    verdicts = Table(("joint", "close_loop says"), tuple((_short(one.joint), one.said) for one in said.itertuples()))
    why = [f"* {_short(one.joint)}, {PEERS[one.peer].words}: {one.why}" for one in failed.itertuples()]
    left = f"Left out, since not installed: {', '.join(absent)}; to get them: {install('peers')}."
    software = "Software: " + ", ".join(f"{name} {version}" for name, version in versions().items()) + "."
    return [
        _table("peer", whole, "rmse_deg"), Section("The model alone", (_table("model alone", whole, "alone_deg"),)),
        verdicts, *([Section("What gave no figure", tuple(map(Text, why)))] if why else []),
        *([Text(left)] if absent else []), Text(software),
    ]  # fmt: skip


def curves_figure(done: Sequence[Mapping[str, Any]]) -> Any:
    """Held-out error against the length of what was fitted, a panel for each joint; None where there is no curve."""
    from matplotlib.figure import Figure

    frame = _frame(done)
    frame = frame.assign(error=frame.rmse_deg.fillna(frame.alone_deg), length=frame.part.fillna(frame.whole_s))
    curves = {name: peer.words for name, peer in PEERS.items() if peer.curve}
    frame = frame[frame.error.notna() & frame.peer.isin(list(curves))]
    frame = frame[frame.groupby(["peer", "joint"]).error.transform("count") > 1]
    names = list(dict.fromkeys(frame.joint))
    if not names:
        return None
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    for axes, joint in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        for (peer, words), color in zip(curves.items(), PALETTE, strict=False):
            mine = frame[(frame.joint == joint) & (frame.peer == peer)].sort_values("length")
            axes.loglog(mine.length, mine.error, "o-", color=color, markersize=3, label=words)
        axes.set(title=_short(joint), xlabel="Fitted [s]")
    figure.axes[0].set_ylabel("Error [°]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    return figure


main = common.command(parser, _run)
