"""Common handling of the launch files' arguments (without ROS)."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Sequence
from pathlib import Path

RESPAWN_DELAY = 2.0
"""[s] Delay before an ended node is started again."""
STOP_TIME = "15"
"""[s] Time for a node to end after Ctrl-C before launch kills it, on a machine that is busy compiling."""
_SWITCHES = ("use_sim_time", "autostart")


def refuse_unknown(file: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Refuse unknown arguments of a launch file, which launch would silently ignore.

    An included launch file is not checked, because the arguments belong to the including file.

    `given`: arguments, such as ``rig:=my_rig``.
    """
    if file not in {Path(word).name for word in sys.argv[1:]}:
        return
    for word in given:
        name, is_argument, _ = word.partition(":=")
        if is_argument and name not in known:
            close = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {close[0]}?" if close else f"expected one of {', '.join(known)}"
            raise ValueError(f"{word}: unknown argument; {hint}")


def value_of(name: str, text: str) -> str | bool:
    """Value of a parameter that was given as an argument: a bool for switches, otherwise the text."""
    if name not in _SWITCHES:
        return text
    if text.lower() not in ("true", "false"):
        raise ValueError(f"{name}:={text}: expected true or false")
    return text.lower() == "true"
