"""Axes of a plotly figure as matplotlib's: ranges, ticks, grid, level lines and their labels (see :mod:`.pictures`)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.report.picture_values import Reach, color, dashes, one_of, only, plain

_KEYS = (
    "title", "domain", "anchor", "matches", "type", "range", "nticks", "tickmode", "tickvals", "ticktext", "ticks",
    "ticklen", "showticklabels", "showline", "linecolor", "gridcolor", "zeroline", "zerolinecolor", "automargin",
)  # fmt: skip
_IDLE = ("meta", "hoverformat")
_PADDING = 0.055
"""Of a range, to either side; plotly's."""
_TICK_PX = {"x": 60.0, "y": 32.0}
"""Least distance of ticks."""


def check(name: str, axis: Mapping[str, Any], layout: Mapping[str, Any]) -> None:
    """Refuse an axis that pictures would draw otherwise than plotly.

    Args:
        name: its key in the layout.
        axis: its values.
        layout: the figure's.

    Raises:
        BadInput: such an axis.
    """
    only(name, axis, _KEYS, _IDLE)
    only(f"{name}: title", axis.get("title", {}), ("text", "standoff"))
    one_of(f"{name}: type", axis.get("type", "linear"), ("linear", "log", "category"))
    one_of(f"{name}: showline", axis.get("showline"), (True,))
    one_of(f"{name}: ticks", axis.get("ticks"), ("outside", ""))
    side, suffix = name[0], name[len("xaxis") :]
    one_of(f"{name}: anchor", axis.get("anchor", ("y" if side == "x" else "x") + suffix),
           (("y" if side == "x" else "x") + suffix,))  # fmt: skip
    if "matches" in axis:
        one_of(f"{name}: matches", axis["matches"], [key.replace("axis", "") for key in layout if key[1:5] == "axis"])
    if axis.get("type") == "category" and "tickvals" not in axis:
        raise BadInput(f"{name}: pictures do not name categories by themselves; expected tickvals and ticktext")


def span(axis: Mapping[str, Any], reaches: Sequence[Reach]) -> tuple[float, float]:
    """The range of an axis, in its own numbers: not their logarithms.

    Args:
        axis: plotly's.
        reaches: what it has to hold.
    """
    log = axis.get("type") == "log"
    if "range" in axis:
        low, high = (float(end) for end in axis["range"])
        return (10.0**low, 10.0**high) if log else (low, high)
    known = [reach.values[np.isfinite(reach.values) & ((reach.values > 0.0) | (not log))] for reach in reaches]
    values = np.concatenate([*known, np.zeros(0)])
    if not values.size:
        return (1.0, 10.0) if log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if log:
        low, high = math.log10(low), math.log10(high)
    if low == high:
        low, high = low - 1.0, high + 1.0
    elif any(reach.padded for reach in reaches):
        low, high = low - _PADDING * (high - low), high + _PADDING * (high - low)
    return (10.0**low, 10.0**high) if log else (low, high)


def dress(axes: Any, side: str, name: str, axis: Mapping[str, Any], ends: tuple[float, float], length: float) -> None:
    """Range, ticks, labels, title and lines of one axis.

    Args:
        axes: matplotlib's.
        side: ``x`` or ``y``.
        name: its key in the layout, for messages.
        axis: plotly's values.
        ends: of its range.
        length: of the axis [px].
    """
    from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator, ScalarFormatter

    drawn = getattr(axes, f"{side}axis")
    log = axis.get("type") == "log"
    getattr(axes, f"set_{side}lim")(*ends)
    most = max(2, min(int(axis.get("nticks", 12)), int(length / _TICK_PX[side])))
    if "tickvals" in axis:
        low, high = sorted(ends)
        shown = [(place, plain(name, text)) for place, text in zip(axis["tickvals"], axis["ticktext"], strict=True)
                 if low <= place <= high]  # fmt: skip
        drawn.set_major_locator(FixedLocator([place for place, _ in shown]))
        drawn.set_major_formatter(FixedFormatter([text for _, text in shown]))
    elif log:
        places = _log_ticks(ends, most)
        drawn.set_major_locator(FixedLocator(places))
        drawn.set_major_formatter(FixedFormatter([f"{place:g}" for place in places]))
    else:
        drawn.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]))
        drawn.set_major_formatter(ScalarFormatter(useOffset=False))
    drawn.set_minor_locator(NullLocator())
    line = color(f"{name}: linecolor", axis["linecolor"])
    edge, far = ("bottom", "top") if side == "x" else ("left", "right")
    axes.spines[far].set_visible(False)
    axes.spines[edge].set(color=line, linewidth=1.0)
    labelled = axis.get("showticklabels", True)
    size = float(axis.get("ticklen", 5)) if axis["ticks"] else 0.0
    axes.tick_params(axis=side, length=size, width=1.0, color=line, pad=3.0, **{f"label{edge}": labelled})
    axes.grid(True, axis=side, color=color(f"{name}: gridcolor", axis["gridcolor"]), linewidth=1.0)
    title = axis.get("title", {})
    if "text" in title:
        getattr(axes, f"set_{side}label")(plain(f"{name}: title", title["text"]), labelpad=float(title["standoff"]))
    if axis.get("zeroline", True) and axis.get("type", "linear") == "linear" and min(ends) < 0.0 < max(ends):
        zero = color(f"{name}: zerolinecolor", axis["zerolinecolor"])
        (axes.axvline if side == "x" else axes.axhline)(0.0, color=zero, linewidth=1.0, zorder=1.5)


