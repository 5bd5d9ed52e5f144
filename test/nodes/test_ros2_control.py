"""A stack of ros2_control in front of the pipeline: a double of joint_state_topic_hardware_interface over real DDS."""

from __future__ import annotations

import math
import re
import signal
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

    def __init__(self, namespace: str, joint: str) -> None:
        import rclpy
        from rclpy.node import Node
        from rclpy.qos import QoSProfile, qos_profile_sensor_data
        from rclpy.signals import SignalHandlerOptions
        from sensor_msgs.msg import JointState

        from pam_antagonist.nodes.spin import tune_middleware
        from pam_antagonist_msgs.msg import ValveCommand

        tune_middleware()
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node("controller_manager", context=self._context, start_parameter_services=False)
        self._joint, self._kind = joint, JointState
        self._commands = self.node.create_publisher(JointState, f"{namespace}/joint_command", QoSProfile(depth=1))
        subscribe = self.node.create_subscription
        profile = qos_profile_sensor_data
        self._states = subscribe(JointState, f"{namespace}/joint_states", lambda message: None, profile)
        self._valves = subscribe(ValveCommand, f"{namespace}/valve_state", lambda message: None, profile)
        self.state = {"position": math.nan, "velocity": math.nan, "effort": math.nan}
        self.command = math.nan
        self.valves: tuple[float, float] | None = None

    def read(self) -> None:
        from pam_antagonist.nodes.wire import take

        for message, _ in take(self._states):
            if self._joint in message.name:
                index = list(message.name).index(self._joint)
                for name in self.state:
                    values = getattr(message, name)
                    if len(values) and math.isfinite(values[index]):
                        self.state[name] = values[index]
        for message, _ in take(self._valves):
            self.valves = (message.voltage[0], message.voltage[1])

    def write(self) -> None:
        message = self._kind(name=[self._joint], position=[self.command])
        message.header.stamp = self.node.get_clock().now().to_msg()
        self._commands.publish(message)

    def until(self, condition: Callable[[], bool], limit: float, what: str, writes: bool = True) -> None:
        """Updates at 50 Hz until it is so."""
        end = time.monotonic() + limit
        while True:
            self.read()
            if condition():
                return
            assert time.monotonic() < end, f"{what} did not happen within {limit} s: {self.state}, {self.valves}"
            if writes:
                self.write()
            time.sleep(0.02)

    def close(self) -> None:
        import rclpy

        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


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
        stack = TopicSystem("/pam", "left_elbow")
        try:
            yield processes, stack
        finally:
            stack.close()


def test_the_stack_moves_the_joint_and_nothing_that_dies_keeps_the_valves(
    pipeline: tuple[Processes, TopicSystem],
) -> None:
    processes, stack = pipeline
    stack.until(lambda: math.isfinite(stack.state["position"]) and stack.valves is not None, 60.0, "a state")
    end = time.monotonic() + 0.5
    stack.until(lambda: time.monotonic() > end, 2.0, "half a second")
    assert stack.valves == SAFE  # NaN is not asked

    stack.command = 0.1
    stack.until(lambda: abs(stack.state["position"] - 0.1) < 0.01, 30.0, "the commanded angle")
    assert stack.valves != SAFE

    # A stack that is gone: the commands stop.
    stack.until(lambda: stack.valves == SAFE, 5.0, "safe voltages without commands", writes=False)
    stack.until(lambda: stack.valves != SAFE, 5.0, "control with commands again")

    # An estimator that is gone: the stack's state stands still and looks alive, and the stack goes on commanding.
    processes.running["estimator"].popen.send_signal(signal.SIGKILL)
    processes.running.pop("estimator").popen.wait(10.0)
    stack.command = 0.15
    stack.until(lambda: stack.valves == SAFE, 5.0, "safe voltages without estimates")
    frozen = dict(stack.state)
    end = time.monotonic() + 0.5
    stack.until(lambda: time.monotonic() > end, 2.0, "half a second")
    assert stack.state == frozen and math.isfinite(frozen["position"])
    assert stack.valves == SAFE
    processes.check()
