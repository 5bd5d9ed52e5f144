"""The gate, ./run test: compiles, tests in the order that keeps the cores busy, and says how long what took.

    ./run test          what has to pass before a change lands
    ./run test --all    also what is marked thorough

What the tests leave in the temporary folder, the home folder or the checkout, or leave running, makes the gate fail.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from durations import FOLDER_VARIABLE, PART_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
STATE = Path(sys.prefix)
"""The environment: what may stay between two runs is kept there."""
SLOWEST = 100
COMPILED = "filter", "filter with effects", "model", "lanes"
"""What most tests need is compiled once, before them: else each worker compiles all of it."""
IGNORED = "__pycache__", ".venv", ".egg-info"
"""Parts of paths in a checkout that are none of a test's doing."""
# Every process of a test ends when its parent does: whatever outlives the run by this time stays.
_ENDS_WITHIN_S = 3.0
_BEHIND = 10
"""Niceness of tests that run beside those that need the cores."""


def environment(folder: Path, part: str) -> dict[str, str]:
    """Variables that keep what tests write in a folder of this run."""
    home, temporary = folder / "home", folder / "tmp"
    for one in (home, temporary):
        one.mkdir(exist_ok=True)
    return {
        **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
        FOLDER_VARIABLE: str(folder),
        PART_VARIABLE: part,
        "HOME": str(home),
        "TMPDIR": str(temporary),
        "HYPOTHESIS_STORAGE_DIRECTORY": str(folder / "hypothesis"),
        "MYPY_CACHE_DIR": str(STATE / "mypy"),
        "ROS_LOG_DIR": str(folder / "log"),
        "RUFF_NO_CACHE": "true",
        "DASK_TEMPORARY_DIRECTORY": str(folder / "dask"),
        # pip asks rustc for its version, which may lay out a folder of its own in the home.
        "RUSTUP_HOME": os.environ.get("RUSTUP_HOME", str(Path.home() / ".rustup")),
        # Nodes of tests run beside other work: in the real-time scheduler they would starve it.
        "PAM_ANTAGONIST_PRIORITY": "0",
    }


class Gate:
    """Runs pytest part by part. `thorough`: with the tests that are marked thorough."""

    def __init__(self, folder: Path, thorough: bool) -> None:
        self._folder, self._thorough = folder, thorough
        self._running: list[subprocess.Popen[bytes]] = []
        self.seconds: dict[str, float] = {}
        self.failed: list[str] = []

    def pytest(
        self, part: str, marks: str, *arguments: object, output: Any = None, nice: int = 0
    ) -> subprocess.Popen[bytes]:
        """Start pytest for the tests with some marks."""
        marks = marks if self._thorough else f"({marks}) and not thorough"
        cache = f"cache_dir={self._folder / 'cache' / part.split(maxsplit=1)[0]}"
        return self._start(part, ["pytest", "-m", marks, "-o", cache, *map(str, arguments)], output, nice)

    def _start(self, part: str, module: Sequence[str], output: Any = None, nice: int = 0) -> subprocess.Popen[bytes]:
        popen = subprocess.Popen(
            ["nice", "-n", str(nice), sys.executable, "-m", *module],
            cwd=ROOT, env=environment(self._folder, part), stdin=subprocess.DEVNULL,
            stdout=output, stderr=output and subprocess.STDOUT, start_new_session=True,
        )  # fmt: skip
        self._running.append(popen)
        return popen

    def compile(self) -> None:
        """Compile side by side; what fails here is told by the tests that need it."""
        waiting, running = list(COMPILED), list[subprocess.Popen[bytes]]()
        while waiting or running:
            while waiting and len(running) < (os.cpu_count() or 1):
                running.append(self._start("compile", ["pam_antagonist.cli.first_start", waiting.pop(0)]))
            time.sleep(0.05)
            running = [popen for popen in running if popen.poll() is None]

    def units(self) -> subprocess.Popen[bytes]:
        """Tests without nodes, by a worker on each core; test/conftest.py puts what takes longest first."""
        return self.pytest(
            "units", "not (ros or realtime)", "-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"
        )

    def nodes(self, output: Any, nice: int) -> subprocess.Popen[bytes]:
        """Nodes that start and end more than they compute: beside the pipelines, which come first."""
        return self.pytest("nodes", "ros and not realtime", *_files_with("ros"), output=output, nice=nice)

    def pipelines(self, beside: subprocess.Popen[bytes]) -> int:
        """What keeps up with the clock comes first on the cores; what failed is tried once more, alone, and said."""
        files = _files_with("realtime")
        if status := self.pytest("pipelines", "realtime", *files).wait():
            print("\nREPEATED, once, since they need the real clock:", flush=True)
            beside.wait()
            if not self._machine_keeps_up():
                return 0
            again = ("--last-failed", "--last-failed-no-failures", "none")
            status = self.pytest("pipelines again", "realtime", *again, *files).wait()
        return status

    def _machine_keeps_up(self) -> bool:
        bare = subprocess.run(
            [sys.executable, "test/nodes/machine.py"], cwd=ROOT, env=environment(self._folder, "machine"), check=False
        )
        if bare.returncode:
            print("Tests of pipelines are LEFT OUT: this machine is too slow for 1 kHz.", flush=True)
        return bare.returncode == 0

    @contextlib.contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Keep the time of a part."""
        began = time.monotonic()
        yield
        self.seconds[part] = time.monotonic() - began

    def run(self) -> None:
        """All parts, of which those that fail are kept."""
        with self.timed("compile"):
            self.compile()
        with self.timed("units"):
            self.ended("units", self.units().wait())
        with self.timed("pipelines and nodes"), (self._folder / "nodes.log").open("w+b") as log:
            idle = self._machine_keeps_up()
            nodes = self.nodes(log, _BEHIND if idle else 0)
            if idle:
                self.ended("pipelines", self.pipelines(nodes))
            self.ended("nodes", nodes.wait())
            log.seek(0)
            print(log.read().decode(errors="replace"), flush=True)

    def ended(self, part: str, status: int) -> None:
        """Keep the name of a part that failed. Status 5: no test is left, which happens with a part of the files."""
        if status not in (0, 5):
            self.failed.append(part)

    def stop(self) -> None:
        """End what still runs, with all that it started."""
        for popen in self._running:
            if popen.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(popen.pid, signal.SIGINT)
        for popen in self._running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                popen.wait(20.0)


def _files_with(mark: str) -> list[str]:
    """Files that use a mark: all others are not even imported."""
    return [
        str(path.relative_to(ROOT))
        for path in sorted((ROOT / "test").rglob("test_*.py"))
        if f"mark.{mark}" in path.read_text(encoding="utf-8")
    ]


# ----------------------------------------------------------------------------------------------- what is left behind


def checkout() -> set[str]:
    """Files of the checkout that git does not know, beside those of ./run; empty without git."""
    told = subprocess.run(
        ["git", "status", "--porcelain", "--ignored", "--untracked-files=all"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return {line for line in told.stdout.splitlines() if not any(part in line for part in IGNORED)}


def left_behind(folder: Path, before: set[str]) -> list[str]:
    """What the tests left: files in the temporary and the home folder and in the checkout, and processes."""
    found = [str(path) for path in (folder / "tmp").glob("*") if not path.name.startswith("pytest-of-")]
    found += [str(path) for path in (folder / "home").glob("*")]
    found += [f"checkout: {line}" for line in sorted(checkout() - before)]
    end = time.monotonic() + _ENDS_WITHIN_S
    while (running := _still_running(folder)) and time.monotonic() < end:
        time.sleep(0.1)
    return found + [f"process: {line}" for line in running]


def _still_running(folder: Path) -> list[str]:
    """Command lines of processes that were started for this run: their temporary folder is its own."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"TMPDIR={folder / 'tmp'}".encode() in (process / "environ").read_bytes().split(b"\0"):
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip())
    return [line for line in found if line]


