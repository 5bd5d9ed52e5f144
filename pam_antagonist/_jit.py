"""Compilation by numba, cached on disk, with strict floating point.

Strict (no ``fastmath``) because a replay has to reproduce the live estimate bit for bit.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import os
import re
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
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
_DESCRIPTIONS = ("Effect", "EffectParameter", "AddedState", "Place", "per_muscle", "state_per_muscle")
"""Classes and functions that describe effects. Their sentences (strings with spaces) do not change machine code."""
_IMPORT = re.compile(r"^\s*(?:from|import) (pam_antagonist[\w.]*)(?: import (\([^)]*\)|[^\n(]*))?", re.MULTILINE)


@lru_cache(maxsize=1)
def _source_hash() -> str:
    """Hash of all code that is compiled: of this package, and of effects from other packages.

    numba only checks the file of a cached function, not those of the functions that it calls: after an update of the
    package, an unchanged estimator would use the old physics. So each state of the code has a cache folder of its own.
    Comments, docstrings, sentences about effects and files without kernels change no machine code, and do not count.
    """
    raw = hashlib.sha256(numba.__version__.encode())
    sources = [(path.relative_to(_PACKAGE).as_posix(), path.read_bytes()) for path in _kernel_sources()]
    for module, added in _added_effects():
        sources += [(module, source.read_bytes()) for source in added]
    for name, content in sources:
        raw.update(name.encode() + content)
    # Parsing would slow down the start of commands, so its result is stored for each state of the files.
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
    """Source code without comments, docstrings, sentences of effects, and line numbers."""
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
    """All files of the model, and the files of the estimator that have kernels or are imported by them.

    All files of the model count, because its effects are found by listing their folder.
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
            # A package's __init__ counts only if a name is imported from it, not if all names are its modules.
            others = inside if inside and inside <= set(files) else {base, *inside}
            new = {other for other in others if other in files} - found
            found |= new
            waiting += new
    return tuple(files[name] for name in sorted(found))


def _added_effects() -> Iterator[tuple[str, list[Path]]]:
    """Modules of effects from other packages, with the sources that may have their kernels, without importing them."""
    for point in sorted(entry_points(group=EFFECTS_GROUP), key=lambda point: point.name):
        spec = find_spec(point.module.split(".")[0])
        folders = [] if spec is None else list(spec.submodule_search_locations or ())
        sources = [source for folder in folders for source in sorted(Path(folder).rglob("*.py"))]
        if spec is not None and not folders and spec.origin is not None:
            sources = [Path(spec.origin)]
        yield point.value, sources


def _base() -> Path:
    """Base folder of the cache: ``NUMBA_CACHE_DIR``, else the user's cache."""
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
    """Location of a kernel's machine code, determined by the code and not by path and time of its file.

    So an update of the package, another checkout, or a changed comment does not recompile unchanged code.
    """

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file
        path = Path(py_file)
        inside = path.is_relative_to(_PACKAGE)
        self._stamp = "" if path in _kernel_sources() else _content_hash(py_file)
        name = path.relative_to(_PACKAGE).with_suffix("").as_posix().replace("/", ".") if inside else path.stem
        self._cache_path = str(cache_dir() / name)
        # Number kernels of the same name; line numbers would change with every comment above.
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
def _content_hash(file: str) -> str:
    """Hash of a file and of what it imports from its folder, directly or not: a kernel may call or hold any of it."""
    folder, waiting = Path(file).parent, [Path(file)]
    found: dict[Path, bytes] = {}
    while waiting:
        path = waiting.pop()
        if path not in found and path.is_file():
            found[path] = path.read_bytes()
            for base, names in _IMPORT.findall(found[path].decode()):
                words = {base.rsplit(".", 1)[-1], *re.findall(r"\w+", names)}
                waiting += [folder / f"{word}.py" for word in words]
    return hashlib.sha256(b"".join(found[path] for path in sorted(found))).hexdigest()[:16]


class Compiling(event.Listener):  # type: ignore[misc]
    """Counts compilations, which happen once for each state of the code and each machine, and shows them on a terminal.

    `seconds`: time that this process has spent compiling, to be excluded when speed is measured [s]. `tell`: called
    with one sentence at the first compilation; None: not called.
    """

    def __init__(self) -> None:
        self.seconds, self.kernels = 0.0, 0
        self._depth, self._began = 0, 0.0
        self.tell: Callable[[str], object] | None = None

    def on_start(self, event: Any) -> None:
        """A kernel, or a function that it calls, is being compiled."""
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
        """A compilation has ended."""
        self._depth -= 1
        if self._depth == 0:
            self.seconds += time.perf_counter() - self._began
            if sys.stderr.isatty():
                print("\r\033[K", end="", file=sys.stderr, flush=True)


COMPILING = Compiling()
event.register("numba:compile", COMPILING)


_FORMS: list[Callable[[Callable[..., Any], Sequence[Any]], Callable[..., Any]]] = []


def form_by_types(form: Callable[[Callable[..., Any], Sequence[Any]], Callable[..., Any]]) -> Any:
    """Decorator for a function that returns what is compiled for a kernel: its code, or another form for some types.

    `form`: of the kernel's function and the types of its arguments.
    """
    _FORMS.append(form)
    return form


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    def form(args: Sequence[Any], _: Any) -> Any:
        return functools.reduce(lambda code, other: other(code, args), _FORMS, function)

    previous = caching.CompileResultCacheImpl._locator_classes
    # numba looks for a locator while it decorates; restored for other users of numba in the process.
    caching.CompileResultCacheImpl._locator_classes = [_Locator]
    try:
        compiled = numba.njit(cache=True, error_model="numpy", nogil=True, **options)(function)
    finally:
        caching.CompileResultCacheImpl._locator_classes = previous
    compiled._compiler._get_implementation = form
    return compiled


def kernel(function: Callable[..., Any]) -> Any:
    """Compile ``function`` on first call and keep the result on disk.

    Divisions follow numpy's rules (inf and NaN, no exception): the estimator checks its results instead.
    """
    return _compiled(function, _nrt=True)


def in_place(function: Callable[..., Any]) -> Any:
    """A kernel that works only on given arrays, and neither makes nor returns arrays.

    So numba need not count references to arrays, which it does for each row that is taken. It says that it is not
    inlined: numba would else pass ``forceinline`` on to it from an :func:`inlined` function that calls it.
    """
    return _compiled(function, _nrt=False, forceinline=False)


def merged(function: Callable[..., Any]) -> Any:
    """A part of an in-place kernel that is compiled only within this kernel, not by itself."""
    return _compiled(function, _nrt=False, inline="always")


def by_types(function: Callable[..., Any]) -> Any:
    """Decorator for a function that returns an implementation of ``function`` for given argument types.

    It is called when an in-place kernel that calls ``function`` is compiled, not when machine code is loaded.
    """
    return numba.extending.overload(function, jit_options={"_nrt": False, "error_model": "numpy", "nogil": True})


def inlined(function: Callable[..., Any]) -> Any:
    """An in-place kernel that is always inlined into its callers.

    For parts of the model: a Runge-Kutta step is a fifth faster, because the compiler knows that the parameters are
    constant over its four stages.
    """
    return _compiled(function, _nrt=False, forceinline=True)
