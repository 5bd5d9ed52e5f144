"""Notes in a bag about where it comes from, which no topic can carry.

They stand under ``custom_data`` in the bag's metadata.yaml, which rosbag2 keeps for this: a text for each name. A note
is a help, not a part of the recording: a bag without metadata.yaml, or one that was converted, may have lost them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import yaml

from ..errors import BadInput

SEALED = "pam_antagonist.sealed"
"""Name of the note that lists the muscles whose chambers are sealed: "1", "2" or "1 2"."""
_INFORMATION = "rosbag2_bagfile_information"
_MAX_METADATA = 64 << 20  # [bytes]


def write_notes(path: Path, notes: Mapping[str, str]) -> None:
    """Add notes to a bag.

    Args:
        path: Folder of a finished bag.
        notes: Name -> text.

    Raises:
        OSError: The metadata cannot be read or written.
    """
    file = path / "metadata.yaml"
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    information = content[_INFORMATION]
    information["custom_data"] = {**(information.get("custom_data") or {}), **notes}
    file.write_text(yaml.safe_dump(content, sort_keys=False, allow_unicode=True), encoding="utf-8")


def read_notes(path: str | Path) -> dict[str, str]:
    """Notes of a bag, by name; none where there is no metadata, or none in it.

    Args:
        path: Bag folder, or one of the files in it.

    Raises:
        BadInput: The metadata cannot be read.
    """
    path = Path(path)
    file = (path if path.is_dir() else path.parent) / "metadata.yaml"
    try:
        if not file.is_file():
            return {}
        if file.stat().st_size > _MAX_METADATA:
            raise BadInput(f"{file}: {file.stat().st_size} bytes, expected a short text")
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise BadInput(f"{file}: cannot be read: {' '.join(str(error).split())[:200]}") from None
    information = content.get(_INFORMATION) if isinstance(content, dict) else None
    found = information.get("custom_data") if isinstance(information, dict) else None
    return {str(name): str(text) for name, text in found.items()} if isinstance(found, dict) else {}


def sealed_muscles(path: str | Path) -> tuple[int, ...]:
    """Numbers of the muscles that a bag says are sealed: no air passes their valves, whatever ``valve_state`` holds.

    Raises:
        BadInput: The metadata cannot be read, or the note is not such a list.
    """
    text = read_notes(path).get(SEALED, "")
    if not all(part in ("1", "2") for part in text.split()):
        raise BadInput(f"{path}: {SEALED} in metadata.yaml is {text[:40]!r}, expected '1', '2' or '1 2'")
    return tuple(sorted({int(part) for part in text.split()}))
