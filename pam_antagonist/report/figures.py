"""Figures that several commands draw: one function for each, from arrays; `x` and what is drawn over it are (N,)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.report import decimate
from pam_antagonist.report.figure import (
    TIME,
    Axis,
    Bars,
    Figure,
    FloatArray,
    Heatmap,
    Line,
    Panel,
    Points,
    Reference,
    Region,
    Series,
)
from pam_antagonist.report.style import DEEP, ESTIMATE, FAINT, MEASURED, MODEL, PALE, PALETTE, QUIET, SECOND


def seconds(stamp_ns: NDArray[np.int64], origin_ns: int) -> FloatArray:
    """Time of samples (N,) since an origin [s], from stamps [ns]."""
    return np.asarray((stamp_ns - origin_ns) * 1e-9, dtype=np.float64)


def moving_mean(values: FloatArray, window: int) -> FloatArray:
    """Centred mean of the finite values in `window` samples (N,); NaN without finite values."""
    known = np.isfinite(values)
    total = np.concatenate(([0.0], np.cumsum(np.where(known, values, 0.0))))
    count = np.concatenate(([0], np.cumsum(known)))
    low = np.maximum(np.arange(len(values)) - window // 2, 0)
    high = np.minimum(low + window, len(values))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((total[high] - total[low]) / (count[high] - count[low]))


def with_mean(name: str, x: FloatArray, values: FloatArray, color: str, window: int) -> tuple[Line, Line]:
    """Single samples as a faint line, and in front their moving mean, which reduces the sensor's noise."""
    faint = Line(name, x, values, color, width=0.8, quiet=True, opacity=0.3)
    return faint, Line(name, x, moving_mean(values, window), color, width=1.8, quiet=True)


def lines(x: FloatArray, values: Mapping[str, FloatArray], quiet: bool = False, width: float = 1.7) -> tuple[Line, ...]:
    """A line for each name, in the palette's colours. `values`: name -> samples (N,)."""
    named = zip(values.items(), PALETTE, strict=False)
    return tuple(Line(name, x, line, color, quiet=quiet, width=width) for (name, line), color in named)


