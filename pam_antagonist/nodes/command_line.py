"""Give parameters on a node's command line priority over parameter files (without ROS).

In ROS, ``-p name:=value`` is a rule for all nodes (``/**``). A section of a file that names the node has priority, so a
value on the command line would be silently ignored. The value gets priority when it is repeated in the node's own
arguments.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

_FLAGS = ("-p", "--param")


def own_parameters(arguments: Sequence[str]) -> list[str]:
    """The arguments of a node (``cli_args``) that repeat the parameters of its command line.

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
