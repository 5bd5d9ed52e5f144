"""Executable ``record``: arguments and entry point."""

from __future__ import annotations

import argparse
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import Parameter
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.program import typed
from pam_antagonist.recording.bag_files import Limits
from pam_antagonist.recording.topics import normalize_namespace

if TYPE_CHECKING:
    from pam_antagonist.nodes.recorder_node import RecorderNode

DESCRIPTION = """
Writes every topic of a pipeline, as it comes, into a rosbag2 bag (MCAP), with the time of reception.

It is a process of its own, and nothing waits for it: where the disk does not keep up, messages are dropped, counted and
reported. What is older than a second survives a kill or a power cut; such a bag has no metadata.yaml, and the commands
of this package read it as it is. A full disk ends the recording with status 2; what was written is kept.

options:
  --out DIR         folder of the bag; it must not exist
  --duration S      end after S seconds (default: on Ctrl-C)
  --max-size MB     begin a new file when the last one has so many megabytes (default: one file)
  --max-duration S  begin a new file after so many seconds (default: one file)
  --namespace /NS   record the joint in this namespace (default: that of this node); may be given several times

subscribes:  pressure_1, pressure_2, valve_state, valve_command, pressure_state, pressure_command, joint_estimate,
             joint_states, reference, angle_sensor, external_torque, measured/joint_states, measured/external_torque,
             rig, filter_checkpoint, /diagnostics
"""

PARAMETERS: tuple[Parameter, ...] = ()

_MEGABYTE = 1_000_000
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


@dataclass(frozen=True)
class Options:
    """Options of ``record``.

    Attributes:
        duration: of the recording [s]; None: until it is stopped.
    """

    out: Path
    duration: float | None
    limits: Limits = field(default_factory=Limits)
    namespaces: tuple[str, ...] = ()


class _Parser(argparse.ArgumentParser):
    @override
    def error(self, message: str) -> NoReturn:
        raise BadInput(f"{message} (see {typed('record --help')})")


def read_options(arguments: list[str]) -> Options:
    """Read the arguments other than those of ROS."""
    parser = _Parser(prog="record", add_help=False, allow_abbrev=False)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--duration", type=float)
    parser.add_argument("--max-size", type=float)
    parser.add_argument("--max-duration", type=float)
    parser.add_argument("--namespace", action="append", default=[])
    given = parser.parse_args(arguments)
    _check("--duration", given.duration, 0.0, "seconds")
    _check("--max-duration", given.max_duration, 0.1, "seconds")
    _check("--max-size", given.max_size, 0.1, "megabytes")
    size = None if given.max_size is None else round(given.max_size * _MEGABYTE)
    namespaces = tuple(map(normalize_namespace, given.namespace))
    for namespace in namespaces:
        if not _NAMESPACE.fullmatch(namespace) or namespaces.count(namespace) > 1:
            raise BadInput(f"--namespace {namespace or '/'}: expected a namespace such as /left/elbow, each once")
    return Options(given.out, given.duration, Limits(size, given.max_duration), namespaces)


def _check(name: str, value: float | None, above: float, unit: str) -> None:
    if value is not None and not (math.isfinite(value) and value > above):
        raise BadInput(f"{name} {value}: expected a number of {unit} above {above:g}")


def _create(options: Options, **node_options: Any) -> RecorderNode:
    from pam_antagonist.nodes.recorder_node import RecorderNode

    return RecorderNode(options, **node_options)


def main(argv: list[str] | None = None) -> int:
    """Run the node; see ``record --help``."""
    return run_node(_create, argv, name="record", description=DESCRIPTION, table=PARAMETERS, options=read_options)
