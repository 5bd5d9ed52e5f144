"""How a command is typed where this process was started, for help and hints."""

from __future__ import annotations

import os
import sys
from pathlib import Path

VARIABLE = "PAM_PROGRAM"
"""Environment variable by which a script that starts the package, such as ``./run``, says how it was called."""


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


def typed(command: str) -> str:
    """A command as it is typed here.

    Args:
        command: its name and arguments, such as ``replay --help``.
    """
    return f"{program()} {command}"
