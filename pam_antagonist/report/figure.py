"""Figures as typed data, independent of how they are drawn.

A figure holds panels. A panel holds two axes and the series on them, from back to front. Arrays of a series are (N,),
NaN where a value is missing; series of one name have one entry in the legend, and are switched together.
:mod:`pam_antagonist.report.html` draws it on the page.
Colours are CSS colours of the light theme; the page maps them to the dark one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

MEASURED = "#1a1a1a"
"""Black, as in the paper: measurements."""
ESTIMATE = "#d55e00"
"""Vermilion: the filter. The colours are those of Okabe and Ito."""
MODEL = "#0072b2"
"""Blue: the model alone."""
SECOND = "#009e73"
"""Bluish green: a second channel of the same kind."""
QUIET = "#8a8f98"
"""Grey: bounds, references, raw data behind a summary."""
EDGE = "#8a3b00"
"""Dark vermilion: edge of the filter's 95 % interval, where data hide the shade."""
BAND = "rgba(213, 94, 0, 0.20)"
"""The filter's 95 % interval."""
HELD_OUT = "rgba(11, 92, 138, 0.07)"
"""Shade of held-out parts."""
FAINT = "#c3c8ce"
"""Light grey: single values behind their mean, a prior behind a result."""
PAPER = "#ffffff"
"""Background: middle of a diverging colour scale."""
DEEP = "#0b5c8a"
"""Largest value of a sequential colour scale."""
PALE = "#cfe3f1"
"""Least value of a sequential colour scale."""
INK, GRID, ZERO, VEIL = "#1a1d21", "#e8ebee", "#b9bfc6", "rgba(255, 255, 255, 0.75)"
"""Letters, grid, line at zero, and background of a label."""
PALETTE = (MODEL, ESTIMATE, SECOND, "#cc79a7", "#e69f00", "#56b4e9", MEASURED, QUIET)
"""Colours of Okabe and Ito for other curves."""
DARK = {
    MEASURED: "#e4e7ea",
    MODEL: "#4aa8e0",
    ESTIMATE: "#f07f2e",
    SECOND: "#22c497",
    EDGE: "#ffb486",
    BAND: "rgba(240, 127, 46, 0.28)",
    HELD_OUT: "rgba(110, 180, 225, 0.14)",
    FAINT: "#565d66",
    PAPER: "#15181c",
    "#56b4e9": "#f0e442",  # on dark paper, sky blue would be the blue of the model
    DEEP: "#5fb4e6",
    PALE: "#1d3a4d",
    INK: "#e4e7ea",
    GRID: "#2b3036",
    ZERO: "#5d646c",
    VEIL: "rgba(21, 24, 28, 0.75)",
}
"""Colour of the light theme -> colour of the dark one; other colours are the same in both."""


FloatArray = NDArray[np.float64]
Dash = Literal["", "dash", "dot"]


@dataclass(frozen=True)
class Axis:
    """A horizontal or vertical axis."""

    title: str = ""
    log: bool = False
    bounds: tuple[float, float] | None = None  # values at the two ends, left or lower one first; None: from the series
    labels: tuple[str, ...] = ()  # of a vertical axis: names at 0, 1, 2, ... instead of numbers
    # Seconds of a recording: figures of one link zoom together, and a pause is a gap in a line.
    is_time: bool = False
    from_zero: bool = False  # whether the axis includes 0


TIME = Axis("Time [s]", is_time=True)
"""Time since the first sample of a recording."""


@dataclass(frozen=True, eq=False)
class Line:
    """A curve. Long curves are decimated when drawn (:mod:`pam_antagonist.report.html`)."""

    name: str
    x: FloatArray
    y: FloatArray
    color: str
    dash: Dash = ""
    width: float = 1.3
    quiet: bool = False
    opacity: float = 1.0  # 0 to 1; a translucent line is in the background and has no hover text


@dataclass(frozen=True, eq=False)
class Band:
    """The area between two curves, an interval for example."""

    name: str
    x: FloatArray
    lower: FloatArray
    upper: FloatArray
    color: str
    quiet: bool = False


@dataclass(frozen=True, eq=False)
class Points:
    """Single values."""

    name: str
    x: FloatArray
    y: FloatArray
    color: str
    size: float = 6.0
    hollow: bool = False
    half_width: FloatArray | None = None  # half width of an interval around `x` (N,), drawn as a bar; None: no bars
    bar_width: float = 2.0
    quiet: bool = False


@dataclass(frozen=True, eq=False)
class Bars:
    """Bars from 0; bars of several series are side by side."""

    name: str
    x: FloatArray
    y: FloatArray
    color: str
    quiet: bool = False


@dataclass(frozen=True, eq=False)
class Heatmap:
    """Cells that are darker where more of the time was spent."""

    x: FloatArray  # (C,) centres of the columns [s]
    values: FloatArray  # (R, C) shares of the time, rows at 0, 1, ...; NaN leaves a cell empty
    rows: tuple[str, ...]  # (R,) names of the rows for the hover text


@dataclass(frozen=True)
class Reference:
    """A dashed line at one value of the vertical (or horizontal) axis, with a label at its end."""

    value: float
    label: str = ""
    color: str = QUIET
    vertical: bool = False  # whether the line is vertical, at a value of the horizontal axis


@dataclass(frozen=True)
class Region:
    """A shaded range of the horizontal axis in the background, the held-out part for example."""

    first: float
    last: float
    color: str = HELD_OUT


Series = Line | Band | Points | Bars | Heatmap | Reference | Region
"""Content of a panel."""
_BESIDE = 0.1
"""Distance of panels that are side by side, relative to the width."""
_GAP = 22
"""[px] Distance of panels that are one above the other."""


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes."""

    x: Axis
    y: Axis
    series: tuple[Series, ...]
    height: int = 230


@dataclass(frozen=True, eq=False)
class Figure:
    """A figure."""

    title: str
    about: str
    panels: tuple[Panel, ...]  # one above the other with the same horizontal axis, or side by side with separate axes
    link: str = ""
    side_by_side: bool = False

    @property
    def margins(self) -> tuple[int, int, int, int]:
        """Left, right, upper and lower margin in pixels; the upper one holds a legend."""
        named = any(not getattr(part, "quiet", True) for panel in self.panels for part in panel.series)
        return 66, 14, 34 if named or any(not panel.y.labels for panel in self.panels) else 10, 44

    @property
    def height(self) -> int:
        """Height of the whole figure in pixels."""
        heights = [panel.height for panel in self.panels]
        inner = max(heights) if self.side_by_side else sum(heights) + _GAP * (len(heights) - 1)
        return inner + self.margins[2] + self.margins[3]

    def areas(self) -> list[tuple[float, float, float, float]]:
        """Left, right, lower and upper end of each panel, relative to the area within the margins."""
        count = len(self.panels)
        if self.side_by_side:
            width = (1.0 - _BESIDE * (count - 1)) / count
            return [(k * (width + _BESIDE), k * (width + _BESIDE) + width, 0.0, 1.0) for k in range(count)]
        inner = self.height - self.margins[2] - self.margins[3]
        out, upper = [], inner
        for panel in self.panels:
            out.append((0.0, 1.0, (upper - panel.height) / inner, upper / inner))
            upper -= panel.height + _GAP
        return out
