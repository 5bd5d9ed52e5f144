"""``pam --completion SHELL``: a script that makes a shell complete names, options and files of ``pam``."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.optional import needs
from pam_antagonist.program import typed

_NODE_OPTIONS = ("--help", "--ros-args")
_FILES = ("rig", "map")  # options without a type that take a file's name as well


def main(argv: Sequence[str] | None, commands: Mapping[str, NamedTuple]) -> int:
    """Print the script that completes these commands; gives the exit status."""

    def work() -> int:
        shells = list(_shtab().SUPPORTED_SHELLS)
        if argv is None or len(argv) != 1 or argv[0] not in shells:
            raise BadInput(f"{typed('--completion')}: expected one of {', '.join(shells)}")
        print(_shtab().complete(whole(commands), argv[0]))
        return common.DONE

    return common.ended(work)


def _shtab() -> Any:
    with needs("completion", "--completion"):
        import shtab
    return shtab


def whole(commands: Mapping[str, NamedTuple]) -> argparse.ArgumentParser:
    """One parser with a subparser for each executable."""
    root = argparse.ArgumentParser(prog="pam")
    root.add_argument("--version", action="store_true", help="print the version")
    below = root.add_subparsers()
    for name, (target, summary) in commands.items():
        module = importlib.import_module(target.split(":")[0])
        given = module.parser() if hasattr(module, "parser") else None
        parents = [] if given is None else [given]
        made = below.add_parser(name, help=summary, parents=parents, add_help=False)
        if given is None:
            for option in _NODE_OPTIONS:
                made.add_argument(option, action="store_true")
        for action in made._actions:
            if action.type is Path or action.dest in _FILES:
                action.complete = _shtab().FILE  # type: ignore[attr-defined]
    return root
