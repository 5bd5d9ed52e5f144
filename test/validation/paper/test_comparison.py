"""What tables and sentences say about an order of models."""

from __future__ import annotations

from validation.paper.comparison import Model, comparison_table, ranked
from validation.paper.result import Context

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
