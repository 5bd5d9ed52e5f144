"""Message definitions: those of ROS 2 Jazzy, and this project's own, which come with the package as files."""

from __future__ import annotations

from functools import cache

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ..paths import config_dir

_PACKAGE = "pam_antagonist_msgs"


@cache
def typestore() -> Typestore:
    """Types of ROS 2 Jazzy with this project's messages registered."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in (config_dir().parent / _PACKAGE / "msg").glob("*.msg"):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"{_PACKAGE}/msg/{file.stem}"))
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
