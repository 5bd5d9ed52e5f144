"""Checkpoints of the live filter as a bag holds them: messages <-> records."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cdr import Decoded, Group, encode
from .topics import TOPICS

_TEXTS = ("rig", "fingerprint", "tuning", "joint", "settings")
_ARRAYS = ("state", "covariance", "cross", "voltage")
_SECOND = 1_000_000_000


@dataclass(frozen=True, eq=False)
class RecordedCheckpoint:
    """One unchecked message ``pam_antagonist_msgs/msg/FilterCheckpoint``: n states, m consider parameters.

    Attributes:
        stamp_ns: stamp of the last sample that the filter had used [ns].
        started_ns: stamp of the sample that started the filter [ns].
        joint: ``free`` or ``locked``.
        lock_angle: of a locked joint [rad].
        state: (n,).
        covariance: row-major (n n,).
        cross: row-major (n m,).
        voltage: (2,) [V].
        distances: number of distances between stamps so far, then the last nine distances [ns], (10,).
        angle_sensor: the filter's memory of a measured angle; empty where none was read.
    """

    stamp_ns: int
    started_ns: int
    rig: str
    fingerprint: str
    tuning: str
    joint: str
    lock_angle: float
    settings: str
    added: tuple[str, ...]
    state: NDArray[np.float64]
    covariance: NDArray[np.float64]
    cross: NDArray[np.float64]
    voltage: NDArray[np.float64]
    rejected: int
    distances: NDArray[np.int64]
    angle_sensor: NDArray[np.float64]


def read(decoded: Decoded, keep: NDArray[np.intp]) -> tuple[RecordedCheckpoint, ...]:
    """Records of decoded messages.

    Args:
        keep: numbers of the messages to take, in the order of the result (K,).
    """
    if len(keep) == 0:
        return ()
    stamps, started = decoded.stamp_ns("header.stamp").tolist(), decoded.stamp_ns("started").tolist()
    records = {row: fields for group in decoded.groups for row, fields in _fields(group)}
    return tuple(RecordedCheckpoint(stamps[row], started[row], **records[row]) for row in keep.tolist())


def _fields(group: Group) -> Iterator[tuple[int, dict[str, Any]]]:
    names = [f"added[{k}]" for k in range(group.counts["added"])]
    columns, has_angle_sensor = group.columns, "angle_sensor" in group.columns
    for place, row in enumerate(group.rows.tolist()):
        yield (
            row,
            {
                **{name: _text(columns[name][place]) for name in _TEXTS},
                **{name: np.array(columns[name][place], dtype=np.float64) for name in _ARRAYS},
                "added": tuple(_text(columns[name][place]) for name in names),
                "lock_angle": float(columns["lock_angle"][place]),
                "rejected": int(columns["rejected"][place]),
                "distances": np.array(columns["distances"][place], dtype=np.int64),
                "angle_sensor": np.array(columns["angle_sensor"][place] if has_angle_sensor else [], dtype=np.float64),
            },
        )


def _text(raw: bytes) -> str:
    return raw.decode(errors="replace")


def messages(checkpoints: Sequence[RecordedCheckpoint], frame_id: str) -> Iterator[tuple[int, bytes]]:
    """Stamp [ns] and CDR of each checkpoint."""
    for item in checkpoints:
        columns: dict[str, Any] = {name: getattr(item, name) for name in _TEXTS}
        arrays = (*_ARRAYS, "distances", "angle_sensor")
        columns |= {name: np.asarray(getattr(item, name)).reshape(1, -1) for name in arrays}
        columns |= {name: getattr(item, name) for name in ("lock_angle", "rejected")}
        columns |= {"header.frame_id": frame_id, "added": list(item.added)}
        for path, time_ns in (("header.stamp", item.stamp_ns), ("started", item.started_ns)):
            columns[f"{path}.sec"], columns[f"{path}.nanosec"] = divmod(time_ns, _SECOND)
        yield item.stamp_ns, encode(TOPICS["filter_checkpoint"].type, 1, columns)[0].tobytes()
