"""The residuals' part of a ``close_loop`` report: noise, whiteness, what goes before them, and what is left of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pam_antagonist.diagnosis import remaining
from pam_antagonist.diagnosis.remaining import RemainingResidual
from pam_antagonist.report.close_loop_sealed import ABOUT_RESIDUALS, is_driven
from pam_antagonist.report.document import Block, Finding, Findings, Text
from pam_antagonist.report.figure import Axis, Figure, Line, Panel, Points, Series
from pam_antagonist.report.figures import matrix
from pam_antagonist.report.style import ESTIMATE, MODEL, PAPER, QUIET, SECOND
from pam_antagonist.report.table import MISSING, Table, number, percent

Document = Mapping[str, Any]
_SIGNED = (MODEL, PAPER, ESTIMATE)
_SHARES = (PAPER, MODEL)
_CERTAIN = 0.05
_SHOWN = 5.0
"""Colours end at so many times the value that chance alone would give once in twenty."""
_POINTS = 300
_DRAWN = 3
"""Residuals that are drawn over what they depend on, of each recording."""
_SIGNALS = ("voltage 1", "voltage 2", "pressure 1", "pressure 2", "angle", "velocity")
_KINDS = {"equation": "Equations", "sensor": "Sensors", "innovation": "Estimator's innovations"}
_ABOUT = (
    "On held-out data. Sensors: measurement minus model, run from the start on the voltages alone. Equations: what "
    "flows, torque and motion lack where the model starts from the measurement every fifth of a second, so that one "
    "error does not hide in the next equation. Innovations: what the pressures are beside the estimator's prediction. "
    "A residual is compared with what was there up to 2 s before it, not after: commands follow from residuals where "
    "a loop is closed."
)


def statistics(document: Document, with_figures: bool) -> tuple[Block, ...]:
    """Table and figure of the residuals of each recording of which something was held out."""
    out: list[Block] = [Text(ABOUT_RESIDUALS if is_driven(document) else _ABOUT)]
    models = ("recalibrated", "extended") if document["effects"] else ("recalibrated",)
    for part in document["recordings"]:
        if "residuals" not in part:
            continue
        out.append(_table(part, models))
        if with_figures:
            about = (
                "How strongly each residual (left) goes with what was there before it (below): the largest correlation "
                "of the whitened series, over the one that chance alone would give once in twenty. Beyond ±1 it is no "
                "chance. The model lacks something that the signal drives; its sign is that of the number."
            )
            title = f"What residuals go with, {part['recording']}"
            out.append(Figure(title, about, _map(part["residuals"], models)))
    return tuple(out)


def _table(part: Mapping[str, Any], models: Sequence[str]) -> Table:
    rows: list[tuple[str, ...]] = []
    last = models[-1]
    shown = part["residuals"]
    kind = ""
    for k, row in enumerate(shown[last]):
        if row["kind"] != kind:
            kind = row["kind"]
            rows.append((_KINDS[kind], *[""] * (len(models) + 4)))
        times = [shown[model][k]["rms"] / shown[model][k]["noise"] for model in models]
        name = f"  {row['channel'].replace('_', ' ')}, RMS {number(row['rms'], 2)} {row['unit']}"
        rows.append(
            (
                name, *(number(value, 2) for value in times), percent(row["beyond_noise"]),
                number(row["memory_s"], 2), _chance(row["whiteness_p"]), _strongest(row["relations"]),
            )
        )  # fmt: skip
    header = ("Residual", *(f"× noise, {model}" for model in models), "beyond noise", "memory [s]", "white: p", "after")
    caption = (
        f"Residuals of {part['recording']}, held out. RMS and what follows are of the {last} model. Beyond noise: "
        "share of the squares that sensors do not explain. Memory: time for an independent value. White: probability "
        "that chance alone gives such an autocorrelation. After: the signal that goes before it most clearly, if "
        "chance does not explain that (p < 0.05), and the lag."
    )
    return Table(header, tuple(rows), caption)


def _chance(p: float | None) -> str:
    if p is None or not np.isfinite(p):
        return MISSING
    return "< 0.001" if p < 1e-3 else f"{p:.3f}"


def _strongest(relations: Mapping[str, Mapping[str, float]]) -> str:
    sure = [(item["p"], name, item["lag_s"]) for name, item in relations.items() if item["p"] < _CERTAIN]
    if not sure:
        return MISSING
    _, name, lag = min(sure)
    return f"{name}, {lag:.2g} s"


def _map(shown: Mapping[str, Sequence[Mapping[str, Any]]], models: Sequence[str]) -> tuple[Panel, ...]:
    """One map a model, above each other."""
    known = [s for s in _SIGNALS if any(s in row["relations"] for row in shown[models[0]])]
    names = [row["channel"].replace("_", " ") for row in shown[models[0]]]
    grids = []
    for model in models:
        cells = [[_over_chance(row["relations"].get(signal)) for signal in known] for row in shown[model]]
        grids.append((model, np.array(cells, dtype=np.float64)))
    return matrix(grids, names, known, _SIGNED, (-_SHOWN, _SHOWN), "{value:.1f}×")


def _over_chance(item: Mapping[str, float] | None) -> float:
    """Size of a correlation over that which chance would give once in twenty, with its sign."""
    if item is None:
        return float("nan")
    return float(item["z"] / item["limit"])


def left(found: Sequence[RemainingResidual], with_figures: bool) -> tuple[Block, ...]:
    """What no effect explains: in words, and drawn over what it depends on."""
    out: list[Block] = [Findings(tuple(Finding("note", item.line()) for item in found))]
    if not with_figures:
        return tuple(out)
    for name in dict.fromkeys(item.recording for item in found):
        mine = [item for item in found if item.recording == name]
        kinds = list(mine[0].depends_on)
        shares = np.array([[100.0 * item.depends_on[kind] for kind in kinds] for item in mine])
        about = "Share of each residual's variance that goes with one kind of dependence alone, less what chance gives."
        rows = [item.channel for item in mine]
        grid = matrix([("", shares)], rows, kinds, _SHARES, (0.0, 100.0), "{value:.1f} %")
        out.append(Figure(f"What the rest depends on, {name}", about, grid))
        widest = max(mine, key=lambda item: len(item.bands))
        power = np.array([[100.0 * item.bands.get(band, float("nan")) for band in widest.bands] for item in mine])
        about = "Share of each residual's power in each band of frequency. Equations are known up to 2.5 Hz."
        bands = [_short(band) for band in widest.bands]
        grid = matrix([("", power)], rows, bands, _SHARES, (0.0, 100.0), "{value:.1f} %")
        out.append(Figure(f"How fast the rest moves, {name}", about, grid))
        clear = sorted(mine, key=lambda item: -item.times_noise * max(item.depends_on.values()))[:_DRAWN]
        out += [_drawn(item) for item in clear]
    return tuple(out)


def _short(band: str) -> str:
    return band.replace("below ", "< ").replace("above ", "> ").replace(" to ", "–")


def _drawn(item: RemainingResidual) -> Figure:
    """A residual over the two axes with which it changes most."""
    axes = item.around.axes()
    spread = {}
    for title, over in axes.items():
        means = remaining.means(item.values, over)
        spread[title] = float(np.var(means[:, 1])) if len(means) else 0.0
    chosen = sorted(spread, key=lambda title: -spread[title])[:2]
    velocity = item.around.velocity
    panels, every = [], max(1, len(item.values) // _POINTS)
    named: set[str] = set()
    for title in chosen:
        single = Points("residual", axes[title][::every], item.values[::every], QUIET, quiet=bool(named))
        parts: list[Series] = [single]
        groups: list[tuple[str, np.ndarray | None, str]]
        if velocity is None or title.startswith("Time"):
            groups = [("mean", None, MODEL)]
        else:
            groups = [("angle rising", velocity > 0.0, ESTIMATE), ("angle falling", velocity < 0.0, SECOND)]
        for name, which, color in groups:
            means = remaining.means(item.values, axes[title], which)
            parts.append(Line(name, means[:, 0], means[:, 1], color, width=1.7, quiet=name in named))
            named.add(name)
        panels.append(Panel(Axis(title), Axis(f"{item.channel.capitalize()} [{item.unit}]"), tuple(parts), 222))
    form = f" A sparse regression suggests {item.form}." if item.form.terms else ""
    about = f"The residual over what it changes with most, and means over equal numbers of values.{form}"
    title = f"{item.recording}: {item.channel} that the model lacks"
    return Figure(title, about, tuple(panels), beside=True)
