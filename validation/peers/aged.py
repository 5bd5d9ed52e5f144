"""Compare our model of a real arm with networks that weigh episodes by their age, on the same later episodes.

FILE is the CSV of docs/evidence/measured.md. The networks are those of peers (GRU, two layers of 64, all inputs and the
first angle of an episode). One kind weighs all episodes alike; the other one halves the weight of an episode with its
age. Its half-life is chosen by forecasts inside the episodes that may be fitted, as our model's drift is: fits to the
first half and to three quarters of them forecast the next quarter. Later episodes are opened once, at the end. All
differences are paired by episode. It takes about half an hour of one core, and needs torch.

examples:
  {run} arm_networks pamy_joint0.csv --json networks.json
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS
from pam_antagonist.diagnosis.episodes import EpisodeDiagnosis, diagnose
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.bootstrap import Interval, drawn, rmse
from pam_antagonist.inference.episodes import Squares
from pam_antagonist.inference.held_episodes import held_out
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.optional import available
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.report.document import Block, Table, Text, number
from pam_antagonist.report.identify_episodes import interval
from pam_antagonist.rig import load_rig
from validation import frame
from validation.at_hand import ARM_SIGNALS
from validation.pamy import course
from validation.peers.joints import Floats
from validation.peers.soft_sensors import recurrent

_SHARE = 1.0 / 3.0
HALF_LIVES = (math.inf, 800.0, 400.0, 200.0, 100.0)
"""Episodes after which an episode counts half, of which one is chosen."""
_FORECASTS = ((0.5, 0.75), (0.75, 1.0))
"""Shares of the episodes that may be fitted: the end of a fit, and of what it forecasts."""
SEEDS = (0, 1)


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("arm_networks", __doc__)
    out.add_argument("file", type=Path, metavar="FILE", help="the CSV file")
    frame.add_docs(out)
    out.add_argument("--jobs", type=JOBS, default=2, metavar="N", help="threads of our model's fits (default: 2)")
    frame.add_new_json(out, "the figures")
    return out


def _run(arguments: argparse.Namespace) -> int:
    if not available("torch"):
        raise BadInput("torch is not installed: pip install 'pam_antagonist[peers]'")
    recording = read_csv(arguments.file, load_map("pamy_joint0"))
    joint = PressureDriven.of(recording, load_rig("regulator_joint", regulators=True), ARM_SIGNALS, arguments.jobs)
    held = held_out(len(joint), _SHARE)
    forecasts = {life: _forecast(joint, held.pool, life) for life in HALF_LIVES}
    best = min(forecasts, key=lambda life: forecasts[life])
    found = diagnose(joint, _SHARE, progress=_progress)
    later, pool = joint.take(held.later), joint.take(held.pool)
    angles = {"our model": _ours(found, held.later)}
    for name, life in (("network, all episodes alike", math.inf), ("network, weighed by age", best)):
        each = []
        for seed in SEEDS:
            _progress(f"{name}, seed {seed}")
            each.append(_network(pool, later, life, seed))
            angles[f"{name}, seed {seed}"] = each[-1]
    angles["mean of our model and the last network"] = 0.5 * (angles["our model"] + each[-1])
    squares = {name: later.squares((later.angle - angle)[:, None]) for name, angle in angles.items()}
    rows, content = [], {}
    for name, one in squares.items():
        error, apart = rmse(*one), _apart(one, squares["our model"])
        rows.append((name, interval(error), "–" if name == "our model" else interval(apart, 2)))
        content[name] = {"rmse_deg": error, "minus_ours_deg": apart}
    chosen = "all alike" if math.isinf(best) else f"half the weight after {best:g} episodes"
    said = "; ".join(f"{life:g}: {number(value)}°" for life, value in forecasts.items())
    blocks: list[Block] = [
        Table(
            ("Later episodes", "RMSE [°], 95 % interval by episode", "minus our model's [°]"), tuple(rows),
            f"{len(later)} later episodes, opened once; fitted to {len(pool)}",
        ),
        Text(f"Error of the forecasts by half-life in episodes: {said}. Chosen: {chosen}."),
    ]  # fmt: skip
    frame.show(blocks, arguments, {"later": content, "forecasts_deg": forecasts, "half_life": best})
    return common.DONE


def _progress(text: str) -> None:
    print(f"arm_networks: {text}", file=sys.stderr, flush=True)


def _network(fit: PressureDriven, asked: PressureDriven, half_life: float, seed: int) -> Floats:
    """Angle of a network at the rows of the asked episodes (N,) [rad]."""
    age = len(fit) - 1.0 - np.arange(len(fit))
    weights = 0.5 ** (age / half_life)
    return recurrent([course(fit, True)], [course(asked, True)], seed, weights / weights.sum()).angle[0]


def _forecast(joint: PressureDriven, pool: np.ndarray, half_life: float) -> float:
    """RMS error of the forecasts [deg]."""
    sums = counts = 0.0
    for begin, end in _FORECASTS:
        _progress(f"half-life {half_life:g}, forecast from {begin:g} to {end:g}")
        before, after = (joint.take(pool[round(len(pool) * a) : round(len(pool) * b)]) for a, b in
                         ((0.0, begin), (begin, end)))  # fmt: skip
        one = after.squares((after.angle - _network(before, after, half_life, SEEDS[0]))[:, None])
        sums, counts = sums + one.sums.sum(), counts + one.counts.sum()
    return float(np.degrees(math.sqrt(sums / counts)))


def _ours(found: EpisodeDiagnosis, later: np.ndarray) -> Floats:
    assert found.weak is not None
    fit, model = found.weak
    part, _ = fit.part(later, model.numbers)
    return np.asarray(part.simulated(model.model)[:, 0])


def _apart(one: Squares, other: Squares) -> Interval:
    """Difference of two errors over the same episodes [deg]."""
    draws = drawn(len(one.sums))
    of: Callable[[Squares], Floats] = lambda each: np.degrees(np.sqrt((draws @ each.sums) / (draws @ each.counts)))  # noqa: E731
    return Interval.of(float(np.degrees(one.rmse - other.rmse)), of(one) - of(other))


main = common.command(parser, _run)
