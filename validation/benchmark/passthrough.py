"""A pipeline with the same topics and processes and nothing to compute: what ROS 2 itself costs.

``python -m validation.benchmark.passthrough plant|estimator|controller`` runs one of its three nodes.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from sensor_msgs.msg import FluidPressure, JointState
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health, Level
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.parameters import JOINT_NAME, Parameter
from pam_antagonist.nodes.spin import run_node
from pam_antagonist.nodes.wire import set_stamp
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist_msgs.msg import JointEstimate, JointReference, ValveCommand

ROLES = ("plant", "estimator", "controller")
_PERIOD = Parameter("sample_period", 0.001, 1e-4, 0.1).about("time between two samples [s]")
_BURST = 25


def _joint_state(*fields: str) -> JointState:
    message = JointState(name=[JOINT_NAME.default])
    message.header.frame_id = "joint"
    for field in fields:
        setattr(message, field, [0.0])
    return message


class _Relay(PamNode):
    """Publishes its outputs with the stamp of the message that came last."""

    def __init__(self, role: str, **options: Any) -> None:
        super().__init__(role, (_PERIOD,), **options)
        self._sent = 0
        self._outputs: list[tuple[Any, Any]] = []

    def _output(self, topic: str, message: Any) -> None:
        publisher = self.create_publisher(type(message), TOPICS[topic].relative, qos.STREAM)
        self._outputs.append((publisher, message))

    def _send(self, stamp_ns: int) -> None:
        for publisher, message in self._outputs:
            set_stamp(message.header.stamp, stamp_ns)
            publisher.publish(message)
        self._sent += 1

    def _relay(self, message: Any) -> None:
        self._send(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)

    def _drop(self, message: Any) -> None:
        pass

    @override
    def health(self, steady_ns: int) -> Mapping[str, Health]:
        return {"messages": Health(Level.OK, "passed through", {"samples": self._sent})}


class _Source(_Relay):
    """A sample a period, by its own clock, as the plant does it."""

    def __init__(self, role: str, **options: Any) -> None:
        super().__init__(role, **options)
        for topic in ("pressure_1", "pressure_2"):
            self._output(topic, FluidPressure(fluid_pressure=4e5))
        self._output("valve_state", ValveCommand())
        self._output("measured_joint_states", _joint_state("position", "effort"))
        self.create_subscription(ValveCommand, TOPICS["valve_command"].relative, self._drop, qos.COMMAND)
        self._period = round(self.values["sample_period"] * 1e9)
        self._next: int | None = None
        self.start_diagnostics("none")
        self.steady_timer(self.values["sample_period"], self._tick)

    def _tick(self) -> None:
        now = self.now_ns()
        self._next = now if self._next is None else self._next
        for _ in range(_BURST):
            if self._next > now:
                break
            self._send(self._next)
            self._next += self._period


class _Estimator(_Relay):
    def __init__(self, role: str, **options: Any) -> None:
        super().__init__(role, **options)
        self._output("joint_estimate", JointEstimate())
        self._output("joint_states", _joint_state("position", "velocity", "effort"))
        for topic in ("pressure_1", "pressure_2"):
            self.create_subscription(FluidPressure, TOPICS[topic].relative, self._drop, qos.STREAM)
        # The last message of a sample: by then the others have come.
        self.create_subscription(ValveCommand, TOPICS["valve_state"].relative, self._relay, qos.STREAM)
        self.start_diagnostics("none")


class _Controller(_Relay):
    def __init__(self, role: str, **options: Any) -> None:
        super().__init__(role, **options)
        self._output("valve_command", ValveCommand())
        self.create_subscription(JointEstimate, TOPICS["joint_estimate"].relative, self._relay, qos.STREAM)
        self.create_subscription(JointReference, TOPICS["reference"].relative, self._drop, qos.REFERENCE)
        self.start_diagnostics("none")


_NODES = {"plant": _Source, "estimator": _Estimator, "controller": _Controller}


def main(argv: list[str] | None = None) -> int:
    """Run one node; the first argument is its role."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] not in ROLES:
        print(f"error: pass-through node {arguments[:1]}: expected one of {', '.join(ROLES)}", file=sys.stderr)
        return 2
    role = arguments[0]

    def options(given: list[str]) -> None:
        if given != [role]:
            raise BadInput(f"unknown argument {given[-1]!r}")

    return run_node(
        lambda **node_options: _NODES[role](role, **node_options),
        arguments,
        name=f"passthrough {role}",
        description="A node of the same topics as the real one, without any computation.",
        table=(_PERIOD,),
        options=options,
    )


if __name__ == "__main__":
    sys.exit(main())
