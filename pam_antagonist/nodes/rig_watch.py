"""Comparison of a node's rig file with those of the other nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from std_msgs.msg import String

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health, Level, judged
from pam_antagonist.nodes.node import RIG_TOPIC, PamNode
from pam_antagonist.rig import RigIdentity, differences

_SOURCES = ("plant", "bridge")


class RigWatch:
    """Compares the rig files of other nodes, which publish them, with the node's own.

    The filter often cannot detect a wrong rig file: the innovations may look right while the angle is wrong.

    `disagree`: called with the problem in words when a node publishes the rig of another joint.
    """

    def __init__(self, node: PamNode, own: RigIdentity, disagree: Callable[[str], object]) -> None:
        self._node = node
        self._own = own
        self._disagree = disagree
        self._others: dict[str, RigIdentity] = {}
        node.create_subscription(String, RIG_TOPIC, self._on_rig, qos.LATCHED)

    def _on_rig(self, message: String) -> None:
        try:
            other = RigIdentity.read(message.data)
        except BadInput as error:
            self._node.get_logger().warning(str(error))
            return
        if other.node == self._own.node:
            return
        if other.node in _SOURCES:  # only one of them runs: the last one to publish
            for source in _SOURCES:
                self._others.pop(source, None)
        self._others[other.node] = other
        if problem := self._problem(other):
            self._disagree(problem)

    def _problem(self, other: RigIdentity) -> str:
        found = differences(self._own, other)
        if not found:
            return ""
        more = f", and {len(found) - 1} more" if len(found) > 1 else ""
        return f"the rig file of the {other.node} is another joint's: {found[0]}{more} ({other}; here {self._own})"

    @property
    def present(self) -> str:
        """The present problem, in words; empty if there is none."""
        return next(filter(None, map(self._problem, self._others.values())), "")

    def forget_the_gone(self) -> None:
        """Forget the rigs of nodes that are gone."""
        topic = self._node.resolve_topic_name(RIG_TOPIC)
        there = {info.node_name for info in self._node.get_publishers_info_by_topic(topic)}
        self._others = {name: other for name, other in self._others.items() if name in there}

    def health(self) -> Health:
        """Part ``rig`` for ``/diagnostics``."""
        values: dict[str, Any] = {self._own.node: str(self._own)}
        values |= {name: str(other) for name, other in sorted(self._others.items())}
        unlike = sorted(other.node for other in self._others.values() if other.fingerprint != self._own.fingerprint)
        return judged(
            values,
            "the same for all",
            (self.present, Level.ERROR, self.present),
            (unlike, Level.OK, f"the same joint; {' and '.join(unlike)} with other values than the controller"),
            (not self._others, Level.OK, "no other node has published its rig yet"),
        )
