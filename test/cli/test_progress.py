"""Progress of long commands: a bar on a terminal, a line now and then elsewhere, and nothing for what is quick."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from pam_antagonist.cli import progress

Said = Callable[[], str]


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Said:
    """What was written to the error stream so far, with times that a test can wait for."""
    for name, seconds in (("_TICK", 0.01), ("_DELAY", 0.02), ("_LINES", 0.05)):
        monkeypatch.setattr(progress, name, seconds)
    return lambda: capsys.readouterr().err


def test_off_a_terminal_there_are_lines(said):
    with progress.phases("close_loop") as begin:
        begin("second phase")
        time.sleep(0.13)
    lines = said().splitlines()
    assert 1 <= len(lines) <= 2
    assert all(line == "close_loop: second phase, 0 s" for line in lines)


def test_what_fails_stays_where_it_was(said):
    with pytest.raises(ValueError), progress.counted(100, "replay") as advance:
        advance(40)
        time.sleep(0.12)
        raise ValueError
    lines = said()
    assert "replay: 40 %" in lines and "100 %" not in lines


def test_on_a_terminal_the_bar_reaches_the_end(said, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress.counted(100, "replay") as advance:
        advance(30)
        time.sleep(0.2)
        advance(90)  # more than there is
    drawn = said()
    assert "replay  30 % |" in drawn and "left" in drawn and "100 % |" in drawn


def test_what_is_quick_shows_nothing(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress.counted(10, "replay") as advance:
        advance(10)
    assert capsys.readouterr().err == ""
