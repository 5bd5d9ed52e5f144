"""The exception for invalid input."""

from __future__ import annotations

import math


class BadInput(Exception):
    """Input that cannot be used: a file, topic, parameter or value.

    The message is one line with the problem, its place and what was expected. Commands and nodes print it after
    ``error:`` and end with status 2.
    """


class NoResult(BadInput):
    """Input that can be read, but from which nothing comes out, such as a fit that diverges: status 1."""


def number(name: str, value: object, low: float = -math.inf, high: float = math.inf) -> float:
    """A number that was given to a function of the API."""
    try:
        found = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        found = math.nan
    if not low <= found <= high:
        bounds = "a number" if math.isinf(low) and math.isinf(high) else f"{low:g} or more"
        bounds = bounds if math.isinf(high) else f"{low:g} to {high:g}"
        raise BadInput(f"{name} {value!r}: expected {bounds}")
    return found
