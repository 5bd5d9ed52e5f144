"""Run the paper's experiments on a virtual rig and put the numbers beside the paper's.

The virtual rig is this package's simulator with declared mismatches: how models and estimators compare, nothing about a
real joint. What compares is repeated over --seeds rigs. Writes OUT/paper.md with its pictures, and OUT/report.json.

examples:
  {run} paper --out result
  {run} paper --out offline --only offline compare_angle --seeds 5
  {run} paper --out live --only online control_live --short
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS, whole
from pam_antagonist.errors import BadInput, NoResult
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.optional import available
from pam_antagonist.program import versions
from pam_antagonist.report import terminal
from pam_antagonist.report.document import MISSING, Block, Findings, Section, Table, Text, note, number
from pam_antagonist.strict_json import write_json
from pam_antagonist.strict_yaml import load_bounded
from validation import frame

if TYPE_CHECKING:
    import pandas as pd

    from validation.paper.experiments import Row

SOURCE = (
    "T. Shin, T. Ibayashi, K. Kogiso, “Detailed Dynamic Model of Antagonistic PAM System and its Experimental "
    "Validation: Sensor-less Angle and Torque Control with UKF”, 2022"
)
CAUTION = (
    "Our numbers are of a virtual rig: the simulator of this package with declared mismatches, which model and "
    "estimator do not know. They show how models and estimators compare under these mismatches. They say nothing about "
    "a real joint. The paper's numbers are of its authors' real rig and stand beside ours for comparison only."
)
_ABOUT = load_bounded((Path(__file__).parent / "experiments.yaml").read_text(encoding="utf-8"))
_TITLES = "".join(f"  {name.ljust(14)}  {one['title']}\n" for name, one in _ABOUT.items())


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("paper", __doc__, f"\nexperiments:\n{_TITLES}")
    out.shared("--out")
    out.add_argument("--only", nargs="+", action="extend", choices=tuple(_ABOUT), metavar="NAME",
                     help="run these experiments alone")  # fmt: skip
    out.shared("--seed", help="seed of the first virtual rig (default: 0)", metavar="N")
    out.option("--seeds", "how many virtual rigs (default: 20)", whole(1, 1000), 20, "N")
    out.option("--jobs", "processes (default: one a core)", JOBS, os.cpu_count() or 1, "N")
    out.flag("--short", "live runs of 30 s and less, in place of 130, 62, 38 and 20 s")
    out.flag("--no-figures", "leave the figures out")
    return out


def _run(arguments: argparse.Namespace) -> int:
    from validation.paper.experiments import EXPERIMENTS, run

    names = arguments.only or list(EXPERIMENTS)
    live = [name for name in names if EXPERIMENTS[name].live]
    if live and not available("rclpy"):
        others = " ".join(name for name, item in EXPERIMENTS.items() if not item.live)
        raise BadInput(
            f"{', '.join(live)}: start ROS 2 nodes, and rclpy is not installed; for the rest: --only {others}"
        )
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    common.check_output(arguments.out)
    with common.output_folder(arguments.out) as folder:
        with tempfile.TemporaryDirectory(prefix="live.", dir=folder) as scratch:
            try:
                values, seconds = run(names, seeds, arguments.jobs, arguments.short, Path(scratch))
            except ProcessFailed as error:
                raise NoResult(str(error)) from None
        shown = write(values, seeds, seconds, folder, not arguments.no_figures)
    print(f"\n{terminal.render(shown)}\n\n{CAUTION}\n")
    print(f"after {sum(seconds.values()):.0f} s: {arguments.out / 'paper.md'} and report.json")
    return common.DONE


def compared(values: pd.DataFrame, rows: Sequence[Row]) -> Table:
    """Numbers beside the paper's, median and range over the virtual rigs."""
    out = []
    for row in rows:
        cells: tuple[list[str], list[str]] = [], []
        for name, unit, paper in zip(row.names, row.units, row.paper, strict=True):
            scale, behind = 100.0 if unit == "%" else 1.0, "" if unit == "-" else unit if unit == "°" else f" {unit}"
            found = scale * values.reindex(columns=[name])[name]
            ends = f" ({number(found.min())} … {number(found.max())})" if found.count() > 1 else ""
            cells[0].append(number(found.median()) + ends + behind)
            cells[1].extend([] if paper is None else [f"{scale * paper:.6g}{behind}"])
        out.append((row.what, ", ".join(cells[0]), ", ".join(cells[1]) or MISSING, row.why))
    return Table(("What", "Virtual rig (ours): median (range)", "Paper (real rig)", "On the difference"), tuple(out))


def write(
    values: Mapping[str, pd.DataFrame], seeds: Sequence[int], seconds: Mapping[str, float], folder: Path, figures: bool
) -> list[Block]:
    """Write ``paper.md``, its pictures in ``paper/``, and ``report.json`` into a folder; what a terminal shows.

    `values`: of each experiment, a row a seed. `seconds`: that the experiments took.
    """
    from validation.paper.experiments import EXPERIMENTS
    from validation.paper.virtual import DECLARED, Mismatch, VirtualRig

    sizes = ", ".join(f"{name} {value:g}" for name, value in asdict(Mismatch()).items())
    about = (
        f"{len(seeds)} virtual rigs, seeds {min(seeds)} to {max(seeds)}: {DECLARED} with mismatches ({sizes}; see "
        f"validation/paper/virtual.py). Figures and live runs show seed {seeds[0]}."
    )
    page: list[Block] = [Text(f"After {SOURCE}."), Text(f"**{CAUTION}**"), Text(about)]
    shown: list[Block] = []
    content = {}
    for name, found in values.items():
        one = EXPERIMENTS[name]
        table, said = compared(found, one.rows), Findings(tuple(map(note, one.said(found))))
        pictures = []
        for label, figure in (one.figures(VirtualRig(seeds[0]), found) if figures else {}).items():
            picture = folder / "paper" / f"{'_'.join(filter(None, (name, label)))}.png"
            picture.parent.mkdir(exist_ok=True)
            figure.savefig(picture, dpi=110)
            pictures.append(Text(f"![{one.title}](paper/{picture.name})"))
        page.append(Section(one.title, (Text(one.question), table, said, *pictures)))
        shown.append(Section(one.title, (Table(table.header[:3], tuple(row[:3] for row in table.rows)), said)))
        beside = [
            {"what": value, "unit": unit, "paper": paper, "why": row.why,
             **found.reindex(columns=[value])[value].agg(["median", "min", "max", "count"]).to_dict()}
            for row in one.rows for value, unit, paper in zip(row.names, row.units, row.paper, strict=True)
        ]  # fmt: skip
        of_seed = {str(seed): dict(row) for seed, row in found.iterrows()}
        content[name] = {"title": one.title, "beside_the_paper": beside, "of_seed": of_seed}
    text = ["# Everything the paper shows, beside its numbers", *map(frame.in_markdown, page)]
    (folder / "paper.md").write_text("\n\n".join(filter(None, text)) + "\n", encoding="utf-8")
    write_json(folder / "report.json", {
        "source": SOURCE, "caution": CAUTION, "experiments": content, "seeds": list(seeds), "seconds": dict(seconds),
        "software": versions(),
    })  # fmt: skip
    return shown


main = common.command(parser, _run)
