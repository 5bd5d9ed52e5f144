"""One table of executables: what can be run, what is installed, and what starting it loads."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from pam_antagonist.__main__ import COMMANDS, main

ROOT = Path(__file__).resolve().parents[2]
Python = Callable[..., subprocess.CompletedProcess[str]]
OFFLINE = ("replay", "simulate")


def test_help_lists_every_executable_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, command in COMMANDS.items():
        assert [line for line in lines if line.split() == [name, *command.summary.split()]], name


def test_without_a_name_usage_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "usage" in capsys.readouterr().out


def test_an_unknown_name_lists_the_names(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["repaly"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(name in error for name in COMMANDS)
    assert "did you mean replay?" in error


@pytest.mark.parametrize("words", [["--help"], ["reachable", "--help"], ["plant", "--help"]])
def test_a_reader_of_the_output_may_go(words: list[str]) -> None:
    """As ``pam --help | head``: the pipe is closed before anything is written."""
    with subprocess.Popen(
        [sys.executable, "-m", "pam_antagonist", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (0, "")


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_target_is_there(name: str) -> None:
    module, function = COMMANDS[name].target.split(":")
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None, f"{name}: no module {module}"
    assert re.search(rf"^(def {function}\(|{function} = )", Path(spec.origin).read_text(encoding="utf-8"), re.MULTILINE)


def test_the_table_needs_the_standard_library_only(python: Python) -> None:
    # setup.py reads it where nothing is installed yet.
    code = f"import runpy; print(len(runpy.run_path({str(ROOT / 'pam_antagonist' / '__main__.py')!r})['COMMANDS']))"
    done = python("-I", "-S", "-c", code)
    assert done.stdout.strip() == str(len(COMMANDS)), done.stderr


@pytest.mark.parametrize("name", OFFLINE)
def test_offline_commands_load_no_ros(name: str, python: Python, bag: Path, tmp_path: Path) -> None:
    arguments = {"replay": [str(bag)], "simulate": ["--duration", "1"]}[name]
    code = f"""
import importlib.abc, sys
class NoRos(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("rclpy", "rcl_interfaces", "pam_antagonist_msgs", "sensor_msgs", "std_msgs"):
            raise ImportError(name + " was imported")
sys.meta_path.insert(0, NoRos())
from pam_antagonist.__main__ import main
sys.exit(main([{name!r}, *{arguments!r}, "--rig", "shin2022", "--out", {str(tmp_path / "out")!r}]))
"""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out").is_dir()


def test_replay_without_figures_loads_no_plotting_library(python: Python, bag: Path, tmp_path: Path) -> None:
    code = f"""
import sys
from pam_antagonist.cli.replay import main
status = main([{str(bag)!r}, "--rig", "shin2022", "--out", {str(tmp_path / "out")!r}, "--no-figures"])
slow = [name for name in ("plotly", "matplotlib", "scipy.stats", "scipy.signal", "pandas") if name in sys.modules]
sys.exit(status or f"loaded {{slow}}" if slow else status)
"""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
