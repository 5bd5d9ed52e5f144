"""What a diagnosis ends with: one line for each verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final, Literal

Verdict = Literal["effect", "none", "unexplained"]
EFFECT: Final = "effect"
UNEXPLAINED: Final = "unexplained"
NONE: Final = "none"
TITLES: Mapping[Verdict, str] = {
    EFFECT: "An effect was found",
    UNEXPLAINED: "Unexplained",
    NONE: "Nothing is missing",
}
"""Titles of the page. Of several parts of a diagnosis the first one of these that is among them counts."""


def overall(verdicts: Iterable[Verdict]) -> Verdict:
    """The verdict on all parts together."""
    there = set(verdicts)
    return next((verdict for verdict in TITLES if verdict in there), NONE)
