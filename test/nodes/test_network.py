"""The environment of ROS 2: nodes are heard on this machine only, unless somebody asked for more; typing mistakes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from pam_antagonist.cli import demo, watch
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import plant
from pam_antagonist.nodes.processes import Processes, free_domain
from pam_antagonist.nodes.spin import nothing_there, stay_on_this_machine
from pam_antagonist.optional import check_ros_variables
from pam_antagonist.paths import config_dir


def test_nobody_asked() -> None:
    environment = {"PATH": "/bin", "ROS_STATIC_PEERS": ""}
    assert stay_on_this_machine(environment)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF"),
        ("ROS_STATIC_PEERS", "192.168.0.7"),
        ("ROS_LOCALHOST_ONLY", "0"),
        ("ROS_DISCOVERY_SERVER", "127.0.0.1:11811"),
    ],
)
def test_somebody_did(name: str, value: str) -> None:
    environment = {name: value}
    assert not stay_on_this_machine(environment)
    assert environment == {name: value}


def test_the_local_profile_is_the_other_one_on_the_loopback_interface() -> None:
    comment = re.compile(r"<!--.*?-->", re.DOTALL)
    texts = [comment.sub("", (config_dir() / name).read_text()) for name in ("fastdds.xml", "fastdds_local.xml")]
    for own in (
        r"<maxInitialPeersRange>32</maxInitialPeersRange>",
        r"<interfaceWhiteList>\s*<address>127\.0\.0\.1</address>\s*</interfaceWhiteList>",
        r"<metatrafficUnicastLocatorList>\s*<locator>\s*<udpv4/>\s*</locator>\s*</metatrafficUnicastLocatorList>",
        r"<initialPeersList>.*127\.0\.0\.1.*</initialPeersList>",
    ):
        texts[1], count = re.subn(r"\s*" + own, "", texts[1], flags=re.DOTALL)
        assert count == 1, own
    assert texts[1] == texts[0]


def receiving(pid: int) -> set[str]:
    """Local addresses of the UDP sockets with the ports of DDS that a process has."""
    inodes, found = set(), set()
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):  # a file that was closed since it was listed
            inodes.add(os.readlink(link))
    for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        address, port = fields[1].split(":")
        if f"socket:[{fields[9]}]" in inodes and int(port, 16) in range(7000, 33000):
            found.add(".".join(str(byte) for byte in reversed(bytes.fromhex(address))))
    return found


STRANGER = """
import time, rclpy
from sensor_msgs.msg import FluidPressure
rclpy.init()
node, heard = rclpy.create_node("stranger"), []
node.create_subscription(FluidPressure, "/pam/pressure_1", heard.append, 10)
end = time.monotonic() + 20.0
while time.monotonic() < end and not heard:
    rclpy.spin_once(node, timeout_sec=0.1)
print("heard" if heard else "nothing")
"""


NODES = """
from pathlib import Path
from pam_antagonist.nodes.spin import tune_middleware
tune_middleware()
import rclpy
from rclpy.lifecycle import LifecycleNode
rclpy.init()
kept = []
for several in (2, 8):
    before = int(Path("/proc/self/statm").read_text().split()[1])
    kept += [LifecycleNode(f"node_{len(kept) + k}") for k in range(several)]
print((int(Path("/proc/self/statm").read_text().split()[1]) - before) * 4096 / 8e6)
"""


@pytest.mark.ros
def test_a_node_is_small(domain: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """With room for a second at 1 kHz in the queues of its services it would take 4.7 MB."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    done = subprocess.run([sys.executable, "-c", NODES], capture_output=True, text=True, timeout=60, check=False)
    assert float(done.stdout or "inf") < 2.5, done.stdout + done.stderr


@pytest.mark.slow(5)
@pytest.mark.ros
def test_tools_of_this_machine_hear_the_nodes(tmp_path: Path, domain: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tools that know nothing of this package, whatever their range is."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    with Processes(tmp_path) as processes:
        processes.start("plant")
        tools = {
            range_: subprocess.Popen(
                [sys.executable, "-c", STRANGER], env={**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": range_},
                stdout=subprocess.PIPE, text=True,
            )
            for range_ in ("LOCALHOST", "SUBNET", "")
        }  # fmt: skip
        heard = {range_: tool.communicate(timeout=60)[0].strip() for range_, tool in tools.items()}
        processes.check()
    assert heard == dict.fromkeys(tools, "heard")


@pytest.mark.slow(4)
@pytest.mark.ros
@pytest.mark.parametrize(("range_", "addresses"), [("LOCALHOST", {"127.0.0.1"}), ("SUBNET", {"0.0.0.0"})])
def test_where_nodes_listen_and_that_their_domain_is_not_free(
    range_: str, addresses: set[str], tmp_path: Path, domain: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even when the participant that came first has left again."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", range_)
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE", raising=False)
    used = int(os.environ["ROS_DOMAIN_ID"])
    monkeypatch.setattr("random.shuffle", lambda domains: domains.sort(key=lambda number: number != used))
    assert free_domain() == used
    with Processes(tmp_path) as processes:
        for name in ("controller", "record"):
            pid = processes.start(name, ["--out", str(tmp_path / "bag")] if name == "record" else []).popen.pid
            end = time.monotonic() + 60.0
            while not receiving(pid):
                processes.check()
                assert time.monotonic() < end, "the node has no sockets"
                time.sleep(0.1)
        time.sleep(0.5)
        controller = processes.running["controller"].popen.pid
        assert receiving(controller) == addresses
        # A lock in shared memory outlives a node that was killed, and its successor is not heard.
        assert "/dev/shm/fastrtps" not in Path(f"/proc/{controller}/maps").read_text()
        assert free_domain() != used
        processes.stop("controller")
        assert free_domain() != used
    assert free_domain() == used


@pytest.mark.ros
def test_security_that_is_not_there_is_refused_in_one_line(tmp_path: Path, domain: None) -> None:
    (tmp_path / "enclaves").mkdir()
    asked = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "pam_antagonist", "controller"],
        env={**os.environ, **asked}, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert done.returncode == 2, done.stderr
    assert len(errors) == 1 and "ecurity" in errors[0]
    assert "Traceback" not in done.stderr


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
