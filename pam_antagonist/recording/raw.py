"""Raw messages, by topic, whatever file they came from."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .cdr import Payloads


@dataclass(frozen=True)
class Channel:
    """What a bag says about one of its topics.

    Attributes:
        topic: Absolute topic name.
        msgtype: Message type, such as "sensor_msgs/msg/FluidPressure"; "" where the bag does not say.
        encoding: Serialization, "cdr" for ROS 2.
        definition: Definition in .msg or IDL syntax, or "".
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
        channel: Name and type.
        log_ns: When the recorder got each message (N,) [ns].
        payloads: The messages, or None where nobody asked for this type.
    """

    channel: Channel
    log_ns: NDArray[np.int64]
    payloads: Payloads | None

    @staticmethod
    def joined(channel: Channel, parts: list[RawTopic]) -> RawTopic:
        """One topic of several pieces (the files of a split bag, several publishers)."""
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
        channel: whose messages these are.
        wanted: whether the messages are kept, or their times only.
    """

    channel: Channel
    wanted: bool
    _blocks: list[RawTopic] = field(default_factory=list)

    def add(self, log_ns: NDArray[np.int64], payloads: Payloads | None) -> None:
        """Messages that follow those before.

        Args:
            log_ns: times of reception (N,) [ns].
            payloads: the messages; None where they are not wanted.
        """
        self._blocks.append(RawTopic(self.channel, log_ns, payloads))

    def finish(self) -> RawTopic:
        """Everything that was collected."""
        if not self._blocks:
            return RawTopic(self.channel, np.empty(0, np.int64), Payloads.of([]) if self.wanted else None)
        return RawTopic.joined(self.channel, self._blocks)
