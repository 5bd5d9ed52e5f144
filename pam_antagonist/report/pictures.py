"""Figures as PNG pictures, for documents that run no script: plotly's values, drawn by matplotlib.

A picture shows what the figures of this package use of plotly. Everything else is refused by name, so that no picture
lacks something without a word. Equal values give equal bytes with one version of matplotlib, whatever the user's own
settings of it are. matplotlib is imported where it is needed: nodes never load it.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.report import picture_axes, picture_traces
from pam_antagonist.report.picture_traces import Drawn
from pam_antagonist.report.picture_values import color, one_of, only, plain

WIDTH = 900
"""Of a picture, in the pixels of the figure's own sizes."""
SHARPNESS = 1.5
"""Pixels of the file for one of those."""
MARK = "pam_antagonist"
"""What the file names as its software: :func:`made_here` finds it."""

_LAYOUT = ("height", "margin", "font", "paper_bgcolor", "plot_bgcolor", "legend", "showlegend", "shapes",
           "annotations", "barmode", "bargap")  # fmt: skip
_LEGEND = {"orientation": "h", "x": 0, "y": 1, "yanchor": "bottom", "itemsizing": "constant"}
_CLEAR = "rgba(0,0,0,0)"
_INCH = 72.0
"""Figure's pixels an inch: one is then a point, the unit of matplotlib's line widths and letters."""
_EDGE = 4.0
"""Least distance of letters from the picture's edge [px]."""
_TOLERANCE = 24
"""Of a colour, in steps of 256."""
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def picture(plot: Mapping[str, Any]) -> bytes:
    """A figure as a PNG file.

    Args:
        plot: plotly's ``data`` and ``layout`` as plain values.

    Raises:
        BadInput: the figure has something that pictures do not draw, or matplotlib is not installed.
    """
    try:
        import matplotlib
        from PIL import Image
        from PIL.PngImagePlugin import PngInfo
    except ImportError:
        raise BadInput("matplotlib is not installed: install python3-matplotlib (or matplotlib by pip)") from None
    only("figure", plot, ("data", "layout"))
    out = io.BytesIO()
    with matplotlib.rc_context(), warnings.catch_warnings():
        matplotlib.rcdefaults()
        # A letter that the font lacks would be an empty box.
        warnings.filterwarnings("error", message="Glyph")
        try:
            figure = _figure(plot["data"], plot["layout"])
            figure.set_dpi(_INCH * SHARPNESS)
            figure.canvas.draw()
        except UserWarning as warning:
            raise BadInput(f"figure: {warning}; expected letters of DejaVu Sans") from None
        pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3].copy()
    software = PngInfo()
    software.add_text("Software", MARK)
    _fewer_colors(Image.fromarray(pixels)).save(out, "png", optimize=True, pnginfo=software)
    return out.getvalue()


def _fewer_colors(image: Any) -> Any:
    """The image with a palette, a third of the size, where no colour is off by more than an eye can see."""
    from PIL import Image

    # Not the usual median cut: that gives the colour of a short line to another one.
    few = image.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    off = np.abs(np.asarray(few.convert("RGB"), dtype=np.int16) - np.asarray(image, dtype=np.int16))
    return few if off.max() <= _TOLERANCE else image


def made_here(content: bytes) -> bool:
    """Whether a file's content is a picture that :func:`picture` has made."""
    return content.startswith(_SIGNATURE) and b"tEXtSoftware\0" + MARK.encode() in content[:2000]


