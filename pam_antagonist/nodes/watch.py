"""Looking at a running pipeline now and then, and giving it references."""

from __future__ import annotations

import math

from sensor_msgs.msg import JointState

from pam_antagonist.control import Mode
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.visitor import Visitor
from pam_antagonist.recording.topics import DEFAULT_NAMESPACE
from pam_antagonist_msgs.msg import JointEstimate, JointReference, ValveCommand


class Watch(Visitor):
    """Sees estimate, measurement and commands, and gives references.

    Args:
        namespace: of the pipeline.
    """

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        hears = {
            "joint_estimate": JointEstimate,
            "measured_joint_states": JointState,
            "valve_command": ValveCommand,
        }
        super().__init__("watch", namespace, hears, ("reference", JointReference, qos.REFERENCE))

    def send(self, mode: Mode, value: float) -> None:
        """Publish a reference [rad] or [N m], stamped now."""
        self._say(JointReference(mode=int(mode), value=value))

    def look(self, mode: Mode) -> tuple[float, float]:
        """Estimate and measurement now, [rad] or [N m]; NaN where nothing has come."""
        estimate, measured = self.latest("joint_estimate"), self.latest("measured_joint_states")
        if mode is Mode.ANGLE:
            return (
                estimate.angle if estimate is not None else math.nan,
                measured.position[0] if measured is not None else math.nan,
            )
        return (
            estimate.torque if estimate is not None else math.nan,
            measured.effort[0] if measured is not None else math.nan,
        )
