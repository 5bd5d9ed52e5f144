"""config/security/policy.xml: what it lets whom do, held against the topic table and against the running nodes."""

from __future__ import annotations

import time
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterator
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from pam_antagonist.nodes.processes import Processes, free_domain
from pam_antagonist.paths import config_dir
from pam_antagonist.recording.topics import SAMPLE_TOPICS, TOPICS

POLICY = config_dir() / "security" / "policy.xml"
NODES = ("plant", "bridge", "estimator", "monitor", "controller", "recorder")
SOURCES = {"plant", "bridge"}
PUBLISHERS = {
    "joint_sample": SOURCES,
    "pressure_1": SOURCES, "pressure_2": SOURCES, "valve_state": SOURCES, "pressure_state": SOURCES,
    "angle_sensor": SOURCES, "measured_joint_states": SOURCES, "measured_external_torque": SOURCES,
    "valve_command": {"controller"}, "pressure_command": {"controller"}, "joint_estimate": {"estimator"},
    "joint_states": {"estimator"}, "external_torque": {"estimator"}, "filter_checkpoint": {"estimator"},
    "reference": {"operator"}, "rig": {*SOURCES, "estimator", "monitor", "controller"}, "health": {"monitor"},
    "diagnostics": set(NODES),
}  # fmt: skip
SERVICES = {
    "plant": {"stop", "clear_stop"}, "bridge": {"stop", "clear_stop", "measure_rest"},
    "estimator": {"reset", "set_state"}, "monitor": set(), "controller": {"clear_stop", "enable"}, "recorder": set(),
}  # fmt: skip
COMMAND_LINE = "_ros2cli_requester_std_srvs_Trigger"  # as ros2 service calls its node; the others: _ros2cli_NUMBER
Rules = dict[tuple[str, str], set[str]]


def rules() -> dict[str, Rules]:
    """Node -> ("topic", "publish") and so on -> absolute names."""
    found: dict[str, Rules] = {}
    root = ET.parse(POLICY).getroot()
    assert root.tag == "policy" and root.attrib == {"version": "0.2.0"}
    assert [child.tag for child in root] == ["enclaves"]
    for enclave in root[0]:
        assert enclave.tag == "enclave" and [child.tag for child in enclave] == ["profiles"]
        (profile,) = enclave[0]  # a key for each node
        assert profile.tag == "profile" and set(profile.attrib) == {"ns", "node"}
        ns, node = profile.attrib["ns"], profile.attrib["node"]
        assert enclave.attrib == {"path": f"{ns}/{node}"}
        mine: Rules = defaultdict(set)
        for part in profile:
            ((verb, verdict),) = part.attrib.items()
            assert verdict == "ALLOW"
            assert verb in {"topics": ("publish", "subscribe"), "services": ("reply", "request")}[part.tag]
            for item in part:
                assert item.tag == part.tag[:-1] and item.text and not item.attrib
                name = item.text.replace("~/", f"{ns}/{node}/") if item.text.startswith("~") else item.text
                name = name if name.startswith("/") else f"{ns}/{name}"
                assert name not in mine[item.tag, verb], f"{name} twice"
                mine[item.tag, verb].add(name)
        found[node] = mine
    return found


def test_every_node_has_an_enclave() -> None:
    assert set(rules()) == {*NODES, "operator"}


@pytest.mark.parametrize("name", TOPICS)
def test_who_may_publish(name: str) -> None:
    topic = TOPICS[name].resolve("/pam")
    allowed = {node for node, mine in rules().items() if topic in mine["topic", "publish"]}
    assert allowed == PUBLISHERS[name]
    assert topic in rules()["recorder"]["topic", "subscribe"]
    assert topic in rules()["operator"]["topic", "subscribe"]


def test_who_may_hear() -> None:
    found = rules()
    for node, topics in (
        *((source, {"valve_command", "pressure_command"}) for source in SOURCES),
        *(
            (node, {*SAMPLE_TOPICS, "pressure_state", "angle_sensor", "joint_sample"})
            for node in ("estimator", "monitor")
        ),
        ("controller", {"joint_estimate", "reference", "valve_state", "pressure_state", "rig", "health"}),
    ):
        heard = found[node]["topic", "subscribe"] - {"/clock", "/parameter_events"}
        assert heard == {TOPICS[name].resolve("/pam") for name in topics}