def _figure(data: Sequence[Mapping[str, Any]], layout: Mapping[str, Any]) -> Any:
    """The figure, drawn but not yet written."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = [key for key in layout if re.fullmatch(r"[xy]axis\d*", key)]
    only("layout", layout, (*_LAYOUT, *names), ("hovermode", "modebar"))
    for key in ("paper_bgcolor", "plot_bgcolor"):
        one_of(f"layout: {key}", layout.get(key), (_CLEAR,))
    only("layout: font", layout["font"], ("family", "size", "color"))
    only("layout: margin", layout["margin"], ("l", "r", "t", "b"))
    ink, size = color("layout: font", layout["font"]["color"]), float(layout["font"]["size"])
    matplotlib.rcParams.update(
        {
            "font.size": size,
            "axes.labelsize": size,
            "xtick.labelsize": size,
            "ytick.labelsize": size,
            "legend.fontsize": size,
            **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), ink),
            "axes.axisbelow": True,
            "axes.facecolor": "none",
            "agg.path.chunksize": 10000,
        }
    )
    figure = Figure(figsize=(WIDTH / _INCH, float(layout["height"]) / _INCH), facecolor="white")
    FigureCanvasAgg(figure)
    suffixes = [name[len("xaxis") :] for name in names if name.startswith("x")]
    if sorted(names) != sorted(side + "axis" + suffix for side in "xy" for suffix in suffixes):
        raise BadInput(f"layout: {', '.join(names)}; expected axes in pairs")
    pairs = {suffix: figure.add_axes((0.0, 0.0, 1.0, 1.0)) for suffix in suffixes}
    drawn = _draw(data, layout, pairs)
    margin = {side: float(layout["margin"][side]) for side in "lrtb"}
    legend = _legend(figure, data, drawn, layout, margin)
    _place(figure, layout, pairs, margin, legend)
    _dress(layout, pairs, drawn, data)
    _widen(figure, layout, pairs, margin, legend)
    return figure


def _draw(data: Sequence[Mapping[str, Any]], layout: Mapping[str, Any], pairs: Mapping[str, Any]) -> list[Drawn]:
    """Every trace on its axes; the result is in the order of the traces."""
    home = []
    for number, trace in enumerate(data):
        at = [trace.get(side + "axis", side) for side in "xy"]
        if at[0][1:] != at[1][1:] or at[0][1:] not in pairs:
            raise BadInput(f"trace {number}: on axes {at[0]} and {at[1]}; expected a pair of the layout")
        home.append(at[0][1:])
    drawn: dict[int, Drawn] = {}
    for suffix, axes in pairs.items():
        own = [number for number, at in enumerate(home) if at == suffix]
        # The scale comes first: it sets an axis back.
        for side in "xy":
            log = layout[f"{side}axis{suffix}"].get("type") == "log"
            getattr(axes, f"set_{side}scale")("log" if log else "linear", **({"nonpositive": "mask"} if log else {}))
        axes.set_autoscale_on(False)
        drawn |= zip(own, picture_traces.draw(axes, [data[k] for k in own], own, layout), strict=True)
    return [drawn[number] for number in range(len(data))]


def _dress(
    layout: Mapping[str, Any], pairs: Mapping[str, Any], drawn: Sequence[Drawn], data: Sequence[Mapping[str, Any]]
) -> None:
    """Ranges, ticks and titles, then what lies at fixed values."""
    shapes, labels = layout.get("shapes", ()), layout.get("annotations", ())
    picture_axes.check_levels(shapes, labels, pairs)
    group = {
        side + suffix: layout[f"{side}axis{suffix}"].get("matches", side + suffix) for side in "xy" for suffix in pairs
    }
    needs: dict[str, list[Any]] = {name: [] for name in group.values()}
    for trace, item in zip(data, drawn, strict=True):
        for side, reach in (("x", item.x), ("y", item.y)):
            needs[group[trace.get(side + "axis", side)]].append(reach)
    for suffix in pairs:
        needs[group["y" + suffix]] += picture_axes.level_reach(shapes, suffix)
    for suffix, axes in pairs.items():
        box = axes.get_window_extent()
        for side, length in (("x", box.width), ("y", box.height)):
            name = f"{side}axis{suffix}"
            axis = layout[name]
            picture_axes.check(name, axis, layout)
            ends = picture_axes.span(axis, needs[group[side + suffix]])
            picture_axes.dress(axes, side, name, axis, ends, length * _INCH / axes.figure.dpi)
        picture_axes.draw_levels(axes, shapes, suffix)
        picture_axes.draw_labels(axes, labels, suffix, layout["yaxis" + suffix].get("type") == "log")


def _legend(
    figure: Any,
    data: Sequence[Mapping[str, Any]],
    drawn: Sequence[Drawn],
    layout: Mapping[str, Any],
    margin: Mapping[str, float],
) -> Any:
    """A legend over the whole width, in as few lines as it fits into; None where nothing is named."""
    shown = [
        (item.key, plain("legend", trace["name"]))
        for trace, item in zip(data, drawn, strict=True)
        if item.key is not None and trace.get("showlegend", True) and layout.get("showlegend", True)
    ]
    # As plotly: a single trace is named only where that is asked for.
    if not shown or (len(data) == 1 and "showlegend" not in data[0]):
        return None
    if layout["legend"] != _LEGEND:
        raise BadInput(f"layout: legend {layout['legend']}; expected {_LEGEND}")
    room = WIDTH - margin["l"] - margin["r"]
    for columns in range(len(shown), 0, -1):
        # matplotlib fills column by column, readers read line by line.
        keys, names = zip(*(pair for column in range(columns) for pair in shown[column::columns]), strict=True)
        legend = figure.legend(
            keys, names, ncol=columns, loc="lower left", frameon=False, borderpad=0.0, borderaxespad=0.0,
            handlelength=2.2, handletextpad=0.5, columnspacing=1.4, labelspacing=0.35,
        )  # fmt: skip
        if columns == 1 or _pixels(figure, legend).width <= room:
            return legend
        legend.remove()
    return None


def _pixels(figure: Any, artist: Any) -> Any:
    """Box of something drawn, in the figure's pixels from its lower left corner."""
    from matplotlib.transforms import Affine2D

    box = artist.get_window_extent(figure.canvas.get_renderer())
    return box.transformed(Affine2D().scale(_INCH / figure.dpi))


