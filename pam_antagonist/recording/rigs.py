"""What the nodes said about their rigs while a bag was recorded: texts of the topic ``rig``."""

from __future__ import annotations

from .compression import CompressionError
from .storage import RawBag, unpack_messages
from .topics import TOPICS

_MOST = 100  # restarts of nodes in a recording; beyond, the last ones count
_HEAD = 8  # of a std_msgs/String in CDR: the encoding, and the length of the text with its closing zero [bytes]


def rig_texts(bag: RawBag, valve_state: str) -> tuple[str, ...]:
    """The texts, in the order of reception; none where they are not there or not readable, since they are a help only.

    Args:
        bag: the bag.
        valve_state: name of that topic in it, beside which ``rig`` stands.
    """
    topic = TOPICS["rig"]
    raw = bag.topics.get(valve_state.rpartition("/")[0] + f"/{topic.relative}")
    if raw is None or raw.channel.msgtype != topic.type or raw.channel.encoding != "cdr":
        return ()
    try:
        payloads = unpack_messages(raw).payloads
    except CompressionError:
        return ()
    if payloads is None:
        return ()
    texts: dict[str, None] = {}
    stop = payloads.length.cumsum().tolist()
    for k in raw.log_ns.argsort(kind="stable")[-_MOST:].tolist():
        message = payloads.data[stop[k] - int(payloads.length[k]) : stop[k]].tobytes()
        order = "little" if message[1:2] == b"\x01" else "big"
        size = int.from_bytes(message[4:_HEAD], order)  # type: ignore[arg-type]
        if 0 < size <= len(message) - _HEAD:
            texts[message[_HEAD : _HEAD + size - 1].decode(errors="replace")] = None
    return tuple(texts)
