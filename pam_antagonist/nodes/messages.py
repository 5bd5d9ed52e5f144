"""Message objects that are filled in place, where speed does not matter (see wire.py for where it does)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time

_SECOND = 1_000_000_000


def set_stamp(stamp: Time, time_ns: int) -> None:
    """Write a time [ns] into a stamp."""
    stamp.sec, stamp.nanosec = divmod(time_ns, _SECOND)


def joint_state(name: str, frame_id: str, *fields: str) -> Any:
    """A ``sensor_msgs/JointState`` of one joint.

    Args:
        name: of the joint.
        frame_id: of the header.
        fields: which of ``position``, ``velocity`` and ``effort`` have room.
    """
    from sensor_msgs.msg import JointState

    message = JointState()
    message.header.frame_id = frame_id
    message.name = [name]
    for field in fields:
        setattr(message, field, [0.0])
    return message
