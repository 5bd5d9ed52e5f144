"""The keys of ``report.json`` that a command writes for every kind of recording: what does not apply is null or empty.

A kind of recording may add keys of its own behind these.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

CLOSE_LOOP: Mapping[str, Any] = {
    "verdict": None, "sentence": None, "effects": (), "ambiguous_with": (), "experiments": {}, "ambiguities": (),
    "share_explained": None, "parts": (), "reference": None, "base_friction_removed": False, "errors": None,
    "filter_errors": {}, "recordings": (), "ranking": (), "profiles": (), "remaining": (), "left": (), "unseen": (),
    "warnings": (), "notes": (), "settings": None, "timing": {}, "software": None, "splits": None, "calibration": (),
    "corrections": (), "assumption": None, "next_steps": (), "next_rig": None, "episodes": None,
}  # fmt: skip
IDENTIFY: Mapping[str, Any] = {
    "held_out": (), "coverage95": None, "coverage95_own": None, "errors_deg": None, "parameters": (), "stages": (),
    "correlations": (), "between": None, "noise": None, "tuning": None, "recordings": (), "warnings": (),
    "settings": None, "software": None, "assumption": None, "rejected": "", "episodes": None,
}  # fmt: skip


def with_all_keys(keys: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """The content of a report with every one of these keys."""
    return {**keys, **found}
