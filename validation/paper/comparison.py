"""Tables of several models over many virtual rigs, beside the paper's order of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pam_antagonist.report.figure import Axis, Figure, FloatArray, Line, Panel, Points, Series
from pam_antagonist.report.style import PALETTE
from pam_antagonist.report.table import MISSING, Table, number
from validation.paper.result import Context
from validation.paper.seed_work import TUNINGS

_SIGNS = ("𝕀", "𝕄", "ℚ")
COMPARED_S = 62.0
"""The part of the profile that models are compared over [s]: up to here it has been at all its extremes."""


@dataclass(frozen=True)
class Model:
    """A compared model.

    Attributes:
        name: in the numbers.
        label: in tables.
        paper: its 𝕀, 𝕄, ℚ in the paper, None for one that the paper has not.
    """

    name: str
    label: str
    paper: tuple[float, float, float] | None


def comparison_table(context: Context, models: Sequence[Model], tuning: str, unit: str) -> Table:
    """One row a model: median and range of the figures, the paper's in the last column; the best medians are bold.

    Args:
        context: results of all seeds.
        models: the models that are compared.
        tuning: name of the tuning.
        unit: of the errors.
    """
    keys = ("rmse", "largest", "ratio")
    medians = np.array([[context.spread(model.name, tuning, key).median for key in keys] for model in models])
    rows, best = [], []
    for k, model in enumerate(models):
        spread = {key: context.spread(model.name, tuning, key) for key in (*keys, "coverage", "nis_mean")}
        paper = MISSING if model.paper is None else ", ".join(number(value) for value in model.paper)
        rows.append(
            (
                # The name may wrap at its comma only: the numbers' columns are wide, and would press it together.
                model.label.replace(" ", "\u00a0").replace(",\u00a0", ", "),
                spread["rmse"].text(),
                spread["largest"].text(),
                spread["ratio"].text(100.0),
                spread["coverage"].text(100.0),
                number(spread["nis_mean"].median),
                paper,
            )
        )
        best.append(frozenset(1 + c for c in range(3) if medians[k, c] == np.nanmin(medians[:, c])))
    header = ("Model", f"𝕀 [{unit}]", f"𝕄 [{unit}]", "ℚ [%]", "in 95 % [%]", "mean NIS (2)", "paper: 𝕀, 𝕄, ℚ [-]")
    caption = f"Tuning {tuning}: median (range) over {len(context.seeds)} virtual rigs; the best median is bold"
    return Table(header, tuple(rows), caption, tuple(best))


def ranked(context: Context, models: Sequence[Model], tuning: str, key: str) -> str:
    """A sentence: whether the paper's order holds, and on how many rigs its best model is the best.

    Args:
        context: results of all seeds.
        models: the models that are compared.
        tuning: name of the tuning.
        key: ``rmse``, ``largest`` or ``ratio``.
    """
    compared = [model for model in models if model.paper is not None]
    # What could not be fitted on a rig does not win there.
    values = {
        model.name: np.nan_to_num(np.array(context.values(model.name, tuning, key)), nan=np.inf) for model in compared
    }
    label = {model.name: model.label for model in compared}
    place = ("rmse", "largest", "ratio").index(key)
    theirs = sorted(compared, key=lambda model: model.paper[place] if model.paper else 0.0)
    ours = sorted(compared, key=lambda model: context.spread(model.name, tuning, key).median)
    first = theirs[0].name
    others = np.min([values[model.name] for model in compared if model.name != first], axis=0)
    wins = int(np.sum(values[first] <= others))
    same = [model.name for model in theirs] == [model.name for model in ours]
    order = " < ".join(label[model.name] for model in ours)
    won = (
        f"Tuning {tuning}, by {_SIGNS[place]}: {label[first]}, the paper's best, is the best on {wins} of "
        f"{len(others)} rigs. "
    )
    if same:
        return won + f"The paper's order of the medians holds: {order}."
    return won + f"The paper's order does not hold. Ours: {order}."


def comparison_figure(context: Context, models: Sequence[Model], quantity: str) -> Figure:
    """ℚ of each model on each rig, both tunings.

    Args:
        context: results of all seeds.
        models: the models that are compared.
        quantity: in the title.
    """
    rows = []
    for k, model in enumerate(models):
        for tuning in TUNINGS:
            values = 100.0 * np.array(context.values(model.name, tuning, "ratio"))
            rows.append((f"{_short(model.label)} · {tuning}", values, PALETTE[k % len(PALETTE)]))
    about = "Each point is a virtual rig, the bar their median. Lower is better."
    panel = spreads(rows, "ℚ [%]", log=True)
    return Figure(f"ℚ of the {quantity} by model", about, (panel,), f"models {quantity}")


def _short(label: str) -> str:
    return (
        label.replace(" friction model", "")
        .replace(", the paper's constants", "")
        .replace(", the paper's constant", "")
    )


def spreads(rows: Sequence[tuple[str, FloatArray, str]], title: str, log: bool = False) -> Panel:
    """A row of points for each name, values (K,) and colour; each point a repetition, with a bar at the median."""
    parts: list[Series] = []
    for row, (name, values, color) in enumerate(rows):
        known = np.asarray(values, dtype=np.float64)
        known = known[np.isfinite(known)]
        # A fixed jitter, so that points of equal value do not hide each other.
        place = row + 0.24 * (np.arange(len(known)) % 5 - 2) / 2
        parts.append(Points(name, known, place, color, opacity=0.45, quiet=True))
        if len(known):
            middle = np.full(2, float(np.median(known)))
            parts.append(Line(name, middle, np.array([row - 0.36, row + 0.36]), color, width=4.0, quiet=True))
    names = tuple(name for name, _, _ in rows)
    return Panel(Axis(title, log=log), Axis(labels=names), tuple(parts), 26 + 34 * len(rows))
