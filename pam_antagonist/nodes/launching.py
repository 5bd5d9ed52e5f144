"""Arguments of the launch files, as far as they say the same (no ROS in here)."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Sequence
from pathlib import Path

RESPAWN_DELAY = 2.0
"""[s] until a node that has ended is started again."""
STOP_TIME = "15"
"""[s] for a node to end after Ctrl-C, on a machine that is busy compiling, before launch insists."""
_SWITCHES = ("use_sim_time", "autostart")


def refuse_unknown(file: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Refuse arguments on the command line that a launch file does not have; launch would silently ignore them.

    Where another launch file includes it, the arguments are that file's matter.

    Args:
        file: name of the launch file.
        given: arguments, such as ``rig:=my_rig``.
        known: names that it has.

    Raises:
        ValueError: an unknown argument.
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
    """The value of a parameter that was given as an argument: a switch as true or false, all else as text.

    Args:
        name: of the parameter.
        text: as it was typed.

    Raises:
        ValueError: neither true nor false where one of them is needed.
    """
    if name not in _SWITCHES:
        return text
    if text.lower() not in ("true", "false"):
        raise ValueError(f"{name}:={text}: expected true or false")
    return text.lower() == "true"