def test_wildcards_cover_nothing_but_the_command_line() -> None:
    """The middleware reads ``*``, ``?`` and ``[`` as a shell does; a slash is no border for it."""
    wild = {
        (node, *rule, name)
        for node, mine in rules().items()
        for rule, names in mine.items()
        for name in names
        if set("*?[") & set(name)
    }
    assert wild and {entry[:3] for entry in wild} == {("operator", "service", "reply")}
    assert all(name.startswith("/_ros2cli_*/") and name.count("*") == 1 for *_, name in wild)


def test_another_namespace_is_a_change_of_the_profiles_alone() -> None:
    """docs/how-to/security.md: with ns= and path= changed nothing of the old namespace is left."""
    names = ET.parse(POLICY).getroot().iter()
    assert not [item.text for item in names if item.tag in ("topic", "service") and "pam" in str(item.text)]


def test_the_operator_alone_calls_services() -> None:
    found = rules()
    assert {node for node, mine in found.items() if mine["service", "request"]} == {"operator"}
    offered = set().union(*(found[node]["service", "reply"] for node in NODES))
    assert found["operator"]["service", "request"] == offered
    for node, names in SERVICES.items():
        own = {f"/pam/{node}/{name}" for name in names}
        assert own <= found[node]["service", "reply"]
        assert all(name.startswith(f"/pam/{node}/") for name in found[node]["service", "reply"])


class Auditor:
    """A node that is called like one of the command line, and looks at others.

    Args:
        context: of ROS.
    """

    def __init__(self, context: object) -> None:
        from rclpy.node import Node

        self._node = Node(COMMAND_LINE, context=context)
        self._looks = {
            ("topic", "publish"): self._node.get_publisher_names_and_types_by_node,
            ("topic", "subscribe"): self._node.get_subscriber_names_and_types_by_node,
            ("service", "reply"): self._node.get_service_names_and_types_by_node,
            ("service", "request"): self._node.get_client_names_and_types_by_node,
        }

    def wait(self, processes: Processes, *names: str) -> None:
        """Wait until nodes of ``/pam`` are configured, and a moment longer for the rest of what they have."""

        def configured(name: str) -> bool:
            return name in self._node.get_node_names() and "/diagnostics" in self.has(name)["topic", "publish"]

        processes.wait(lambda: ", ".join(name for name in names if not configured(name)))
        time.sleep(1.0)

    def has(self, name: str, namespace: str = "/pam") -> Rules:
        """The entities of a running node."""
        return {key: {entity for entity, _ in look(name, namespace)} for key, look in self._looks.items()}

    def close(self) -> None:
        self._node.destroy_node()


@pytest.fixture
def auditor(monkeypatch: pytest.MonkeyPatch) -> Iterator[Auditor]:
    rclpy = pytest.importorskip("rclpy")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    auditor = Auditor(context)
    try:
        yield auditor
    finally:
        auditor.close()
        rclpy.shutdown(context=context)


def check_node(name: str, has: Rules) -> None:
    """A running node has what it is allowed to, and is allowed to publish nothing that it never does."""
    allowed = rules()[name]
    for key, there in has.items():
        assert there <= allowed[key], (name, key)
    # What a rig or a parameter has to ask for.
    optional = {"/pam/measured/external_torque", "/pam/angle_sensor", "/pam/external_torque"}
    optional |= {
        "/pam/joint_sample",
        "/pam/pressure_state",
        "/pam/pressure_command",
    }  # of a joint with pressure regulators
    assert not allowed["topic", "publish"] - has["topic", "publish"] - optional


@pytest.mark.thorough(22)
@pytest.mark.ros
def test_the_policy_allows_what_the_nodes_do(tmp_path: Path, auditor: Auditor) -> None:
    """The bridge has all of it without a device, for which it waits; its commander is the plant's."""
    from pam_antagonist.nodes.client import ReferenceClient

    names = ("plant", "estimator", "controller", "recorder", "bridge")
    with Processes(tmp_path) as processes:
        processes.start("record", ["--out", str(tmp_path / "bag")])
        for name in names[:3]:
            processes.start(name)
        with ReferenceClient() as watch:
            processes.wait(watch.missing)
        processes.start("bridge", ["--ros-args", "-p", f"port:={tmp_path / 'absent'}"])
        auditor.wait(processes, *names)
        for name in names:
            check_node(name, auditor.has(name))


@pytest.mark.ros
def test_the_policy_allows_what_the_command_line_does(auditor: Auditor) -> None:
    """Every command of ROS 2 makes a node; without its own services, which it never needs, it would not start."""
    allowed = rules()["operator"]
    has = auditor.has(COMMAND_LINE, "/")
    assert has["service", "reply"]
    for key, there in has.items():
        assert not [name for name in there if not any(fnmatchcase(name, rule) for rule in allowed[key])], key