def residual_figure(
    title: str,
    about: str,
    x: FloatArray,
    models: Sequence[tuple[str, FloatArray, str]],
    channels: Sequence[tuple[str, float]],
    noise: FloatArray | None,
    link: str,
    edges: Sequence[float] = (),
    held: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Residuals over time, a panel for each channel.

    `models`: name, residuals (N, C) and colour of each model. `noise`: standard deviation of each channel's noise (C,);
    dashed lines are drawn at twice this. None: no lines. `edges`: times [s] at which an effect begins or ends; a line
    is drawn at each. `held`: begin and end [s] of the held-out parts, which are shaded.
    """
    panels = []
    for k, (name, scale) in enumerate(channels):
        parts: list[Series] = [Region(begin, min(end, float(x[-1]))) for begin, end in held]
        parts += [Line(model, x, values[:, k] * scale, color, quiet=k > 0) for model, values, color in models]
        parts += [Reference(edge, f"{edge:.1f} s" if k == 0 else "", vertical=True) for edge in edges]
        if noise is not None:
            parts += [Reference(sign * 2.0 * float(noise[k]) * scale) for sign in (-1.0, 1.0)]
        height = 230 if len(channels) == 1 else 170 if noise is not None else 130
        panels.append(Panel(TIME, Axis(name), tuple(parts), height))
    return Figure(title, about, tuple(panels), link)


def tracking_figure(
    title: str,
    about: str,
    quantity: tuple[str, str],
    x: FloatArray,
    signals: tuple[FloatArray, FloatArray, FloatArray],
    link: str,
) -> Figure:
    """A control loop: what was measured, estimated and wanted (N,) over time, the tracking error below."""
    (name, unit), (measured, estimated, wanted) = quantity, signals
    shown = (
        Line("measured", x, measured, MEASURED),
        Line("UKF", x, estimated, ESTIMATE),
        Line("reference", x, wanted, MODEL, dash="dash"),
    )
    error = (Line("tracking error", x, wanted - measured, SECOND, quiet=True),)
    panels = (
        Panel(TIME, Axis(f"{name.capitalize()} [{unit}]"), shown, 250),
        Panel(TIME, Axis(f"Reference − measured [{unit}]"), error, 160),
    )
    return Figure(title, about, panels, link)


def nis_figure(x: FloatArray, nis: FloatArray, bounds: tuple[float, float], window: int, link: str) -> Figure:
    """Normalised innovation squared of two pressures over time, with the bounds of a consistent filter's 95 %."""
    parts = (
        Line("each sample", x, np.maximum(nis, 1e-3), FAINT, width=0.8),
        Line("mean over 1 s", x, moving_mean(nis, window), ESTIMATE, width=2.0),
        Reference(bounds[1], "97.5 %"),
        Reference(2.0, "expected mean: 2", MEASURED),
        Reference(bounds[0], "2.5 %"),
    )
    about = (
        "The pressures' innovations, relative to the covariance that the filter expects. Values below the lower bound "
        "are smaller than expected, values above the upper one larger. One sample in twenty lies outside by chance."
    )
    top = max(30.0, float(np.nanmax(nis, initial=0.0)) * 1.5)
    panel = Panel(TIME, Axis("NIS [-]", log=True, bounds=(1e-3, top)), parts, 230)
    return Figure("Normalised innovation squared (NIS)", about, (panel,), link)


def profile_panel(
    x_title: str,
    y_title: str,
    tried: Sequence[Line | Points],
    parabola: tuple[str, FloatArray, FloatArray, str],
    limit: float,
    height: int,
) -> Panel:
    """Profile likelihoods with the parabola of the standard error and the limit of the 95 % interval.

    `parabola`: name, x (N,), losses (N,) and colour. `limit`: loss at the end of a 95 % interval.
    """
    name, x, loss, color = parabola
    expected = Line(name, x, loss, color, dash="dot", width=1.6)
    bound = Line("95 %", x[[0, -1]], np.full(2, limit), QUIET, dash="dash", width=1.6)
    return Panel(Axis(x_title), Axis(y_title), (*tried, expected, bound), height)


def strip(names: Sequence[str], category: NDArray[np.int64], x: FloatArray, columns: int = 400) -> Panel:
    """Active category over time: one row for each category, darker where it is active for more of the time.

    `names`: of the categories, with a short name before a colon; a category that never occurs has no row. `category`:
    (N,) indices into `names`.
    """
    middle, share = decimate.shares(category, len(names), columns)
    seen = [int(number) for number in np.flatnonzero(share.sum(axis=1) > 0.0)]
    cells = np.where(share[seen] > 0.0, share[seen], np.nan)
    rows = tuple(names[number] for number in seen)
    hover = "{row}\n{column} s: {value:.0%} of the time"
    short = tuple(name.split(":")[0] for name in rows)
    y = Axis("Subsystem σ [-]", labels=short, bounds=(-0.5, len(seen) - 0.5))
    part = Heatmap(x[middle], cells, rows, (PALE, DEEP), (0.0, 1.0), hover)
    return Panel(TIME, y, (part,), max(66, 26 * len(seen) + 36))


def matrix(
    grids: Sequence[tuple[str, FloatArray]],
    rows: Sequence[str],
    columns: Sequence[str],
    colors: tuple[str, ...],
    bounds: tuple[float, float],
    cell: str,
) -> tuple[Panel, ...]:
    """Matrices of the same rows and columns, one above the other, with the number in each cell.

    `grids`: title and values (rows, columns) of each matrix. `colors`: of a :class:`Heatmap`. `cell`: format of
    ``value``.
    """
    x, y = Axis(labels=tuple(columns)), Axis(labels=tuple(rows))
    hover = "{row}, {column}: " + cell
    places = np.arange(len(columns), dtype=np.float64)
    return tuple(
        Panel(x, y, (Heatmap(places, values, tuple(rows), colors, bounds, hover, cell),), 26 * len(rows), title)
        for title, values in grids
    )


def autocorrelation(lag: FloatArray, groups: Sequence[tuple[str, FloatArray, str]], bound: float) -> Panel:
    """Correlation over lag (K,) [ms], with bounds that contain 95 % of a white series' values."""
    bars = [Bars(name, lag, values, color) for name, values, color in groups]
    bounds = [Reference(sign * bound) for sign in (-1.0, 1.0)]
    return Panel(Axis("Lag [ms]"), Axis("Correlation [-]"), (*bars, *bounds), 182)


def spreads(rows: Sequence[tuple[str, FloatArray, str]], title: str, log: bool = False) -> Panel:
    """A row of points for each name, values (K,) and colour; each point a repetition, with a bar at the median."""
    parts: list[Series] = []
    for number, (name, values, color) in enumerate(rows):
        known = np.asarray(values, dtype=np.float64)
        known = known[np.isfinite(known)]
        # A fixed jitter, so that points of equal value do not hide each other.
        place = number + 0.24 * (np.arange(len(known)) % 5 - 2) / 2
        parts.append(Points(name, known, place, color, opacity=0.45, quiet=True))
        if len(known):
            middle = np.full(2, float(np.median(known)))
            parts.append(Line(name, middle, np.array([number - 0.36, number + 0.36]), color, width=4.0, quiet=True))
    names = tuple(name for name, _, _ in rows)
    return Panel(Axis(title, log=log), Axis(labels=names), tuple(parts), 26 + 34 * len(rows))
