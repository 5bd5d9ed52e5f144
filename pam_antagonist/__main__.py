"""``pam NAME ...`` and ``python -m pam_antagonist NAME ...``: the table of all executables."""

from __future__ import annotations

import difflib
import importlib
import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Command(NamedTuple):
    """An executable."""

    target: str  # ``module:function``; the function takes the arguments and returns an exit status
    summary: str


_COMMANDS = {
    "demo": "control a simulated joint live, record, replay and report it",
    "watch": "show a running joint in the browser, 30 times a second",
    "monitor": "tell when a running joint is no longer its rig file, and why (a node)",
    "new_rig": "write the rig file of a new joint, from ruler, scale and data sheets",
    "excite": "design an experiment, drive the joint with it and record it",
    "commission": "lead from a rig file to a controlled joint, step by step",
    "check": "is this a recording of this rig, in the right units?",
    "replay": "run recordings through the estimator again, report its errors",
    "identify": "find a rig's parameters, noise and tuning from recordings",
    "adapt": "update an identified rig by one more recording",
    "close_loop": "find the physical effect that the model lacks, with errors before and after",
    "simulate": "make a recording of a simulated joint",
    "import_csv": "convert a CSV, MATLAB, numpy or Parquet file to a recording",
    "reachable": "compute which angles and torques a joint can reach, and with which stiffness",
    "history": "tell what has changed in a rig over weeks, from its log book",
    "static": "fit volume and force map of a muscle to tables of measurements",
}
_NODES = {
    "plant": "a simulated joint that publishes what its sensors show",
    "bridge": "connect a microcontroller on a serial port with ROS topics",
    "estimator": "estimate the joint's angle and torque from two pressures",
    "controller": "control the joint's angle or torque by the estimate",
    "joints": "run the nodes of several joints in one process",
    "record": "write all topics into a rosbag2 (MCAP) bag",
}
COMMANDS = {name: Command(f"pam_antagonist.cli.{name}:main", text) for name, text in _COMMANDS.items()} | {
    name: Command(f"pam_antagonist.nodes.{'recorder' if name == 'record' else name}:main", text)
    for name, text in _NODES.items()
}
"""Name of an executable -> description. In a ROS workspace, ``setup.py`` installs one script for each."""

_PLACES = {"Commands": "pam_antagonist.cli.", "ROS 2 nodes": "pam_antagonist.nodes."}
"""Title in the help -> package of its executables."""


def usage(commands: Mapping[str, Command] = COMMANDS, places: Mapping[str, str] = _PLACES) -> str:
    """Text of the help: one line for each executable, by groups."""
    from pam_antagonist.program import program

    width = max(len(name) for name in commands)
    lines = [f"usage: {program()} NAME [arguments]"]
    for title, package in places.items():
        lines += ["", title]
        for name, command in commands.items():
            if command.target.startswith(package):
                lines.append(f"  {name.ljust(width)}  {command.summary}")
    lines += ["", "NAME --help explains one command. --version prints the version."]
    shells = "prints a script with which a shell (bash, zsh, fish, ...) completes names and options."
    return "\n".join([*lines, f"--completion SHELL {shells}"])


def main(
    argv: Sequence[str] | None = None, commands: Mapping[str, Command] = COMMANDS, places: Mapping[str, str] = _PLACES
) -> int:
    """Run the executable that the first argument names; gives its exit status, 2 for an unknown name."""
    from pam_antagonist.program import INTERRUPTED, alone, piped

    arguments = list(sys.argv[1:] if argv is None else argv)

    def work() -> int:
        return piped(lambda: _main(arguments, commands, places))

    node = bool(arguments) and arguments[0] in (*_NODES, "monitor")
    return work() if argv is not None else alone(work, 0 if node else INTERRUPTED)


def _main(arguments: list[str], commands: Mapping[str, Command], places: Mapping[str, str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(usage(commands, places))
        return 0 if arguments else 2
    name, rest = arguments[0], arguments[1:]
    if name == "--version":
        print(f"pam_antagonist {importlib.import_module('pam_antagonist').__version__}")
        return 0
    if name == "--completion":
        return int(importlib.import_module("pam_antagonist.cli.completion").main(rest, commands))
    if name not in commands:
        close = difflib.get_close_matches(name, commands, 1)
        hint = f"did you mean {close[0]}? " if close else ""
        print(f"error: unknown command {name!r}: {hint}Expected one of {', '.join(commands)}", file=sys.stderr)
        return 2
    module, function = commands[name].target.split(":")
    if module.startswith(_PLACES["ROS 2 nodes"]):
        from pam_antagonist.errors import BadInput
        from pam_antagonist.optional import needs_ros

        try:
            needs_ros(name)
        except BadInput as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    return int(getattr(importlib.import_module(module), function)(rest) or 0)


if __name__ == "__main__":
    sys.exit(main())
