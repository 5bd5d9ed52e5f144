"""Break twenty behaviours on purpose, one at a time, in a copy of the checkout, and count how many the tests notice.

The behaviours stand in validation/broken.yaml. Each is tried with the tests beside it, then with those of ./run test,
then with those of ./run test --all. It is noticed by a test that fails with it and passes without it. A behaviour
takes seconds to minutes.

examples:
  {run} broken --out broken.json
  {run} broken --only stamp --only unit
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from pam_antagonist import program
from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.report.document import Table
from validation import frame

ROOT = Path(__file__).resolve().parents[1]
TABLE = Path(__file__).with_suffix(".yaml")
# Tests of ./run and of packages would set up an environment for the copy. That of the table fails with any change.
_LEFT_OUT = tuple(f"--ignore=test/{name}.py" for name in ("test_run", "test_packaging", "validation/test_broken"))
GATE, THOROUGH = "not thorough and not realtime", "thorough and not realtime"
"""Marks of what is tried; pipelines need the cores for themselves, and none of the behaviours is theirs alone."""
_FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


class Behaviour(NamedTuple):
    """A behaviour, and how it is broken: `old` stands once in `file`. `tests`: files or folders to look in first."""

    what: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


def behaviours() -> list[Behaviour]:
    """Those of the table; each is one that the code has."""
    rows = [Behaviour(**{**row, "tests": tuple(row["tests"])}) for row in yaml.safe_load(TABLE.read_text("utf-8"))]
    for row in rows:
        if (count := (ROOT / row.file).read_text("utf-8").count(row.old)) != 1:
            raise BadInput(f"{TABLE.name}: {row.what}: its text is {count} times in {row.file}, expected once")
    return rows


class Copy:
    """A copy of what git knows of the checkout, for the tests of which the present environment is used."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "project"
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout.decode()
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (self.root / name).parent.mkdir(parents=True, exist_ok=True)
                (self.root / name).write_bytes((ROOT / name).read_bytes())
        (folder / "shared").symlink_to(ROOT.parent / "shared")
        given = os.environ.get("PYTHONPATH", "").split(os.pathsep)
        paths = [str(self.root), *(path for path in given if path and Path(path) != ROOT)]
        kept = {name: value for name, value in os.environ.items() if name != program.VARIABLE}  # in messages
        self._environment = {**kept, "PYTHONPATH": os.pathsep.join(paths), "PAM_ANTAGONIST_PRIORITY": "0"}

    def fails(self, marks: str, tests: Sequence[str], workers: bool = True) -> str:
        """The first test that fails, empty where all pass. `workers`: one on each core."""
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", marks, "-p", "no:cacheprovider", *_LEFT_OUT]
        more = ["-n", "auto", "--dist", "loadfile"] if workers else []
        done = subprocess.run(
            [*command, *more, *tests],
            cwd=self.root, env=self._environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode in (0, 5):  # 5: none of the tests has the marks
            return ""
        found = _FAILED.search(done.stdout)
        return found[1] if found else f"pytest ended with {done.returncode}: {(done.stdout + done.stderr)[-300:]}"

    def noticed(self, behaviour: Behaviour) -> dict[str, Any]:
        """Break a behaviour, look for a test that fails, and mend it again; then this test has to pass."""
        file, began = self.root / behaviour.file, time.monotonic()
        whole = file.read_text("utf-8")
        file.write_text(whole.replace(behaviour.old, behaviour.new), "utf-8")
        try:
            tries = (("gate", GATE, behaviour.tests), ("gate", GATE, ()), ("--all", THOROUGH, ()))
            found = ((by, test) for by, marks, tests in tries if (test := self.fails(marks, tests, not tests)))
            by, test = next(found, ("", ""))
        finally:
            file.write_text(whole, "utf-8")
        if test and self.fails(GATE if by == "gate" else THOROUGH, [test.split("[")[0]], False):
            raise BadInput(f"{test} fails with nothing broken as well: expected tests that pass")
        return {"what": behaviour.what, "by": by, "test": test, "seconds": round(time.monotonic() - began, 1)}


def run(chosen: Sequence[Behaviour]) -> Iterator[dict[str, Any]]:
    """What noticed each behaviour."""
    with tempfile.TemporaryDirectory(prefix="broken_") as folder:
        copy = Copy(Path(folder))
        yield from map(copy.noticed, chosen)


def parser() -> common.Parser:
    """The arguments."""
    parser = common.Parser("broken", __doc__)
    parser.option("--out", "write the outcomes to FILE as JSON", Path, metavar="FILE")
    parser.repeated("--only", "only behaviours whose description has these words; may be given several times", "WORDS")
    return parser


def _main(asked: argparse.Namespace) -> int:
    chosen = [row for row in behaviours() if not asked.only or any(word in row.what for word in asked.only)]
    if not chosen:
        raise BadInput(f"--only {' '.join(asked.only)}: no behaviour, expected words of {TABLE.name}")
    outcomes = []
    for outcome in run(chosen):
        outcomes.append(outcome)
        print(f"{outcome['what']}: {outcome['test'] or 'NOT NOTICED'} ({outcome['seconds']:.0f} s)", flush=True)
    by = [outcome["by"] for outcome in outcomes]
    rows = [(one["what"], one["by"] or "–", one["test"] or "not noticed") for one in outcomes]
    frame.show([Table(("broken", "noticed by", "first test that fails"), tuple(rows), prose=True)], asked)
    print(f"noticed: {by.count('gate')} of {len(by)} by ./run test, {by.count('--all')} more by ./run test --all")
    if asked.out:
        common.write_text(asked.out, json.dumps(outcomes, indent=1) + "\n")
    return common.FAILED if "" in by else common.DONE


main = common.command(parser, _main)
