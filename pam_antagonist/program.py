"""The way to call a command in the user's environment, for help and hints."""

from __future__ import annotations

import os
import sys
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


def typed(command: str) -> str:
    """A command as the user would type it.

    Args:
        command: name and arguments, such as ``replay --help``.
    """
    return f"{program()} {command}"
