"""``control_laws``: how well the laws of control do on simulated joints, sensor-less."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.cli import common
from pam_antagonist.cli.numbers import JOBS, whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.control.command import Mode
from pam_antagonist.control.stiffness import Box
from pam_antagonist.control.tracking import largest_torque
from pam_antagonist.report import html, terminal
from pam_antagonist.report.document import Document, Text
from pam_antagonist.report.figure import TIME, Axis, Figure, Line, Panel
from pam_antagonist.report.style import ESTIMATE, MODEL, SECOND
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.rig import load_rig
from validation.control import trials

PARTS = ("time", "steps", "grid", "limits", "yielding")
_DESCRIPTION = """\
Measure the laws of control on simulated joints: the law through the model beside the paper's PI with its published
gains. Plant, filter and laws run in one process, without ROS. The laws see the estimate only, which knows pressures
and voltages. Each seed is another joint, whose parameters are off the declared ones by 2 % (one standard deviation).

  time      one call of each law and of the governor, from Python
  steps     20 deg and 2 N m (joint locked): settling to 5 %, overshoot, steady error, and the least time there is
  grid      seven pairs of angle and stiffness, held one after the other
  limits    references at random with pushes of up to 0.3 N m, with the governor and without it
  yielding  mode IMPEDANCE: transfer from a torque to the angle, over that of the spring and damper asked for, and the
            largest torque that the valves can follow

