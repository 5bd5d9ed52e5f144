"""The one way in which this package compiles: numba, cached on disk, strict floating point.

Strict (no ``fastmath``) because a replay has to reproduce the live estimate bit for bit.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from functools import lru_cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numba
import numba.extending
from numba.core import caching, event

EFFECTS_GROUP = "pam_antagonist.effects"
"""Group of the entry points by which other packages add effects."""


_PACKAGE = Path(__file__).parent
_FOLDERS = ("model", "estimation")
_DESCRIPTIONS = ("Effect", "EffectParameter", "AddedState", "per_muscle", "state_per_muscle")
"""What effects are described by: their sentences, which have spaces and which no kernel sees, make no other code."""
_IMPORT = re.compile(r"^\s*(?:from|import) (pam_antagonist[\w.]*)(?: import (\([^)]*\)|[^\n(]*))?", re.MULTILINE)


@lru_cache(maxsize=1)
def _source_hash() -> str:
    """Hash over all code that machine code is made of: of this package, and of effects that others add.

    numba looks at the file of a cached function only, not at those of the functions that it calls: after an update of
    the package, an unchanged estimator would go on with yesterday's physics. A cache folder of its own for each state
    of the code rules that out. Comments, docstrings, sentences about effects and files without kernels do not count:
    they change no machine code.
    """
    raw = hashlib.sha256(numba.__version__.encode())
    sources = [(path.relative_to(_PACKAGE).as_posix(), path.read_bytes()) for path in _kernel_sources()]
    for module, added in _added_effects():
        sources += [(module, source.read_bytes()) for source in added]
    for name, content in sources:
        raw.update(name.encode() + content)
    # Parsing takes longer than a command should to start: once for each state of the files.
    known = _base() / "pam_antagonist" / "sources" / raw.hexdigest()[:16]
    with contextlib.suppress(OSError):
        return known.read_text(encoding="ascii")
    digest = hashlib.sha256(numba.__version__.encode())
    for name, content in sources:
        digest.update(f"{name}\n{_code(content)}".encode())
    found = digest.hexdigest()[:16]
    with contextlib.suppress(OSError):
        known.parent.mkdir(parents=True, exist_ok=True)
        partial = known.with_name(f"{known.name}.{os.getpid()}")
        partial.write_text(found, encoding="ascii")
        partial.replace(known)
    return found


def _code(content: bytes) -> str:
    """Source code without comments, docstrings, the sentences of effects, and the places of its lines."""
    tree = ast.parse(content)
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in _DESCRIPTIONS:
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str) and " " in part.value:
                    part.value = ""
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                node.body = node.body[1:]
    return ast.dump(tree)


@lru_cache(maxsize=1)
def _kernel_sources() -> tuple[Path, ...]:
    """The files of the model, and those of the estimator that hold kernels or are imported by them.

    All of the model: its effects are found by looking into their folder.
    """
    files = {
        ".".join(("pam_antagonist", *path.relative_to(_PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
        for folder in _FOLDERS
        for path in sorted((_PACKAGE / folder).rglob("*.py"))
    }
    texts = {name: path.read_text(encoding="utf-8") for name, path in files.items()}
    waiting = [name for name, text in texts.items() if "_jit import" in text or ".model" in name]
    found = set(waiting)
    while waiting:
        name = waiting.pop()
        for base, names in _IMPORT.findall(texts[name]):
            inside = {f"{base}.{word}" for word in re.findall(r"\w+", names)}
            # A folder's own file counts where a name is from it, and not for the modules beside it.
            others = inside if inside and inside <= set(files) else {base, *inside}
            new = {other for other in others if other in files} - found
            found |= new
            waiting += new
    return tuple(files[name] for name in sorted(found))


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


def _base() -> Path:
    """``NUMBA_CACHE_DIR``, else the user's cache."""
    user_cache = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    return Path(os.environ["NUMBA_CACHE_DIR"]) if "NUMBA_CACHE_DIR" in os.environ else user_cache


