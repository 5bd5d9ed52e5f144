"""Figures as PNG pictures, drawn by matplotlib, for documents without scripts.

With one version of matplotlib, equal figures give equal bytes, independent of the user's settings. matplotlib is
imported only where needed, so that nodes do not load it.
"""

from __future__ import annotations

import io
import math
import re
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs
from pam_antagonist.report import decimate
from pam_antagonist.report.figure import Axis, Band, Bars, Figure, Heatmap, Line, Panel, Points, Reference, Region
from pam_antagonist.report.style import GRID, INK, QUIET, VEIL, ZERO

FloatArray = NDArray[np.float64]

WIDTH = 900
"""Width of a picture, in the pixels of the figure's sizes."""
SHARPNESS = 1.5
"""Pixels of the file for each pixel of the figure."""
MARK = "pam_antagonist"
"""Name of the software in the file, which :func:`made_here` looks for."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_INCH = 72.0
"""Pixels of the figure in an inch, so that a pixel is a point, matplotlib's unit of line widths and letters."""
_EDGE = 4.0
"""Least distance of letters from the picture's edge [px]."""
_TOLERANCE = 24
"""Largest error of a colour, in 1/256."""
_PADDING = 0.055
"""Margin on either side, relative to the range; as in plotly."""
_TICK = {"x": 60.0, "y": 32.0}
"""Least distance of ticks [px]."""
_DASHES = {"": (), "dot": (1.0, 1.0), "dash": (3.0, 3.0)}
"""Lengths in line widths; thin lines use the lengths of a line of 3 px, as in plotly."""
_RGBA = re.compile(r"rgba\((.+),(.+),(.+),(.+)\)")
_LETTERS = ("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor")
_SETTINGS = {"font.size": 12.0, "axes.labelsize": 12.0, "legend.fontsize": 12.0, "axes.axisbelow": True,
             "axes.facecolor": "none", "agg.path.chunksize": 10000, **dict.fromkeys(_LETTERS, INK)}  # fmt: skip
_BOTTOM = 3.0
"""Drawing order: series are above grid and zero line, in the given order."""


def picture(figure: Figure) -> bytes:
    """A figure as a PNG file.

    Args:
        figure: what to draw.

    Raises:
        BadInput: a colour or a letter that matplotlib does not know, or matplotlib is not installed.
    """
    with needs("test", "pictures"):
        import matplotlib
        from PIL import Image
        from PIL.PngImagePlugin import PngInfo
    out = io.BytesIO()
    with matplotlib.rc_context(), warnings.catch_warnings():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_SETTINGS)
        # Make missing letters an error; they would be drawn as empty boxes.
        warnings.filterwarnings("error", message="Glyph")
        try:
            drawn = _drawn(figure)
            drawn.set_dpi(_INCH * SHARPNESS)
            drawn.canvas.draw()
        except UserWarning as warning:
            raise BadInput(f"{figure.title}: {warning}; expected letters of DejaVu Sans") from None
        pixels = np.asarray(drawn.canvas.buffer_rgba())[..., :3].copy()
    software = PngInfo()
    software.add_text("Software", MARK)
    _fewer_colors(Image.fromarray(pixels)).save(out, "png", optimize=True, pnginfo=software)
    return out.getvalue()


def made_here(content: bytes) -> bool:
    """Whether a file is a picture of :func:`picture`."""
    return content.startswith(_SIGNATURE) and b"tEXtSoftware\0" + MARK.encode() in content[:2000]


def _fewer_colors(image: Any) -> Any:
    """The image with a palette, a third of the size, if no colour visibly changes; otherwise the image itself."""
    from PIL import Image

    # Median cut would merge the colour of a short line with another one.
    few = image.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    off = np.abs(np.asarray(few.convert("RGB"), dtype=np.int16) - np.asarray(image, dtype=np.int16))
    return few if off.max() <= _TOLERANCE else image


