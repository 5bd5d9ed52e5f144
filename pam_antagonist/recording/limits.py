"""When a file of a bag is full."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """When to begin the next file of a bag; the file is looked at with every batch of messages.

    Attributes:
        size: as large as this, or by one chunk (1 MB) more [bytes]; None: never.
        duration: that long after its first message [s]; None: never.
    """

    size: int | None = None
    duration: float | None = None

    @property
    def split(self) -> bool:
        """Whether there may be more than one file."""
        return self.size is not None or self.duration is not None
