"""Limit discovery to this machine, unless the user chose another range (without ROS)."""

from __future__ import annotations

import os
from collections.abc import MutableMapping

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

_ASKED = (RANGE, "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER")
"""Environment variables of ROS 2 that set the range of discovery."""


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Limit discovery of this process's nodes to this machine; call before ROS is initialised.

    By default ROS 2 discovers the whole subnet, where anybody could publish commands to the valves. If the user has set
    any of the variables of discovery, nothing is changed.

    Args:
        environment: of the process.

    Returns:
        Whether the limit was set.
    """
    if any(environment.get(name) for name in _ASKED):
        return False
    environment[RANGE] = "LOCALHOST"
    return True


def local_only(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether discovery is limited to this machine."""
    return environment.get(RANGE) == "LOCALHOST" and not environment.get("ROS_STATIC_PEERS")


def secured(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether SROS2 is switched on."""
    return environment.get("ROS_SECURITY_ENABLE", "").lower() == "true"