def _drawn(figure: Figure) -> Any:
    """The matplotlib figure, drawn but not written."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    canvas = Canvas(figsize=(WIDTH / _INCH, figure.height / _INCH), facecolor="white")
    FigureCanvasAgg(canvas)
    pairs = [canvas.add_axes((0.0, 0.0, 1.0, 1.0), label=str(number)) for number in range(len(figure.panels))]
    keys: dict[str, Any] = {}
    for axes, panel in zip(pairs, figure.panels, strict=True):
        for side, axis in (("x", panel.x), ("y", panel.y)):
            options = {"nonpositive": "mask"} if axis.log else {}
            getattr(axes, f"set_{side}scale")("log" if axis.log else "linear", **options)
        axes.set_autoscale_on(False)
        for number, part in enumerate(panel.series):
            key = _series(axes, part, panel, _BOTTOM + 1e-3 * number)
            if key is not None and not getattr(part, "quiet", True):
                keys.setdefault(_plain(part.name), key)  # type: ignore[union-attr]
    left, right, _, _ = figure.margins
    legend = _legend(canvas, keys, WIDTH - left - right)
    _place(canvas, figure, pairs, legend, (left, right))
    for axes, panel in zip(pairs, figure.panels, strict=True):
        over = (panel,) if figure.beside else figure.panels
        _dress(axes, "x", panel, _ends(panel, "x", over), figure.beside or panel is figure.panels[-1])
        _dress(axes, "y", panel, _ends(panel, "y", (panel,)), True)
        for part in panel.series:
            if isinstance(part, Reference):
                _label(axes, part)
        if panel.title:
            axes.set_title(_plain(panel.title), loc="left", fontsize=12.0, pad=3.0)
    # Widen the margins where labels need more room.
    renderer = canvas.canvas.get_renderer()
    standing = [part for axes in pairs for part in (axes.xaxis, axes.yaxis, *axes.child_axes)]
    found = [part.get_tightbbox(renderer) for part in standing]
    # An axis without letters has no box.
    boxes = [box for box in found if box is not None]
    scale = _INCH / canvas.dpi
    wider = max(0.0, _EDGE - scale * min(box.x0 for box in boxes))
    other = max(0.0, _EDGE - (WIDTH - scale * max(box.x1 for box in boxes)))
    lower = max(0.0, _EDGE - scale * min(box.y0 for box in boxes))
    if wider or other or lower:
        _place(canvas, figure, pairs, legend, (left + wider, right + other), lower)
    return canvas


def _series(axes: Any, part: Any, panel: Panel, depth: float) -> Any:
    """Draw a series; returns its handle for the legend, None without one."""
    from matplotlib.collections import PolyCollection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    if isinstance(part, Line):
        x, y = decimate.curve(part.x, part.y, panel.x.is_time)
        style = {"color": _color(part.color), "linewidth": part.width, "solid_joinstyle": "round"}
        style |= {"linestyle": _dashes(part.dash, part.width), "alpha": part.opacity if part.opacity < 1.0 else None}
        axes.add_line(Line2D(x, y, zorder=depth, **style))
        return Line2D([], [], **style)
    if isinstance(part, Band):
        runs = decimate.band(part.x, part.lower, part.upper, panel.x.is_time)
        outlines = [np.column_stack([np.r_[x, x[::-1]], np.r_[high, low[::-1]]]) for x, low, high in runs]
        style = {"facecolor": _color(part.color), "edgecolor": "none"}
        axes.add_collection(PolyCollection(outlines, zorder=depth, **style), autolim=False)
        return Patch(**style)
    if isinstance(part, Points):
        *solid, alpha = _color(part.color)
        shade = (*solid, alpha * part.opacity)
        style = {"linestyle": "none", "marker": "o", "markersize": part.size}
        style |= {"markerfacecolor": "none" if part.hollow else shade}
        style |= {"markeredgecolor": shade if part.hollow else "none"}
        axes.add_line(Line2D(part.x, part.y, zorder=depth, **style))
        if part.half_width is not None:
            ends = (part.x - part.half_width, part.x + part.half_width)
            axes.hlines(part.y, *ends, color=shade, linewidth=part.bar_width, zorder=depth)
            style |= {"linestyle": "-", "linewidth": part.bar_width, "color": shade}
        return Line2D([], [], **style)
    if isinstance(part, Bars):
        bars = [other for other in panel.series if isinstance(other, Bars)]
        places, step = _steps(bars)
        width = step * 0.65 / len(bars)
        turn = next(k for k, other in enumerate(bars) if other is part) - (len(bars) - 1) / 2
        shade = _color(part.color)
        axes.bar(part.x + turn * width, part.y, width, color=shade, zorder=depth)
        return Patch(facecolor=shade, edgecolor="none")
    if isinstance(part, Heatmap):
        _heatmap(axes, part, depth)
    elif isinstance(part, Region):
        axes.axvspan(part.first, part.last, facecolor=_color(part.color), edgecolor="none", zorder=0.5)
    elif isinstance(part, Reference):
        line = axes.axvline if part.vertical else axes.axhline
        line(part.value, color=_color(part.color), linewidth=1.4, linestyle=_dashes("dash", 1.4), zorder=4.0)
    else:
        raise BadInput(f"pictures do not draw {type(part).__name__}; expected a series of a figure")
    return None


def _heatmap(axes: Any, part: Heatmap, depth: float) -> None:
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    shades = LinearSegmentedColormap.from_list("scale", [_color(color) for color in part.colors])
    cells, norm = np.ma.masked_invalid(part.values), Normalize(*part.bounds)
    edges, rows = _edges(part.x), np.arange(len(part.rows) + 1) - 0.5
    line = {"edgecolors": "white", "linewidth": 1.0} if part.cell else {}
    axes.pcolormesh(edges, rows, cells, cmap=shades, norm=norm, zorder=depth, **line)
    if not part.cell:
        return
    for row, values in enumerate(part.values):
        for column, value in zip(part.x, values, strict=True):
            if math.isfinite(value):
                red, green, blue, _ = shades(norm(value))
                ink = "white" if 0.3 * red + 0.59 * green + 0.11 * blue < 0.5 else INK
                text = _plain(part.cell.format(value=value))
                axes.text(column, row, text, ha="center", va="center", color=ink, fontsize=11.0, zorder=depth + 0.1)


def _edges(x: FloatArray) -> FloatArray:
    """Edges of columns, midway between their centres."""
    half = np.diff(x) / 2 if len(x) > 1 else np.array([0.5])
    return np.concatenate([x[:1] - half[:1], (x[:-1] + x[1:]) / 2, x[-1:] + half[-1:]])


def _steps(bars: list[Bars]) -> tuple[FloatArray, float]:
    """Positions of groups of bars, and their distance."""
    places = np.unique(np.concatenate([other.x for other in bars]))
    return places, float(np.min(np.diff(places))) if len(places) > 1 else 1.0


def _color(text: str) -> tuple[float, float, float, float]:
    """A CSS colour as red, green, blue and alpha from 0 to 1.

    Raises:
        BadInput: not of the form ``#rrggbb`` or ``rgba(r, g, b, a)``.
    """
    from matplotlib.colors import to_rgba

    try:
        match = _RGBA.fullmatch(text)
        if match is None:
            return to_rgba(text)
        red, green, blue, alpha = (float(part) for part in match.groups())
        return to_rgba((red / 255.0, green / 255.0, blue / 255.0), alpha)
    except ValueError:
        raise BadInput(f"{text!r} is no colour; expected #rrggbb or rgba(r, g, b, a)") from None


def _dashes(dash: str, width: float) -> tuple[float, tuple[float, ...] | None]:
    """Matplotlib's line style."""
    if dash not in _DASHES:
        raise BadInput(f"pictures do not draw {dash!r} lines; expected {', '.join(map(repr, _DASHES))}")
    return 0.0, tuple(length * max(width, 3.0) / width for length in _DASHES[dash]) or None


