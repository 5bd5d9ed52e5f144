"""The definitions of messages, and the topic table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.interfaces import Nodetype

from pam_antagonist.recording import TOPICS
from pam_antagonist.recording.cdr import CdrError, decode
from pam_antagonist.recording.messages import LATER, stores_of, typestore
from pam_antagonist.recording.raw import Payloads
from pam_antagonist.recording.topics import find_topic

VALVE = "pam_antagonist_msgs/msg/ValveCommand"


def test_valve_command_has_the_hash_of_existing_recordings(rig_a: Path) -> None:
    metadata = yaml.safe_load((rig_a / "nominal" / "free" / "metadata.yaml").read_text())
    topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
    hashes = {entry["topic_metadata"]["type"]: entry["topic_metadata"]["type_description_hash"] for entry in topics}
    assert VALVE in hashes
    for msgtype, digest in hashes.items():
        assert typestore().hash_rihs01(msgtype) == digest


def test_every_topic_has_a_known_type_and_a_name() -> None:
    for name, topic in TOPICS.items():
        assert topic.type in typestore().fielddefs
        assert find_topic(name) is topic
        assert find_topic(topic.relative) is topic
    assert TOPICS["pressure_1"].resolve("pam") == "/pam/pressure_1"
    assert TOPICS["pressure_1"].resolve("/") == "/pressure_1"
    assert TOPICS["diagnostics"].resolve("/pam") == "/diagnostics"


def test_topic_table_needs_no_bag_library() -> None:
    code = (
        "import sys, pam_antagonist.recording as r; r.TOPICS; print('rosbags' in sys.modules or 'numpy' in sys.modules)"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("digest", "definition", "differs"),
    [
        ("", "", False),
        (typestore().hash_rihs01(VALVE), "", False),
        ("RIHS01_" + "0" * 64, "", True),
        ("", typestore().generate_msgdef(VALVE, ros_version=2)[0], False),
        ("", "std_msgs/Header header\nfloat64[3] voltage\n", True),
        ("", "std_msgs/Header header\nfloat32[2] voltage\n", True),
        ("", "@@@", False),
    ],
)
def test_other_definitions_are_noticed(digest: str, definition: str, differs: bool) -> None:
    assert (stores_of(VALVE, digest, definition) == ()) is differs


@pytest.mark.parametrize("msgtype", LATER)
def test_a_former_definition_is_taken_where_the_bag_declares_it_or_the_length_fits(msgtype: str) -> None:
    old, new = typestore(former=True), typestore()
    assert stores_of(msgtype, old.hash_rihs01(msgtype), "") == (old,)
    assert stores_of(msgtype, "", old.generate_msgdef(msgtype, ros_version=2)[0]) == (old,)
    assert stores_of(msgtype, new.hash_rihs01(msgtype), "") == (new,)
    undeclared = stores_of(msgtype, "", "")
    assert undeclared == (new, old)
    for store in (old, new):
        time = store.types["builtin_interfaces/msg/Time"](1, 2)
        values: dict[str, Any] = {"header": store.types["std_msgs/msg/Header"](time, "ab"), "started": time}
        numbers = []
        for name, (kind, what) in store.fielddefs[msgtype][1]:
            if name in values:
                continue
            element = what[0] if kind == Nodetype.BASE else what[0][1][0]
            if element == "string":
                values[name] = "1" if kind == Nodetype.BASE else ["1"]
            else:
                values[name] = 1 if kind == Nodetype.BASE else np.ones(what[1] or 1, element)
                numbers.append(name)
        fields = {name: values[name] for name, _ in store.fielddefs[msgtype][1]}
        data = Payloads.of([bytes(store.serialize_cdr(store.types[msgtype](**fields), msgtype))])
        decoded = decode(data, msgtype, undeclared)
        for name in numbers:
            assert np.all(decoded.fixed(name) == 1)
        assert decoded.has(LATER[msgtype][0]) is (store is new)
        cut = Payloads.of([data.data[:-9].tobytes()])
        with pytest.raises(CdrError, match="needs"):
            decode(cut, msgtype, undeclared)
