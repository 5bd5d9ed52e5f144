"""``battery``: how often the diagnosis is right, on joints whose effects are known."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from pam_antagonist.cli import cluster, common
from pam_antagonist.cli.numbers import JOBS, SEED, whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.report import terminal
from pam_antagonist.rig import load_rig
from pam_antagonist.strict_json import write_json
from validation.battery import outcomes, page, remainders
from validation.battery.draw import LARGE, cases
from validation.battery.outcomes import Outcome
from validation.battery.plants import DURATION, RIG, Case

_DESCRIPTION = """\
Let close_loop diagnose many simulated joints (a battery), and count how often the diagnosis was right.

Each case is a free and a locked recording of a joint with one effect, with two, with none, or with an effect that is
not in the catalogue. The effects are written in another form than the catalogue's. What they add to the most affected
measurement ranges from half to 16 times the sensor's noise (RMS). The base parameters are scattered by a percent. Every
share comes with its 95 % interval. It is this package's own simulator: being right here is less than being right on a
real joint.

The folder --out gets a JSON file for each finished case, and summary.json with all figures. The same command again
continues an interrupted run. Shards of one battery may run at the same time into one folder; the tables are of the
cases that are finished. --remainders fits the catalogue's law to each form without noise, and writes the remaining
error to remainders.json.
Status: 0 whether or not the diagnosis was right, 2 bad input.
"""
_EXAMPLES = """\
examples:
  {run} battery --out result --count 8
  {run} battery --out result --shard 1/2 &   {run} battery --out result --shard 2/2
  {run} battery --out result --count 80 --nothing 100 --docs docs/battery.md
  {run} battery --out result --count 0 --nothing 100
  {run} battery --out result --count 0 --uncatalogued 22
  {run} battery --out result --count 40 --effect friction
  {run} battery --out result --dask tcp://10.0.0.5:8786
  {run} battery --out result --remainders
