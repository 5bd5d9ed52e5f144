"""The one way in which this package compiles: numba, cached on disk, strict floating point.

Strict (no ``fastmath``) because a replay has to reproduce the live estimate bit for bit.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numba
from numba.core import config as numba_config

EFFECTS_GROUP = "pam_antagonist.effects"
"""Group of the entry points by which other packages add effects."""


@lru_cache(maxsize=1)
def _source_hash() -> str:
    """Hash over every source file that may hold a kernel: of this package, and of effects that others add.

    numba looks at the file of a cached function only, not at those of the functions that it calls: after
    an update of the package, an unchanged estimator would go on with yesterday's physics. A cache folder
    of its own for each state of the sources rules that out.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    package = Path(__file__).parent
    for folder in ("model", "estimation"):
        for source in sorted((package / folder).rglob("*.py")):
            digest.update(source.relative_to(package).as_posix().encode())
            digest.update(source.read_bytes())
    for module, sources in _added_effects():
        digest.update(module.encode())
        for source in sources:
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _added_effects() -> Iterator[tuple[str, list[Path]]]:
    """Modules of effects that other packages add, with the sources that may hold their kernels.

    Nothing is imported: the kernels of these modules need the hash while they are being imported themselves.
    """
    for point in sorted(entry_points(group=EFFECTS_GROUP), key=lambda point: point.name):
        spec = find_spec(point.module.split(".")[0])
        folders = [] if spec is None else list(spec.submodule_search_locations or ())
        sources = [source for folder in folders for source in sorted(Path(folder).rglob("*.py"))]
        if spec is not None and not folders and spec.origin is not None:
            sources = [Path(spec.origin)]
        yield point.value, sources


@lru_cache(maxsize=1)
def cache_dir() -> Path:
    """Folder of the compiled kernels: ``NUMBA_CACHE_DIR``, else the user's cache, else a temporary one."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    base = Path(os.environ["NUMBA_CACHE_DIR"]) if "NUMBA_CACHE_DIR" in os.environ else user_cache
    folder = base / "pam_antagonist" / _source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"pam_antagonist-{os.getuid()}" / _source_hash()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return folder


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    previous = numba_config.CACHE_DIR
    # numba reads the setting while it decorates; other users of numba in the process keep theirs.
    numba_config.CACHE_DIR = str(cache_dir())
    try:
        return numba.njit(cache=True, error_model="numpy", nogil=True, **options)(function)
    finally:
        numba_config.CACHE_DIR = previous


def kernel(function: Callable[..., Any]) -> Any:
    """Compile ``function`` on first call and keep the result on disk.

    Divisions follow numpy's rules (inf and NaN, no exception): the estimator checks its results instead.
    """
    return _compiled(function, _nrt=True)


def in_place(function: Callable[..., Any]) -> Any:
    """A kernel that works on the arrays that it is given, and neither makes nor returns one.

    numba counts references to arrays, at each row that is taken of one. Here it need not.
    """
    return _compiled(function, _nrt=False)


def merged(function: Callable[..., Any]) -> Any:
    """A piece of one kernel in place, compiled as a part of it: by itself, it would be compiled once more."""
    return _compiled(function, _nrt=False, inline="always")


def inlined(function: Callable[..., Any]) -> Any:
    """A kernel in place that is always inlined into the kernels that call it.

    For the pieces of the model: a Runge-Kutta step then knows that the parameters stay the same over its
    four stages, which makes it a fifth faster.
    """
    return _compiled(function, _nrt=False, forceinline=True)
