"""Sections of parameter files that apply to no node that runs: another namespace, another node's name (without ROS)."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import yaml

from pam_antagonist.shown import listed


def parameter_files(arguments: Sequence[str]) -> list[Path]:
    """Files of ``--params-file`` in the arguments of a node.

    Example:
        >>> [str(path) for path in parameter_files(["--ros-args", "--params-file", "a.yaml", "-p", "seed:=3"])]
        ['a.yaml']
    """
    return [Path(word) for before, word in pairwise(arguments) if before == "--params-file"]


def applies(section: str, node: str) -> bool:
    """Whether a section applies to a node, both with full names; ``*`` is one word of a name, ``**`` any number.

    Example:
        >>> applies("/left/**", "/left/elbow/plant"), applies("/**/plant", "/plant"), applies("/*", "/left/plant")
        (True, True, False)
    """
    pattern = re.escape(section).replace(r"/\*\*", r"(/\w+)*").replace(r"/\*", r"/\w+")
    return re.fullmatch(pattern, node) is not None


def unused(path: Path, nodes: Sequence[str], joints: Sequence[str] = ()) -> str:
    """What is said of the sections of a file that apply to none of the nodes, in words; empty where that is right.

    A file may hold sections of other nodes, as long as one of them applies here. Sections of other joints are told
    where the process starts all joints.

    `nodes`: full names of the nodes of the process. `joints`: namespaces of its joints; empty: it has one node.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError):
        return ""  # ROS has refused it, or read it in its own way
    sections = list(_sections(content if isinstance(content, dict) else {}))
    others = [name for name in sections if not any(applies(name, node) for node in nodes)]
    if others and len(others) == len(sections):
        return (
            f"{path}: none of its sections is for {nodes[0]}, which runs without it. It has {listed(others)}; expected "
            f"{nodes[0]} or /**"
        )
    elsewhere = [name for name in others if not any(applies(name.rpartition("/")[0] or "/", one) for one in joints)]
    if joints and elsewhere:
        return f"{path}: {listed(elsewhere)} is for no joint that is started here. The joints are {listed(joints)}"
    return ""


def _sections(content: Mapping[object, object], above: str = "") -> Iterator[str]:
    """Full names of the sections of a parameter file; namespaces may be nested."""
    for key, value in content.items():
        name = f"{above}/{str(key).strip('/')}"
        if isinstance(value, dict) and "ros__parameters" in value:
            yield name
        elif isinstance(value, dict):
            yield from _sections(value, name)