# -------------------------------------------------------------------------------------------------------- durations


def table(folder: Path, seconds: dict[str, float]) -> str:
    """Durations of the parts and of the slowest tests, as text."""
    tests: list[dict[str, Any]] = []
    rows = list(seconds.items())
    for file in sorted(folder.glob("*.json")):
        found = json.loads(file.read_text(encoding="utf-8"))
        rows += [(f"{file.stem}: start and collection", found["collection_s"]), (f"{file.stem}: all", found["all_s"])]
        tests += found["tests"]
    for name, test in (("linters", "test_style.py::test_ruff"), ("types", "test_style.py::test_mypy")):
        rows += [(name, one["seconds"]) for one in tests if one["test"].endswith(test) and one["part"] == "call"]
    lines = ["seconds  part", *(f"{took:7.1f}  {name}" for name, took in rows), ""]
    lines += [f"The {SLOWEST} slowest of {sum(one['part'] == 'call' for one in tests)} tests and set-ups", ""]
    lines.append("seconds  of processor time  test")
    for one in sorted(tests, key=lambda one: -one["seconds"])[:SLOWEST]:
        used = "" if one["processor_s"] is None else f"{one['processor_s']:.1f}"
        what = "" if one["part"] == "call" else f" ({one['part']})"
        lines.append(f"{one['seconds']:7.1f}  {used:>17}  {one['test']}{what}")
    return "\n".join(lines) + "\n"


def _set_up() -> dict[str, float]:
    """Time of the last set-up by ./run."""
    with contextlib.suppress(OSError, ValueError):
        return {"set-up, when it was last done": float((STATE / "setup-seconds").read_text())}
    return {}


def main(arguments: Sequence[str]) -> int:
    """The gate; 0 if all passed."""
    parser = argparse.ArgumentParser(prog="./run test", description=__doc__, add_help=False)
    parser.add_argument("--all", action="store_true")
    asked = parser.parse_args(arguments)
    began, before = time.monotonic(), checkout()
    folder = Path(tempfile.mkdtemp(prefix="pam_test_"))
    gate = Gate(folder, asked.all)
    try:
        gate.run()
        if left := left_behind(folder, before):
            gate.failed.append("left behind")
            print("The tests left something behind:", *left, sep="\n  ", flush=True)
        gate.seconds = {**_set_up(), **gate.seconds, "all, without set-up": time.monotonic() - began}
        file = STATE / "test_durations.txt"
        file.write_text(table(folder, gate.seconds), encoding="utf-8")
        print("\n".join(f"{took:7.1f} s  {part}" for part, took in gate.seconds.items()))
        print(f"durations: {file}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    finally:
        gate.stop()
        shutil.rmtree(folder, ignore_errors=True)
    print(f"FAILED: {', '.join(gate.failed)}" if gate.failed else "passed", flush=True)
    return int(bool(gate.failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
