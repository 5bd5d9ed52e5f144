"""The program itself: how a command of it is called in the user's environment, and versions that made a result."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

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


def piped(work: Callable[[], int]) -> int:
    """The status of some work, whose output is flushed; 0 where its reader had gone (``| head``)."""
    try:
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
