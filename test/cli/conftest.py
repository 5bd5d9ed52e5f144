"""A bag made by the command itself, and a way to run commands as users do."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pam_antagonist.cli import simulate

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds of a simulated free joint."""
    path = tmp_path_factory.mktemp("cli") / "bag"
    arguments = ["--rig", "shin2022", "--out", str(path), "--duration", "4", "--profile", "steps", "--seed", "3"]
    assert simulate.main([*arguments, "--mismatch", "0.01"]) == 0
    return path


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that is refused in one line, which holds some words; gives that line."""

    def run(command: Callable[[list[str]], int], arguments: list[str], *words: str) -> str:
        capsys.readouterr()
        assert command(arguments) == 2, arguments
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1, error
        assert all(word in error for word in words), error
        return error

    return run


@pytest.fixture(scope="session")
def python() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run this checkout's Python code in a process of its own."""

    def run(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
        path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {**os.environ, "PYTHONPATH": path}
        command = [sys.executable, *arguments]
        return subprocess.run(
            command, cwd=cwd, env=environment, capture_output=True, text=True, check=False, timeout=300
        )

    return run
