"""``external_torque``: how well the torque from outside is estimated, on simulated joints."""

from __future__ import annotations

import argparse
import math
from typing import Any

from pam_antagonist.cli import common
from pam_antagonist.cli.numbers import JOBS, real, whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.rig import NO_ENCODER, load_rig
from validation.pushes import trial

_DESCRIPTION = """\
Measure the estimate of the torque from outside on simulated joints, by pressures alone and with an encoder. Each seed
is another joint, whose parameters are off the declared ones by 1 % (one standard deviation), driven by voltage steps
and pushed by 0.1 to 1.5 N m for 0.1 to 2 s. Detection is judged by pushes of 0.3 N m. The threshold is the least one
that estimates of other joints, which nobody pushes, exceed in one second of an hour.

Status: 0 whether or not a figure is good, 2 bad input.
"""
_EXAMPLES = """\
examples:
  {run} external_torque --seeds 10
  {run} external_torque --seeds 10 --quiet-hours 3
"""
_KINDS = ("pushed", "small")


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("external_torque", _DESCRIPTION, _EXAMPLES)
    out.add_argument(
        "--rig", default="shin2022_external_torque", metavar="RIG",
        help="a rig with the state external_torque and an encoder (default: shin2022_external_torque)",
    )  # fmt: skip
    out.add_argument(
        "--seeds",
        type=whole(1, 10_000),
        default=10,
        metavar="N",
        help="number of joints, with seeds 0 to N - 1 (default: 10)",
    )
    out.add_argument(
        "--seconds", type=real(4.0, 3600.0), default=20.0, metavar="S", help="length of each run [s] (default: 20)"
    )
    out.add_argument(
        "--quiet-hours",
        type=float,
        metavar="H",
        help="total time of runs in which nobody pushes [h] (default: seeds times seconds)",
    )
    out.add_argument("--jobs", type=JOBS, default=2, metavar="N", help="processes (default: 2)")
    common.add_new_json(out, "the figures")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    hours = arguments.quiet_hours
    if hours is not None and not 0.001 <= hours <= 1000.0:
        raise BadInput(f"--quiet-hours {hours:g}: expected 0.001 to 1000 h")
    results = measure(arguments.rig, arguments.seeds, arguments.seconds, arguments.jobs, hours)
    common.show(terminal.table(_table(results), indent=""), results, arguments.json)
    return common.DONE


def measure(rig_name: str, seeds: int, seconds: float, jobs: int, quiet_hours: float | None = None) -> dict[str, Any]:
    """Run the joints.

    Args:
        rig_name: of the declared rig.
        seeds: how many joints.
        seconds: of each course.
        jobs: processes.
        quiet_hours: in which nobody pushes; None: as long as the joints are pushed.

    Returns:
        Figures by angle sensor, and what they were measured on.

    Raises:
        BadInput: a rig without the state ``external_torque`` or without an encoder.
    """
    from joblib import Parallel, delayed

    rig = load_rig(rig_name)
    if "external_torque" not in rig.effects:
        raise BadInput(
            f"rig {rig.name} does not have the state external_torque: write it under effects in the rig file, as in "
            "shin2022_external_torque"
        )
    if rig.encoder is None:
        raise BadInput(NO_ENCODER.format(rig=rig.name))
    calm = seeds if quiet_hours is None else math.ceil(quiet_hours * 3600.0 / (seconds - 1.0))
    tasks = [(kind, seed) for kind in _KINDS for seed in range(seeds)]
    found: dict[str, dict[str, list[Any]]] = {kind: {} for kind in (*_KINDS, "quiet")}
    with counted(len(tasks) + calm, "external_torque") as done:
        work = [delayed(trial.run)(rig, seed, seconds, kind) for kind, seed in tasks]
        work += [delayed(trial.quiet)(rig, trial.QUIET_SEED + k, seconds) for k in range(calm)]
        kinds = [kind for kind, _ in tasks] + ["quiet"] * calm
        for kind, runs in zip(kinds, Parallel(n_jobs=jobs, return_as="generator")(work), strict=True):
            for sensor, one in runs.items():
                found[kind].setdefault(sensor, []).append(one)
            done(1)
    figures = {
        sensor: trial.errors(runs) | trial.detection(found["small"][sensor], found["quiet"][sensor])
        for sensor, runs in found["pushed"].items()
    }
    return {"rig": rig_name, "seeds": seeds, "seconds": seconds, "mismatch": trial.MISMATCH, "figures": figures}


def _table(results: dict[str, Any]) -> Table:
    columns = list(results["figures"].values())

    def row(title: str, key: str, shown: Any = number) -> tuple[str, ...]:
        return (title, *(shown(column[key]) for column in columns))

    def milliseconds(value: float) -> str:
        return f"{value * 1e3:.0f}" if math.isfinite(value) else "never"

    rows = (
        row("RMSE [N m]", "rmse_nm"),
        row("in the 95 % interval", "coverage95", percent),
        row("claimed standard deviation [N m]", "std_nm"),
        row("delay [ms]", "delay_s", milliseconds),
        row("threshold for one false alarm an hour [N m]", "threshold_nm"),
        row("0.3 N m seen within 100 ms", "seen", percent),
        row("0.3 N m seen after, median [ms]", "median_s", milliseconds),
    )
    caption = (
        f"{results['seeds']} simulated joints of {results['rig']}, {100 * results['mismatch']:.0f} % off, "
        f"{results['seconds']:g} s each; the threshold is of {columns[0]['quiet_s'] / 3600.0:.2g} h without a "
        f"push, with {columns[0]['alarms']:.0f} alarms"
    )
    return Table(("torque from outside", "pressures alone", "with an encoder"), rows, caption)
