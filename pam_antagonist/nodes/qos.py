"""Quality of service of every topic, chosen once.

* ``STREAM``: the 1 kHz topics, published and subscribed. Reliable and a second deep: single stalls of 100 to 300 ms
  come from any shared machine, and what was sent meanwhile is to arrive late, flagged, rather than never. Subscribers
  that prefer the latest value match it with best effort.
* ``RECORD``: what the recorder subscribes with: as ``STREAM``, five seconds deep.
* ``COMMAND``: what the valves listen to. Reliable; of several commands of one publisher only the newest counts, and a
  time-out watches over it. Deep enough that a second publisher cannot push the first one's commands out unseen.
* ``REFERENCE``: reliable, volatile, depth 10, so that a second publisher cannot push the first one's out unseen; the
  last one is held until the next one.
* ``LATCHED``: said once, and kept for those who come later.
* ``LAST_ONE``: the same of the last message alone.
* ``GLANCE``: best effort, depth 1, for displays that look at the latest value now and then.
"""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy


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
