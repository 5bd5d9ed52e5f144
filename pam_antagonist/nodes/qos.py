"""Quality of service of every topic, and what a user may change of it.

* ``STREAM``: publishers and subscribers of the 1 kHz topics. Reliable, with a depth of one second: stalls of 100 to
  300 ms happen on any shared machine, and messages from this time should arrive late and flagged rather than never.
  Subscribers that prefer the latest value can use best effort.
* ``RECORD``: subscriptions of the recorder; as ``STREAM``, with a depth of five seconds.
* ``COMMAND``: commands of the valves. Reliable; only the newest command of a publisher counts, and a time-out watches
  the commands. The depth makes sure that messages of a second publisher do not hide those of the first one.
* ``REFERENCE``: reliable, volatile, depth 10 for the same reason; a reference holds until the next one.
* ``LATCHED``: reliable, the last ten messages are kept for late subscribers.
* ``LAST_ONE``: as ``LATCHED``, for the last message only.
* ``GLANCE``: best effort, depth 1, for displays that read the latest value from time to time.
* ``DIAGNOSTICS``: reliable, depth 10.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

from rclpy.exceptions import ParameterException
from rclpy.qos import DurabilityPolicy, InvalidQoSProfileException, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import InvalidQosOverridesError, QoSOverridingOptions

from pam_antagonist.errors import BadInput

# As ROS 2 has it, a profile is reliable, volatile and keeps the last messages unless it says otherwise.
STREAM = QoSProfile(depth=1000)
RECORD = QoSProfile(depth=5000)
COMMAND = QoSProfile(depth=100)
REFERENCE = QoSProfile(depth=10)
GLANCE = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LAST_ONE = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DIAGNOSTICS = QoSProfile(depth=10)

# Durability is fixed: an old command must not reach the valves, and an old reference must not count as new.
_OVERRIDES = QoSOverridingOptions.with_default_policies()  # reliability, history and depth
_FIXED = ("/diagnostics", "/rosout", "/parameter_events", "/clock")
_INVALID = (InvalidQosOverridesError, ParameterException, InvalidQoSProfileException, RuntimeError, ValueError)


def overridable(make: Callable[..., Any], topic: str, profile: Any, options: dict[str, Any]) -> Any:
    """``make(profile, **options)``: a publisher or subscription that obeys ``qos_overrides`` of its topic."""
    if topic in _FIXED or not isinstance(profile, QoSProfile):
        return make(profile, **options)
    try:
        return make(copy.copy(profile), **{"qos_overriding_options": _OVERRIDES, **options})
    except _INVALID as error:
        if type(error).__name__ == "RCLError" or (isinstance(error, RuntimeError) and "QoS override" not in str(error)):
            raise
        raise BadInput(
            f"qos_overrides of {topic}: {error}; expected reliability, history or depth as in ROS 2"
        ) from None
