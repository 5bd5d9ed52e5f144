"""Quality of service over DDS: what does not match is told by name, and an override makes it match."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from sent import MS, stamped

from pam_antagonist.errors import BadInput

pytestmark = pytest.mark.ros


DRIVEN = ("pressure_1", "pressure_2", "valve_state")


@pytest.fixture
def driver(ros: None) -> Iterator[Any]:
    """A driver as many are: sensor data, best effort."""
    from probe import Probe
    from rclpy.qos import qos_profile_sensor_data

    with Probe(name="daq", profile=qos_profile_sensor_data) as driver:
        driver.outputs = {name: driver.publisher(name) for name in DRIVEN}
        yield driver


@pytest.fixture
def make(new_node: Callable[..., Any]) -> Callable[..., Any]:
    from pam_antagonist.nodes.estimator import EstimatorNode

    def factory(**parameters: Any) -> Any:
        node = new_node(EstimatorNode, **parameters)
        node.start()
        return node

    return factory


def problems(node: Any) -> list[str]:
    return list(node.connections().values.values())


def override(topic: str, side: str = "subscription", **policies: Any) -> dict[str, Any]:
    return {f"qos_overrides.{topic}.{side}.{name}": value for name, value in policies.items()}


def test_a_best_effort_driver_is_an_error_that_names_it_and_what_to_set(make: Any, driver: Any) -> None:
    node = make()
    driver.until(lambda: " ".join(problems(node)).count("/pam/daq") == 3, what="a driver")
    health = node.connections()
    assert health.level == 2
    assert health.message == (
        "publisher /pam/daq of /pam/pressure_1 is not connected: best effort offered, reliable asked for; set "
        "qos_overrides./pam/pressure_1.subscription.reliability to best_effort, or change the other side, and 2 more"
    )
    sent: list[Any] = []
    node._diagnostics._publisher.publish = sent.append
    node._diagnose()
    (status,) = [status for status in sent[0].status if status.name == "pam/estimator: connections"]
    assert status.level == b"\x02" and status.message == health.message


def test_what_the_error_says_makes_it_work(make: Any, driver: Any) -> None:
    import rclpy

    from pam_antagonist.nodes.qos import STREAM

    given: dict[str, Any] = {}
    for name in DRIVEN:
        given |= override(f"/pam/{name}", reliability="best_effort")
    node = make(**given)
    assert STREAM.reliability.name == "RELIABLE"  # the default of all others is untouched
    driver.until(lambda: all(output.get_subscription_count() for output in driver.outputs.values()), what="a listener")
    assert node.connections().level == 0
    begin = node.now_ns()
    executor = rclpy.executors.SingleThreadedExecutor()
    executor.add_node(node)
    end, k = time.monotonic() + 10.0, 0
    try:
        while node._published < 20 and time.monotonic() < end:  # best effort: what comes before both know is lost
            for name, output in driver.outputs.items():
                message = output.msg_type()
                stamped(message, begin + k * MS)
                if name == "valve_state":
                    message.voltage = [5.5, 5.5]
                else:
                    message.fluid_pressure = 450e3
                output.publish(message)
            k += 1
            executor.spin_once(timeout_sec=0.01)
    finally:
        executor.shutdown()
    assert node._published >= 20


def test_a_subscriber_that_asks_for_more_is_named_too(make: Any, driver: Any) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from sensor_msgs.msg import JointState

    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    driver.node.create_subscription(JointState, "joint_states", lambda message: None, kept)
    node = make()

    def words() -> str:
        return "; ".join(problems(node))

    driver.until(lambda: "/pam/daq of /pam/joint_states" in words(), what="a subscriber")
    assert (
        "subscriber /pam/daq of /pam/joint_states is not connected: volatile offered, transient local asked" in words()
    )


@pytest.mark.parametrize(
    ("policies", "words"),
    [({"reliability": "perhaps"}, "perhaps"), ({"reliability": 1}, "reliability"), ({"depth": "deep"}, "depth")],
)
def test_overrides_that_cannot_be_used_are_refused(make: Any, policies: dict[str, Any], words: str) -> None:
    with pytest.raises(
        BadInput, match=rf"qos_overrides of pressure_1: .*{words}.*expected reliability, history or depth"
    ):
        make(**override("/pam/pressure_1", **policies))


def test_durability_is_no_ones_to_override(make: Any, ros: None) -> None:
    node = make(**override("/pam/pressure_1", durability="transient_local"))
    (info,) = node.get_subscriptions_info_by_topic("/pam/pressure_1")
    assert info.qos_profile.durability.name == "VOLATILE"
