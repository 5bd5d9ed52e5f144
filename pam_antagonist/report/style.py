"""The colours of a report's figures; every kind of colour vision tells them apart."""

MEASURED = "#1a1a1a"
"""Black, as in the paper: what a sensor said."""
ESTIMATE = "#d55e00"
"""Vermilion: the filter. The colours are Okabe and Ito's, which every kind of colour vision tells apart."""
MODEL = "#0072b2"
"""Blue: the model alone."""
SECOND = "#009e73"
"""Bluish green: a second channel of the same kind."""
QUIET = "#8a8f98"
"""Grey: bounds, references, raw data behind a summary."""
EDGE = "#8a3b00"
"""Dark vermilion: the edge of the filter's 95 % interval, where data would hide the shade."""
BAND = "rgba(213, 94, 0, 0.20)"
"""The filter's 95 % interval."""
HELD_OUT = "rgba(11, 92, 138, 0.07)"
"""Shade of what was held out."""
FAINT = "#c3c8ce"
"""Light grey: single values behind their mean, a prior behind what was found."""
PAPER = "#ffffff"
"""Background: the middle of a scale of colours that has a sign."""
DEEP = "#0b5c8a"
"""The largest value of a scale of colours without a sign."""
PALE = "#cfe3f1"
"""Its least value that is not nothing."""
INK, GRID, ZERO, VEIL = "#1a1d21", "#e8ebee", "#b9bfc6", "rgba(255, 255, 255, 0.75)"
"""Letters, grid, the line at zero, and what is behind a label."""
PALETTE = (MODEL, ESTIMATE, SECOND, "#cc79a7", "#e69f00", "#56b4e9", MEASURED, QUIET)
"""Okabe and Ito's colours, for curves that have no meaning of their own."""
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
"""Colours of the dark theme, by those of the light one; the others serve both."""
