"""Environment variables of ROS 2 that a person mistypes, and what watch says where there is no joint."""

from __future__ import annotations

import pytest

from pam_antagonist.cli import demo, watch
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import plant
from pam_antagonist.nodes.spin import nothing_there
from pam_antagonist.optional import check_ros_variables

BAD = [
    ("ROS_DOMAIN_ID", "abc", "expected a whole number from 0 to 232"),
    ("ROS_DOMAIN_ID", "-1", "expected a whole number from 0 to 232"),
    ("ROS_DOMAIN_ID", "233", "expected a whole number from 0 to 232"),
    ("ROS_DOMAIN_ID", "4.5", "expected a whole number from 0 to 232"),
    ("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhost", "did you mean LOCALHOST?"),
    ("ROS_LOCALHOST_ONLY", "yes", "expected one of 0, 1"),
    ("ROS_SECURITY_ENABLE", "yes", "expected one of true, false"),
    ("RMW_IMPLEMENTATION", "rmw_no_such", "is not installed"),
]


@pytest.mark.parametrize(("name", "value", "words"), BAD)
def test_a_variable_that_ros_cannot_use_is_named(name: str, value: str, words: str) -> None:
    with pytest.raises(BadInput, match=f"environment variable {name} is '{value}'") as refused:
        check_ros_variables({name: value, "AMENT_PREFIX_PATH": "/nowhere"})
    assert words in str(refused.value)


def test_what_ros_can_use_is_left_alone() -> None:
    check_ros_variables({})
    check_ros_variables({"ROS_DOMAIN_ID": "", "ROS_AUTOMATIC_DISCOVERY_RANGE": ""})
    check_ros_variables({"ROS_DOMAIN_ID": "232", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "1"})


@pytest.mark.parametrize("command", [demo.main, watch.main, plant.main])
def test_commands_and_nodes_refuse_it_in_one_line(
    command, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", "abc")
    assert command([]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: environment variable ROS_DOMAIN_ID is 'abc'") and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_watch_without_a_joint_says_where_it_looks_and_what_to_try() -> None:
    said = nothing_there("/pam", [], [], {})
    assert said.startswith("no joint in namespace /pam of ROS domain 0. Try: start the joint's nodes")
    assert "ROS domain of their own" in said
    said = nothing_there("/pam", ["/left"], [7, 57], {"ROS_DOMAIN_ID": "7"})
    assert "domain 7" in said and "--namespace /left" in said and "ROS_DOMAIN_ID=57 " in said
    assert "ROS_DOMAIN_ID=7 " not in said, "that is where it looks"
