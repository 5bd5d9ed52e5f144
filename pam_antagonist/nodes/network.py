"""Limit discovery to this machine, unless the user chose another range (without ROS)."""

from __future__ import annotations

import os
from collections.abc import Mapping, MutableMapping, Sequence

from pam_antagonist.program import typed

RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"

_ASKED = (RANGE, "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "ROS_DISCOVERY_SERVER")
"""Environment variables of ROS 2 that set the range of discovery."""


def stay_on_this_machine(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Limit discovery of this process's nodes to this machine; call before ROS is initialised.

    By default ROS 2 discovers the whole subnet, where anybody could publish commands to the valves. If the user has set
    any of the variables of discovery, nothing is changed.
    """
    if any(environment.get(name) for name in _ASKED):
        return False
    environment[RANGE] = "LOCALHOST"
    return True


def local_only(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether discovery is limited to this machine."""
    return environment.get(RANGE) == "LOCALHOST" and not environment.get("ROS_STATIC_PEERS")


def nothing_there(
    namespace: str, elsewhere: Sequence[str], busy: Sequence[int], environment: Mapping[str, str] = os.environ
) -> str:
    """What to try where no node publishes a joint's topics, in words."""
    domain = int(environment.get("ROS_DOMAIN_ID") or 0)
    others = [other for other in busy if other != domain]
    tries = [f"--namespace {other or '/'} (a joint is there)" for other in elsewhere]
    tries += [f"ROS_DOMAIN_ID={other} {typed('watch')} (nodes of this machine seem to be there)" for other in others]
    if not tries:
        tries = [
            "start the joint's nodes",
            "the line that demo, excite or commission prints (they have a ROS domain of their own)",
            f"for a joint on another machine, {RANGE}=SUBNET on both",
        ]
    return f"no joint in namespace {namespace or '/'} of ROS domain {domain}. Try: {'; or '.join(tries)}"


def secured(environment: MutableMapping[str, str] = os.environ) -> bool:
    """Whether SROS2 is switched on."""
    return environment.get("ROS_SECURITY_ENABLE", "").lower() == "true"
