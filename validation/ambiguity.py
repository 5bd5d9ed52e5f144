"""``ambiguity``: which missing effects look alike, by pairs of simulated joints, and what recordings cannot show."""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from pam_antagonist import load_rig, simulate
from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.report import terminal
from pam_antagonist.report.document import Table, markdown, number, percent

_DESCRIPTION = """\
Show which missing effects look alike, and which recordings cannot show an effect, on simulated joints (rig A).

Each pair is two laws. One is put into the joint; the table of the other is fitted to what it does, in free and locked
minutes, and simulated. What is left says whether recordings can tell the two apart. It is this package's own simulator,
and the base parameters are known exactly: on a real joint less can be told apart. It takes a minute.
"""
_BASE, _SECONDS, _SEED, _NODES, _ROUNDS = "shin2022", 20.0, 3, 4, 2
RECORDINGS = {"free": ("angle", "torque", "pressure 1", "pressure 2"), "locked": ("torque", "pressure 1", "pressure 2")}
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Law:
    """A learned law of a rig file, by the range of what it depends on, and a unit of its values."""

    words: str
    low: float
    high: float
    unit: float
    content: tuple[tuple[str, Any], ...]
    values: tuple[float, ...] = ()  # in units; empty: the law that is there

    def rig(self) -> str:
        """Its rig file; a bent table where it is the law that is there, which changes its sign where the range does."""
        nodes = np.linspace(self.low, self.high, _NODES)
        share = nodes / self.high if self.low < 0.0 else np.linspace(0.0, 1.0, _NODES)
        there = 0.5 * share + 0.5 * share * np.abs(share)
        values = self.unit * (np.array(self.values) if self.values else there)
        law = {**dict(self.content), "nodes": nodes.tolist(), "values": values.tolist()}
        return yaml.safe_dump({"based_on": _BASE, "name": "a_law", "effects": {"learned": {"law1": law}}})


def _law(words: str, low: float, high: float, unit: float, **content: Any) -> Law:
    return Law(words, low, high, unit, tuple(content.items()))


_P, _L = (2.0e5, 7.0e5), (0.145, 0.185)
FLOW = _law("flow 1 by its pressure", *_P, -2e-6, place="flow", muscle=1, argument="pressure")
VALVE = _law("valve 1 by its pressure", *_P, -0.01, place="valve", muscle=1, argument="pressure")
SENSOR = _law("sensor 1 by its pressure", *_P, 4e3, place="sensor", muscle=1, argument="pressure")
FORCES = [_law(f"force {i} by its length", *_L, 2.0, place="force", muscle=i, argument="length") for i in (1, 2)]
STRENGTHS = [_law(f"strength {i} by length", *_L, 0.02, place="strength", muscle=i, argument="length") for i in (1, 2)]
DRAW = _law("supply by the air that is drawn", 0.0, 1e-4, -0.04, place="supply", argument="draw", operator="lag",
            time=3.0)  # fmt: skip
TIME = _law("supply by the running time", 0.0, _SECONDS, -0.01, place="supply", argument="time")
EXCHANGE = _law("exchange by P1 − P2", -4e5, 4e5, 2e-6, place="exchange", argument="pressure_difference")
CREEP = _law("strength 1 by its pressure, late", *_P, 0.02, place="strength", muscle=1, argument="pressure",
             operator="lag", time=3.0)  # fmt: skip
FRICTION = _law("friction by the speed", 0.0, 2.0, 0.02, place="friction", argument="speed")
PAIRS = (
    (FLOW, VALVE, "the flow: an opening counts by what passes the valve"),
    (SENSOR, FLOW, "the torque meter, which sees the true pressure"),
    (SENSOR, VALVE, "the same"),
    (FORCES[0], FORCES[1], "nothing; say: force of the muscles"),
    (STRENGTHS[0], STRENGTHS[1], "pressures that differ, which scale the law"),
    (DRAW, TIME, "pauses: the time runs on, the draw returns"),
)
SHOWN = (FLOW, EXCHANGE, VALVE, SENSOR, DRAW, CREEP, FORCES[0], FRICTION)


@lru_cache(maxsize=256)
def shown(law: Law | None, joint: str) -> Floats:
    """What the sensors of a joint with a law would show, in noises of a sample (N, C), without noise."""
    rig = load_rig(_BASE)
    if law is not None:
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "rig.yaml").write_text(law.rig(), encoding="utf-8")
            rig = load_rig(Path(folder) / "rig.yaml")
    found = simulate(rig, duration=_SECONDS, joint=joint, seed=_SEED, noise=False)
    assert found.angle is not None and found.torque is not None  # a simulated joint has both
    sensors = rig.sensors
    columns = {"angle": (found.angle, sensors.angle_std), "torque": (found.torque, sensors.torque_std),
               **{f"pressure {i + 1}": (found.pressure[:, i], sensors.pressure_std) for i in (0, 1)}}  # fmt: skip
    return np.column_stack([values / std for values, std in (columns[name] for name in RECORDINGS[joint])])


def changed_by(law: Law, joint: str) -> Floats:
    """By how much a law moves each channel (N, C), in noises."""
    return shown(law, joint) - shown(None, joint)


def _every(law: Law, pressures: bool) -> Floats:
    """What a law moves of all channels, or of the pressures of the locked joint alone."""
    if pressures:
        return changed_by(law, "locked")[:, 1:].ravel()
    return np.concatenate([changed_by(law, joint).ravel() for joint in RECORDINGS])


def left(there: Law, other: Law, pressures: bool) -> tuple[float, float]:
    """Root mean square of what a law moves, and of what the fitted table of another one leaves of it [noises]."""
    target, steps = _every(there, pressures), np.eye(_NODES)
    if not target.any():
        return 0.0, 0.0
    slopes = np.column_stack([_every(replace(other, values=tuple(row)), pressures) for row in steps])
    theta, found = np.zeros(_NODES), [_rms(target)]
    rest = target
    for _ in range(_ROUNDS):
        theta = theta + np.linalg.lstsq(slopes, rest, rcond=1e-6)[0]
        rest = target - _every(replace(other, values=tuple(theta)), pressures)
        found.append(_rms(rest))
    return found[0], min(found)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _main(arguments: argparse.Namespace) -> int:
    pairs, seen = [], []
    with counted(len(PAIRS) + len(SHOWN), "ambiguity") as advance:
        for there, other, decides in PAIRS:
            both = (left(there, other, pressures) for pressures in (False, True))
            cells = [f"{number(b, 2)} of {number(a, 2)} ({percent(b / a)})" if a else "not seen" for a, b in both]
            pairs.append((there.words, other.words, *cells, decides))
            advance(1)
        for law in SHOWN:
            each = np.concatenate([np.sqrt(np.mean(changed_by(law, joint) ** 2, axis=0)) for joint in RECORDINGS])
            seen.append((law.words, *("–" if value < 0.05 else number(float(value), 2) for value in each)))
            advance(1)
    first = ("there", "imitated by", "left", "left of pressures alone", "what tells them apart")
    second = ("there", *(f"{joint}: {name}" for joint, names in RECORDINGS.items() for name in names))
    tables = Table(first, tuple(pairs)), Table(second, tuple(seen))
    print("\n\n".join(terminal.table(table, indent="") for table in tables))
    if arguments.docs is not None:
        common.write_text(arguments.docs, "\n".join(line for one in tables for line in (*markdown(one), "")))
    return common.DONE


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("ambiguity", _DESCRIPTION)
    out.option("--docs", "write the tables as Markdown; FILE is replaced", Path, metavar="FILE")
    return out


main = common.command(parser, _main)
