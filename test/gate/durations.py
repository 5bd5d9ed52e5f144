"""How long tests take: a file of all durations, and a limit for a test that is not marked slow."""

from __future__ import annotations

import json
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist._jit import COMPILING

FOLDER_VARIABLE = "PAM_TEST_DURATIONS"
"""Environment variable: folder for a JSON file of each run of pytest; not set: none is written."""
PART_VARIABLE = "PAM_TEST_PART"
"""Environment variable: name of the run, and of its file."""
LIMIT_S = 3.0
"""Processor time of a test that is not marked slow, without compiling [s]."""
SLOW_MACHINE = 4.0
"""A test fails beyond so many times the limit only: no machine refuses what a quicker one has accepted."""
IDLE = 2.0
"""Running processes per core beyond which processor time says nothing: cores share caches and clock."""
_USED = pytest.StashKey[float]()


def _used() -> float:
    """Processor time of this process and of the processes that it has waited for, without compiling [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime - COMPILING.seconds


def too_long(seconds: float, load: float, marked: bool) -> str:
    """Why a test fails for its processor time, empty where it does not. `load`: running processes per core."""
    if marked or seconds <= SLOW_MACHINE * LIMIT_S or load > IDLE:
        return ""
    return (
        f"this test used {seconds:.1f} s of processor time; a test that is not marked slow has {LIMIT_S:g} s: "
        "make it shorter, share a fit by a session fixture, or mark it with pytest.mark.slow(seconds)"
    )


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Measure the processor time of a test without its fixtures."""
    began = _used()
    yield
    item.stash[_USED] = _used() - began


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Add the processor time to the report of a test, and fail what took too long."""
    outcome: Any = yield
    report = outcome.get_result()
    if call.when != "call":
        return
    seconds = item.stash.get(_USED, 0.0)
    report.user_properties.append(("processor_s", round(seconds, 3)))
    marked = any(item.get_closest_marker(name) for name in ("slow", "thorough"))
    words = too_long(seconds, os.getloadavg()[0] / (os.cpu_count() or 1), marked)
    if report.passed and words:
        report.outcome, report.longrepr = "failed", words


class Durations:
    """Collects durations where the results of all workers come together, and writes them at the end."""

    def __init__(self, file: Path) -> None:
        self._file, self._began = file, time.monotonic()
        self._collection = 0.0
        self._tests: list[dict[str, Any]] = []

    def pytest_runtest_logstart(self) -> None:
        """The first test begins: collection and the start of workers are over."""
        self._collection = self._collection or time.monotonic() - self._began

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A set-up, a test or its end is over."""
        used = dict(report.user_properties).get("processor_s") if report.when == "call" else None
        self._tests.append(
            {"test": report.nodeid, "part": report.when, "seconds": round(report.duration, 3), "processor_s": used}
        )

    def pytest_sessionfinish(self) -> None:
        """Write the file."""
        found = {"collection_s": self._collection, "all_s": time.monotonic() - self._began, "tests": self._tests}
        self._file.write_text(json.dumps(found), encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """Collect where a folder is named, but not in a worker."""
    folder, part = os.environ.get(FOLDER_VARIABLE), os.environ.get(PART_VARIABLE, "tests")
    if folder and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(Path(folder) / f"{part}.json"))
