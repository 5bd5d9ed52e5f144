"""Output folders that are written completely or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pam_antagonist.errors import BadInput


def check_output(path: Path, overwrite: bool = False) -> Path:
    """Refuse an output path that exists, before any work; with overwrite, unless it has a ``report.json``."""
    earlier = overwrite and (path / "report.json").is_file() and not path.is_symlink()
    if not earlier and (path.exists() or path.is_symlink()):
        raise BadInput(f"{path}: exists; expected the name of a new folder, nothing is overwritten")
    ancestor = path.absolute().parent
    while not ancestor.exists():
        ancestor = ancestor.parent
    if not ancestor.is_dir() or not os.access(ancestor, os.W_OK | os.X_OK):
        raise BadInput(f"{path}: cannot be made, {ancestor} is not a folder that can be written to")
    return path


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
