"""``paper``: every experiment of the paper on a virtual rig, beside its numbers."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path

from pam_antagonist import strict_json
from pam_antagonist.cli import common
from pam_antagonist.cli.numbers import JOBS, SEED, whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.processes import ProcessFailed
from pam_antagonist.optional import available, install
from pam_antagonist.paths import config_dir
from pam_antagonist.report import terminal
from pam_antagonist.report.html import render
from validation.paper import docs, page
from validation.paper.experiments import EXPERIMENTS, Options, run
from validation.paper.scenario import load_scenario

_DESCRIPTION = """\
Run the paper's experiments on a virtual rig and put the numbers beside the paper's.

The virtual rig is this package's simulator with declared mismatches (config/scenarios/paper.yaml): how models and
estimators compare, nothing about a real joint. What compares is repeated over --seeds rigs. Writes OUT/report.html and
OUT/report.json.

experiments:
"""
_EXAMPLES = """\
examples:
  {run} paper --out result
  {run} paper --out offline --only offline compare_angle --seeds 5
  {run} paper --out live --only online control --short
"""


def parser() -> common.Parser:
    """The arguments."""
    listed = "".join(
        f"  {name.ljust(14)}  {item.summary}{' (live nodes)' if item.live else ''}\n"
        for name, item in EXPERIMENTS.items()
    )
    out = common.Parser("paper", _DESCRIPTION + listed, _EXAMPLES)
    add = out.add_argument
    add("--out", required=True, type=Path, metavar="DIR", help="folder of the report; a new one")
    add(
        "--only",
        nargs="+",
        action="extend",
        choices=tuple(EXPERIMENTS),
        metavar="NAME",
        help="run these experiments alone",
    )
    add("--seed", type=SEED, default=0, metavar="N", help="first seed of the virtual rigs (default: 0)")
    add("--seeds", type=whole(1, 1000), default=20, metavar="N", help="how many virtual rigs (default: 20)")
    add("--jobs", type=JOBS, default=os.cpu_count() or 1, metavar="N", help="processes (default: one a core)")
    add("--short", action="store_true", help="live runs of 30 s and less, in place of 130, 62, 38 and 20 s")
    add("--no-figures", action="store_true", help="leave the figures out")
    docs_help = (
        "write tables and figures as Markdown to FILE as well (docs/paper.md); the figures are pictures in a folder of "
        "that name (docs/paper)"
    )
    add("--docs", type=Path, metavar="FILE", help=docs_help)
    map_help = (
        "force map of a real muscle, CSV (default: ../shared/data/measured/force_maps/dmsp_20_300.csv, if it is there)"
    )
    out.shared("--json")
    add("--force-map", type=Path, metavar="FILE", help=map_help)
    out.shared("--open")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _run, argv)


def _run(arguments: argparse.Namespace) -> int:
    options = _options(arguments)
    scenario = load_scenario()
    common.check_output(arguments.out)
    if arguments.docs is not None:
        docs.check(arguments.docs, options.names)
    # What draws is looked for before minutes are spent.
    for needed in ("plotly", "matplotlib") if arguments.docs else ("plotly",):
        if options.with_figures and not available(needed):
            raise BadInput(f"figures: {needed} is not installed; to get it: {install('reports')}, or give --no-figures")
    with common.output_folder(arguments.out) as folder:
        with tempfile.TemporaryDirectory(prefix="live.", dir=folder) as recordings:
            try:
                with counted(len(options.seeds), "virtual rigs") as done:
                    results, took = run(scenario, options, Path(recordings), done, _print_line)
            except ProcessFailed as error:
                print(f"error: {error}", file=sys.stderr)
                return common.FAILED
        document = page.document(results, scenario, options.seeds, took)
        strict_json.write_json(folder / "report.json", document)
        html = render(page.page(results, scenario, options.seeds, took))
        (folder / "report.html").write_text(html, encoding="utf-8")
    if arguments.docs is not None:
        docs.write(arguments.docs, results, scenario, options.seeds)
    print(f"\n{terminal.table(page.overview(results))}\n\n{page.CAUTION}\n")
    print(f"after {sum(took.values()):.0f} s")
    common.announce_report(arguments, arguments.out)
    return common.DONE


def _print_line(text: str) -> None:
    print(text, flush=True)


def _options(arguments: argparse.Namespace) -> Options:
    names = tuple(arguments.only or EXPERIMENTS)
    live = [name for name in names if EXPERIMENTS[name].live]
    if live and not available("rclpy"):
        others = " ".join(name for name, item in EXPERIMENTS.items() if not item.live)
        raise BadInput(
            f"{', '.join(live)}: start ROS 2 nodes, and rclpy is not installed; for the rest: --only {others}"
        )
    force_map: Path | None = arguments.force_map
    if force_map is None:
        beside = config_dir().parents[1] / "shared" / "data" / "measured" / "force_maps" / "dmsp_20_300.csv"
        force_map = beside if beside.is_file() else None
    elif not force_map.is_file():
        raise BadInput(f"{force_map}: no such file; expected a CSV with length, pressure and force")
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    return Options(names, tuple(seeds), arguments.jobs, not arguments.no_figures, arguments.short, force_map)
