"""One table of executables: what can be run, what is installed, and what starting it loads."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pam_antagonist.__main__ import COMMANDS, main

ROOT = Path(__file__).resolve().parents[2]


def test_help_lists_every_executable_in_one_line(capsys):
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for name, command in COMMANDS.items():
        assert [line for line in lines if line.split() == [name, *command.summary.split()]], name


def test_without_a_name_usage_is_shown(capsys):
    assert main([]) == 2
    assert "usage" in capsys.readouterr().out


def test_an_unknown_name_lists_the_names(capsys):
    assert main(["repaly"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(name in error for name in COMMANDS)
    assert "did you mean replay?" in error


@pytest.mark.parametrize("words", ["--help", "reachable --help", "plant --help", "reachable --rig shin2022"])
def test_a_reader_of_the_output_may_go(words):
    """As ``pam --help | head``: the pipe is closed before anything is written."""
    command, pipe = [sys.executable, "-m", "pam_antagonist", *words.split()], subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        said = process.stderr.read()
    assert (process.returncode, said) == (0, "")


def test_the_table_needs_the_standard_library_only(python):
    # setup.py reads it where nothing is installed yet.
    code = f"import runpy; print(len(runpy.run_path({str(ROOT / 'pam_antagonist' / '__main__.py')!r})['COMMANDS']))"
    done = python("-I", "-S", "-c", code)
    assert done.stdout.strip() == str(len(COMMANDS)), done.stderr


@pytest.mark.parametrize(
    ("name", "arguments", "further"),
    [
        ("replay", "{bag} --no-figures", ["plotly", "matplotlib", "scipy.stats", "scipy.signal", "pandas"]),
        ("simulate", "--duration 1", []),
    ],
)
def test_offline_commands_load_no_ros_and_what_is_slow_only_where_it_is_needed(
    name, arguments, further, python, bag, tmp_path
):
    words = [name, *arguments.format(bag=bag).split(), "--rig", "shin2022", "--out", str(tmp_path / "out")]
    code = f"""
import sys
from pam_antagonist.__main__ import main
status = main({words!r})
ros = ["rclpy", "rcl_interfaces", "pam_antagonist_msgs", "sensor_msgs", "std_msgs"]
found = {{*ros, *{further!r}}} & set(sys.modules)
sys.exit(status or (f"loaded {{found}}" if found else 0))
"""
    done = python("-c", code)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out").is_dir()
