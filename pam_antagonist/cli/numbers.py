"""Types of arguments that are numbers within bounds."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


def real(low: float, high: float, what: str = "a number", bounds: str = "") -> Callable[[str], float]:
    """Type of an argument that is a number between two bounds; what it is and its bounds in words, for the message."""

    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected {what}{bounds or f' from {low:g} to {high:g}'}")
        return value

    return convert


def whole(low: int, high: int) -> Callable[[str], int]:
    """Type of an argument that is a whole number between two bounds."""

    def convert(text: str) -> int:
        if not text.isdecimal() or not low <= int(text) <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number from {low} to {high}")
        return int(text)

    return convert


def degrees(text: str) -> float:
    """Degrees on the command line, radians within."""
    return math.radians(real(-90.0, 90.0, "an angle in degrees", ", -90 to 90")(text))


SEED = whole(0, 2**31 - 1)
"""Type of an argument that seeds a random generator."""
JOBS = whole(1, 64)
"""Type of an argument that is a number of threads or processes."""
