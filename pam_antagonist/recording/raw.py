"""Messages of a bag as they are stored: bytes by topic, before anything is decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Payloads:
    """Raw messages of one topic, end to end."""

    data: NDArray[np.uint8]  # all payloads (B,)
    length: NDArray[np.int64]  # of each payload (N,) [bytes]

    @classmethod
    def of(cls, messages: Sequence[bytes | bytearray | memoryview]) -> Payloads:
        """Join a list of payloads."""
        length = np.fromiter(map(len, messages), np.int64, len(messages))
        return cls(np.frombuffer(b"".join(messages), np.uint8), length)

    @classmethod
    def joined(cls, parts: Sequence[Payloads]) -> Payloads:
        """Join blocks of payloads."""
        if len(parts) == 1:
            return parts[0]
        data = np.concatenate([part.data for part in parts])
        return cls(data, np.concatenate([part.length for part in parts]))

    def __len__(self) -> int:
        return len(self.length)

    def each(self) -> Iterator[memoryview]:
        """The messages one by one."""
        view = self.data.data
        for end, size in zip(self.length.cumsum().tolist(), self.length.tolist(), strict=True):
            yield view[end - size : end]


@dataclass(frozen=True)
class RawTopic:
    """Messages of one topic, in the order of the file."""

    topic: str
    msgtype: str  # such as "sensor_msgs/msg/FluidPressure"; "" where the bag does not say
    encoding: str  # "cdr" for ROS 2
    definition: str = ""
    digest: str = ""  # RIHS01 hash of the type, or ""
    log_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))  # times of reception (N,) [ns]
    payloads: Payloads | None = None  # the messages, or None where this type was not requested

    def __len__(self) -> int:
        return len(self.log_ns)

    def joined(self, others: Sequence[RawTopic]) -> RawTopic:
        """This topic with the messages of others behind it: files of a split bag, several publishers."""
        if not others:
            return self
        every = (self, *others)
        payloads = [part.payloads for part in every if part.payloads is not None]
        return replace(
            self,
            log_ns=np.concatenate([part.log_ns for part in every]),
            payloads=Payloads.joined(payloads) if len(payloads) == len(every) else None,
        )
