"""Notes in a bag about its origin, for which there is no topic.

The notes are texts by name under ``custom_data`` in the bag's metadata.yaml, the place that rosbag2 provides. They are
optional: a bag without metadata.yaml, or a converted one, may have lost them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..errors import BadInput
from . import metadata

SEALED = "pam_antagonist.sealed"
"""Name of the note that lists the muscles whose chambers are sealed: "1", "2" or "1 2"."""
REGULATOR = "pam_antagonist.regulator"
"""Name of the note that says of a bag that its valve voltages are placeholders: pressure regulators drove the joint.

Like the note of the source, it is for people and for programs of other packages who open the bag: nothing else in it
distinguishes these voltages from those of closed valves. No command of this package reads it, since the rig file says
what drives the joint."""


def write_notes(path: Path, notes: Mapping[str, str]) -> None:
    """Add notes to a bag.

    Args:
        path: Folder of a finished bag.
        notes: Name -> text.

    Raises:
        BadInput: The metadata cannot be read.
        OSError: The notes cannot be written.
    """
    information = metadata.read_information(path)
    if information is None:
        raise BadInput(f"{path}: has no metadata.yaml, expected a finished bag")
    information["custom_data"] = {**metadata.custom_data(information), **notes}
    metadata.write_information(path, information)


def read_notes(path: str | Path) -> dict[str, str]:
    """Notes of a bag, by name; empty without metadata or notes.

    Args:
        path: Bag folder, or one of the files in it.

    Raises:
        BadInput: The metadata cannot be read.
    """
    path = Path(path)
    return metadata.read_custom_data(path if path.is_dir() else path.parent)


def sealed_muscles(path: str | Path) -> tuple[int, ...]:
    """Numbers of the muscles that are sealed according to a bag's note; their valves pass no air at any voltage.

    Raises:
        BadInput: The metadata cannot be read, or the note is no list of muscles.
    """
    text = read_notes(path).get(SEALED, "")
    if not all(part in ("1", "2") for part in text.split()):
        raise BadInput(f"{path}: {SEALED} in metadata.yaml is {text[:40]!r}, expected '1', '2' or '1 2'")
    return tuple(sorted({int(part) for part in text.split()}))
