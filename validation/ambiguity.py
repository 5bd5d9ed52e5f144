"""Show which missing effects look alike, and which recordings cannot show an effect, on simulated joints (rig A).

Each pair is two laws. One is put into the joint; the table of the other is fitted to what it does, in free and locked
minutes, and simulated. What is left says whether recordings can tell the two apart. It is this package's own simulator,
and the base parameters are known exactly: on a real joint less can be told apart. It takes a minute.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist import load_rig, simulate
from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.report.document import Table, number, percent
from pam_antagonist.rig.learned import Law, with_law
from validation import frame

_SECONDS, _SEED, _NODES, _ROUNDS = 20.0, 3, 4, 2
RECORDINGS = {"free": ("angle", "torque", "pressure 1", "pressure 2"), "locked": ("torque", "pressure 1", "pressure 2")}
_NOT_SEEN = "locked", "angle"
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Pull:
    """A learned law that is put into the joint, in words, and the unit in which its table is fitted."""

    words: str
    unit: float
    law: Law


def _pull(words: str, low: float, high: float, unit: float, place: str, argument: str, **more: Any) -> Pull:
    """A law with a bent table, which changes its sign where the range of what it depends on does."""
    nodes = np.linspace(low, high, _NODES)
    share = nodes / high if low < 0.0 else np.linspace(0.0, 1.0, _NODES)
    values = unit * (0.5 * share + 0.5 * share * np.abs(share))
    return Pull(words, unit, Law(place, tuple(nodes.tolist()), tuple(values.tolist()), argument=argument, **more))


_P, _L = (2.0e5, 7.0e5), (0.145, 0.185)
FLOW = _pull("flow 1 by its pressure", *_P, -2e-6, "flow", "pressure", muscle=1)
VALVE = _pull("valve 1 by its pressure", *_P, -0.01, "valve", "pressure", muscle=1)
SENSOR = _pull("sensor 1 by its pressure", *_P, 4e3, "sensor", "pressure", muscle=1)
FORCES = [_pull(f"force {i} by its length", *_L, 2.0, "force", "length", muscle=i) for i in (1, 2)]
STRENGTHS = [_pull(f"strength {i} by length", *_L, 0.02, "strength", "length", muscle=i) for i in (1, 2)]
DRAW = _pull("supply by the air that is drawn", 0.0, 1e-4, -0.04, "supply", "draw", operator="lag", time=3.0)
TIME = _pull("supply by the running time", 0.0, _SECONDS, -0.01, "supply", "time")
EXCHANGE = _pull("exchange by P1 − P2", -4e5, 4e5, 2e-6, "exchange", "pressure_difference")
CREEP = _pull("strength 1 by its pressure, late", *_P, 0.02, "strength", "pressure", muscle=1, operator="lag", time=3.0)
FRICTION = _pull("friction by the speed", 0.0, 2.0, 0.02, "friction", "speed")
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
    rig = load_rig("shin2022")
    found = simulate(
        rig if law is None else with_law(rig, law), duration=_SECONDS, joint=joint, seed=_SEED, noise=False
    )
    assert found.angle is not None and found.torque is not None  # a simulated joint has both
    columns = {"angle": found.angle, "torque": found.torque, "pressure": found.pressure}
    noises = {name: values / rig.sensors.reading(name).std for name, values in columns.items()}
    return np.column_stack([noises[name] for name in ("angle", "torque", "pressure") if (joint, name) != _NOT_SEEN])


def changed_by(law: Law, joint: str) -> Floats:
    """By how much a law moves each channel (N, C), in noises."""
    return shown(law, joint) - shown(None, joint)


def left(there: Pull, other: Pull, pressures: bool) -> tuple[float, float]:
    """Root mean square of what a law moves, and of what the fitted table of another one leaves of it [noises].

    Of all channels, or of the pressures of the locked joint alone.
    """

    def every(law: Law) -> Floats:
        if pressures:
            return changed_by(law, "locked")[:, 1:].ravel()
        return np.concatenate([changed_by(law, joint).ravel() for joint in RECORDINGS])

    def with_table(theta: Floats) -> Floats:
        return every(replace(other.law, values=tuple((other.unit * theta).tolist())))

    target = every(there.law)
    if not target.any():
        return 0.0, 0.0
    slopes = np.column_stack([with_table(row) for row in np.eye(_NODES)])
    theta, rest, found = np.zeros(_NODES), target, [np.mean(target**2)]
    for _ in range(_ROUNDS):
        theta = theta + np.linalg.lstsq(slopes, rest, rcond=1e-6)[0]
        rest = target - with_table(theta)
        found.append(np.mean(rest**2))
    return float(np.sqrt(found[0])), float(np.sqrt(min(found)))


def _main(arguments: argparse.Namespace) -> int:
    pairs, seen = [], []
    with counted(len(PAIRS) + len(SHOWN), "ambiguity") as advance:
        for there, other, decides in PAIRS:
            both = (left(there, other, pressures) for pressures in (False, True))
            cells = [f"{number(b, 2)} of {number(a, 2)} ({percent(b / a)})" if a else "not seen" for a, b in both]
            pairs.append((there.words, other.words, *cells, decides))
            advance(1)
        for one in SHOWN:
            each = np.concatenate([np.sqrt(np.mean(changed_by(one.law, joint) ** 2, axis=0)) for joint in RECORDINGS])
            seen.append((one.words, *("–" if value < 0.05 else number(float(value), 2) for value in each)))
            advance(1)
    first = ("there", "imitated by", "left", "left of pressures alone", "what tells them apart")
    second = ("there", *(f"{joint}: {name}" for joint, names in RECORDINGS.items() for name in names))
    frame.show([Table(first, tuple(pairs)), Table(second, tuple(seen))], arguments)
    return common.DONE


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("ambiguity", __doc__)
    frame.add_docs(out)
    return out


main = common.command(parser, _main)
