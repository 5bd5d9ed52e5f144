"""What a result was made with and from: versions and names, so that it can be made again."""

from __future__ import annotations

import platform
from importlib import metadata
from pathlib import Path

import numba
import numpy as np


def versions() -> dict[str, str]:
    """Versions of this package and of what decides about its numbers."""
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


def bag_name(path: Path) -> str:
    """A bag's name that tells ``nominal/free`` from ``nominal/locked`` and says nothing about the machine."""
    return "/".join(Path(path).resolve().parts[-2:]).lstrip("/")
