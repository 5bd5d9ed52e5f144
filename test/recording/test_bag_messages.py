"""The definitions of messages, and the topic table."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from pam_antagonist.recording import TOPICS
from pam_antagonist.recording.messages import is_known, typestore
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
    assert is_known(VALVE, digest, definition) is not differs
