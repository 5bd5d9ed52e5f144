"""What tables and sentences say about an order of models."""

from __future__ import annotations

import pytest

from validation.paper.comparison import Model, comparison_table, ranked
from validation.paper.result import Beside, Context, Result, Spread

MODELS = (Model("a", "A", (1.0, 1.0, 0.1)), Model("b", "B", (2.0, 2.0, 0.2)), Model("c", "C fitted", None))


def _context(ratios: dict[str, list[float]], tmp_path) -> Context:
    seeds = range(len(ratios["a"]))

    def entry(value: float) -> dict[str, float]:
        return {"rmse": value, "largest": value, "ratio": value, "coverage": 0.9, "nis_mean": 2.0}

    of_seeds = [{name: {"default": entry(values[k])} for name, values in ratios.items()} for k in seeds]
    return Context(None, of_seeds, list(seeds), False, False, None, tmp_path, print)  # type: ignore[arg-type]


def test_the_papers_order_is_found_where_it_is(tmp_path):
    text = ranked(_context({"a": [0.1, 0.3], "b": [0.2, 0.2], "c": [0.0, 0.0]}, tmp_path), MODELS, "default", "ratio")
    assert "is the best on 1 of 2 rigs" in text, "a model that the paper has not does not compete"
    assert "order of the medians holds: A < B" in text


def test_and_denied_where_it_is_not(tmp_path):
    text = ranked(_context({"a": [0.3, 0.3], "b": [0.2, 0.2], "c": [0.0, 0.0]}, tmp_path), MODELS, "default", "ratio")
    assert "does not hold. Ours: B < A." in text


def test_the_best_median_is_marked(tmp_path):
    table = comparison_table(
        _context({"a": [0.3, 0.3, 0.3], "b": [0.1, 0.2, 9.0], "c": [0.25, 0.25, 0.25]}, tmp_path),
        MODELS,
        "default",
        "°",
    )
    assert [bool(marked) for marked in table.best] == [False, True, False]
    assert table.rows[1][1] == "0.200 (0.100 … 9.00)"
    assert table.rows[2][-1] == "–"


def test_a_spread_leaves_out_what_is_not_there():
    assert Spread.of([3.0, float("nan"), 1.0, 2.0]) == Spread(2.0, 1.0, 3.0, 3)
    assert Spread.of([]).text() == "–"
    assert Spread.of([0.05]).text(100.0) == "5.00"


def test_a_row_says_whose_number_is_whose():
    row = Beside("angle", Spread.of([0.05, 0.07]), 0.0887, "%", "why")
    assert row.cells == ("angle", "6.00 (5.00 … 7.00) %", "8.87 %", "why")
    entry = Result("x", "X", "?", beside=(row,)).document()["beside_the_paper"][0]
    assert entry["ours"] == {"median": pytest.approx(0.06), "range": [0.05, 0.07], "n": 2}
    assert entry["paper"] == 0.0887
    assert entry["unit"] == "fraction"
