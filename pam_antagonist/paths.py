"""Where files are: the package's data (rigs, maps, node parameters), and output folders, written whole or not."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.program import UNFINISHED

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


def check_output(path: Path, overwrite: bool = False) -> Path:
    """Refuse an output path that exists or cannot be made, before any work.

    `overwrite`: whether the path may be a folder with a ``report.json``.
    """
    try:
        earlier = overwrite and (path / "report.json").is_file() and not path.is_symlink()
        if not earlier and (path.exists() or path.is_symlink()):
            raise BadInput(f"{path}: exists; expected the name of a new folder, nothing is overwritten")
        check_makable(path)
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise BadInput(f"{path}: cannot be made: {getattr(error, 'strerror', None) or error}") from None
    return path


def check_makable(path: Path) -> None:
    """Refuse a path that cannot be made: it is tried, beside the place where it would be.

    Raises:
        BadInput: no folder above it can be written to.
        OSError: the file system refuses the name.
    """
    target = path.resolve()
    ancestor = target.parent
    while not ancestor.exists():
        ancestor = ancestor.parent
    if not ancestor.is_dir() or not os.access(ancestor, os.W_OK | os.X_OK):
        raise BadInput(f"{path}: cannot be made, {ancestor} is not a folder that can be written to")
    with tempfile.TemporaryDirectory(prefix=".", dir=ancestor) as aside:
        (Path(aside) / target.relative_to(ancestor)).mkdir(parents=True)


@contextmanager
def output_folder(path: Path, make: bool = True, overwrite: bool = False) -> Iterator[Path]:
    """A new folder, see :func:`check_output`, that appears only after all in it is written without an error."""
    check_output(path, overwrite)
    target = path.resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        raise BadInput(f"{path}: cannot be made: {error.strerror}") from None
    UNFINISHED.add(aside)
    try:
        partial = aside / target.name
        if make:
            partial.mkdir()
        yield partial
        if overwrite and target.exists():
            target.rename(aside / "earlier")
        partial.rename(target)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        UNFINISHED.discard(aside)
