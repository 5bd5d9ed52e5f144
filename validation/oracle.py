"""Run close_loop on cases whose answer was frozen, and say what got worse.

The kinds of cases: the recordings at hand (rig A, the strangers, the measured joints; DATA is their folder), 60 joints
of the battery, 10 with effects that no law of the catalogue can imitate (laws), 12 rigs of data sheets (guessed), six
known joints with regulators and six with short trials (trials), 10 sealed joints.
Each finished case is appended to FILE; the same command again continues. With --against, each case is compared with the
same case of an earlier file: verdict, effects, sizes, calibrations, held-out errors, processor time.
Status: 0 nothing is worse, 1 something is, 2 bad input.

examples:
  {run} oracle now.jsonl --data ../shared/data --against test/diagnosis/oracle.jsonl --jobs 2
  {run} oracle now.jsonl --only battery --against test/diagnosis/oracle.jsonl
  {run} oracle now.jsonl --only none --against test/diagnosis/oracle.jsonl --compare-only
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed

from pam_antagonist import diagnose
from pam_antagonist.cli import common
from pam_antagonist.cli.common import JOBS
from pam_antagonist.cli.progress import counted
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects import CATALOGUE
from validation import frame, frozen

_KINDS = ", ".join(frozen.KINDS)
SIGMAS = 3.0
"""Sizes that differ by more than so many standard deviations of both are said to differ."""
ERROR_RATIO, ERROR_FLOOR = 1.1, {"deg": 0.002, "nm": 0.0005, "pa": 20.0}
"""A held-out error is worse from this ratio on, and by more than a tenth or so of what the sensors of rig A add."""

TIME_RATIO = 1.5
LEARNED = "learned"
"""Name of an effect whose law was measured: no claim that the truth could contradict."""

Entry = dict[str, Any]


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("oracle", __doc__)
    out.add_argument("file", type=Path, metavar="FILE", help="JSON lines, one a case; may exist")
    out.option("--data", "folder of the recordings at hand (default: none)", Path, metavar="DATA")
    out.option("--only", f"only cases of this kind, or whose name contains this; kinds: {_KINDS}", str, "", "KIND")
    out.option("--against", "compare with this file", Path, metavar="OLD")
    out.flag("--compare-only", "run nothing, compare what is finished")
    out.option("--jobs", "cases at the same time (default: 1)", JOBS, 1, "N")
    return out


def _run(arguments: argparse.Namespace) -> int:
    old = {} if arguments.against is None else read(arguments.against)
    done = read(arguments.file) if arguments.file.exists() else {}
    joints = {} if arguments.compare_only else frozen.joints(arguments.data, old)
    only = arguments.only
    chosen = [name for name in {**joints, **old} if only in name or only == frozen.kind_of(name)]
    if not chosen:
        raise BadInput(f"--only {only}: no such case; expected a part of a name, or a kind: {_KINDS}")
    waiting = [name for name in chosen if name in joints and name not in done]
    work = (delayed(answer)(name, joints[name]) for name in waiting)
    answers = Parallel(arguments.jobs, return_as="generator_unordered")(work)
    with counted(len(waiting), "oracle") as advance:
        for entry in answers:
            done[entry["case"]] = entry
            frame.add_line(arguments.file, entry)
            advance(1)
    if arguments.against is None:
        return common.DONE
    both = [name for name in chosen if name in old and name in done]
    said = [line for name in both for line in compared(old[name], done[name])]
    worse = [line for line in said if line.startswith("worse")]
    print("\n".join([*said, f"{len(both)} of {len(old)} cases compared: {len(worse)} things are worse"]))
    return 1 if worse else common.DONE


def read(path: Path) -> dict[str, Entry]:
    """The cases of a file, by name."""
    try:
        return {entry["case"]: entry for entry in map(json.loads, path.read_text(encoding="utf-8").splitlines())}
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{path}: no file of an oracle ({error}); expected what oracle writes") from None


def answer(name: str, made: frozen.Made) -> Entry:
    """A case's entry, from the ``report.json`` that ``close_loop`` would write."""
    with made() as joint:
        truth, wall, cpu = joint.truth, time.perf_counter(), time.process_time()
        try:
            found = diagnose(joint.recordings, joint.rig, jobs=1, profiles=False, estimator=False, **joint.options)
            seconds, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
            with tempfile.TemporaryDirectory() as folder:
                found.save(Path(folder) / "found", figures=False)
                report = json.loads((Path(folder) / "found" / "report.json").read_text(encoding="utf-8"))
        except Exception as error:  # a defect in one case is an answer too, and the others go on
            seconds, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
            report = {"verdict": "refused" if isinstance(error, BadInput) else "defect", "sentence": repr(error)}
    kept = {key: report.get(key) for key in ("verdict", "sentence", "ambiguous_with", "next_rig")}
    entry = {
        "case": name, "truth": truth, **kept, "effects": [_effect(effect) for effect in report.get("effects") or []],
        "calibration": [
            {key: item.get(key) for key in ("name", "value", "std", "unit")} for item in report.get("calibration") or []
        ],
        "errors": _of_rows(report.get("errors_deg")) or report.get("errors"), "values": report.get("values"),
        "seconds": seconds, "cpu_s": cpu_s, "commit": frame.commit(),
    }  # fmt: skip
    return dict(json.loads(json.dumps(entry, default=list), parse_float=lambda text: float(f"{float(text):.5g}")))


