"""Let close_loop diagnose many simulated joints (a battery), and count how often the diagnosis was right.

Each case is a free and a locked recording of a joint with one effect, with two, with none, or with an effect that is
not in the catalogue. The effects are written in another form than the catalogue's. What they add to the most affected
measurement ranges from half to 16 times the sensor's noise (RMS). The base parameters are scattered by a percent. Every
share comes with its 95 % interval. It is this package's own simulator: being right here is less than being right on a
real joint.

The folder --out gets a JSON file for each finished case, and summary.json with all figures. The same command again
continues an interrupted run. Shards of one battery may run at the same time into one folder; the tables are of the
cases that are finished.
Status: 0 whether or not the diagnosis was right, 2 bad input.

examples:
  {run} battery --out result --count 8
  {run} battery --out result --shard 1/2 &   {run} battery --out result --shard 2/2
  {run} battery --out result --count 80 --nothing 100 --docs figures.md
  {run} battery --out result --count 0 --uncatalogued 22
  {run} battery --out result --count 40 --effect friction
  {run} battery --out result --dask tcp://10.0.0.5:8786
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS, SEED, whole
from pam_antagonist.cli.progress import counted
from pam_antagonist.cli.recordings import connected
from pam_antagonist.diagnosis.thresholds import SHORTEST
from pam_antagonist.errors import BadInput
from pam_antagonist.program import versions
from pam_antagonist.report.document import Text
from pam_antagonist.strict_json import write_json
from validation import frame
from validation.battery import outcomes
from validation.battery.outcomes import Outcome
from validation.battery.plants import DURATION, LARGE, LEVELS, RIG, Case, cases

_KINDS = {
    "nothing": "nothing wrong",
    "calibrations": "a wrong zero or clock as their only fault",
    "uncatalogued": "an effect from the literature that no law can imitate",
}


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("battery", __doc__)
    out.option("--out", "folder of the outcomes; may exist", Path, metavar="DIR", required=True)
    out.option("--count", "how many cases (default: 80)", whole(0, 100_000), 80, "N")
    for name, what in _KINDS.items():
        out.option(f"--{name}", f"further cases with {what} (default: 0)", whole(0, 100_000), 0, "N")
    text = f"all cases are of this effect, in its forms in turn, {LARGE:g} noises or more (default: all kinds)"
    out.option("--effect", text, metavar="NAME")
    out.option("--seed", "seed of the battery (default: 1)", SEED, 1, "S")
    out.option("--shard", "run only every K-th case, from the I-th on (default: 1/1)", shard, (1, 1), "I/K")
    out.option("--duration", f"length of a recording [s] (default: {DURATION:g})", float, DURATION, "S")
    out.option("--jobs", "threads (default: all cores)", JOBS, os.cpu_count() or 1, "N")
    out.shared(
        "--dask", help="judge whole cases, one a worker's thread, on the workers of this Dask scheduler, such as "
        "tcp://10.0.0.5:8786 (needs pam_antagonist[dask])"
    )  # fmt: skip
    frame.add_docs(out)
    frame.add_new_json(out, "summary.json")
    return out


def shard(text: str) -> tuple[int, int]:
    """``I/K`` as two numbers: every K-th case, from the I-th on."""
    first, slash, count = text.partition("/")
    if not (slash and first.isdigit() and count.isdigit() and 1 <= int(first) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r}: expected I/K with 1 ≤ I ≤ K, such as 1/2")
    return int(first), int(count)


def _main(arguments: argparse.Namespace) -> int:
    if not SHORTEST < arguments.duration <= 3600.0:
        # What is shorter counts as a trial, in which effects are looked for in another way.
        raise BadInput(f"--duration {arguments.duration:g}: expected more than {SHORTEST:g} s, up to 3600")
    asked = {name: getattr(arguments, name) for name in ("seed", "count", *_KINDS, "effect")}
    every = cases(**asked)
    first, shards = arguments.shard
    mine = every[first - 1 :: shards]
    folder = frame.made(arguments.out)
    waiting = [(k, case) for k, case in mine if outcomes.load(folder, k, case, arguments.duration) is None]
    with common.json_alone(arguments.json), counted(len(waiting), "battery") as advance:
        for number, outcome in _judged(waiting, arguments):
            frame.kept(outcomes.path_of(folder, number), partial(asdict, outcome))
            advance(1)
    loaded = (outcomes.load(folder, k, case, arguments.duration) for k, case in every)
    done = [outcome for outcome in loaded if outcome is not None]
    _report(done, len(every), {**asked, "duration": arguments.duration}, arguments)
    return common.DONE


def _judged(waiting: Sequence[tuple[int, Case]], arguments: argparse.Namespace) -> Iterator[tuple[int, Outcome]]:
    """The outcome of each case, as soon as it is there."""
    if arguments.dask is None:
        yield from (_numbered(number, case, arguments.duration, arguments.jobs) for number, case in waiting)
        return
    with connected(arguments.dask):
        work = (delayed(_numbered)(number, case, arguments.duration, 1) for number, case in waiting)
        yield from Parallel(return_as="generator_unordered")(work)


def _numbered(number: int, case: Case, duration: float, jobs: int) -> tuple[int, Outcome]:
    return number, outcomes.judge(case, diagnosis(case, jobs), duration, jobs)


def diagnosis(case: Case, jobs: int) -> outcomes.Diagnose:
    """What ``close_loop`` makes of a case, without what is only for the report."""
    from pam_antagonist import diagnose

    options: dict[str, Any] = {"holdout": outcomes.HOLDOUT, "profiles": False, "estimator": False}
    return lambda recordings: diagnose(recordings, RIG, jobs=jobs, seed=case.seed % 2**31, **options)


def _report(done: Sequence[Outcome], count: int, asked: dict[str, Any], arguments: argparse.Namespace) -> None:
    from validation.battery import scores

    if not done:
        if arguments.json is not None:
            raise BadInput(f"{arguments.out}: no case is finished yet, so there is no summary for --json")
        print(f"{arguments.out}: no case is finished yet")
        return
    codes, seconds = sorted({one.code for one in done}), sorted(one.seconds for one in done)
    summary = {
        **asked, "finished": len(done), "code": codes, "levels": list(LEVELS), "software": versions(),
        "scores": scores.scores(done).reset_index().to_dict("records"),
        "detection": scores.detections(done).reset_index().to_dict("records"),
    }  # fmt: skip
    write_json(arguments.out / "summary.json", summary)
    about = (f"{len(done)} of {count} cases are finished; a diagnosis took {seconds[len(seconds) // 2]:.0f} s "
             f"(median), {seconds[-1]:.0f} s at most; commit {', '.join(codes)}.")  # fmt: skip
    tables = (scores.figures_table(done), scores.detection_table(done), scores.misses_table(done))
    frame.show([Text(about), *tables], arguments, summary)


main = common.command(parser, _main)