Status: 0 whether or not a figure is good, 2 bad input.
"""
_EXAMPLES = """\
examples:
  {run} control_laws --seeds 20 --out laws
  {run} control_laws --only limits --references 10000 --seeds 20
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("control_laws", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--only", choices=PARTS, action="append", help="run this part alone; may be given several times")
    out.add_argument("--rig", default="shin2022", metavar="RIG", help="a rig of the size of shin2022 (the default)")
    out.add_argument(
        "--seeds",
        type=whole(1, 100_000),
        default=20,
        metavar="N",
        help="number of joints, with seeds 0 to N - 1 (default: 20)",
    )
    out.add_argument(
        "--references",
        type=whole(1, 100_000),
        default=1000,
        metavar="N",
        help="number of random references, of all joints together (default: 1000)",
    )
    out.add_argument("--jobs", type=JOBS, default=2, metavar="N", help="processes (default: 2)")
    out.add_argument("--out", type=Path, metavar="DIR", help="folder of report.html and report.json; a new one")
    common.add_new_json(out, "the figures")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    if arguments.out is not None:
        common.check_output(arguments.out)
    parts = [part for part in PARTS if part in (arguments.only or PARTS)]
    results = measure(parts, arguments.rig, arguments.seeds, arguments.references, arguments.jobs)
    shown = tables(results)
    common.show("\n\n".join(terminal.table(table, indent="") for table in shown), results, arguments.json)
    if arguments.out is not None:
        with common.output_folder(arguments.out) as folder:
            html.write(folder, document(results, shown, arguments.rig), results)
        with common.json_alone(arguments.json):
            print(f"report: {arguments.out / 'report.html'} and report.json")
    return common.DONE


def measure(parts: Sequence[str], rig_name: str, seeds: int, references: int, jobs: int) -> dict[str, Any]:
    """Run the trials.

    Args:
        parts: of ``PARTS``.
        rig_name: of the declared rig.
        seeds: how many joints.
        references: at random, of all joints together.
        jobs: processes.

    Returns:
        By part, the results of each seed; those of ``time`` by law.
    """
    from joblib import Parallel, delayed

    rig, each = load_rig(rig_name), math.ceil(references / seeds)
    work: dict[str, Callable[[int], Any]] = {
        "steps": lambda seed: delayed(trials.steps)(rig, seed),
        "grid": lambda seed: delayed(trials.grid)(rig, seed),
        "limits": lambda seed: delayed(_both)(rig, seed, each),
        "yielding": lambda seed: delayed(trials.yielding)(rig, seed),
    }
    asked = [part for part in parts if part in work]
    results: dict[str, Any] = {"rig": rig_name, "seeds": seeds, "mismatch": 0.02}
    if "time" in parts:
        results["time"] = trials.call_times(rig_name)
    tasks = [(part, seed) for part in asked for seed in range(seeds)]
    if not tasks:
        return results
    with counted(len(tasks), "control_laws") as done:
        runs = Parallel(n_jobs=min(jobs, len(tasks)), return_as="generator")(work[part](seed) for part, seed in tasks)
        for (part, _), result in zip(tasks, runs, strict=True):
            results.setdefault(part, []).append(result)
            done(1)
    return results


def _both(rig: Any, seed: int, count: int) -> dict[str, Any]:
    """With the governor, and a fifth of the references without it: enough to see what it is worth."""
    fewer = math.ceil(count / 5)
    return {"with": trials.limits(rig, seed, count, True), "without": trials.limits(rig, seed, fewer, False)}


def tables(results: Mapping[str, Any]) -> list[Table]:
    """What was measured, a table a part."""
    makers: dict[str, Callable[[Any], Table]] = {"time": _time, "steps": _steps, "grid": _grid, "limits": _limits}
    makers["yielding"] = lambda found: _yielding(found, results["rig"])
    return [make(results[part]) for part, make in makers.items() if part in results]


def _time(found: Mapping[str, float]) -> Table:
    rows = tuple((name, f"{value:.1f}") for name, value in found.items())
    return Table(("one call from Python", "[µs]"), rows, "The least of 60 batches of 100 calls")


def _spread(values: Sequence[float], digits: int = 3) -> str:
    """Median, and the range from the 10th to the 90th percentile; inf: it never settled."""
    low, middle, high = (float(value) for value in np.quantile(values, (0.1, 0.5, 0.9), method="nearest"))
    return f"{_or_never(middle, digits)} ({_or_never(low, digits)} to {_or_never(high, digits)})"


def _or_never(value: float, digits: int) -> str:
    return number(value, digits) if math.isfinite(value) else "never"


def _steps(found: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for quantity, unit, scale in ((Mode.ANGLE, "°", math.degrees(1.0)), (Mode.TORQUE, "N m", 1.0)):
        for law in ("pi", "model"):
            name = f"{quantity.name.lower()}, {law}"
            every = [step for seed in found for step in seed[name]]
            columns = [[step[key] for step in every] for key in ("settling_s", "overshoot", "steady_error")]
            overshoot, steady = ([scale * value for value in column] for column in columns[1:])
            rows.append((f"{name} [{unit}]", _spread(columns[0]), _spread(overshoot), _spread(steady)))
        name = quantity.name.lower()
        rows.append((f"{name}, valves fully open", _spread([seed[f"{name}, least"] for seed in found]), "", ""))
    header = ("step", "settling to 5 % [s]", "overshoot", "steady error")
    about = (
        "Of the true angle or torque: median (10th to 90th percentile). With valves fully open: the least time there is"
    )
    return Table(header, tuple(rows), about)


def _grid(found: Sequence[Sequence[Mapping[str, float]]]) -> Table:
    rows = []
    for k, (angle, stiffness) in enumerate((*trials.GRID, (math.nan, math.nan))):
        every = [pair for seed in found for pair in (seed[k : k + 1] if math.isfinite(angle) else seed)]
        name = f"{angle:g}°, {stiffness:g} N m/rad" if math.isfinite(angle) else "all"
        columns = [[pair[key] for pair in every] for key in ("angle_error_deg", "estimate_error_deg")]
        share = [100.0 * pair["stiffness_error"] for pair in every]
        rows.append((name, *(_spread(column) for column in columns), _spread(share)))
    header = ("held", "angle's error [°]", "the estimate's [°]", "stiffness's error [%]")
    about = "Steady errors of the true angle, of the estimate, and of the joint's own −∂τ/∂ψ"
    return Table(header, tuple(rows), f"{about}: median (10th to 90th percentile)")


def _limits(found: Sequence[Mapping[str, Any]]) -> Table:
    rows = []
    for name in found[0]["with"]["beyond"]:
        cells = []
        for way in ("with", "without"):
            samples = sum(seed[way]["samples"] for seed in found)
            part = sum(seed[way]["samples"] * seed[way]["beyond"][name] for seed in found) / samples
            count = sum(seed[way]["references_beyond"][name] for seed in found)
            cells += [f"{100.0 * part:.4f} %", str(count)]
        rows.append((f"{name} beyond its limit", *cells))
    total = sum(seed["with"]["references"] for seed in found)
    for name, key in (("RMSE of the angle [°]", "rmse_deg"), ("RMSE of the stiffness [N m/rad]", "stiffness_rmse")):
        cells = [
            number(math.sqrt(float(np.mean([seed[way][key] ** 2 for seed in found])))) for way in ("with", "without")
        ]
        rows.append((name, cells[0], "", cells[1], ""))
    rows.append(("held back", percent(float(np.mean([seed["with"]["held_back"] for seed in found]))), "", "", ""))
    header = ("", "governor: samples", "references", "none: samples", "references")
    about = (
        f"{total} references at random of 0.2 to 0.6 s (a fifth of them without the governor), pushes of up to "
        f"{trials.PUSH:g} N m, level {trials.LEVEL:g}"
    )
    return Table(header, tuple(rows), about)


def _yielding(found: Sequence[Sequence[Mapping[str, float]]], rig_name: str) -> Table:
    rows, p = [], load_rig(rig_name).parameters()
    stiffness, damping = trials.YIELDING
    for k, first in enumerate(found[0]):
        known = "known" if first["known"] else "not known"
        gain, phase = ([seed[k][key] for seed in found] for key in ("gain", "phase_deg"))
        name = f"{first['torque_nm']:g} N m at {first['frequency_hz']:g} Hz, {known}"
        most = largest_torque(p, Box.of(p), stiffness, damping, first["frequency_hz"])
        rows.append((name, f"{most:.2f}", _spread(gain), _spread(phase)))
    about = f"Torque to angle over 1/(K + iωD), K = {stiffness:g} N m/rad, D = {damping:g} N m s/rad; exact: 1 and 0°"
    return Table(("torque", "valves follow [N m]", "gain", "phase [°]"), tuple(rows), about)


def document(results: Mapping[str, Any], shown: Sequence[Table], rig_name: str) -> Document:
    """The page, with a step of both laws beside each other.

    Args:
        results: of :func:`measure`.
        shown: its tables.
        rig_name: of the declared rig.
    """
    lede = (
        f"{results['seeds']} simulated joints of rig {rig_name}, parameters 2 % off, controlled on the estimate alone."
    )
    figures = (step_figure(rig_name, Mode.ANGLE), step_figure(rig_name, Mode.TORQUE)) if "steps" in results else ()
    return Document("Laws of control", rig_name, (Text(lede, "lede"), *figures, *shown))


def step_figure(rig_name: str, quantity: Mode) -> Figure:
    """A step up of the joint of seed 0 with both laws.

    Args:
        rig_name: of the declared rig.
        quantity: angle or torque.
    """
    rig = load_rig(rig_name)
    name, unit, scale = ("angle", "°", math.degrees(1.0)) if quantity is Mode.ANGLE else ("torque", "N m", 1.0)
    lines: list[Line] = []
    for law, color in (("model", ESTIMATE), ("pi", MODEL)):
        course = trials.step_course(rig, law, quantity, 0)
        hold = trials.HOLD_S[law, quantity]
        first = round((hold - 0.5) / rig.sample_period)
        rows = slice(first, first + round(min(hold, 12.0) / rig.sample_period))
        true = course.angle if quantity is Mode.ANGLE else course.torque
        time = np.arange(len(true), dtype=np.float64)[rows] * rig.sample_period - hold
        words = {"model": "law through the model", "pi": "PI, published gains"}[law]
        lines.append(Line(words, time, true[rows] * scale, color, width=1.8))
        if law == "pi":
            lines.append(Line("reference", time, course.value[rows] * scale, SECOND, dash="dash"))
    about = "Simulated joint of seed 0, parameters 2 % off, controlled on the estimate. Shown is the true value."
    panel = Panel(TIME, Axis(f"{name.capitalize()} [{unit}]"), tuple(lines), 300)
    return Figure(f"A step of the {name} with both laws", about, (panel,))
