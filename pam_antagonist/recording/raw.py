"""Raw messages by topic, independent of the file format."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .cdr import Payloads


@dataclass(frozen=True)
class Channel:
    """A bag's description of one of its topics.

    Attributes:
        msgtype: Message type, such as "sensor_msgs/msg/FluidPressure"; "" where the bag does not say.
        encoding: Serialization, "cdr" for ROS 2.
        digest: RIHS01 hash of the type, or "".
    """

    topic: str
    msgtype: str
    encoding: str
    definition: str = ""
    digest: str = ""


@dataclass(frozen=True)
class RawTopic:
    """Messages of one channel in the order of the file.

    Attributes:
        log_ns: Time of reception of each message (N,) [ns].
        payloads: The messages, or None where this type was not requested.
    """

    channel: Channel
    log_ns: NDArray[np.int64]
    payloads: Payloads | None

    @staticmethod
    def joined(channel: Channel, parts: list[RawTopic]) -> RawTopic:
        """Join pieces of one topic (files of a split bag, several publishers)."""
        log_ns = np.concatenate([part.log_ns for part in parts])
        chosen = [part.payloads for part in parts if part.payloads is not None]
        if len(chosen) != len(parts):
            return RawTopic(channel, log_ns, None)
        data = np.concatenate([payloads.data for payloads in chosen])
        return RawTopic(channel, log_ns, Payloads(data, np.concatenate([payloads.length for payloads in chosen])))


@dataclass
class Collector:
    """Gathers messages of one channel, block by block.

    Attributes:
        wanted: whether the messages are kept; otherwise only their times are.
    """

    channel: Channel
    wanted: bool
    _blocks: list[RawTopic] = field(default_factory=list)

    def add(self, log_ns: NDArray[np.int64], payloads: Payloads | None) -> None:
        """Append messages.

        Args:
            log_ns: times of reception (N,) [ns].
        """
        self._blocks.append(RawTopic(self.channel, log_ns, payloads))

    def __len__(self) -> int:
        return sum(len(block.log_ns) for block in self._blocks)

    def cut(self, size: int) -> None:
        """Forget all messages but the first ones."""
        whole = self.finish()
        payloads = whole.payloads
        if payloads is not None:
            data = payloads.data[: int(payloads.length[:size].sum())]
            payloads = Payloads(data, payloads.length[:size])
        self._blocks = [RawTopic(self.channel, whole.log_ns[:size], payloads)]

    def finish(self) -> RawTopic:
        """All collected messages as one topic."""
        if not self._blocks:
            return RawTopic(self.channel, np.empty(0, np.int64), Payloads.of([]) if self.wanted else None)
        return RawTopic.joined(self.channel, self._blocks)
