"""Quality of service of every topic.

* ``STREAM``: publishers and subscribers of the 1 kHz topics. Reliable, with a depth of one second: stalls of 100 to
  300 ms happen on any shared machine, and messages from this time should arrive late and flagged rather than never.
  Subscribers that prefer the latest value can use best effort.
* ``RECORD``: subscriptions of the recorder; as ``STREAM``, with a depth of five seconds.
* ``COMMAND``: commands of the valves. Reliable; only the newest command of a publisher counts, and a time-out watches
  the commands. The depth makes sure that messages of a second publisher do not hide those of the first one.
* ``REFERENCE``: reliable, volatile, depth 10 for the same reason; a reference holds until the next one.
* ``LATCHED``: reliable, the last ten messages are kept for late subscribers.
* ``LAST_ONE``: as ``LATCHED``, for the last message only.
* ``GLANCE``: best effort, depth 1, for displays that read the latest value from time to time.
* ``DIAGNOSTICS``: reliable, depth 10.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

if TYPE_CHECKING:
    pass


def _profile(depth: int, reliable: bool = True, kept: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


STREAM = _profile(1000)
RECORD = _profile(5000)
COMMAND = _profile(100)
REFERENCE = _profile(10)
GLANCE = _profile(1, reliable=False)
LATCHED = _profile(10, kept=True)
LAST_ONE = _profile(1, kept=True)
DIAGNOSTICS = _profile(10)
