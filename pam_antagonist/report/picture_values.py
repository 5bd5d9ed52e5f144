"""Plotly's values in matplotlib's terms, and the refusal of what pictures do not know (see :mod:`.pictures`)."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pam_antagonist.errors import BadInput

FloatArray = NDArray[np.float64]
Rgba = tuple[float, float, float, float]

_DASHES = {"solid": (), "dot": (1, 1), "dash": (3, 3), "longdash": (5, 5), "dashdot": (3, 1, 1, 1)}
"""Lengths in line widths; a thin line's are those of one of 3 px, as plotly has them."""
_RGBA = re.compile(r"rgba?\(([^,]+),([^,]+),([^,]+)(?:,([^,]+))?\)")
_MARKUP = re.compile(r"</?[a-z]")


@dataclass(frozen=True, eq=False)
class Reach:
    """What the range of an axis has to hold.

    Attributes:
        values: (N,); those that are not finite do not count.
        padded: the range has a margin around them.
    """

    values: FloatArray
    padded: bool


def only(where: str, given: Mapping[str, Any], drawn: Collection[str], idle: Collection[str] = ()) -> None:
    """Refuse what a picture would leave out.

    Args:
        where: part of the figure, for the message.
        given: its values.
        drawn: keys that pictures show.
        idle: keys that matter to a pointing hand only.

    Raises:
        BadInput: another key.
    """
    unknown = sorted(set(given) - set(drawn) - set(idle))
    if unknown:
        raise BadInput(f"{where}: pictures do not draw {', '.join(unknown)}; expected some of {', '.join(drawn)}")


def one_of(where: str, value: Any, allowed: Collection[Any]) -> Any:
    """A value that pictures know.

    Raises:
        BadInput: another one.
    """
    if value not in allowed:
        raise BadInput(f"{where}: pictures do not draw {value!r}; expected {' or '.join(map(repr, allowed))}")
    return value


def numbers(values: ArrayLike) -> FloatArray:
    """Values as an array of the same shape; what is missing (None) is NaN."""
    return np.array(values, dtype=np.float64)


def color(where: str, text: str) -> Rgba:
    """A CSS colour, parts from 0 to 1.

    Raises:
        BadInput: not of the form ``#rrggbb``, ``rgb(r, g, b)``, ``rgba(r, g, b, a)``, nor a name.
    """
    from matplotlib.colors import to_rgba

    try:
        match = _RGBA.fullmatch(text)
        if match is None:
            return to_rgba(text)
        red, green, blue, alpha = (float(part) if part else 1.0 for part in match.groups())
        return to_rgba((red / 255.0, green / 255.0, blue / 255.0), alpha)
    except ValueError:
        raise BadInput(f"{where}: {text!r} is no colour; expected #rrggbb or rgba(r, g, b, a)") from None


def dashes(where: str, dash: str, width: float) -> tuple[float, tuple[float, ...] | None]:
    """matplotlib's line style of a dash.

    Args:
        where: for the message.
        dash: plotly's name.
        width: of the line [px].

    Raises:
        BadInput: another name.
    """
    lengths = _DASHES[one_of(where, dash, _DASHES)]
    return 0.0, tuple(length * max(width, 3.0) / width for length in lengths) or None


def plain(where: str, text: str) -> str:
    """A text as matplotlib takes it.

    Raises:
        BadInput: it has HTML in it, which plotly would obey.
    """
    if _MARKUP.search(text):
        raise BadInput(f"{where}: pictures do not draw HTML; expected plain text in place of {text!r}")
    return text.replace("$", r"\$")
