"""How commands end, and what they leave behind."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput


def _raising(error: BaseException) -> Any:
    def command(argv: Sequence[str] | None) -> int:
        raise error

    return command


def test_bad_input_is_one_line_and_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert common.run(_raising(BadInput("this\nfile: is\n\n  bad"))) == 2
    assert capsys.readouterr().err == "error: this file: is bad\n"


def test_an_interrupt_is_status_130(capsys: pytest.CaptureFixture[str]) -> None:
    assert common.run(_raising(KeyboardInterrupt())) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_an_interrupt_during_a_compiled_function_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    caused = SystemError("CPUDispatcher(<function course>) returned a result with an exception set")
    caused.__cause__ = KeyboardInterrupt()
    assert common.run(_raising(caused)) == 130
    assert capsys.readouterr().err == "interrupted: nothing was written\n"
    assert common.run(_raising(SystemError("oops"))) == 1


def test_a_defect_is_status_1_and_says_where(capsys: pytest.CaptureFixture[str]) -> None:
    assert common.run(_raising(ZeroDivisionError("oops"))) == 1
    error = capsys.readouterr().err
    assert "ZeroDivisionError: oops" in error
    assert "defect" in error


def test_arguments_are_handed_on_and_the_status_comes_back() -> None:
    assert common.run(lambda argv: len(argv or ()), ["a", "b", "c"]) == 3


def test_usage_errors_are_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def command(argv: Sequence[str] | None) -> int:
        parser = common.Parser("thing", "Do a thing.")
        common.add_rig(parser)
        parser.parse_args(argv)
        return 0

    assert common.run(command, []) == 2
    assert capsys.readouterr().err == "error: the following arguments are required: --rig (see pam thing --help)\n"
    assert common.run(command, ["--help"]) == 0
    assert "Do a thing." in capsys.readouterr().out
    assert common.run(command, ["--ri", "x"]) == 2, "abbreviations would break when an argument is added"


def test_an_output_folder_appears_when_it_is_whole(tmp_path: Path) -> None:
    with common.output_folder(tmp_path / "a" / "out") as folder:
        (folder / "x").write_text("1")
        assert folder.name == "out"
        assert not (tmp_path / "a" / "out").exists()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["out"]
    assert (tmp_path / "a" / "out" / "x").read_text() == "1"


def test_a_folder_that_exists_is_refused_even_when_it_is_empty(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    with pytest.raises(BadInput, match="exists"), common.output_folder(tmp_path / "out"):
        pytest.fail("it was taken")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_writer_may_make_the_folder_itself(tmp_path: Path) -> None:
    with common.output_folder(tmp_path / "out", make=False) as folder:
        assert not folder.exists()
        folder.mkdir()
    assert (tmp_path / "out").is_dir()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), BadInput("x"), ValueError("y")])
def test_a_failure_leaves_nothing(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)), common.output_folder(tmp_path / "out") as folder:
        (folder / "half").touch()
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_termination_cleans_up_as_well(tmp_path: Path) -> None:
    def command(argv: Sequence[str] | None) -> int:
        with common.output_folder(tmp_path / "out") as folder:
            (folder / "half").touch()
            os.kill(os.getpid(), signal.SIGTERM)
            raise AssertionError("not reached")

    before = signal.getsignal(signal.SIGTERM)
    assert common.run(command, []) == 130
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGTERM) is before


def test_nothing_is_overwritten(tmp_path: Path) -> None:
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
def test_a_topic_has_a_name_and_another_name(text: str) -> None:
    parser = common.Parser("thing", "x")
    common.add_topics(parser)
    with pytest.raises(BadInput, match="NAME=/OTHER"):
        parser.parse_args(["--topic", text])


def test_topics() -> None:
    parser = common.Parser("thing", "x")
    common.add_topics(parser)
    given = parser.parse_args(["--topic", "pressure_1=/a/p", "--topic", "pressure_2=/b"])
    assert common.topics(given) == {"pressure_1": "/a/p", "pressure_2": "/b"}
    twice = parser.parse_args(["--topic", "pressure_1=/a", "--topic", "pressure_1=/b"])
    with pytest.raises(BadInput, match="given twice"):
        common.topics(twice)