@lru_cache(maxsize=1)
def cache_dir() -> Path:
    """Folder of the compiled kernels: ``NUMBA_CACHE_DIR``, else the user's cache, else a temporary one."""
    folder = _base() / "pam_antagonist" / _source_hash()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        folder = Path(tempfile.gettempdir()) / f"pam_antagonist-{os.getuid()}" / _source_hash()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    return folder


class _Locator(caching._CacheLocator):  # type: ignore[misc]
    """Where a kernel's machine code lies: by what it is made of, not by where and when its file was written.

    So an update of the package, another checkout, or a comment does not compile again what is the same.
    """

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file
        path = Path(py_file)
        inside = path.is_relative_to(_PACKAGE)
        self._stamp = "" if path in _kernel_sources() else _content_hash(str(path.parent) if inside else py_file)
        name = path.relative_to(_PACKAGE).with_suffix("").as_posix().replace("/", ".") if inside else path.stem
        self._cache_path = str(cache_dir() / name)
        # The line changes with every comment above; which of several kernels of a name this is does not.
        number = _NAMES[py_file, py_func.__qualname__] if inside else py_func.__code__.co_firstlineno
        _NAMES[py_file, py_func.__qualname__] += 1
        self._disambiguator = str(number)

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _Locator | None:
        return cls(py_func, py_file) if os.path.exists(py_file) else None

    def get_cache_path(self) -> str:
        return self._cache_path

    def get_source_stamp(self) -> str:
        return self._stamp

    def get_disambiguator(self) -> str:
        return self._disambiguator


_NAMES: Counter[tuple[str, str]] = Counter()


@lru_cache(maxsize=64)
def _content_hash(place: str) -> str:
    """Hash of a file, or of the files of a folder: kernels of this package call those beside them."""
    files = sorted(Path(place).glob("*.py")) if Path(place).is_dir() else [Path(place)]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


class Compiling(event.Listener):  # type: ignore[misc]
    """Counts what is compiled, which happens once for each state of the code and each machine.

    It takes about a minute. Who looks at a terminal is told, and how far it is.

    Attributes:
        seconds: spent on it by this process, so that whoever measures speed can leave it out.
        kernels: how many were compiled.
        tell: is called with one sentence when the first one is compiled; None: nobody is told but a terminal.
    """

    def __init__(self) -> None:
        self.seconds, self.kernels = 0.0, 0
        self._depth, self._began = 0, 0.0
        self.tell: Callable[[str], object] | None = None

    def on_start(self, event: Any) -> None:
        """A kernel, or one inside of it, is being compiled."""
        self._began = self._began if self._depth else time.perf_counter()
        self._depth += 1
        self.kernels += 1
        if self.kernels == 1 and self.tell is not None:
            self.tell("compiling, once: about a minute")
        if sys.stderr.isatty():
            took = self.seconds + time.perf_counter() - self._began
            text = f"\rCompiling, once (about a minute): {self.kernels} functions, {took:.0f} s"
            print(text, end="", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """It is done."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began
            if sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr, flush=True)


COMPILING = Compiling()
event.register("numba:compile", COMPILING)


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    previous = caching.CompileResultCacheImpl._locator_classes
    # numba asks for a place while it decorates; other users of numba in the process keep theirs.
    caching.CompileResultCacheImpl._locator_classes = [_Locator]
    try:
        return numba.njit(cache=True, error_model="numpy", nogil=True, **options)(function)
    finally:
        caching.CompileResultCacheImpl._locator_classes = previous


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


def by_types(function: Callable[..., Any]) -> Any:
    """Decorate what gives compiled code for calls of ``function``, a part of the kernel in place that calls it.

    It is given the types of the arguments when such a kernel is compiled, and not where machine code is loaded.
    """
    return numba.extending.overload(function, jit_options={"_nrt": False, "error_model": "numpy", "nogil": True})


def inlined(function: Callable[..., Any]) -> Any:
    """A kernel in place that is always inlined into the kernels that call it.

    For the pieces of the model: a Runge-Kutta step then knows that the parameters stay the same over its
    four stages, which makes it a fifth faster.
    """
    return _compiled(function, _nrt=False, forceinline=True)
