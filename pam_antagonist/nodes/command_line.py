"""Parameters on a node's command line, which win over parameter files (no ROS in here).

To ROS, ``-p name:=value`` is a rule for all nodes (``/**``). A section of a file that names the node is a rule for this
node, and wins, wherever it stands. So a value that somebody types would be silently ignored. Given to the node once
more, as its own arguments, it wins.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

_FLAGS = ("-p", "--param")


def own_parameters(arguments: Sequence[str]) -> list[str]:
    """The arguments of a node (``cli_args``) that repeat the parameters of its command line.

    Args:
        arguments: of the process, those of ROS among others.

    Returns:
        Arguments in the form of ROS; empty where no parameter is given.

    Example:
        >>> own_parameters(["--out", "bag", "--ros-args", "-p", "seed:=3", "--params-file", "a.yaml"])
        ['--ros-args', '-p', 'seed:=3']
    """
    rules = [word for rule in _rules(arguments) for word in ("-p", rule)]
    return ["--ros-args", *rules] if rules else []


def _rules(arguments: Sequence[str]) -> Iterator[str]:
    inside = False
    for before, word in zip(("", *arguments), arguments, strict=False):
        if word == "--ros-args":
            inside = True
        elif word == "--":
            inside = False
        elif inside and before in _FLAGS:
            yield word
