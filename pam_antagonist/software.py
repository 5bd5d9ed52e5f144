"""Versions of the software that made a result."""

from __future__ import annotations

import platform
from importlib import metadata

import numba
import numpy as np


def versions() -> dict[str, str]:
    """Versions of this package and of the software that its results depend on."""
    try:
        own = metadata.version("pam_antagonist")
    except metadata.PackageNotFoundError:
        own = "not installed"
    return {
        "pam_antagonist": own,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
    }
