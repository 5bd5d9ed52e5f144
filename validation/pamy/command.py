"""``pamy``: the measured arm from its CSV file to the page: effects, baselines, drift and regulators."""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from dataclasses import replace
from pathlib import Path

from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS
from pam_antagonist.diagnosis.episodes import diagnose
from pam_antagonist.identification.regulators import of_commands, pressures_of
from pam_antagonist.inference.bootstrap import rmse
from pam_antagonist.inference.held_episodes import held_out
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.optional import available
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.recording.recording import Recording
from pam_antagonist.report import episodes as report
from pam_antagonist.report import html
from pam_antagonist.rig import load_rig
from validation.pamy import baselines, network, page
from validation.pamy.day import by_parts

_DESCRIPTION = """\
Apply close_loop to the recording of a real arm, compare it with models without physics, and show drift and regulators.

FILE is the CSV of docs/pamy.md, which is not part of this package. Other files with the same columns can be
used as well. Writes DIR/report.html and DIR/report.json, and with --docs the page. It takes some minutes.
"""
_EXAMPLES = """\
examples:
  {run} pamy pamy_joint0.csv --out result
  {run} pamy pamy_joint0.csv --out result --docs docs/pamy.md
"""
_OTHER = ("joint1_p1", "joint1_p2")
_SHARE = 1.0 / 3.0


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("pamy", _DESCRIPTION, _EXAMPLES)
    out.add_argument("file", type=Path, metavar="FILE", help="the CSV file")
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the report; a new one")
    out.add_argument("--docs", type=Path, metavar="FILE", help="write the page as Markdown as well (docs/pamy.md)")
    out.add_argument("--jobs", type=JOBS, default=2, metavar="N", help="threads (default: 2)")
    out.add_argument("--no-figures", action="store_true", help="leave the figure out of report.html")
    out.shared("--json", "--open")
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _run, argv)


def _run(arguments: argparse.Namespace) -> int:
    common.check_output(arguments.out)
    recording = read_csv(arguments.file, load_map("pamy_joint0"))
    begin = time.perf_counter()
    result = analysed(recording, arguments.jobs)
    result = replace(result, took=time.perf_counter() - begin)
    hashes = (hashlib.sha256(arguments.file.read_bytes()).hexdigest(),)
    with common.output_folder(arguments.out) as folder:
        found = report.EpisodesDiagnoseResult(result.found, result.joint, hashes)
        content = found.document(not arguments.no_figures)
        html.write(folder, content, page.numbers(result, hashes))
    if arguments.docs is not None:
        common.write_text(arguments.docs, page.markdown(result))
    print(found.summary())
    common.announce_report(arguments, arguments.out)
    return common.DONE


def analysed(recording: Recording, jobs: int) -> page.ArmResult:
    """All that the page shows.

    Args:
        recording: of the arm, with the signals of its map.
        jobs: threads.

    Raises:
        BadInput: a recording from which nothing can be learned.
    """
    rig = load_rig("regulator_joint", regulators=True)
    joint = PressureDriven.of(recording, rig, _OTHER, jobs)
    held = held_out(len(joint), _SHARE)

    def progress(text: str) -> None:
        print(f"pamy: {text}", file=sys.stderr, flush=True)

    found = diagnose(joint, _SHARE, progress=progress)
    rows = baselines.rows(joint, held, found.window)
    regulators = of_commands(joint, held, progress)
    later = joint.take(held.later)
    held_by = pressures_of(regulators, later)
    commanded = rmse(
        *later.squares(replace(later, pressure=held_by, longest_step=found.longest_step).residual(found.model))
    )
    beside = None
    if available("torch"):
        progress("the recurrent network")
        beside = network.row(joint.take(held.pool), later, joint.take(held.interleaved))
    book = by_parts(recording, progress, jobs)
    return page.ArmResult(found, joint, rows, available("sklearn"), commanded, regulators, 0.0, beside, book)