def _plain(text: str) -> str:
    """A text for matplotlib, with dollar signs escaped because they would begin a formula."""
    return text.replace("$", r"\$")


def _reach(part: Any, side: str, panel: Panel) -> tuple[FloatArray, bool]:
    """Values of a series that an axis must include, and whether a margin is added."""
    nothing = np.zeros(0)
    if isinstance(part, Reference):
        return (np.array([part.value]), not part.vertical) if part.vertical == (side == "x") else (nothing, False)
    if isinstance(part, Region):
        return nothing, False
    if isinstance(part, Heatmap):
        return (_edges(part.x) if side == "x" else np.array([-0.5, len(part.rows) - 0.5])), False
    if isinstance(part, Bars):
        places, step = _steps([part])
        edges = np.concatenate([places - step / 2, places + step / 2])
        return (edges, False) if side == "x" else (np.append(part.y, 0.0), True)
    if isinstance(part, Band):
        return (part.x, False) if side == "x" else (np.concatenate([part.lower, part.upper]), True)
    if isinstance(part, Points) and side == "x" and part.half_width is not None:
        return np.concatenate([part.x - part.half_width, part.x + part.half_width]), True
    return (part.x, isinstance(part, Points)) if side == "x" else (part.y, True)


def _ends(panel: Panel, side: str, panels: tuple[Panel, ...]) -> tuple[float, float]:
    """Range of an axis for the series of these panels, with margins as in plotly."""
    axis: Axis = getattr(panel, side)
    if axis.bounds:
        return axis.bounds
    if axis.labels and side == "y":
        return len(axis.labels) - 0.5, -0.5
    reaches = [_reach(part, side, other) for other in panels for part in other.series]
    values = np.concatenate([np.zeros(1 if axis.from_zero else 0), *(reach for reach, _ in reaches)])
    values = values[np.isfinite(values) & ((values > 0.0) | (not axis.log))]
    if not values.size:
        return (1.0, 10.0) if axis.log else (0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if axis.log:
        low, high = math.log10(low), math.log10(high)
    if low == high:
        low, high = low - 1.0, high + 1.0
    elif any(padded for _, padded in reaches):
        room = _PADDING * (high - low)
        low, high = (low if axis.from_zero and low == 0.0 else low - room), high + room
    return (10.0**low, 10.0**high) if axis.log else (low, high)


def _dress(axes: Any, side: str, panel: Panel, ends: tuple[float, float], labelled: bool) -> None:
    """Range, ticks, labels, title and lines of one axis."""
    from matplotlib.ticker import MaxNLocator, NullLocator, ScalarFormatter

    axis: Axis = getattr(panel, side)
    drawn = getattr(axes, f"{side}axis")
    getattr(axes, f"set_{side}lim")(*ends)
    box = axes.get_window_extent()
    length = (box.width if side == "x" else box.height) * _INCH / axes.figure.dpi
    most = max(2, min(12 if side == "x" else 6, int(length / _TICK[side])))
    size = 12.0
    if axis.labels:
        drawn.set_ticks(range(len(axis.labels)), [_plain(name) for name in axis.labels])
        size = 12.0 if length / len(axis.labels) > (60.0 if side == "x" else 20.0) else 9.0
    elif axis.log:
        places = _log_ticks(ends, most)
        drawn.set_ticks(places, [f"{place:g}" for place in places])
    else:
        drawn.set_major_locator(MaxNLocator(most, steps=[1, 2, 5, 10]))
        drawn.set_major_formatter(ScalarFormatter(useOffset=False))
    drawn.set_minor_locator(NullLocator())
    edge, far = ("bottom", "top") if side == "x" else ("left", "right")
    axes.spines[far].set_visible(False)
    axes.spines[edge].set(color=_color(QUIET), linewidth=1.0)
    ticks = {"length": 4.0 if labelled else 0.0, "width": 1.0, "color": _color(QUIET), "pad": 3.0, "labelsize": size}
    axes.tick_params(axis=side, **ticks, **{f"label{edge}": labelled})
    if size < 12.0 and side == "x":
        axes.tick_params(axis="x", labelrotation=60.0)
    axes.grid(not panel.x.labels, axis=side, **({} if panel.x.labels else {"color": _color(GRID), "linewidth": 1.0}))
    if labelled:
        getattr(axes, f"set_{side}label")(_plain(axis.title), labelpad=6.0 if side == "x" else 4.0)
    zero = not (axis.log or axis.labels) and (side == "y" or (bool(panel.y.labels) and not axis.is_time))
    if zero and min(ends) < 0.0 < max(ends):
        (axes.axvline if side == "x" else axes.axhline)(0.0, color=_color(ZERO), linewidth=1.0, zorder=1.5)


def _log_ticks(ends: tuple[float, float], most: int) -> list[float]:
    """Round tick values within a range: powers of ten, more digits until there are three, else evenly spaced ones."""
    from matplotlib.ticker import MaxNLocator

    low, high = sorted(ends)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for digits in ((1,), (1, 2, 5), tuple(range(1, 10))):
        places = [digit * 10.0**power for power in powers for digit in digits]
        places = [place for place in places if low <= place <= high]
        if len(places) >= 3:
            return places
    even = MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [float(place) for place in even if low <= place <= high]


def _label(axes: Any, part: Reference) -> None:
    """Draw the text at the end of a reference line, unless the line is out of range (as in plotly)."""
    low, high = sorted(axes.get_ylim())
    if part.label and low <= part.value <= high:
        axes.annotate(
            _plain(part.label), (1.0, part.value), xycoords=axes.get_yaxis_transform(),
            # Not on the line itself.
            xytext=(0.0, 2.0), textcoords="offset points", horizontalalignment="right", verticalalignment="bottom",
            fontsize=11.0, color=_color(part.color), zorder=5.0,
            bbox={"facecolor": _color(VEIL), "edgecolor": "none", "pad": 1.0},
        )  # fmt: skip


def _legend(canvas: Any, keys: dict[str, Any], room: float) -> Any:
    """A legend over the whole width, in as few lines as possible; None without names."""
    shown = list(keys.items())
    for columns in range(len(shown), 0, -1):
        # matplotlib fills the legend by columns; reorder the names so that they read by lines.
        names, signs = zip(*(pair for column in range(columns) for pair in shown[column::columns]), strict=True)
        legend = canvas.legend(
            signs, names, ncol=columns, loc="lower left", frameon=False, borderpad=0.0, borderaxespad=0.0,
            handlelength=2.2, handletextpad=0.5, columnspacing=1.4, labelspacing=0.35,
        )  # fmt: skip
        if columns == 1 or legend.get_window_extent(canvas.canvas.get_renderer()).width * _INCH / canvas.dpi <= room:
            return legend
        legend.remove()
    return None


def _place(
    canvas: Any, figure: Figure, pairs: list[Any], legend: Any, sides: tuple[float, float], lower: float = 0.0
) -> None:
    """Position axes and legend; the picture grows if the legend or labels exceed their margins."""
    (left, right), (_, _, top, bottom), gap = sides, figure.margins, 6.0
    inner, above = figure.height - top - bottom, float(top)
    if legend is not None:
        box = legend.get_window_extent(canvas.canvas.get_renderer())
        above = max(above, box.height * _INCH / canvas.dpi + 2 * gap)
    height, width = above + inner + bottom + lower, WIDTH - left - right
    canvas.set_size_inches(WIDTH / _INCH, height / _INCH)
    for axes, (start, end, low, high) in zip(pairs, figure.areas(), strict=True):
        x0, x1 = ((left + share * width) / WIDTH for share in (start, end))
        y0, y1 = ((bottom + lower + share * inner) / height for share in (low, high))
        axes.set_position((x0, y0, x1 - x0, y1 - y0))
    if legend is not None:
        legend.set_bbox_to_anchor((left / WIDTH, (height - above + gap) / height))