def _place(
    figure: Any, layout: Mapping[str, Any], pairs: Mapping[str, Any], margin: Mapping[str, float], legend: Any
) -> None:
    """Put axes and legend where they belong; a legend that needs more room than the margin makes the picture taller."""
    gap = 6.0
    top = margin["t"] if legend is None else max(margin["t"], _pixels(figure, legend).height + 2 * gap)
    height = float(layout["height"]) + top - margin["t"]
    figure.set_size_inches(WIDTH / _INCH, height / _INCH)
    width, inner = WIDTH - margin["l"] - margin["r"], height - top - margin["b"]
    for suffix, axes in pairs.items():
        left, right = layout["xaxis" + suffix].get("domain", (0.0, 1.0))
        low, high = layout["yaxis" + suffix].get("domain", (0.0, 1.0))
        axes.set_position(
            (
                (margin["l"] + left * width) / WIDTH,
                (margin["b"] + low * inner) / height,
                (right - left) * width / WIDTH,
                (high - low) * inner / height,
            )
        )
    if legend is not None:
        legend.set_bbox_to_anchor((margin["l"] / WIDTH, (height - top + gap) / height))


def _widen(
    figure: Any, layout: Mapping[str, Any], pairs: Mapping[str, Any], margin: Mapping[str, float], legend: Any
) -> None:
    """Make the margins at the sides as wide as what stands there."""
    from matplotlib.transforms import Affine2D

    renderer = figure.canvas.get_renderer()
    scale = Affine2D().scale(_INCH / figure.dpi)
    sides = [axis for axes in pairs.values() for axis in (axes.xaxis, axes.yaxis)]
    # An axis without letters has no box.
    boxes = [box.transformed(scale) for box in (axis.get_tightbbox(renderer) for axis in sides) if box is not None]
    left = max(0.0, _EDGE - min(box.x0 for box in boxes))
    right = max(0.0, _EDGE - min(WIDTH - box.x1 for box in boxes))
    if left or right:
        _place(figure, layout, pairs, {**margin, "l": margin["l"] + left, "r": margin["r"] + right}, legend)
