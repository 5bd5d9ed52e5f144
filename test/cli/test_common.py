"""How commands end, and what they leave behind."""

from __future__ import annotations

import argparse
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput


def _raising(error: BaseException) -> Any:
    def work() -> int:
        raise error

    return work


def test_bad_input_is_one_line_and_status_2(capsys):
    assert common.ended(_raising(BadInput("this\nfile: is\n\n  bad"))) == 2
    assert capsys.readouterr().err == "error: this file: is bad\n"


def test_an_interrupt_is_status_130(capsys):
    assert common.ended(_raising(KeyboardInterrupt())) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_an_interrupt_during_a_compiled_function_is_one(capsys):
    caused = SystemError("CPUDispatcher(<function course>) returned a result with an exception set")
    caused.__cause__ = KeyboardInterrupt()
    assert common.ended(_raising(caused)) == 130
    assert capsys.readouterr().err == "interrupted: nothing was written\n"
    assert common.ended(_raising(SystemError("oops"))) == 1


def test_a_defect_is_status_1_and_says_where(capsys):
    assert common.ended(_raising(ZeroDivisionError("oops"))) == 1
    error = capsys.readouterr().err
    assert "ZeroDivisionError: oops" in error
    assert "defect" in error


def _parser() -> common.Parser:
    parser = common.Parser("thing", "Do a thing.")
    parser.shared("--rig", "--json")
    parser.add_argument("--out", type=Path)
    return parser


def test_arguments_are_handed_on_and_the_status_comes_back():
    assert common.run(_parser, lambda arguments: len(arguments.rig), ["--rig", "abc", "--out", "none"]) == 3


def test_usage_errors_are_one_line(capsys):
    def refuse(arguments: argparse.Namespace) -> int:
        raise AssertionError("not reached")

    assert common.run(_parser, refuse, []) == 2
    assert capsys.readouterr().err == "error: the following arguments are required: --rig (see pam thing --help)\n"
    assert common.run(_parser, refuse, ["--help"]) == 0
    assert "Do a thing." in capsys.readouterr().out
    assert common.run(_parser, refuse, ["--ri", "x"]) == 2, "abbreviations would break when an argument is added"


def test_json_of_the_report_is_given_alone(tmp_path, capsys):
    def command(arguments: argparse.Namespace) -> int:
        (arguments.out / "report.json").write_text("{}\n")
        print("a table")
        return 0

    assert common.run(_parser, command, ["--rig", "x", "--out", str(tmp_path), "--json", "-"]) == 0
    assert capsys.readouterr() == ("{}\n", "a table\n")


def test_an_output_folder_appears_when_it_is_whole(tmp_path):
    with common.output_folder(tmp_path / "a" / "out") as folder:
        (folder / "x").write_text("1")
        assert folder.name == "out"
        assert not (tmp_path / "a" / "out").exists()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["out"]
    assert (tmp_path / "a" / "out" / "x").read_text() == "1"


@pytest.mark.parametrize("error", [KeyboardInterrupt(), BadInput("x"), ValueError("y")])
def test_a_failure_leaves_nothing(tmp_path, error):
    with pytest.raises(type(error)), common.output_folder(tmp_path / "out") as folder:
        (folder / "half").touch()
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_termination_cleans_up_as_well(tmp_path):
    def work() -> int:
        with common.output_folder(tmp_path / "out") as folder:
            (folder / "half").touch()
            os.kill(os.getpid(), signal.SIGTERM)
            raise AssertionError("not reached")

    before = signal.getsignal(signal.SIGTERM)
    assert common.ended(work) == 130
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is before


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").write_text("x")
    (tmp_path / "file").write_text("y")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    for name in ("full", "file", "dangling", "file/below"):
        with pytest.raises(BadInput, match=name.split("/", maxsplit=1)[0]), common.output_folder(tmp_path / name):
            pass
    assert (tmp_path / "full" / "precious").read_text() == "x"
    assert (tmp_path / "file").read_text() == "y"
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize("text", ["pressure_1", "=/a", "pressure_1=a", "pressure_1="])
def test_a_topic_has_a_name_and_another_name(text):
    parser = common.Parser("thing", "x")
    parser.shared("--topic")
    with pytest.raises(BadInput, match="NAME=/OTHER"):
        parser.parse_args(["--topic", text])


def test_topics():
    parser = common.Parser("thing", "x")
    parser.shared("--topic")
    given = parser.parse_args(["--topic", "pressure_1=/a/p", "--topic", "pressure_2=/b"])
    assert common.topics(given) == {"pressure_1": "/a/p", "pressure_2": "/b"}
    twice = parser.parse_args(["--topic", "pressure_1=/a", "--topic", "pressure_1=/b"])
    with pytest.raises(BadInput, match="given twice"):
        common.topics(twice)
