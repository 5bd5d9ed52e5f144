"""Progress of long commands: it reaches the end, does not go back, and the time that is left does not jump."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pam_antagonist.cli import progress
from pam_antagonist.cli.progress import CLOSE_LOOP, IDENTIFY, Counted, Plan, Planned, Steady, in_words, roughly

PLAN = Plan(1.0, 4.0, {"first": 1.0, "second": 2.0, "third": 1.0})


def recordings(*seconds: float) -> Any:
    """Recordings of these lengths."""
    return [SimpleNamespace(duration_s=each) for each in seconds]


@pytest.mark.parametrize("slowness", [0.5, 1.0, 3.0])
def test_phases_take_their_share_and_never_more(slowness: float) -> None:
    state, seen = Planned(40.0, PLAN), []
    for k in range(int(400 * slowness)):
        elapsed = 0.1 * k
        for name, begin in (("first", 0.0), ("second", 10.0), ("third", 30.0)):
            if abs(elapsed - slowness * begin) < 0.05:
                state.begin(f"now the {name} phase", elapsed)
        seen.append(state.fraction(elapsed))
    assert all(after >= before for before, after in zip(seen, seen[1:], strict=False))
    assert seen[int(99 * slowness)] <= 0.25 and seen[int(299 * slowness)] <= 0.75 and 0.85 < seen[-1] < 1.0


def test_a_phase_that_is_left_out_or_comes_again_does_not_take_progress_back() -> None:
    state = Planned(40.0, PLAN)
    state.begin("second", 1.0)
    before = state.fraction(5.0)
    state.begin("first of another group", 5.0)
    assert state.text == "first of another group"
    assert state.fraction(5.0) == before >= 0.25


@pytest.mark.parametrize("slowness", [0.5, 1.0, 3.0])
def test_the_time_that_is_left_counts_down_without_jumps(slowness: float) -> None:
    state, steady, shown = Planned(40.0, PLAN), Steady(), []
    end = 40.0 * slowness
    for k in range(int(2 * end)):
        elapsed = 0.5 * k
        for name, begin in (("first", 0.0), ("second", 10.0), ("third", 30.0)):
            if math.isclose(elapsed, slowness * begin):
                state.begin(name, elapsed)
        shown.append(steady.left(elapsed, state.left(elapsed)))
    known = [left for left in shown if not math.isnan(left)]
    # It never grows, nor falls from one half second to the next by more than a tenth of what was expected or came.
    assert all(after <= before for before, after in zip(known, known[1:], strict=False))
    assert not any(before - after > 0.1 * max(end, 40.0) for before, after in zip(shown, shown[1:], strict=False))
    # From the middle on, it is right to a quarter of that, or not said.
    assert slowness > 2.0 or len(known) == len(shown)
    for k in range(len(shown) // 2, len(shown)):
        assert math.isnan(shown[k]) or shown[k] == pytest.approx(end - 0.5 * k, abs=max(end, 40.0) / 4)


def test_a_phase_that_takes_ten_times_as_long_as_expected_lets_no_time_grow() -> None:
    state, steady, shown = Planned(40.0, PLAN), Steady(), []
    state.begin("first", 0.0)
    for k in range(600):  # the first phase alone takes 300 s
        shown.append(steady.left(0.5 * k, state.left(0.5 * k)))
    told = [left for left in shown if not math.isnan(left)]
    assert all(after <= before for before, after in zip(told, told[1:], strict=False))
    assert math.isnan(shown[-1])  # longer than expected: better no time than a wrong one


def test_a_phase_that_counts_is_as_far_as_it_says() -> None:
    state = Planned(40.0, PLAN)
    state.begin("second phase, 5 of at most 20", 10.0)
    assert state.fraction(12.0) == state.fraction(900.0) == pytest.approx(0.25 + 0.5 * 5 / 20)
    state.begin("second phase, 15 of at most 20", 30.0)
    assert state.fraction(30.0) == pytest.approx(0.25 + 0.5 * 15 / 20)
    state.begin("third", 40.0)
    assert state.fraction(40.0) == pytest.approx(0.75)


def test_what_is_counted_ends_at_one() -> None:
    state = Counted(10.0)
    assert math.isnan(state.left(3.0))
    state.add(4.0)
    assert state.fraction(2.0) == 0.4 and state.left(2.0) == pytest.approx(3.0)
    state.add(8.0)
    assert state.fraction(3.0) == 1.0 and state.left(3.0) == 0.0


def test_off_a_terminal_there_are_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(progress, "_TICK", 0.01)
    monkeypatch.setattr(progress, "_LINES", 0.1)
    with progress.planned("close_loop", recordings(0.01), PLAN) as report:
        report("second phase")
        time.sleep(0.25)
    *lines, last = capsys.readouterr().err.splitlines()
    assert 1 <= len(lines) <= 3
    assert lines[0].startswith("close_loop: ") and "second phase" in lines[0]
    assert lines[0].endswith((" left", ", longer than expected"))
    assert last == "close_loop: 100 %, took 1 s"


def test_what_fails_does_not_end_at_100_percent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_TICK", 0.01)
    monkeypatch.setattr(progress, "_LINES", 0.05)
    with pytest.raises(ValueError), progress.counted(100, "replay") as advance:
        advance(100)
        time.sleep(0.2)
        raise ValueError
    said = capsys.readouterr().err
    assert "99 %" in said and "100 %" not in said


def test_before_anything_is_done_there_is_no_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_TICK", 0.01)
    monkeypatch.setattr(progress, "_LINES", 0.05)
    with progress.counted(100, "replay") as advance:
        time.sleep(0.2)
        advance(100)
    assert capsys.readouterr().err == ""


def test_on_a_terminal_the_bar_reaches_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(progress, "_TICK", 0.01)
    monkeypatch.setattr(progress, "_DELAY", 0.02)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress.counted(100, "replay") as advance:
        advance(30)
        time.sleep(0.2)
    said = capsys.readouterr().err
    assert " 30 %" in said and "100 %" in said


def test_how_long_it_takes_is_said_first_from_the_recordings_length(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert CLOSE_LOOP.low < CLOSE_LOOP.middle < CLOSE_LOOP.high
    with progress.planned("close_loop", recordings(600.0, 600.0), CLOSE_LOOP) as report:
        assert capsys.readouterr().err == ""  # a refusal of the recordings would come here, alone
        report("recalibrating the base parameters")
        report("round 1: score tests")
    said = capsys.readouterr().err
    assert said.startswith("close_loop: 2 recordings of 20 min together, about ") and said.count("\n") == 1
    monkeypatch.setattr(progress, "load", lambda: 3.0)
    with progress.planned("close_loop", recordings(600.0, 600.0), CLOSE_LOOP) as report:
        report("recalibrating the base parameters")
    assert "about 6 min to 60 min while the machine is busy (load 3.0 a core)" in capsys.readouterr().err
    with progress.planned("identify", recordings(2.0), IDENTIFY) as report:
        report("force map")
    assert capsys.readouterr().err == ""


def test_times_for_people() -> None:
    assert [in_words(value) for value in (0.2, 7.6, 38.0, 200.0, 9000.0)] == ["1 s", "8 s", "40 s", "3 min", "2.5 h"]


def test_a_time_that_is_left_is_told_roughly() -> None:
    """A step to the next one is about a third: what is known no better changes seldom."""
    told = [roughly(left) for left in np.arange(0.5, 105.0, 0.5)]
    assert told[0] == "1 s" and told[-1] == "2 min" and len(set(told)) == 11
    assert [roughly(left) for left in (38.0, 41.0, 44.0)] == ["45 s"] * 3
    assert [roughly(left) for left in (107.0, 130.0, 200.0, 9000.0)] == ["2 min", "2 min", "3 min", "2.5 h"]


def test_a_time_left_that_is_over_stays_over() -> None:
    steady = Steady()
    shown = [steady.left(now, max(30.0 - now, 0.0)) for now in np.arange(0.0, 200.0, 0.37)]
    assert np.all(np.diff(shown) <= 0.0)
    assert shown[-1] == 0.0
