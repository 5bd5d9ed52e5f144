"""A process between two nodes. It forwards messages, and on order it loses some, sends some twice, or late.

``python -m validation.faults.relay relay PIPE DOMAIN TOPIC...``: what comes on a topic goes out on
``relayed/TOPIC``. Orders come through the pipe: ``+drop=SHARE TOPIC``, ``+double TOPIC``, ``+late=SECONDS TOPIC``, and
``-TOPIC`` ends whatever there is with it.
"""

from __future__ import annotations

import os
import random
import sys
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pam_antagonist.nodes.processes import PARENT_VARIABLE
from pam_antagonist.nodes.spin import hurry
from validation.device.line_faults import FaultOrders

_LOOK = 2e-4  # [s]


def parse_order(text: str) -> tuple[str, str, float]:
    """Topic of an order; what is to be done to its messages: ``drop``, ``double``, ``late`` or nothing; how much."""
    if text.startswith("-"):
        return text[1:], "", 0.0
    head, topic = text.removeprefix("+").split()
    kind, _, number = head.partition("=")
    return topic, kind, float(number or 0.0)


class Line:
    """What happens to the messages of one topic on their way (no ROS in here)."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._waiting: deque[tuple[float, Any]] = deque()
        self.order = "", 0.0  # share of messages [-], or delay [s]

    def put(self, message: Any, now: float) -> None:
        """Take a message at a time [s]."""
        kind, value = self.order
        if kind == "drop" and self._random.random() < value:
            return
        due = now + value if kind == "late" else now
        for _ in range(2 if kind == "double" else 1):
            self._waiting.append((due, message))

    def due(self, now: float) -> Iterator[Any]:
        """Messages that are to go on, in the order in which they came: none overtakes another one."""
        while self._waiting and self._waiting[0][0] <= now:
            yield self._waiting.popleft()[1]


def main(argv: list[str]) -> int:
    """Forward until the parent is gone or a signal comes."""
    import importlib

    import rclpy
    from rclpy.node import Node

    from pam_antagonist.nodes import qos
    from pam_antagonist.nodes.spin import tune_middleware
    from pam_antagonist.recording.topics import DEFAULT_NAMESPACE, TOPICS

    _, pipe, domain, *names = argv
    orders = FaultOrders(Path(pipe))
    parent = int(os.environ.get(PARENT_VARIABLE, "0"))
    tune_middleware()
    rclpy.init(args=[], domain_id=int(domain))
    node = Node("relay", namespace=DEFAULT_NAMESPACE, start_parameter_services=False)
    lines = {name: Line(seed) for seed, name in enumerate(names)}
    ways = []
    for name in names:
        package, _, of = TOPICS[name].type.split("/")
        message = getattr(importlib.import_module(f"{package}.msg"), of)
        topic = TOPICS[name].relative
        out = node.create_publisher(message, f"relayed/{topic}", qos.STREAM)
        ways.append((lines[name], node.create_subscription(message, topic, lambda _: None, qos.STREAM, raw=True), out))
    hurry()
    try:
        while rclpy.ok() and not (parent and os.getppid() != parent):
            for text in orders.take():
                topic, kind, value = parse_order(text)
                lines[topic].order = kind, value
            now = time.monotonic()
            for line, subscription, out in ways:
                with subscription.handle:
                    while (taken := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                        line.put(taken[0], now)
                for data in line.due(now):
                    out.publish(data)
            time.sleep(_LOOK)
    except KeyboardInterrupt:
        pass
    finally:
        orders.close()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
