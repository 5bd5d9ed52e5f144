"""The program itself: how a command of it is called in the user's environment, and versions that made a result."""

from __future__ import annotations

import codecs
import contextlib
import io
import json
import os
import platform
import shutil
import signal
import sys
import unicodedata
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import NoReturn, TextIO

VARIABLE = "PAM_PROGRAM"
"""Environment variable in which a start script, such as ``./run``, passes its own name."""


def program() -> str:
    """The words before a command's name, such as ``./run``, ``pam`` or ``ros2 run pam_antagonist``."""
    given = os.environ.get(VARIABLE)
    if given:
        return given
    path = Path(sys.argv[0] or "pam")
    if path.parts[-3:-1] == ("lib", "pam_antagonist"):
        return "ros2 run pam_antagonist"
    if path.name == "__main__.py" and path.parent.name == "pam_antagonist":
        return "python -m pam_antagonist"
    return "pam"


def started(module: str, *arguments: str) -> list[str]:
    """The words that start a module in a process of its own, as ``python -m`` does; see :mod:`start`."""
    return [sys.executable, str(Path(__file__).with_name("start.py")), module, *arguments]


INTERRUPTED = 130
"""Exit status of a command that Ctrl-C ended."""
UNFINISHED: set[Path] = set()
"""Folders that are removed where a signal ends the process at once."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SWALLOW = ("numba", "llvmlite", "importlib._bootstrap", "importlib._bootstrap_external")
"""Modules of others in whose calls an exception of a signal handler is lost, or comes out as another error."""


class Interrupts:
    """Handler of Ctrl-C and SIGTERM in a process of an executable.

    `raises`: whether somebody catches a ``KeyboardInterrupt``. It is raised where it unwinds the stack. Elsewhere the
    process ends at once: nobody catches it while modules are imported and at the end of the interpreter; a compiler
    calls Python from its own code, which loses an exception.
    """

    def __init__(self, status: int, raises: bool = False) -> None:
        self.status, self._raises = status, raises

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take the signal."""
        if self._raises and not any(_swallows(one) for one in _callers(frame)):
            raise KeyboardInterrupt
        leave(self.status, "interrupted" if self.status == INTERRUPTED else "")

    def install(self) -> None:
        """Take all signals from now on, also those that came while they were blocked."""
        with contextlib.suppress(ValueError):  # not in the main thread: whoever runs us there handles signals
            for number in SIGNALS:
                signal.signal(number, self)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def _callers(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def _swallows(frame: FrameType) -> bool:
    module = str(frame.f_globals.get("__name__"))
    return module in _SWALLOW or module.split(".", 1)[0] in _SWALLOW or frame.f_code.co_name == "__del__"


def leave(status: int, said: str = "") -> NoReturn:
    """End the process at once, without what its modules would do at its end, such as to wait for threads."""
    for folder in UNFINISHED:
        shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(Exception):
        sys.stdout.flush()
        os.write(2, f"{said}\n".encode() if said else b"")
    os._exit(status)


def alone(work: Callable[[], int], interrupted: int = INTERRUPTED) -> int:
    """The status of an executable's work, in a process of its own. `interrupted`: status if a signal ends it."""
    Interrupts(interrupted).install()
    status = work()
    if status == INTERRUPTED:
        leave(status)
    Interrupts(status).install()  # the work is done
    return status


def piped(work: Callable[[], int]) -> int:
    """The status of some work, whose output is flushed; 0 where its reader had gone (``| head``)."""
    try:
        with writable(sys.stdout, sys.stderr):
            status = work()
    except BrokenPipeError:
        status = 0
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            # The interpreter flushes once more at its end, and would complain then.
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            status = 0
    return status


_PLAIN = str.maketrans({
    "°": " deg", "²": "^2", "³": "^3", "±": "+/-", "×": "x", "·": "*", "µ": "u", "μ": "u",
    "–": "-", "—": "-", "−": "-", "…": "...", "“": "'", "”": "'", "‘": "'", "’": "'", "→": "->", "←": "<-",
    "≤": "<=", "≥": ">=", "≈": "~", "√": "sqrt ", "✓": "yes", "✗": "no", "█": "#",
})  # fmt: skip
"""Marks that an encoding may lack, and plain ones."""
_ERRORS = "pam_antagonist.plain"


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Handler of encoding errors: plain marks, else an escape that JSON knows as well."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    # An accent becomes a mark of its own, and is left out.
    marks = unicodedata.normalize("NFKD", lacking.translate(_PLAIN))
    return escaped("".join(mark for mark in marks if not unicodedata.combining(mark))), error.end


codecs.register_error(_ERRORS, _plain)


def escaped(text: str) -> str:
    """A text in ASCII, with JSON's escapes for other characters, so that JSON keeps its content."""
    return "".join(mark if mark.isascii() else json.dumps(mark)[1:-1] for mark in text)


@contextlib.contextmanager
def writable(*streams: TextIO) -> Iterator[None]:
    """Streams that take every text meanwhile, whatever their encoding is."""
    with contextlib.ExitStack() as back:
        for stream in streams:
            if isinstance(stream, io.TextIOWrapper):
                back.callback(stream.reconfigure, errors=stream.errors)
                stream.reconfigure(errors=_ERRORS)
        yield


def typed(command: str) -> str:
    """A command, with its arguments, as the user would type it."""
    return f"{program()} {command}"


def versions() -> dict[str, str]:
    """Versions of this package and of the software that its results depend on."""
    try:
        own = metadata.version("pam_antagonist")
    except metadata.PackageNotFoundError:
        own = "not installed"
    return {
        "pam_antagonist": own,
        "python": platform.python_version(),
        "numpy": metadata.version("numpy"),
        "numba": metadata.version("numba"),
    }