_KEPT = tuple("name muscle signal parameters delta_bic holdout_gain onset_s place arguments like".split())
"""Of an effect, what is compared or read."""


def _effect(effect: Entry) -> Entry:
    return {key: effect[key] for key in _KEPT if key in effect}


def _of_rows(rows: Sequence[Mapping[str, Any]] | None) -> Entry | None:
    """Errors of episodes: as configured first, extended last."""
    if not rows:
        return None
    return {row["model"]: {f"{key} rmse_deg": row[key][0] for key in ("later", "interleaved")} for row in rows}


def compared(old: Entry, new: Entry) -> list[str]:
    """What differs in a case, a line each, that begins with ``worse``, ``better`` or ``other``."""
    true = None if old["truth"] is None else {name for name, _ in old["truth"]["effects"]}
    said = [(_judged(_right(old, true), _right(new, true)), f"verdict {old['verdict']} -> {new['verdict']}")]
    said = said if old["verdict"] != new["verdict"] else []
    before, after = ({(item["name"], item["muscle"]): item for item in entry["effects"]} for entry in (old, new))
    for key in before.keys() ^ after.keys():
        found, there = key in after, key[0] == LEARNED or (true is not None and key[0] in true)
        word = "other" if key[0] == LEARNED else "better" if true is not None and found is there else "worse"
        said.append((word, f"effect {_words(key)} is {'new' if found else 'gone'}"))
    for key in before.keys() & after.keys():
        said += _sizes(_words(key), before[key]["parameters"], after[key]["parameters"])
    one, other = ({item["name"]: item for item in entry["calibration"]} for entry in (old, new))
    # The battery's joints need none.
    lost = "better" if old["case"].startswith(("battery/", "laws/")) else "worse"
    said += [("worse" if name in other else lost, f"calibration {name} is {'new' if name in other else 'gone'}")
             for name in one.keys() ^ other.keys()]  # fmt: skip
    said += _sizes("calibration", {k: one[k] for k in one if k in other}, other)
    then, now = _leaves(_last(old["errors"])), _leaves(_last(new["errors"]))
    for path in then.keys() & now.keys():
        floor = next((value for unit, value in ERROR_FLOOR.items() if unit in path), 0.0)
        word = _grown(then[path], now[path], ERROR_RATIO, floor)
        said += [(word, f"held-out {path} {then[path]:.3g} -> {now[path]:.3g}")] if word else []
    if _grown(old["cpu_s"], new["cpu_s"], TIME_RATIO, 10.0) == "worse":
        said.append(("worse", f"processor time {old['cpu_s']:.0f} -> {new['cpu_s']:.0f} s"))
    return [f"{word}: {old['case']}: {text}" for word, text in sorted(said)]


def _right(entry: Entry, true: set[str] | None) -> bool | None:
    """Whether the verdict is what the truth asks for; None where nobody knows it."""
    if true is None:
        return None
    named = {item["name"] for item in entry["effects"]}
    if true <= set(CATALOGUE):
        return entry["verdict"] == ("effect" if true else "none") and named == true
    return entry["verdict"] == "unexplained" or named == {LEARNED}


def _judged(before: bool | None, after: bool | None) -> str:
    return "worse" if before is None or (before and not after) else "better" if after and not before else "other"


def _words(key: tuple[str, int | None]) -> str:
    return key[0] if key[1] is None else f"{key[0]} {key[1]}"


def _sizes(what: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Sizes that differ by more than their standard deviations allow."""
    out = []
    for name in old.keys() & new.keys():
        (a, sa), (b, sb) = ((item["value"], item["std"] or 0.0) for item in (old[name], new[name]))
        if abs(a - b) > SIGMAS * (sa**2 + sb**2) ** 0.5 + 1e-4 * abs(a):
            out.append(("worse", f"{what} {name} {a:.4g} +- {sa:.2g} -> {b:.4g} +- {sb:.2g}"))
    return out


def _last(errors: Entry | None) -> Any:
    """Errors of the extended model."""
    if not errors:
        return None
    return errors["extended"] if "extended" in errors else list(errors.values())[-1]


def _leaves(value: Any, path: str = "") -> dict[str, float]:
    """RMS errors by their path."""
    if isinstance(value, Mapping):
        return {k: v for key, item in value.items() for k, v in _leaves(item, f"{path} {key}".strip()).items()}
    if isinstance(value, list):
        return {k: v for i, item in enumerate(value) for k, v in _leaves(item, f"{path} {i + 1}").items()}
    return {path: value} if isinstance(value, float) and "rmse" in path else {}


def _grown(old: float, new: float, ratio: float, floor: float) -> str:
    return "worse" if new > ratio * old + floor else "better" if old > ratio * new + floor else ""


main = common.command(parser, _run)
