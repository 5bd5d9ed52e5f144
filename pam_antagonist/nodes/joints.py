"""Executable ``joints``: parameters and entry point."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import Parameter
from pam_antagonist.nodes.spin import run_node

if TYPE_CHECKING:
    from pam_antagonist.nodes.joints_node import JointsNode

DESCRIPTION = """
Several joints in one process. Each joint has a namespace, and in it a plant or a bridge, an estimator and a controller
with their topics, services and parameters, as in processes of their own. Samples of a plant, estimates and commands to
a plant go from node to node without the middleware, and are published beside that. So the valves of a plant here obey
the controller of the same joint alone.

A parameter file has a section for each joint, such as /left/elbow/** (config/robot.yaml). Each joint has a joint_name
of its own.

subscribes:  what the nodes of each joint subscribe to
publishes:   what they publish; /diagnostics
services:    ~/stop_all (std_srvs/Trigger: stops the valves of every joint until each is cleared by its own clear_stop),
             those of a lifecycle node, and those of the nodes of each joint
"""

PARAMETERS = (
    Parameter("joints", ["pam"], "namespaces of the joints, such as [left/elbow, left/wrist]"),
    Parameter(
        "source",
        "plant",
        "what each joint has: plant, the simulated joint; bridge, a way to hardware; none: it is started elsewhere",
        choices=("plant", "bridge", "none"),
    ),
)

_RENAMES = re.compile(r"__(ns|node|name):=")


def refuse_renames(arguments: Sequence[str]) -> None:
    """Refuse a remapped namespace or name, which would apply to all nodes of the process."""
    for word in arguments:
        if _RENAMES.match(word):
            raise BadInput(
                f"joints: {word} would rename all nodes of the process; give the namespaces of the joints as "
                f"parameter joints, or write joints:{word} to rename the node joints alone"
            )


def _create(_options: None, **node_options: Any) -> JointsNode:
    from pam_antagonist.nodes.joints_node import JointsNode

    return JointsNode(**node_options)


def main(argv: list[str] | None = None) -> int:
    """Run the nodes; see ``joints --help``."""
    # Fast DDS then sends from a thread of its own on another core. For six joints at 500 Hz with a recorder, sending
    # takes a quarter of a core.
    os.environ.setdefault("RMW_FASTRTPS_PUBLICATION_MODE", "ASYNCHRONOUS")
    return run_node(_create, argv, name="joints", description=DESCRIPTION, table=PARAMETERS, check=refuse_renames)
