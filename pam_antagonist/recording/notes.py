"""Notes in a bag about where it comes from, which no topic can carry.

They stand under ``custom_data`` in the bag's metadata.yaml, which rosbag2 keeps for this: a text for each name. A note
is a help, not a part of the recording: a bag without metadata.yaml, or one that was converted, may have lost them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..errors import BadInput
from . import metadata

SEALED = "pam_antagonist.sealed"
"""Name of the note that lists the muscles whose chambers are sealed: "1", "2" or "1 2"."""
REGULATOR = "pam_antagonist.regulator"
"""Name of the note that says of a bag that its valve voltages are placeholders: pressure regulators drove the joint."""


def write_notes(path: Path, notes: Mapping[str, str]) -> None:
    """Add notes to a bag.

    Args:
        path: Folder of a finished bag.
        notes: Name -> text.

    Raises:
        BadInput: The metadata cannot be read.
        OSError: They cannot be written.
    """
    information = metadata.read_information(path)
    if information is None:
        raise BadInput(f"{path}: has no metadata.yaml, expected a finished bag")
    information["custom_data"] = {**metadata.custom_data(information), **notes}
    metadata.write_information(path, information)


def read_notes(path: str | Path) -> dict[str, str]:
    """Notes of a bag, by name; none where there is no metadata, or none in it.

    Args:
        path: Bag folder, or one of the files in it.

    Raises:
        BadInput: The metadata cannot be read.
    """
    path = Path(path)
    return metadata.read_custom_data(path if path.is_dir() else path.parent)


def sealed_muscles(path: str | Path) -> tuple[int, ...]:
    """Numbers of the muscles that a bag says are sealed: no air passes their valves, whatever ``valve_state`` holds.

    Raises:
        BadInput: The metadata cannot be read, or the note is not such a list.
    """
    text = read_notes(path).get(SEALED, "")
    if not all(part in ("1", "2") for part in text.split()):
        raise BadInput(f"{path}: {SEALED} in metadata.yaml is {text[:40]!r}, expected '1', '2' or '1 2'")
    return tuple(sorted({int(part) for part in text.split()}))
