"""Recording topics as they come, without looking into the messages."""

from __future__ import annotations

import contextlib
import importlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

from rclpy.subscription import Subscription

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import qos
from pam_antagonist.nodes.health import Health, Level, Rate
from pam_antagonist.nodes.node import PamNode
from pam_antagonist.nodes.recorder import PARAMETERS, Options
from pam_antagonist.recording.topics import TOPICS
from pam_antagonist.recording.writer import BagWriter

_PERIOD = 0.02  # time between two looks [s]; the queues hold 250 times as much at 1 kHz


def message_class(name: str) -> Any:
    """The class of a message type such as ``sensor_msgs/msg/JointState``."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


class RecorderNode(PamNode):
    """Collects serialised messages in bulk, and hands them to the bag's own thread.

    The queues of the middleware are emptied fifty times a second. Being woken for each of 7000 messages a second would
    cost twice the processor time; the times of reception are the middleware's, and lose nothing by it.

    Args:
        options: where to write, and for how long.

    Raises:
        BadInput: the folder exists or cannot be made.
    """

    def __init__(self, options: Options) -> None:
        self._collected: dict[str, Subscription] = {}
        super().__init__("recorder", PARAMETERS)
        self._bag = BagWriter(options.out)
        self._path = options.out
        self._counts: dict[str, int] = {}
        self._failed = False
        self._rate = Rate()
        for topic in TOPICS.values():
            name = self.resolve_topic_name(topic.relative)
            self._bag.add_topic(name, topic.type)
            self._counts[name] = 0
            self._collected[name] = self.create_subscription(
                message_class(topic.type), topic.relative, _never, qos.RECORD, raw=True
            )
        self._end = None if options.duration is None else time.monotonic() + options.duration
        self.start_diagnostics(options.out.name)
        self.steady_timer(_PERIOD, self._collect)
        self.get_logger().info(f"recording into {options.out}")

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Those that an executor is to wake up for: not the recorded ones."""
        collected = set(map(id, self._collected.values()))
        return (item for item in super().subscriptions if id(item) not in collected)

    def _collect(self) -> None:
        for name, subscription in self._collected.items():
            items = []
            with subscription.handle:
                handle = subscription.handle
                while (taken := handle.take_message(subscription.msg_type, True)) is not None:
                    items.append((name, taken[1]["received_timestamp"] or time.time_ns(), taken[0]))
            self._counts[name] += len(items)
            try:
                self._bag.write_many(items)
            except OSError as error:
                self._failed = True
                raise BadInput(f"{self._path}: cannot be written: {error.strerror or error}") from None
        if self._end is not None and time.monotonic() >= self._end:
            self.finished = True

    def close(self) -> None:
        """Write what is left, finish the bag, and say what is in it."""
        if self._failed:
            with contextlib.suppress(OSError):  # it was reported where it was met
                self._bag.close()
            return
        self._collect()
        try:
            self._bag.close()
        except OSError as error:
            raise BadInput(f"{self._path}: cannot be written: {error.strerror or error}") from None
        print(f"recorded {sum(self._counts.values())} messages into {self._path}")
        width = max(map(len, self._counts))
        for topic, count in self._counts.items():
            print(f"  {topic.ljust(width)}  {count:9d}")

    def health(self, steady_ns: int) -> Mapping[str, Health]:
        total = sum(self._counts.values())
        rate = self._rate.take(total, steady_ns)
        return {
            "bag": Health(
                Level.OK if total else Level.WARN,
                "recording" if total else "no message has come yet",
                {"rate [Hz]": f"{rate:.1f}", "messages": total, **self._counts},
            )
        }


def _never(_message: bytes) -> None:
    raise AssertionError("the executor does not see this subscription")
