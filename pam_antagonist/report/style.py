"""Colours of a report's figures, which are distinguishable with any colour vision."""

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
