"""Where the files lie that come with the package: rigs, scenarios, node parameters."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


@lru_cache(maxsize=1)
def config_dir() -> Path:
    """Folder ``config`` of the package.

    It lies beside the package in a checkout (also under an editable installation and under
    ``colcon build --symlink-install``). Everything that installs the package, pip as well as colcon, puts it into
    ``share/pam_antagonist/config`` of the same prefix: the nearest folder above the package that has it is the one.

    Raises:
        FileNotFoundError: the package was installed without its files.
    """
    checkout = _PACKAGE.parent / "config"
    if (_PACKAGE.parent / "package.xml").is_file() and checkout.is_dir():
        return checkout
    for prefix in _PACKAGE.parents:
        installed = prefix / "share" / "pam_antagonist" / "config"
        if installed.is_dir():
            return installed
    raise FileNotFoundError(f"no share/pam_antagonist/config in any folder above {_PACKAGE}: install the package again")
