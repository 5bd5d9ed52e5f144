"""Notes about a recording: what was wrong with it when it was read, and the notes in a bag about its origin.

The notes in a bag are texts by name under ``custom_data`` in its metadata.yaml, the place that rosbag2 provides. They
are optional: a bag without metadata.yaml, or a converted one, may have lost them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..errors import BadInput
from . import metadata

KINDS = (
    "clock", "publishers", "damage", "restart", "hole", "jump", "missing", "unstamped", "repeated", "dropped", "late",
    "resampled", "remark",
)  # fmt: skip
"""Kinds of issues, the one that changes results most first."""


class Issue(str):
    """A sentence about repaired, dropped or doubtful data, with what a program needs of it.

    Args:
        kind: one of ``KINDS``.
        size: number of messages, rows, samples or bytes that it concerns; 0 where nothing is counted.
        start_s: where it begins, from the first sample that was read [s]; NaN where it has no place.
        length_s: how long it lasts [s]; NaN where it has no length.
    """

    kind: str
    size: int
    start_s: float
    length_s: float

    def __new__(
        cls, text: str, kind: str = "remark", size: int = 0, start_s: float = math.nan, length_s: float = math.nan
    ) -> Issue:
        """Make one."""
        out = super().__new__(cls, text)
        out.kind, out.size, out.start_s, out.length_s = kind, int(size), float(start_s), float(length_s)
        return out

    @staticmethod
    def sorted(texts: Iterable[str]) -> tuple[Issue, ...]:
        """Issues in the order of ``KINDS``; a text of no kind is a remark."""
        issues = [text if isinstance(text, Issue) else Issue(text) for text in texts]
        return tuple(sorted(issues, key=lambda issue: KINDS.index(issue.kind)))


SEALED = "pam_antagonist.sealed"
"""Name of the note that lists the muscles whose chambers are sealed: "1", "2" or "1 2"."""
REGULATOR = "pam_antagonist.regulator"
"""Name of the note that says of a bag that its valve voltages are placeholders: pressure regulators drove the joint.

Like the note of the source, it is for people and for programs of other packages who open the bag: nothing else in it
distinguishes these voltages from those of closed valves. No command of this package reads it, since the rig file says
what drives the joint."""


ISSUES = "pam_antagonist.issues"
"""Name of the note that lists what was found when a table was imported: a line with kind, size and text for each."""
_IN_THE_BAG = ("hole", "missing")  # found again when the bag is read


def issues_note(issues: Iterable[Issue]) -> dict[str, str]:
    """The note of what the import found and a bag does not show; none where there is nothing."""
    lines = [f"{issue.kind} {issue.size} {issue}" for issue in issues if issue.kind not in _IN_THE_BAG]
    return {ISSUES: "\n".join(lines)} if lines else {}


def noted_issues(path: Path) -> list[Issue]:
    """What the import of a bag found, according to its note."""
    lines = [line.split(" ", 2) for line in read_notes(path).get(ISSUES, "").splitlines()]
    return [
        Issue(f"import: {line[2]}", line[0], int(line[1]))
        for line in lines
        if len(line) == 3 and line[0] in KINDS and line[1].isdecimal()
    ]


def write_notes(path: Path, notes: Mapping[str, str]) -> None:
    """Add notes to a bag."""
    information = metadata.read_information(path)
    if information is None:
        raise BadInput(f"{path}: has no metadata.yaml, expected a finished bag")
    information["custom_data"] = {**metadata.custom_data(information), **notes}
    metadata.write_information(path, information)


def read_notes(path: str | Path) -> dict[str, str]:
    """Notes of a bag, by name; empty without metadata or notes."""
    path = Path(path)
    return metadata.read_custom_data(path if path.is_dir() else path.parent)


def sealed_muscles(path: str | Path) -> tuple[int, ...]:
    """Numbers of the muscles that are sealed according to a bag's note; their valves pass no air at any voltage."""
    text = read_notes(path).get(SEALED, "")
    if not all(part in ("1", "2") for part in text.split()):
        raise BadInput(f"{path}: {SEALED} in metadata.yaml is {text[:40]!r}, expected '1', '2' or '1 2'")
    return tuple(sorted({int(part) for part in text.split()}))
