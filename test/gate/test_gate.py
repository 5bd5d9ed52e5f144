"""The gate: a test that takes too long fails, durations are written, and what tests leave behind is found."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import durations
import machine
import pytest
import suite


@pytest.mark.parametrize(
    ("seconds", "load", "marked", "fails"),
    [(11.9, 1.0, False, False), (12.1, 1.0, False, True), (12.1, 1.0, True, False), (12.1, 3.0, False, False)],
)
def test_an_unmarked_test_fails_at_four_times_its_three_seconds_on_an_idle_machine(
    seconds: float, load: float, marked: bool, fails: bool
) -> None:
    said = durations.too_long(seconds, load, marked)
    assert bool(said) == fails
    if fails:
        assert said.startswith("this test used 12.1 s of processor time; a test that is not marked slow has 3 s")


def test_a_run_of_pytest_fails_the_long_test_and_writes_how_long_each_took(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "conftest.py").write_text(
        "import durations\ndurations.LIMIT_S, durations.IDLE = 0.02, 1e9\npytest_plugins = ['durations']\n", "utf-8"
    )
    (tmp_path / "test_it.py").write_text(
        "import time\n"
        "def busy():\n    end = time.process_time() + 0.1\n    while time.process_time() < end: pass\n"
        "def test_long(): busy()\n"
        "def test_short(): pass\n",
        "utf-8",
    )
    environment = {
        **os.environ, "PAM_TEST_DURATIONS": str(tmp_path), "PAM_TEST_PART": "some",
        "PYTHONPATH": os.pathsep.join([str(Path(durations.__file__).parent), os.environ.get("PYTHONPATH", "")]),
    }  # fmt: skip
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert "1 failed, 1 passed" in done.stdout and "test_long used 0.1 s" not in done.stdout
    assert "this test used 0.1 s of processor time" in done.stdout
    written = json.loads((tmp_path / "some.json").read_text("utf-8"))
    used = {row["test"].split("::")[1]: row["processor_s"] for row in written["tests"] if row["part"] == "call"}
    assert 0.1 <= used["test_long"] < 1.0 and used["test_short"] < 0.05
    text = suite.table(tmp_path, {"compile": 12.5})
    assert "   12.5  compile" in text and "some: start and collection" in text and "test_it.py::test_long" in text


@pytest.mark.parametrize(
    ("rates", "shares", "keeps_up"),
    [
        ((9e6, 1e6, 1e6), (0.1, 0.6, 0.0), True),
        ((7e6, 7.9e6, 1e6), (1.0,), False),
        ((9e6, 9e6, 9e6), (0.1,) * 3, False),
    ],
)
def test_a_machine_is_too_slow_where_python_or_bare_messages_are(
    rates: tuple[float, ...], shares: tuple[float, ...], keeps_up: bool, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    added, brought = iter(rates), iter(shares)
    monkeypatch.setattr(machine, "additions_a_second", lambda: next(added))
    monkeypatch.setattr(machine, "round_trips_in_time", lambda: next(brought))
    assert machine.keeps_up() is keeps_up
    assert f"This machine makes {max(rates) / 1e6:.1f} million additions" in capsys.readouterr().out


def test_files_and_processes_that_tests_leave_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(suite, "_ENDS_WITHIN_S", 0.2)
    before = suite.checkout()
    environment = suite.environment(tmp_path, "some")
    (tmp_path / "tmp" / "pytest-of-somebody").mkdir()
    assert suite.left_behind(tmp_path, before) == []
    (tmp_path / "home" / ".config").mkdir()
    (tmp_path / "tmp" / "bag").touch()
    sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(30)"], env=environment)
    try:
        end = time.monotonic() + 5.0  # its environment is there once it has begun
        while len(found := suite.left_behind(tmp_path, before)) < 3 and time.monotonic() < end:
            time.sleep(0.05)
    finally:
        sleeper.kill()
        sleeper.wait()
    assert found[:2] == [str(tmp_path / "tmp" / "bag"), str(tmp_path / "home" / ".config")]
    assert found[2].startswith("process: ") and "time.sleep(30)" in found[2]
