"""Checkpoints of the filter on a topic, from which a replay of a later recording can go on."""

from __future__ import annotations

from pam_antagonist.estimation.checkpoint import Checkpoint
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.wire import set_stamp
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import FilterCheckpoint

PERIOD = 1.0
"""Time between two checkpoints [s]; at most this much at the start of a recording cannot be replayed bit for bit."""


class CheckpointPublisher:
    """Publishes checkpoints; the last one is kept for late subscribers."""

    def __init__(self, node: PamNode, frame_id: str) -> None:
        self._publisher = node.create_publisher(FilterCheckpoint, TOPICS["filter_checkpoint"].relative, qos.LAST_ONE)
        self._frame = frame_id
        self._last: tuple[int, int] | None = None

    def publish(self, checkpoint: Checkpoint | None) -> None:
        """Publish a checkpoint, unless it is the same as the last one."""
        if checkpoint is None or (checkpoint.started_ns, checkpoint.stamp_ns) == self._last:
            return
        self._last = checkpoint.started_ns, checkpoint.stamp_ns
        self._publisher.publish(message(checkpoint, self._frame))


def message(checkpoint: Checkpoint, frame_id: str) -> FilterCheckpoint:
    """A checkpoint as a message."""
    out = FilterCheckpoint()
    set_stamp(out.header.stamp, checkpoint.stamp_ns)
    out.header.frame_id = frame_id
    set_stamp(out.started, checkpoint.started_ns)
    for name in ("rig", "fingerprint", "tuning", "joint", "settings"):
        setattr(out, name, getattr(checkpoint.identity, name))
    out.lock_angle, out.added = checkpoint.identity.lock_angle, list(checkpoint.identity.added)
    for name in ("state", "covariance", "cross", "angle_sensor"):
        setattr(out, name, getattr(checkpoint, name).ravel().tolist())
    out.voltage, out.distances, out.rejected = checkpoint.voltage, checkpoint.distances, checkpoint.rejected
    return out
