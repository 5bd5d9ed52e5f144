"""Recordings: rosbag2 bags <-> arrays, and tables -> arrays.

``read_bag`` makes a :class:`Recording` of a bag, ``write_bag`` and :class:`BagWriter` make bags, ``TOPICS`` names the
topics. A bag passes ``storage`` (files; ``mcap``, ``sqlite``), ``naming`` (which topic is which), ``cdr`` (bytes to
arrays), ``stamps`` (order, clocks, samples), ``corrections`` and ``plausible``, in the order of ``reader``. A table
passes ``csv_map``, ``csv_table`` and ``plausible``, in the order of ``csv_import``. Names are imported at
their first use, because nodes need only the topic table and not the libraries that read bags.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .topics import DEFAULT_NAMESPACE, SAMPLE_TOPICS, TOPICS, Topic

if TYPE_CHECKING:
    from .reader import read_bag
    from .recording import ESTIMATE_SHAPES, Arrival, RecordedEstimate, RecordedReference, Recording
    from .storage import bag_hash, bag_name, recording_hash, seen_in_words, seen_until
    from .writer import BagWriter, write_bag

_LAZY = {
    "SeveralJoints": "naming",
    "read_bag": "reader",
    "ESTIMATE_SHAPES": "recording",
    "Arrival": "recording",
    "RecordedEstimate": "recording",
    "RecordedReference": "recording",
    "Recording": "recording",
    "bag_hash": "storage",
    "bag_name": "storage",
    "recording_hash": "storage",
    "seen_in_words": "storage",
    "seen_until": "storage",
    "BagWriter": "writer",
    "write_bag": "writer",
}

__all__ = [
    "DEFAULT_NAMESPACE",
    "ESTIMATE_SHAPES",
    "SAMPLE_TOPICS",
    "TOPICS",
    "Arrival",
    "BagWriter",
    "RecordedEstimate",
    "RecordedReference",
    "Recording",
    "SeveralJoints",
    "Topic",
    "bag_hash",
    "bag_name",
    "read_bag",
    "recording_hash",
    "seen_in_words",
    "seen_until",
    "write_bag",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_LAZY[name]}", __name__), name)
