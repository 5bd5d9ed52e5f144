"""What commands print and pages draw: JSON that every reader accepts, tables that line up, thinned data."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pam_antagonist.report import html
from pam_antagonist.report.document import Comparison, Definitions, Findings, Section, Statement, Table, Text
from pam_antagonist.report.terminal import WIDTH, render
from pam_antagonist.shown import number, percent
from pam_antagonist.strict_json import dumps, plain, write_json


def _refuse(text: str) -> Any:
    raise AssertionError(f"{text} is not JSON")


def test_what_is_not_finite_becomes_null(tmp_path: Path) -> None:
    value = {
        "nan": float("nan"),
        "list": [math.inf, np.float64(1.5), -np.inf],
        "array": np.array([1.0, np.nan]),
        "scalars": [np.int32(3), np.bool_(True), np.float32(0.5), None, "µ", True, 2**60],
        1: (),
    }
    write_json(tmp_path / "x.json", value)
    text = (tmp_path / "x.json").read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=_refuse) == {
        "nan": None, "list": [None, 1.5, None], "array": [1.0, None],
        "scalars": [3, True, 0.5, None, "µ", True, 2**60], "1": [],
    }  # fmt: skip


@dataclass(frozen=True)
class Errors:
    """A dataclass with the keys of its fields."""

    rmse: float
    parts: tuple[Any, ...] = ()


class Renamed(Errors):
    """One that names its own keys."""

    def to_json(self) -> dict[str, float]:
        return {"rmse_deg": self.rmse}


def test_a_dataclass_becomes_an_object() -> None:
    value = plain({"all": Errors(math.nan, (Renamed(1.0), Errors(2.0)))})
    assert value == {"all": {"rmse": None, "parts": [{"rmse_deg": 1.0}, {"rmse": 2.0, "parts": []}]}}


def test_what_has_no_form_is_refused() -> None:
    with pytest.raises(TypeError, match="complex"):
        dumps({"z": 1j})


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.0, 3, "0"), (0.32534, 3, "0.325"), (0.32534, 2, "0.33"), (12.3456, 3, "12.3"), (1234.5, 3, "1234"),
        (-0.0805, 2, "-0.081"), (3.2e-9, 3, "3.20e-09"), (None, 3, "–"), (float("nan"), 3, "–"),
    ],
)  # fmt: skip
def test_numbers_have_the_digits_that_mean_something(value: float | None, digits: int, text: str) -> None:
    assert number(value, digits) == text


def test_a_share_is_never_minus_nothing() -> None:
    assert [percent(value) for value in (-1e-5, 0.1234, -0.02, None)] == ["0.0 %", "12.3 %", "-2.0 %", "–"]


def test_findings_are_marked_and_wrapped() -> None:
    long = "word " * 40
    lines = render(
        (Findings((Statement("good", "right"), Statement("warn", long), Statement("note", "known"))),)
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


VALUES = st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=400)


@given(VALUES, st.sampled_from([4, 10, 50]))
def test_extremes_survive_and_the_limit_holds(values: list[float], limit: int) -> None:
    array = np.array(values)
    index = html.min_max_indices(array, limit)
    assert len(index) <= max(limit, 1)
    assert np.all(np.diff(index) > 0)
    if np.isfinite(array).any():
        assert np.nanmax(array[index]) == np.nanmax(array)
        assert np.nanmin(array[index]) == np.nanmin(array)
    else:
        assert np.isnan(array[index]).all()


def test_what_fits_is_not_touched() -> None:
    assert list(html.min_max_indices(np.arange(7.0), 7)) == list(range(7))


@given(VALUES)
def test_a_thinned_band_covers_all_of_the_full_one(values: list[float]) -> None:
    lower = np.array(values)
    upper = lower + 1.0
    limit = 10
    _, low, high = html.envelope(lower, upper, limit)
    width = html.bucket_width(len(lower), limit)
    for k in range(len(lower)):
        if np.isfinite(lower[k]):
            assert low[k // width] <= lower[k]
            assert high[k // width] >= upper[k]


def test_a_pause_starts_a_new_stretch() -> None:
    stamps = np.array([0, 1, 2, 50, 51]) * 1_000_000
    assert list(html.stretches(stamps * 1e-9)) == [0, 0, 0, 1, 1]
    assert len(html.stretches(stamps[:0] * 1e-9)) == 0
