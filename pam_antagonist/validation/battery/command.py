"""``battery``: how often the diagnosis is right, on joints whose effects are known."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, percent
from pam_antagonist.rig import load_rig
from pam_antagonist.software import versions
from pam_antagonist.strict_json import write_json
from pam_antagonist.validation.battery import outcomes
from pam_antagonist.validation.battery.plants import DURATION, RIG, Case, cases

_DESCRIPTION = """\
Diagnose a battery of simulated joints and say how often the diagnosis was right.

Each case is a free and a locked recording of a joint with one effect, two, none, or something that is in no catalogue.
The effects are written in another form than the catalogue's, their sizes are random, the base parameters are scattered
by a percent and the sensors are noisy. It is this package's own simulator: being right here is less than being right
on a real joint.

One JSON a finished case in the folder --out: the same command again goes on where it was interrupted. Shards of one
battery may run at the same time into one folder; the tables are of the cases that are finished.
Status: 0 whether or not the diagnosis was right, 2 bad input.
"""
_EXAMPLES = """\
examples:
  battery --out result --count 8
  battery --out result --shard 1/2 &   battery --out result --shard 2/2
  battery --out result --count 80 --docs docs/battery.md
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("battery", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the outcomes; may exist")
    out.add_argument("--count", type=int, default=80, metavar="N", help="how many cases (default: 80)")
    out.add_argument("--seed", type=int, default=1, metavar="S", help="of the battery (default: 1)")
    out.add_argument(
        "--shard", type=_shard, default=(1, 1), metavar="I/K", help="every K-th case, from the I-th on (default: 1/1)"
    )
    out.add_argument(
        "--duration", type=float, default=DURATION, metavar="S", help=f"of a recording [s] (default: {DURATION:g})"
    )
    out.add_argument("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="threads (default: all cores)")
    out.add_argument("--docs", type=Path, metavar="FILE", help="write the tables as Markdown; FILE is replaced")
    out.add_argument("--bags", type=Path, metavar="DIR", help="write the recordings as bags and diagnose nothing")
    return out


def _shard(text: str) -> tuple[int, int]:
    first, slash, count = text.partition("/")
    if not (slash and first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r}: expected I/K with 1 ≤ I ≤ K, such as 1/2")
    return int(first), int(count)


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(_main, argv)


def _main(argv: Sequence[str] | None) -> int:
    arguments = parser().parse_args(argv)
    if not 10.0 <= arguments.duration <= 3600.0:
        raise BadInput(f"--duration {arguments.duration:g}: expected 10 to 3600 s")
    if arguments.jobs < 1:
        raise BadInput(f"--jobs {arguments.jobs}: expected 1 or more")
    every = list(enumerate(cases(arguments.seed, arguments.count)))
    first, shards = arguments.shard
    mine = every[first - 1 :: shards]
    if arguments.bags is not None:
        return _bags(mine, arguments)
    folder = _folder(arguments.out)
    waiting = [(k, case) for k, case in mine if outcomes.load(folder, k, case, arguments.duration) is None]
    with common.progress(len(waiting), "battery", "cases") as bar:
        for number, case in waiting:
            outcome = outcomes.judge(case, _diagnosis(case, arguments.jobs), arguments.duration, arguments.jobs)
            outcomes.save(folder, number, outcome)
            bar.update(1)
    done = [outcomes.load(folder, k, case, arguments.duration) for k, case in every]
    _tell([outcome for outcome in done if outcome is not None], arguments)
    return common.DONE


def _folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{path}: cannot be made: {error.strerror}") from None
    return path


def _bags(mine: Sequence[tuple[int, Case]], arguments: argparse.Namespace) -> int:
    folder = common.check_output(arguments.bags)
    with common.output_folder(folder) as partial:
        for number, case in mine:
            case.write(partial / f"{number:03d}", arguments.duration)
            truth = {
                "name": case.name,
                "kind": case.kind,
                "effects": case.effects,
                "form": case.form,
                "seed": case.seed,
            }
            write_json(partial / f"{number:03d}" / "truth.json", {**truth, "sizes": case.sizes})
    print(f"{folder}: {len(mine)} cases, a free and a locked bag each, and truth.json")
    return common.DONE


def _diagnosis(case: Case, jobs: int) -> outcomes.Diagnose:
    from pam_antagonist.diagnosis import diagnose

    rig = load_rig(RIG)

    def run(recordings: tuple[Recording, Recording]) -> Any:
        # What is only for the report is left out.
        return diagnose(
            recordings,
            rig,
            joint="auto",
            holdout=outcomes.HOLDOUT,
            jobs=jobs,
            seed=case.seed % 2**31,
            progress=None,
            profiles=False,
            estimator=False,
        )

    return run


def _tables(done: Sequence[outcomes.Outcome]) -> tuple[Table, Table]:
    mark = {True: "yes", False: "NO", None: ""}
    figures = Table(
        ("figure", "measured", "cases", "wanted", "holds"),
        tuple(
            (score.what, percent(score.value), str(score.count), score.wanted, mark[score.holds])
            for score in outcomes.scores(done)
        ),
    )
    header, rows = outcomes.confusion(done)
    return figures, Table(header, rows)


def _misses(done: Sequence[outcomes.Outcome]) -> Table:
    """What was not right, or had something beside it that was not there."""

    def words(effects: Sequence[tuple[str, int | None]]) -> str:
        return " + ".join(f"{name} {muscle}" if muscle else name for name, muscle in effects)

    rows = tuple(
        (
            item.name,
            " + ".join(item.form) or "–",
            " + ".join(f"{size:.0f}" for size in item.sizes) or "–",
            words(item.found) if item.verdict == "effect" else item.verdict,
        )
        for item in done
        if not item.right or item.superfluous
    )
    return Table(("case", "form", "size", "said"), rows)


def _tell(done: Sequence[outcomes.Outcome], arguments: argparse.Namespace) -> None:
    if not done:
        print(f"{arguments.out}: no case is finished yet")
        return
    figures, matrix = _tables(done)
    misses = _misses(done)
    print(f"{len(done)} of {arguments.count} cases are finished\n")
    for table in (figures, matrix, misses):
        if table.rows:
            print(terminal.table(table, indent="") + "\n")
    if arguments.docs is not None:
        try:
            arguments.docs.write_text(_markdown(done, arguments), encoding="utf-8")
        except OSError as error:
            raise BadInput(f"{arguments.docs}: cannot be written: {error.strerror}") from None


def _markdown(done: Sequence[outcomes.Outcome], arguments: argparse.Namespace) -> str:
    figures, matrix = _tables(done)
    seconds = sorted(item.seconds for item in done)
    command = f"./run battery --out DIR --count {arguments.count} --seed {arguments.seed}"
    if arguments.duration != DURATION:
        command += f" --duration {arguments.duration:g}"
    lines = [
        "# The battery",
        "",
        "How often the diagnosis is right on simulated joints whose effects are known. Made by",
        "",
        f"    {command} --docs FILE",
        "",
        "Each case is a free and a locked recording. The effects are written in another form than the catalogue's",
        "([`forms.py`](../pam_antagonist/validation/battery/forms.py)), sizes are random, base parameters are",
        "scattered by 1 %, anew in each recording; sensors are noisy and have 12 bits. It is this package's own",
        "simulator: being right here is less than being right on a real joint.",
        "",
        f"{len(done)} of {arguments.count} cases; a diagnosis took {seconds[len(seconds) // 2]:.0f} s (median), "
        f"{seconds[-1]:.0f} s at most, with {_threads(done)} (`--jobs`).",
        "",
        *_rows(figures),
        "",
        "## Confusion matrix",
        "",
        "Rows: what was there. Columns: what was said first. In brackets: what is in no catalogue.",
        "",
        *_rows(matrix),
        "",
        "## What was not right",
        "",
        "Or right, with something beside it that is not there. A size is in noises of the channel that the effect",
        "moves most.",
        "",
        *_rows(_misses(done)),
        "",
        "Software: " + ", ".join(f"{name} {version}" for name, version in versions().items()) + ".",
        "",
    ]
    return "\n".join(lines)


def _threads(done: Sequence[outcomes.Outcome]) -> str:
    least, most = (limit(item.threads for item in done) for limit in (min, max))
    return f"{least} to {most} threads" if least < most else "one thread" if most == 1 else f"{most} threads"


def _rows(table: Table) -> list[str]:
    def row(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.strip().replace("\\", "\\\\") for cell in cells) + " |"

    return [row(table.header), "|" + "---|" * len(table.header), *map(row, table.rows)]


if __name__ == "__main__":
    sys.exit(main())
