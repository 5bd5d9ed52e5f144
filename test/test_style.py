"""Lint and types are part of the tests: one command checks everything."""

import subprocess
import sys
from pathlib import Path

import pydantic
import pytest

ROOT = Path(__file__).resolve().parents[1]


def _passes(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(arguments)}\n{done.stdout}{done.stderr}"


def test_ruff() -> None:
    _passes("ruff", "check", "--no-cache", "--output-format=concise", ".")


@pytest.mark.slow(60)
@pytest.mark.skipif(pydantic.VERSION.startswith("1."), reason="the types follow pydantic 2")
def test_mypy() -> None:
    _passes("mypy")
