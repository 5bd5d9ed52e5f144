"""References of the controller from a topic: one message type, one publisher at a time, and a health report."""

from __future__ import annotations

import math
import time
from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from pam_antagonist.control.command import Mode
from pam_antagonist.control.reference import Nearest, References, Rules, Trajectory
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health, Level, Rises, judged, publishers_of
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.wire import number_of, take
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.safety import ReferenceOwner
from pam_antagonist_msgs.msg import JointReference

_LOOK = 0.005  # [s] time between two reads of references
_REPEAT_NS = 20_000_000  # [ns] time between two repeated references for a bag
MODES = {"angle": Mode.ANGLE, "torque": Mode.TORQUE}
"""Modes by their names in parameters and pages."""
MODE, ASKED, STIFFNESS = "mode", "asked for now [rad or N m]", "stiffness asked for [N m/rad]"
"""Keys of the part ``reference`` of ``/diagnostics``: mode, value and stiffness of the reference."""


class ReferenceInput:
    """Takes references from the one topic that the parameter ``reference_source`` names.

    Make it in ``configure``, and call :meth:`listen` in ``activate``. It reads references every 5 ms; reading at each
    estimate would add 10 to 20 µs to the round trip of each sample.

    `nearest`: gives the nearest reference that the active law can follow.
    """

    def __init__(self, node: PamNode, nearest: Nearest | None = None) -> None:
        values = node.values
        self._node = node
        self.references = References(
            Rules(
                {Mode.ANGLE: values["max_angle"], Mode.TORQUE: values["max_torque"]},
                {Mode.ANGLE: values["max_angle_rate"], Mode.TORQUE: values["max_torque_rate"]},
                {Mode.ANGLE: values["angle_reference_timeout"], Mode.TORQUE: values["torque_reference_timeout"]},
                values["reference_lost"],
            ),
            nearest,
        )
        self._joint: str = values["joint_name"]
        self._array = (MODES[values["commands_mode"]], int(values["commands_index"]))
        self._kind, self._topic, self._accept = {
            "reference": (JointReference, TOPICS["reference"].relative, self.reference),
            "joint_command": (JointState, "joint_command", self.joint_command),
            "commands": (Float64MultiArray, "commands", self.commands),
            "joint_trajectory": (JointTrajectory, "joint_trajectory", self.trajectory),
        }[values["reference_source"]]
        self._owner = ReferenceOwner()
        self._rises = Rises()
        self._logged = ""
        self._heard_ns: int | None = None
        self._repeated_ns = 0
        self._subscription: Any = None
        self._echo = None
        if values["reference_source"] != "reference":  # repeat the reference as a JointReference for bags and displays
            self._echo = node.create_publisher(JointReference, TOPICS["reference"].relative, qos.REFERENCE)

    def listen(self) -> None:
        """Take references from now on; earlier ones are forgotten."""
        self.references.forget()
        self._owner = ReferenceOwner()
        self._rises, self._logged, self._heard_ns = Rises(), "", None
        self._subscription = self._node.collect(self._kind, self._topic, qos.REFERENCE)
        self._node.steady_timer(_LOOK, self.poll)

    def poll(self) -> None:
        """Read the messages that have come."""
        for data, info in take(self._subscription):
            now = time.monotonic_ns()
            if self._owner.admit(number_of(info), self._subscription.get_publisher_count(), now):
                self._accept(deserialize_message(data, self._kind))
                self._heard_ns = now
                self._log(self.references.complaint or self.references.limited)
            else:
                self._log(
                    f"a second publisher's reference is refused: {', '.join(publishers_of(self._node, self._topic))}"
                )

    def _log(self, words: str) -> None:
        if words and words != self._logged:
            self._node.get_logger().warning(words)
        self._logged = words

    # ---------------------------------------------------------------- kinds of messages

    def reference(self, message: JointReference) -> None:
        """Hold an angle or a torque, with a stiffness where the mode has one."""
        try:
            mode = Mode(message.mode)
        except ValueError:
            self.references.refuse(f"reference has mode {message.mode}, expected {list(map(int, Mode))}")
        else:
            self.references.set(
                mode, message.value, time.monotonic_ns(), stiffness=message.stiffness, damping=message.damping
            )

    def joint_command(self, message: JointState) -> None:
        """Hold the position or, where none is given, the effort of this joint; NaN means not given."""
        if self._joint not in message.name:
            return
        index = list(message.name).index(self._joint)

        def item(name: str) -> float:
            values = getattr(message, name)
            if len(values) not in (0, len(message.name)):
                raise BadInput(f"joint_command has {len(message.name)} names and {len(values)} of {name}")
            return float(values[index]) if len(values) else math.nan

        try:
            position, velocity, effort = item("position"), item("velocity"), item("effort")
        except BadInput as error:
            self.references.refuse(str(error))
            return
        if not math.isnan(position):
            self.references.set(Mode.ANGLE, position, time.monotonic_ns(), velocity)
        elif not math.isnan(effort):
            self.references.set(Mode.TORQUE, effort, time.monotonic_ns())

    def commands(self, message: Float64MultiArray) -> None:
        """Hold the number of this joint; NaN means not given."""
        mode, index = self._array
        if index >= len(message.data):
            self.references.refuse(
                f"commands has {len(message.data)} numbers, but this joint's has index {index} (parameter "
                "commands_index, from 0)",
                mode,
            )
        elif not math.isnan(message.data[index]):
            self.references.set(mode, message.data[index], time.monotonic_ns())

    def trajectory(self, message: JointTrajectory) -> None:
        """Follow the positions or, where there are none, the efforts of this joint."""
        names = list(message.joint_names)
        if self._joint not in names:
            return
        if not message.points:  # as in joint_trajectory_controller: stop at the present position
            self.references.cancel()
            return
        start = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if not start and not self._node.ages.known:  # it would be over at once when the clock comes
            self.references.refuse("joint_trajectory has no stamp, and the node's clock does not run")
            return
        try:
            made = _trajectory(message.points, names.index(self._joint), start or self._node.now_ns())
        except BadInput as error:
            self.references.refuse(str(error))
        else:
            self.references.follow(made, time.monotonic_ns())

    # ---------------------------------------------------------------- what is said about them

    def repeat(self, stamp_ns: int) -> None:
        """Publish the reference at a sample as a JointReference for bags, at most every 20 ms.

        `stamp_ns`: of the sample [ns].
        """
        references = self.references
        if self._echo is None or not math.isfinite(references.value) or references.mode is None:
            return
        if 0 <= stamp_ns - self._repeated_ns < _REPEAT_NS:
            return
        self._repeated_ns = stamp_ns
        message = JointReference(
            mode=int(references.mode), value=references.value, stiffness=math.nan, damping=math.nan
        )
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        self._echo.publish(message)

    def health(self) -> Health:
        """Part ``reference`` for ``/diagnostics``."""
        references = self.references
        refused = self._rises.take(refused=self._owner.refused)["refused"]
        publishers = publishers_of(self._node, self._topic)
        names = ", ".join(publishers) or "none"
        age = math.nan if self._heard_ns is None else (time.monotonic_ns() - self._heard_ns) * 1e-9
        values = {
            "source": f"{self._node.resolve_topic_name(self._topic)} ({self._kind.__name__})",
            MODE: references.mode.name.lower() if references.mode is not None else "none",
            ASKED: references.value,
            STIFFNESS: references.stiffness,
            "age [s]": f"{age:.3f}",
            "limited": references.limited_count,
            "timed out": references.lost_count,
            "refused, second publisher": self._owner.refused,
            "publishers": names,
        }
        holds = self._node.values["reference_lost"] == "hold"
        then = "the angle estimated at that moment is held" if holds else "safe voltages"
        return judged(
            values,
            "followed",
            (refused, Level.ERROR, f"{refused} references of a second publisher refused: {names}"),
            (references.complaint, Level.ERROR, f"{references.complaint}: safe voltages"),
            (references.lost, Level.ERROR, f"the reference timed out: {then}"),
            (len(publishers) > 1, Level.WARN, f"{len(publishers)} publishers of references: {names}"),
            (references.limited, Level.WARN, references.limited),
            (references.mode is None, Level.WARN, "no reference has come yet"),
        )


def _trajectory(points: Any, index: int, start_ns: int) -> Trajectory:
    """The trajectory of one joint, from positions or, without them, from efforts."""
    seconds = [point.time_from_start.sec + point.time_from_start.nanosec * 1e-9 for point in points]

    def column(name: str) -> list[float]:
        rows = [getattr(point, name) for point in points]
        if not any(len(row) for row in rows):
            return []
        if any(len(row) <= index for row in rows):
            raise BadInput(f"trajectory whose points do not all have {name} of this joint")
        return [float(row[index]) for row in rows]

    positions, velocities, efforts = column("positions"), column("velocities"), column("effort")
    if positions:
        return Trajectory(Mode.ANGLE, start_ns, seconds, positions, velocities)
    if efforts:
        return Trajectory(Mode.TORQUE, start_ns, seconds, efforts)
    raise BadInput("trajectory with neither positions nor efforts")
