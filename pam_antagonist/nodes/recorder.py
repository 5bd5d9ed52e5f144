"""Executable ``record``: its arguments and its way into the node."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import Parameter
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.nodes.recorder_node import RecorderNode

DESCRIPTION = """
Writes every topic of a pipeline, as it comes, into a rosbag2 bag (MCAP), with the time of reception.

options:
  --out DIR        folder of the bag; it must not exist
  --duration S     end by itself after so many seconds (default: when it is told to)

subscribes:  pressure_1, pressure_2, valve_state, valve_command, joint_estimate, joint_states, reference,
             measured/joint_states, measured/external_torque, /diagnostics
"""

PARAMETERS: tuple[Parameter, ...] = ()


@dataclass(frozen=True)
class Options:
    """What ``record`` was asked to do.

    Attributes:
        out: folder of the bag.
        duration: after which it ends by itself [s]; None: never.
    """

    out: Path
    duration: float | None


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message} (see record --help)")


def read_options(arguments: list[str]) -> Options:
    """Read the arguments that are not ROS's.

    Raises:
        BadInput: one is missing, unknown or makes no sense.
    """
    parser = _Parser(prog="record", add_help=False, allow_abbrev=False)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--duration", type=float)
    given = parser.parse_args(arguments)
    if given.duration is not None and not (math.isfinite(given.duration) and given.duration > 0.0):
        raise BadInput(f"--duration {given.duration}: expected a number of seconds above 0")
    return Options(given.out, given.duration)


def _create(options: Options) -> RecorderNode:
    from pam_antagonist.nodes.recorder_node import RecorderNode

    return RecorderNode(options)


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``record --help``."""
    return run_node(_create, argv, name="record", description=DESCRIPTION, table=PARAMETERS, options=read_options)
