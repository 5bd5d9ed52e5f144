"""The topics of the package: one table for the nodes and for reading and writing bags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

DEFAULT_NAMESPACE = "/pam"
"""Default namespace of nodes and recordings."""


@dataclass(frozen=True)
class Topic:
    """One topic of the package.

    Attributes:
        name: Logical name, as used by ``read_bag(topics=...)`` and ``--topic NAME=/other``.
        relative: Name relative to the namespace; one that starts with "/" belongs to no namespace.
        type: Full ROS message type, such as "sensor_msgs/msg/FluidPressure".
        meaning: One line with the unit.
    """

    name: str
    relative: str
    type: str
    meaning: str

    def resolve(self, namespace: str) -> str:
        """Absolute name of this topic in ``namespace`` ("" and "/" both mean the root)."""
        if self.relative.startswith("/"):
            return self.relative
        return f"{normalize_namespace(namespace)}/{self.relative}"


def normalize_namespace(namespace: str) -> str:
    """Write a namespace as "/a/b" without a trailing slash; the root is the empty string."""
    stripped = namespace.strip("/")
    return f"/{stripped}" if stripped else ""


_TABLE = (
    Topic("pressure_1", "pressure_1", "sensor_msgs/msg/FluidPressure", "absolute pressure in muscle 1 [Pa]"),
    Topic("pressure_2", "pressure_2", "sensor_msgs/msg/FluidPressure", "absolute pressure in muscle 2 [Pa]"),
    Topic(
        "valve_state",
        "valve_state",
        "pam_antagonist_msgs/msg/ValveCommand",
        "voltages on the valves over the sample that ends at the stamp [V]",
    ),
    Topic(
        "pressure_state",
        "pressure_state",
        "pam_antagonist_msgs/msg/PressureCommand",
        "absolute pressures that the regulators were asked for over the sample that ends at the stamp [Pa]",
    ),
    Topic(
        "angle_sensor",
        "angle_sensor",
        "sensor_msgs/msg/JointState",
        "encoder angle [rad] as an input of the estimator, where it is told to use one (angle_sensor: encoder)",
    ),
    Topic(
        "joint_sample",
        "joint_sample",
        "pam_antagonist_msgs/msg/JointSample",
        "all of a sample in one message, from a node with samples: one [Pa, V, rad, N m]",
    ),
    Topic("valve_command", "valve_command", "pam_antagonist_msgs/msg/ValveCommand", "voltages asked for [V]"),
    Topic(
        "pressure_command",
        "pressure_command",
        "pam_antagonist_msgs/msg/PressureCommand",
        "absolute pressures asked for, of a joint with pressure regulators [Pa]",
    ),
    Topic(
        "joint_estimate",
        "joint_estimate",
        "pam_antagonist_msgs/msg/JointEstimate",
        "estimated angle [rad], velocity [rad/s], torque [N m] and what helps to judge them",
    ),
    Topic(
        "joint_states",
        "joint_states",
        "sensor_msgs/msg/JointState",
        "estimated angle [rad], velocity [rad/s], torque [N m] for larger stacks",
    ),
    Topic(
        "external_torque",
        "external_torque",
        "geometry_msgs/msg/WrenchStamped",
        "estimated torque from outside about +z [N m], of a rig with that state",
    ),
    Topic("reference", "reference", "pam_antagonist_msgs/msg/JointReference", "angle [rad] or torque [N m] wanted"),
    Topic(
        "measured_joint_states",
        "measured/joint_states",
        "sensor_msgs/msg/JointState",
        "encoder angle [rad] and torque meter [N m], for validation only",
    ),
    Topic(
        "measured_external_torque",
        "measured/external_torque",
        "geometry_msgs/msg/WrenchStamped",
        "torque applied from outside about +z [N m], for validation and identification only",
    ),
    Topic("rig", "rig", "std_msgs/msg/String", "the rig that each node was given, as JSON; kept for late subscribers"),
    Topic(
        "filter_checkpoint",
        "filter_checkpoint",
        "pam_antagonist_msgs/msg/FilterCheckpoint",
        "all that the estimator's filter remembers, once a second; a replay goes on from it; kept for late subscribers",
    ),
    Topic(
        "health",
        "health",
        "pam_antagonist_msgs/msg/Health",
        "what the monitor found: the joint is no longer its rig file; kept for late subscribers",
    ),
    Topic("diagnostics", "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "health of the nodes"),
)

TOPICS: Mapping[str, Topic] = MappingProxyType({topic.name: topic for topic in _TABLE})
"""Logical name -> :class:`Topic`."""

SAMPLE_TOPICS = ("pressure_1", "pressure_2", "valve_state")
"""The topics that a recording of a joint with valves needs; the three messages of one sample share a stamp."""
STATE_TOPICS: Mapping[str, str] = MappingProxyType({"valve": "valve_state", "regulator": "pressure_state"})
"""Drive of a joint -> topic of the voltages or pressures that its valves or regulators got."""
COMMAND_TOPICS: Mapping[str, str] = MappingProxyType({"valve": "valve_command", "regulator": "pressure_command"})
"""Drive of a joint -> the topic of its commands."""

ALSO = "also/"
"""Namespace of further signals, relative to the joint's; in a list of columns their prefix."""


def find_topic(name: str) -> Topic | None:
    """Topic of a logical name ("measured_joint_states") or a relative one ("measured/joint_states"), else None."""
    if name in TOPICS:
        return TOPICS[name]
    return next((topic for topic in _TABLE if topic.relative == name), None)