def _log_ticks(ends: tuple[float, float], most: int) -> list[float]:
    """Round numbers between two: as many of a decade as make at least three of them, else evenly spaced ones."""
    from matplotlib.ticker import MaxNLocator

    low, high = sorted(ends)
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in ((1,), (1, 2, 5), tuple(range(1, 10))):
        places = [digit * 10.0**power for power in decades for digit in digits]
        places = [place for place in places if low <= place <= high]
        if len(places) >= 3:
            return places
    even = MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [float(place) for place in even if low <= place <= high]


def check_levels(
    shapes: Sequence[Mapping[str, Any]], labels: Sequence[Mapping[str, Any]], pairs: Iterable[str]
) -> None:
    """Refuse shapes that are no level lines, and annotations that are not their labels.

    Args:
        shapes: plotly's.
        labels: plotly's annotations.
        pairs: suffixes of the figure's axes.

    Raises:
        BadInput: such a shape or annotation.
    """
    places = [(f"x{suffix} domain", f"y{suffix}") for suffix in pairs]
    for shape in shapes:
        only("shape", shape, ("type", "xref", "yref", "x0", "x1", "y0", "y1", "line"))
        only("shape: line", shape["line"], ("color", "width", "dash"))
        one_of("shape: type", shape["type"], ("line",))
        one_of("shape: xref and yref", (shape["xref"], shape["yref"]), places)
    for label in labels:
        only("annotation", label, ("xref", "yref", "x", "y", "xanchor", "yanchor", "text", "showarrow", "font",
                                   "bgcolor"))  # fmt: skip
        only("annotation: font", label["font"], ("size", "color"))
        one_of("annotation: showarrow", label.get("showarrow", True), (False,))
        one_of("annotation: xref and yref", (label["xref"], label["yref"]), places)


def level_reach(shapes: Sequence[Mapping[str, Any]], suffix: str) -> list[Reach]:
    """What the level lines on a pair of axes need of its vertical axis."""
    own = [shape for shape in shapes if shape["yref"] == "y" + suffix]
    return [Reach(np.array([shape["y0"], shape["y1"]], dtype=np.float64), True) for shape in own]


def draw_levels(axes: Any, shapes: Sequence[Mapping[str, Any]], suffix: str) -> None:
    """Lines over the whole width of a pair of axes."""
    for shape in shapes:
        if shape["yref"] == "y" + suffix:
            width = float(shape["line"]["width"])
            axes.plot(
                [shape["x0"], shape["x1"]],
                [shape["y0"], shape["y1"]],
                color=color("shape: color", shape["line"]["color"]),
                linewidth=width,
                linestyle=dashes("shape: dash", shape["line"].get("dash", "solid"), width),
                transform=axes.get_yaxis_transform(),
                zorder=4.0,
            )


def draw_labels(axes: Any, labels: Sequence[Mapping[str, Any]], suffix: str, log: bool) -> None:
    """Texts beside level lines.

    Args:
        axes: matplotlib's, with its final range.
        labels: plotly's annotations.
        suffix: of the pair of axes.
        log: the vertical axis is logarithmic; plotly gives logarithms for such texts, but not for lines.
    """
    low, high = sorted(axes.get_ylim())
    upright = {"bottom": "bottom", "middle": "center", "top": "top"}
    beside = {"bottom": 2.0, "middle": 0.0, "top": -2.0}
    for label in labels:
        height = 10.0 ** float(label["y"]) if log else float(label["y"])
        # What lies beyond the range plotly does not show either.
        if label["yref"] == "y" + suffix and low <= height <= high:
            axes.annotate(
                plain("annotation", label["text"]),
                (label["x"], height),
                xycoords=axes.get_yaxis_transform(),
                # Not on the line itself.
                xytext=(0.0, beside[one_of("annotation: yanchor", label["yanchor"], beside)]),
                textcoords="offset points",
                horizontalalignment=one_of("annotation: xanchor", label["xanchor"], ("left", "center", "right")),
                verticalalignment=upright[label["yanchor"]],
                fontsize=float(label["font"]["size"]),
                color=color("annotation: color", label["font"]["color"]),
                bbox={"facecolor": color("annotation", label["bgcolor"]), "edgecolor": "none", "pad": 1.0},
                zorder=5.0,
            )
