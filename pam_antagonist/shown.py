"""How results look in a console and in a notebook."""

from __future__ import annotations

import html
import math
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

from typing_extensions import override

T = TypeVar("T")
_LONGEST = 500
_VALUE = 40
MISSING = "–"
"""Text for a missing value."""
DIVERGES = "that of a model that diverges"
"""Text for an infinite error."""


def listed(names: Sequence[str]) -> str:
    """Names in a sentence: ``a``, ``a and b``, ``a, b and c``."""
    return " and ".join(filter(None, (", ".join(names[:-1]), *names[-1:])))


def few(names: Sequence[str], most: int = 12) -> str:
    """The first of many names: ``a, b, c and 4 more``."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


class Shown:
    """A result with a short ``repr``, and its tables in a notebook. Its dataclass needs ``repr=False``."""

    def _brief(self) -> str:
        """What the result is, in a line or a few; fields with their values, or with the size of what they hold."""
        return ", ".join(f"{item.name} {_short(getattr(self, item.name))}" for item in fields(self))  # type: ignore[arg-type]

    @override
    def __repr__(self) -> str:
        text = f"{type(self).__name__}: {self._brief()}"
        return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."

    def _repr_html_(self) -> str:
        """The tables of the command, for a notebook."""
        summary = getattr(self, "summary", None)
        return f"<pre>{html.escape(repr(self) if summary is None else summary())}</pre>"


def widened(kind: type[T], base: Any, **more: Any) -> T:
    """An instance of a subclass: the fields of an instance of its base, and further ones."""
    return kind(**{item.name: getattr(base, item.name) for item in fields(base)}, **more)


def _short(value: Any) -> str:
    shape = getattr(value, "shape", ())
    if shape:
        return f"({', '.join(map(str, shape))})"
    if value is None or isinstance(value, (str, int, float)):
        return reprlib.repr(value)[:_VALUE]
    if isinstance(value, (Sequence, Mapping)):
        return f"[{len(value)}]"
    return type(value).__name__


def number(value: float | None, digits: int = 3) -> str:
    """A number with `digits` significant digits, without an exponent if possible; a dash for a missing number."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    magnitude = math.floor(math.log10(abs(value)))
    if not -5 <= magnitude < 9:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - magnitude, 0)}f}"


def error_in_words(value: float | None, unit: str, digits: int = 2) -> str:
    """An error with its unit; that of a model which diverges is infinite, and is no number.

    `unit`: with the space before it, where there is one.
    """
    if value is not None and math.isinf(value):
        return DIVERGES
    return f"{number(value, digits)}{unit}"


def percent(value: float | None) -> str:
    """A share as a percentage; a dash for a missing value."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{round(100.0 * value, 1) + 0.0:.1f} %"  # no -0.0


def unlike(value: float, limit: float, decimals: int) -> str:
    """A number with as many decimals as it takes to differ from a limit that it misses."""
    while decimals < 12 and float(f"{value:.{decimals}f}") == limit != value:
        decimals += 1
    return f"{value:.{decimals}f}"
