"""config/record_qos.yaml: what ``ros2 bag record`` is told about quality of service."""

from __future__ import annotations

import pytest
import yaml

from pam_antagonist.paths import config_dir
from pam_antagonist.recording.topics import TOPICS


@pytest.mark.ros
def test_rosbag2_subscribes_as_record_does() -> None:
    from pam_antagonist.nodes import qos

    profiles = yaml.safe_load((config_dir() / "record_qos.yaml").read_text())
    assert set(profiles) == {topic.resolve("/pam") for topic in TOPICS.values()}
    ours = qos.RECORD
    expected = {
        "history": ours.history.name.lower(),
        "depth": ours.depth,
        "reliability": ours.reliability.name.lower(),
        "durability": ours.durability.name.lower(),
    }
    latched = {**expected, "depth": qos.LATCHED.depth, "durability": qos.LATCHED.durability.name.lower()}
    assert profiles.pop("/pam/rig") == latched and profiles.pop("/pam/filter_checkpoint") == latched
    assert all(profile == expected for profile in profiles.values())


def test_the_documented_command_names_every_topic() -> None:
    text = (config_dir().parent / "docs" / "how-to" / "recording.md").read_text()
    command = text.partition("ros2 bag record --storage")[2].partition("\n\n")[0]
    assert {word for word in command.split() if word.startswith(("/pam/", "/diag"))} == {
        topic.resolve("/pam") for topic in TOPICS.values()
    }
