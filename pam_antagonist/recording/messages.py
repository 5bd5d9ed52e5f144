"""Message definitions: those of ROS 2 Jazzy, and this project's own, which come with the package as files."""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..paths import config_dir

_PACKAGE = "pam_antagonist_msgs"
LATER = {
    f"{_PACKAGE}/msg/JointReference": ("stiffness", "damping"),
    f"{_PACKAGE}/msg/JointEstimate": ("external_torque", "external_torque_covariance"),
    f"{_PACKAGE}/msg/FilterCheckpoint": ("angle_sensor",),
}
"""Message type -> the fields that messages of version 0.1.0 lack. They are read as NaN, or as nothing."""


@cache
def typestore(*, former: bool = False) -> Typestore:
    """Types of ROS 2 Jazzy with this project's messages registered, as they were in version 0.1.0 where asked for."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (config_dir().parent / _PACKAGE / "msg").glob("*.msg"):
        name = f"{_PACKAGE}/msg/{file.stem}"
        left_out = LATER.get(name, ()) if former else ()
        lines = [
            line for line in file.read_text(encoding="utf-8").splitlines() if not {*line.split()[1:2]} & {*left_out}
        ]
        store.register(get_types_from_msg("\n".join(lines), name))
    return store


def stores_of(msgtype: str, digest: str, definition: str) -> tuple[Typestore, ...]:
    """Type stores whose definition of a message type agrees with the bag's.

    `digest`: RIHS01 hash that the bag states, or "". `definition`: in .msg or .idl syntax, or "".
    """
    stores = (typestore(), typestore(former=True)) if msgtype in LATER else (typestore(),)
    return tuple(store for store in stores if _agrees(store, msgtype, digest, definition))


def _agrees(store: Typestore, msgtype: str, digest: str, definition: str) -> bool:
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
