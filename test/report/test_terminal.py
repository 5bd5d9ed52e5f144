"""What commands print: marks, wrapped sentences, tables that line up."""

from __future__ import annotations

from pam_antagonist.report.document import Comparison, Definitions, Finding, Findings, Section, Table, Text
from pam_antagonist.report.terminal import WIDTH, render


def test_findings_are_marked_and_wrapped() -> None:
    long = "word " * 40
    lines = render(
        (Findings((Finding("good", "right"), Finding("warn", long), Finding("note", "known"))),)
    ).splitlines()
    assert lines[0] == "✓ right"
    assert lines[1].startswith("! word") and lines[2].startswith("  word")
    assert lines[-1] == "  known"
    assert all(len(line) <= WIDTH for line in lines)


def test_no_line_ends_between_a_number_and_its_unit() -> None:
    text = render((Text("word " * 19 + "0.93 N m and 93.3 % of it"),))
    assert [line.split()[-1] for line in text.splitlines()] == ["word", "it"] and "\u00a0" not in text
    assert text.splitlines()[1].startswith("0.93 N m and 93.3 %")


def test_blocks_stand_apart_and_what_only_a_page_shows_is_left_out() -> None:
    numbers = Table(("", "UKF"), (("Angle", "0.1"),))
    shown = render(
        (Text("Result."), Table(("a", "b"), ()), Definitions((("UKF", "a filter"),)), Section("More", (numbers,)))
    )
    assert shown == "Result.\n\nMore\n         UKF\n  Angle  0.1"


def test_a_comparison_marks_the_best_of_each_row() -> None:
    out = Comparison("", "before", "after", "own")
    out.heading("Model alone")
    out.values("error", [2.0, 1.0, 1.0])
    out.values("written alike", [1.0001, 1.0002, None])
    out.values("nothing is better", [2.0, 1.0, 3.0], best=None)
    done = out.table("Errors")
    assert done.rows[0] == ("Model alone", "", "", "")
    assert done.rows[2] == ("written alike", "1.00", "1.00", "–")
    assert done.marked == (frozenset(), frozenset({2, 3}), frozenset(), frozenset())
