"""Outcomes of a battery, made by hand."""

from __future__ import annotations

from validation.battery.outcomes import Outcome


def outcome(kind: str, effects=(), verdict: str = "none", found=(), **values) -> Outcome:
    base = {
        "name": "a case", "kind": kind, "effects": tuple(effects), "form": tuple(name for name, _ in effects),
        "seed": 1, "sizes": (5.0,) * len(effects), "duration": 60.0, "verdict": verdict, "found": tuple(found),
        "ambiguous_with": (), "leading": (), "channel": None, "errors": {}, "seconds": 1.0, "threads": 1,
    }  # fmt: skip
    return Outcome(**{**base, **values})


LEAK, CREEP, DROOP = ("leak", 1), ("creep", None), ("supply_droop", None)
