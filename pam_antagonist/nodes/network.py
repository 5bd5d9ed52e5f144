"""Who on the network hears the nodes: nobody but this machine, unless somebody asked for more (no ROS in here)."""

from __future__ import annotations

import os
from collections.abc import MutableMapping

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

_ASKED = (RANGE, "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER")
"""Variables of ROS 2 by which a user says who is to be found."""


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Have nodes of this process find those of this machine only, before ROS is initialised.

    The default of ROS 2 is the whole subnet, where anybody may publish a command to the valves. A user who has set any
    of the variables about discovery, if only to that default, has decided, and is left alone.

    Args:
        environment: of the process.

    Returns:
        Whether that was done.
    """
    if any(environment.get(name) for name in _ASKED):
        return False
    environment[RANGE] = "LOCALHOST"
    return True


def local_only(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether nothing is to be heard from outside of this machine."""
    return environment.get(RANGE) == "LOCALHOST" and not environment.get("ROS_STATIC_PEERS")


def secured(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether SROS2 is switched on."""
    return environment.get("ROS_SECURITY_ENABLE", "").lower() == "true"
