"""``close_loop``, ``identify`` and ``battery`` of this code against an earlier checkout's, by processor time.

What ``close_loop`` does besides what commit 8e1972c did is measured apart (:mod:`added`).
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.recording.metadata import NAME
from pam_antagonist.validation.benchmark import added
from pam_antagonist.validation.benchmark.figure import Figure, at_most
from pam_antagonist.validation.benchmark.spent import spent, spent_on

_BOUND = 0.4
IDENTIFIED = "nominal"
"""Name of the case that is identified as well."""
_JOINTS, _SEED = 8, 5
"""Cases of the battery, and its seed."""


def measure(rig: str, before: Path, cases: Path) -> list[Figure]:
    """Run both in turn, case by case, after one run each that compiles.

    Args:
        rig: name or path.
        before: folder of the earlier checkout.
        cases: folder with a folder for each case, which holds its bags.

    Raises:
        BadInput: there is no such checkout, no case, or a command failed.
    """
    if not (before / "pam_antagonist" / "__main__.py").is_file():
        raise BadInput(f"{before}: no checkout of this package; expected the folder of `git worktree add DIR COMMIT`")
    folders = {case.name: bags for case in sorted(cases.glob("*/")) if (bags := _bags(case))}
    if not folders:
        raise BadInput(
            f"{cases}: expected a folder for each case with its bags in it, such as CASE/free and CASE/locked"
        )
    runs = [("close_loop", name) for name in folders]
    runs += [("identify", name) for name in folders if name == IDENTIFIED]
    figures = []
    total = {"before": 0.0, "now": 0.0, "added": 0.0}
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as scratch:
        for checkout in (before, None):
            spent_on("close_loop", folders[runs[0][1]], rig, Path(scratch) / f"first_{checkout is None}", checkout)
        for command, name in runs:
            outs = {side: Path(scratch) / f"{command}_{name}_{side}" for side in ("before", "now")}
            old = spent_on(command, folders[name], rig, outs["before"], before)
            new = spent_on(command, folders[name], rig, outs["now"])
            parts = {"before_cpu_s": old.cpu_s, "now_cpu_s": new.cpu_s}
            parts |= {"before_wall_s": old.wall_s, "now_wall_s": new.wall_s}
            meaning = f"processor time of {command} of {name} against that of {before.name}"
            if command == "close_loop":
                total["before"] += old.cpu_s
                total["now"] += new.cpu_s
                verdicts = [_verdict(out) for out in outs.values()]
                meaning += f"; verdict {verdicts[1]}" + ("" if verdicts[0] == verdicts[1] else f", was {verdicts[0]}")
                since = added.parts(folders[name], rig)
                total["added"] += sum(since.values())
                parts |= {f"{part}_cpu_s": cpu_s for part, cpu_s in since.items()}
                figures.append(Figure(f"{command}_{name}", meaning, new.cpu_s / old.cpu_s, "", None, "×", parts))
            else:
                figures.append(at_most(f"{command}_{name}", meaning, new.cpu_s / old.cpu_s, _BOUND, "×", parts))
    parts = {f"{side}_cpu_s": value for side, value in total.items()}
    meaning = f"processor time of close_loop of all {len(folders)} cases against that of {before.name}"
    figures.append(Figure("close_loop_all", meaning, total["now"] / total["before"], "", None, "×", parts))
    meaning += ", without the work that the earlier version did not do"
    same = (total["now"] - total["added"]) / total["before"]
    figures.append(at_most("close_loop_same_work", meaning, same, _BOUND, "×", parts))
    return [*figures, _battery(before)]


def _battery(before: Path) -> Figure:
    """The time of a case of the battery; earlier versions draw other cases from the same seed."""
    with tempfile.TemporaryDirectory(prefix="pam_benchmark_") as scratch:
        old, new = (
            spent(
                "battery", "--out", str(Path(scratch) / str(checkout is None)), "--count", str(_JOINTS), "--seed",
                str(_SEED), checkout=checkout,
            )
            for checkout in (before, None)
        )  # fmt: skip
    parts = {"before_cpu_s": old.cpu_s / _JOINTS, "now_cpu_s": new.cpu_s / _JOINTS}
    meaning = f"processor time of battery for each of {_JOINTS} cases against that of {before.name} for as many"
    return at_most("battery", meaning, new.cpu_s / old.cpu_s, _BOUND, "×", parts)


def _bags(case: Path) -> list[str]:
    return [str(bag.resolve()) for bag in sorted(case.iterdir()) if (bag / NAME).is_file()]


def _verdict(out: Path) -> str:
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    return " ".join([report["verdict"], *sorted({effect["name"] for effect in report["effects"]})])
