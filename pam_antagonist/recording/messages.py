"""Message definitions: those of ROS 2 Jazzy and the five of ``pam_antagonist_msgs``.

The definitions of this project's messages are repeated here because an offline installation has no
``pam_antagonist_msgs``; a test compares them with the ``.msg`` files field by field.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

DEFINITIONS: Mapping[str, str] = MappingProxyType(
    {
        "pam_antagonist_msgs/msg/ValveCommand": """\
std_msgs/Header header
float64[2] voltage
""",
        "pam_antagonist_msgs/msg/PressureCommand": """\
std_msgs/Header header
float64[2] pressure
""",
        "pam_antagonist_msgs/msg/JointReference": """\
std_msgs/Header header
uint8 ANGLE=0
uint8 TORQUE=1
uint8 ANGLE_STIFFNESS=2
uint8 TORQUE_STIFFNESS=3
uint8 IMPEDANCE=4
uint8 mode
float64 value
float64 stiffness
float64 damping
""",
        "pam_antagonist_msgs/msg/JointEstimate": """\
std_msgs/Header header
builtin_interfaces/Time started
float64 angle
float64 velocity
float64 torque
float64[9] covariance
float64[2] pressure
float64[2] force
float64 stiffness
float64[2] innovation
float64[4] innovation_covariance
float64 nis
uint8 subsystem
uint8 MISSING_PRESSURE_1=1
uint8 MISSING_PRESSURE_2=2
uint8 MISSING_VALVE=4
uint8 OUTLIER=8
uint8 GAP=16
uint8 REPAIRED=32
uint8 LATE=64
uint8 NO_ANGLE=128
uint8 flags
float64 external_torque
float64[4] external_torque_covariance
""",
        "pam_antagonist_msgs/msg/FilterCheckpoint": """\
std_msgs/Header header
builtin_interfaces/Time started
string rig
string fingerprint
string tuning
string joint
float64 lock_angle
string settings
string[] added
float64[] state
float64[] covariance
float64[] cross
float64[2] voltage
uint32 rejected
int64[10] distances
float64[] angle_sensor
""",
    }
)
"""Message type -> definition in .msg syntax."""


@cache
def typestore() -> Typestore:
    """Types of ROS 2 Jazzy with this project's messages registered."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def is_known(msgtype: str, digest: str, definition: str) -> bool:
    """Whether a bag's definition of a message type is that of :func:`typestore`.

    `digest`: RIHS01 hash that the bag states, or "". `definition`: in .msg or .idl syntax, or "".
    """
    store = typestore()
    if digest:
        return digest == store.hash_rihs01(msgtype)
    if not definition:
        return True
    try:
        is_idl = definition.startswith("=" * 80 + "\nIDL: ")
        theirs = get_types_from_idl(definition) if is_idl else get_types_from_msg(definition, msgtype)
    except Exception:  # any error of the parser: an unreadable definition proves no difference
        return True
    return all(
        [(field.lower(), kind) for field, kind in fields] == [(f.lower(), k) for f, k in store.fielddefs[name][1]]
        for name, (_, fields) in theirs.items()
        if name in store.fielddefs
    )