"""


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("battery", _DESCRIPTION, _EXAMPLES)
    out.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder of the outcomes; may exist")
    out.add_argument("--count", type=whole(0, 100_000), default=80, metavar="N", help="how many cases (default: 80)")
    out.add_argument(
        "--nothing",
        type=whole(0, 100_000),
        default=0,
        metavar="N",
        help="further cases with nothing wrong (default: 0)",
    )
    out.add_argument(
        "--calibrations",
        type=whole(0, 100_000),
        default=0,
        metavar="N",
        help="further cases whose only fault is a wrong zero or clock (default: 0)",
    )
    out.add_argument(
        "--uncatalogued",
        type=whole(0, 100_000),
        default=0,
        metavar="N",
        help="further cases with an effect from the literature that no law can imitate (default: 0)",
    )
    out.add_argument(
        "--effect",
        metavar="NAME",
        help=f"all cases are of this effect, in its forms in turn, {LARGE:g} noises or more (default: all kinds)",
    )
    out.add_argument("--seed", type=SEED, default=1, metavar="S", help="seed of the battery (default: 1)")
    out.add_argument(
        "--shard",
        type=_shard,
        default=(1, 1),
        metavar="I/K",
        help="run only every K-th case, from the I-th on (default: 1/1)",
    )
    out.add_argument(
        "--duration",
        type=float,
        default=DURATION,
        metavar="S",
        help=f"length of a recording [s] (default: {DURATION:g})",
    )
    out.add_argument("--jobs", type=JOBS, default=os.cpu_count() or 1, metavar="N", help="threads (default: all cores)")
    cases = (
        "judge whole cases, one a worker's thread, on the workers of this Dask scheduler, such as tcp://10.0.0.5:8786"
    )
    out.shared("--dask", help=f"{cases} (needs pam_antagonist[dask])")
    out.add_argument("--docs", type=Path, metavar="FILE", help="write the tables as Markdown; FILE is replaced")
    out.add_argument(
        "--remainders", action="store_true", help="compute how much of each form the catalogue's law cannot imitate"
    )
    common.add_new_json(out, "summary.json")
    out.add_argument("--bags", type=Path, metavar="DIR", help="write the recordings as bags and diagnose nothing")
    return out


def _shard(text: str) -> tuple[int, int]:
    first, slash, count = text.partition("/")
    if not (slash and first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r}: expected I/K with 1 ≤ I ≤ K, such as 1/2")
    return int(first), int(count)


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    if not 10.0 <= arguments.duration <= 3600.0:
        raise BadInput(f"--duration {arguments.duration:g}: expected 10 to 3600 s")
    if arguments.json is not None and (arguments.remainders or arguments.bags is not None):
        raise BadInput("--json: expected without --remainders and --bags, which make no summary.json")
    if arguments.remainders:
        return _remainders(_folder(arguments.out))
    every = cases(
        arguments.seed, arguments.count, arguments.nothing, arguments.calibrations, arguments.effect,
        arguments.uncatalogued,
    )  # fmt: skip
    first, shards = arguments.shard
    mine = every[first - 1 :: shards]
    if arguments.bags is not None:
        return _bags(mine, arguments)
    folder = _folder(arguments.out)
    waiting = [(k, case) for k, case in mine if outcomes.load(folder, k, case, arguments.duration) is None]
    with common.json_alone(arguments.json), counted(len(waiting), "battery") as advance:
        for number, outcome in _judged(waiting, arguments):
            outcomes.save(folder, number, outcome)
            advance(1)
    done = [outcomes.load(folder, k, case, arguments.duration) for k, case in every]
    known = {**remainders.known(), **remainders.load(folder / remainders.FILE)}
    finished = [outcome for outcome in done if outcome is not None]
    asked = (
        arguments.seed,
        arguments.count,
        arguments.nothing,
        arguments.calibrations,
        arguments.uncatalogued,
        arguments.duration,
        arguments.effect,
    )
    _report(page.Run(*asked, done=finished, remainders=known), arguments)
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
                "sizes": case.sizes,
            }
            write_json(partial / f"{number:03d}" / "truth.json", {**truth, "reached": case.reached})
    print(f"{folder}: {len(mine)} cases, a free and a locked bag each, and truth.json")
    return common.DONE


def _judged(waiting: Sequence[tuple[int, Case]], arguments: argparse.Namespace) -> Iterator[tuple[int, Outcome]]:
    """The outcome of each case, as soon as it is there."""
    if arguments.dask is None:
        for number, case in waiting:
            yield number, _judge(case, arguments.duration, arguments.jobs)
        return
    with cluster.connected(arguments.dask):
        work = (delayed(_numbered)(number, case, arguments.duration) for number, case in waiting)
        yield from Parallel(return_as="generator_unordered")(work)


def _numbered(number: int, case: Case, duration: float) -> tuple[int, Outcome]:
    return number, _judge(case, duration, 1)


def _judge(case: Case, duration: float, jobs: int) -> Outcome:
    return outcomes.judge(case, _diagnosis(case, jobs), duration, jobs)


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


def _report(run: page.Run, arguments: argparse.Namespace) -> None:
    if not run.done:
        if arguments.json is not None:
            raise BadInput(f"{arguments.out}: no case is finished yet, so there is no summary for --json")
        print(f"{arguments.out}: no case is finished yet")
        return
    shown = [terminal.table(table, indent="") for table in page.tables(run) if table.rows]
    summary = page.as_json(run)
    write_json(arguments.out / "summary.json", summary)
    text = "\n\n".join([f"{len(run.done)} of {run.asked} cases are finished", *shown])
    common.show(f"{text}\n", summary, arguments.json)
    if arguments.docs is not None:
        try:
            page.write_page(run, arguments.docs)
        except OSError as error:
            raise BadInput(f"{arguments.docs}: cannot be written: {error.strerror}") from None


def _remainders(folder: Path) -> int:
    """Work out what is not in the folder's file yet."""
    path = folder / remainders.FILE
    found = remainders.load(path)
    waiting = [form for form in remainders.with_law() if form.name not in found]
    with counted(len(waiting), "battery") as advance:
        for form in waiting:
            found[form.name] = remainders.remainder(form)
            remainders.save(path, found)
            advance(1)
    print(terminal.table(page.remainders_table(found), indent=""))
    return common.DONE
