"""The estimator's checkpoints as messages: what a bag holds of them is taken by another filter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.ros
MS = 1_000_000


def test_a_message_holds_what_the_filter_remembers() -> None:
    from rclpy.serialization import serialize_message

    from pam_antagonist.estimation import Estimator
    from pam_antagonist.nodes.estimator import checkpoint_message
    from pam_antagonist.recording import signals
    from pam_antagonist.recording.cdr import decode
    from pam_antagonist.recording.raw import Payloads
    from pam_antagonist.recording.topics import TOPICS
    from pam_antagonist.rig import load_rig

    rig = load_rig("shin2022")
    estimator = Estimator(rig)
    stamps = 10**18 + MS * np.arange(200)
    pressure, voltage = np.full((200, 2), 450e3) + np.arange(200)[:, None] * 100.0, np.full((200, 2), 5.5)
    estimator.run(stamps[:100], pressure[:100], voltage[:100])
    checkpoint = estimator.checkpoint()
    assert checkpoint is not None
    data = Payloads.of([serialize_message(checkpoint_message(checkpoint, "elbow"))])
    (recorded,) = signals.read_checkpoints(decode(data, TOPICS["filter_checkpoint"].type), np.arange(1))
    other = Estimator(rig)
    other.restore(recorded)
    whole, rest = (one.run(stamps[100:], pressure[100:], voltage[100:]) for one in (estimator, other))
    assert rest.rows.tobytes() == whole.rows.tobytes()


def test_the_node_publishes_one_a_second_and_when_its_state_is_set(ros: None) -> None:
    from test_estimator_node import send

    from pam_antagonist.nodes.estimator import EstimatorNode
    from pam_antagonist_msgs.srv import SetState

    node = EstimatorNode()
    try:
        sent: list[Any] = []
        node._checkpoints = type("Publisher", (), {"publish": staticmethod(sent.append)})
        node._remember()
        assert sent == []  # the filter is not started
        begin = node.now_ns()
        for k in range(20):
            send(node, begin + k * MS, 450e3, 450e3, (5.5, 5.5))
        node._remember()
        node._remember()  # nothing new
        (first,) = sent
        assert first.rig == "shin2022" and first.tuning == "default" and len(first.state) == 4
        assert first.header.stamp.nanosec == (begin + 19 * MS) % 10**9
        request = SetState.Request(angle=0.1, velocity=0.0, pressure=[4e5, 4e5])
        assert node._on_set_state(request, SetState.Response()).success
        assert len(sent) == 2 and sent[1].state[0] == 0.1 and sent[1].started == sent[1].header.stamp
    finally:
        node.destroy_node()
