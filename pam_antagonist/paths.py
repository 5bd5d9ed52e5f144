"""Location of the package's data files: rigs, maps, node parameters."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


@lru_cache(maxsize=1)
def config_dir() -> Path:
    """Folder ``config`` of the package.

    In a checkout, or built by ``colcon build --symlink-install``, it is next to the package. Installed by pip or colcon
    it is ``share/pam_antagonist/config`` in the same prefix: the nearest folder above the package that contains it.
    """
    checkout = _PACKAGE.parent / "config"
    if (_PACKAGE.parent / "package.xml").is_file() and checkout.is_dir():
        return checkout
    for prefix in _PACKAGE.parents:
        installed = prefix / "share" / "pam_antagonist" / "config"
        if installed.is_dir():
            return installed
    raise FileNotFoundError(f"no share/pam_antagonist/config in any folder above {_PACKAGE}: install the package again")
