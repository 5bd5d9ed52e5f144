"""Message definitions: those of ROS 2 Jazzy and the four of ``pam_antagonist_msgs``.

The definitions of this project's messages stand here a second time because an offline installation has no
``pam_antagonist_msgs``; a test holds them against the ``.msg`` files field for field.
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
        "pam_antagonist_msgs/msg/JointReference": """\
std_msgs/Header header
uint8 ANGLE=0
uint8 TORQUE=1
uint8 mode
float64 value
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
uint8 flags
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


@cache
def definition_differs(msgtype: str, digest: str, definition: str) -> bool:
    """Tell whether a bag means something else by ``msgtype`` than this project does.

    Args:
        msgtype: Message type, known to :func:`typestore`.
        digest: RIHS01 hash that the bag states, or "".
        definition: Definition in the bag as .msg or IDL text, or "".

    Returns:
        True if hash or, without one, fields differ. False if they agree or the bag says neither.
    """
    store = typestore()
    if digest:
        return digest != store.hash_rihs01(msgtype)
    if not definition:
        return False
    try:
        parse = get_types_from_idl if definition.startswith("=" * 80 + "\nIDL: ") else None
        theirs = parse(definition) if parse else get_types_from_msg(definition, msgtype)
    except Exception:  # whatever the parser stumbles over: an unreadable text proves no difference
        return False
    return any(
        [(field.lower(), kind) for field, kind in fields] != [(f.lower(), k) for f, k in store.fielddefs[name][1]]
        for name, (_, fields) in theirs.items()
        if name in store.fielddefs
    )
