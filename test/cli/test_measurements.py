"""The measurements of the laboratory: each is there, and its help teaches."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

from pam_antagonist.__main__ import main
from pam_antagonist.program import VARIABLE
from validation.__main__ import COMMANDS, PLACES


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_shows_how_it_is_typed(name, monkeypatch, capsys):
    module, function = COMMANDS[name].target.split(":")
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None, f"{name}: no module {module}"
    text = Path(spec.origin).read_text(encoding="utf-8")
    assert f"def {function}(" in text or f"\n{function} = common.command(" in text
    monkeypatch.setenv(VARIABLE, "here/run")
    assert main([name, "--help"], COMMANDS, PLACES) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"usage: here/run {name} ") and "{run}" not in said


def test_they_start_from_a_checkout():
    done = subprocess.run([sys.executable, "-m", "validation"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert all(name in done.stdout for name in COMMANDS)
