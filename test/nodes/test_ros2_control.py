"""A stack of ros2_control in front of the pipeline: a double of joint_state_topic_hardware_interface over real DDS."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

from pam_antagonist.nodes.processes import Processes, ros_arguments
from pam_antagonist.paths import config_dir

pytestmark = pytest.mark.ros

SAFE = (5.0, 5.2)
PERIOD = 0.01


class TopicSystem:
    """What ``JointStateTopicSystem`` does (version 1.1.0), for one joint with a position command.

    States come by sensor data QoS. The last one is kept for ever: no age is looked at, and values that are not finite
    are passed over. A command goes out with each ``write``, reliably with depth 1, since the threshold is -1. As long
    as no controller has set it, it is NaN, and goes out as that.
    """

    def __init__(self, joint: str) -> None:
        from probe import Probe
        from rclpy.qos import QoSProfile, qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self.probe = Probe("joint_states", "valve_state", name="controller_manager", profile=qos_profile_sensor_data)
        self._message = JointState(name=[joint])
        self._commands = self.probe.node.create_publisher(JointState, "joint_command", QoSProfile(depth=1))
        self.position = self.command = math.nan
        self.valves: tuple[float, float] | None = None

    def read(self) -> None:
        self.probe.collect()
        for _, message in self.probe.seen["joint_states"]:
            (name,) = message.name
            if name == self._message.name[0] and math.isfinite(message.position[0]):
                self.position = message.position[0]
        if self.probe.seen["valve_state"]:
            self.valves = self.probe.voltage()
        self.probe.clear()

    def write(self) -> None:
        self._message.position = [self.command]
        self._message.header.stamp = self.probe.node.get_clock().now().to_msg()
        self._commands.publish(self._message)

    def until(self, condition: Callable[[], bool], limit: float, what: str, writes: bool = True) -> None:
        """Updates at 50 Hz until it is so."""
        end = time.monotonic() + limit
        while True:
            self.read()
            if condition():
                return
            assert time.monotonic() < end, f"{what} did not happen within {limit} s: {self.position}, {self.valves}"
            if writes:
                self.write()
            time.sleep(0.02)


@pytest.fixture
def pipeline(tmp_path: Path, domain: None) -> Iterator[tuple[Processes, TopicSystem]]:
    """Three nodes at 100 Hz, which any machine keeps up with, and the stack."""
    text = (config_dir() / "rigs" / "shin2022.yaml").read_text()
    rig = tmp_path / "slow.yaml"
    rig.write_text(re.sub(r"^sample_period: \S+", f"sample_period: {PERIOD}", text, flags=re.MULTILINE))
    common = {"rig": str(rig), "joint_name": "left_elbow"}
    given = yaml.safe_load((config_dir() / "ros2_control" / "pipeline.yaml").read_text())
    controller = given["/**/controller"]["ros__parameters"]
    patient = {"max_age": 0.2}
    with Processes(tmp_path) as processes:
        processes.start("estimator", ros_arguments({**common, **patient, "pairing_timeout": 0.2}, {}))
        # Gains that settle within about a second.
        more = {"safe_voltage": list(SAFE), "angle_proportional": 30.0, "angle_integral": 30.0}
        processes.start("controller", ros_arguments({**common, **patient, **controller, **more}, {}))
        owner = {"safe_voltage": list(SAFE), "command_timeout": 0.5, "max_command_age": 0.5}
        processes.start("plant", ros_arguments({**common, **owner, "wait_for_subscribers": 1}, {}))
        stack = TopicSystem("left_elbow")
        with stack.probe:
            yield processes, stack


@pytest.mark.slow(4)
def test_the_stack_moves_the_joint_and_nothing_that_dies_keeps_the_valves(
    pipeline: tuple[Processes, TopicSystem],
) -> None:
    from probe import kill

    processes, stack = pipeline
    stack.until(lambda: math.isfinite(stack.position) and stack.valves is not None, 60.0, "a state")
    end = time.monotonic() + 0.5
    stack.until(lambda: time.monotonic() > end, 2.0, "half a second")
    assert stack.valves == SAFE  # NaN is not asked

    stack.command = 0.1
    stack.until(lambda: abs(stack.position - 0.1) < 0.01, 30.0, "the commanded angle")
    assert stack.valves != SAFE

    # A stack that is gone: the commands stop.
    stack.until(lambda: stack.valves == SAFE, 5.0, "safe voltages without commands", writes=False)
    stack.until(lambda: stack.valves != SAFE, 5.0, "control with commands again")

    # An estimator that is gone: the stack's state stands still and looks alive, and the stack goes on commanding.
    kill(processes, "estimator")
    stack.command = 0.15
    stack.until(lambda: stack.valves == SAFE, 5.0, "safe voltages without estimates")
    frozen = stack.position
    end = time.monotonic() + 0.5
    stack.until(lambda: time.monotonic() > end, 2.0, "half a second")
    assert stack.position == frozen
    assert stack.valves == SAFE
    processes.check()
