"""Memory that reading has freed goes back to the system.

The C library keeps it for what comes next. A fit's arrays are too large to find a place in it: after a bag of half an
hour, 0.7 GB would lie idle while they take as much again.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any


def give_back() -> None:
    """Return what was freed; nothing happens where the C library does not know how (glibc does)."""
    trim = _trim()
    if trim is not None:
        trim(0)


@lru_cache(maxsize=1)
def _trim() -> Any:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError):
        return None
