"""config/security/policy.xml: what it lets whom do, held against the topic table and against the running nodes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections import defaultdict
from pathlib import Path

import pytest

from pam_antagonist.nodes.processes import Processes, free_domain
from pam_antagonist.paths import config_dir
from pam_antagonist.recording.topics import TOPICS

POLICY = config_dir() / "security" / "policy.xml"
NODES = ("plant", "bridge", "estimator", "controller", "recorder")
SOURCES = {"plant", "bridge"}
PUBLISHERS = {
    "pressure_1": SOURCES,
    "pressure_2": SOURCES,
    "valve_state": SOURCES,
    "measured_joint_states": SOURCES,
    "measured_external_torque": SOURCES,
    "valve_command": {"controller"},
    "joint_estimate": {"estimator"},
    "joint_states": {"estimator"},
    "reference": {"operator"},
    "rig": {*SOURCES, "estimator", "controller"},
    "diagnostics": set(NODES),
}
SERVICES = {
    "plant": {"clear_stop"},
    "bridge": {"clear_stop", "measure_rest"},
    "estimator": {"reset", "set_state"},
    "controller": {"clear_stop", "enable"},
    "recorder": set(),
}
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
        *((source, {"valve_command"}) for source in SOURCES),
        ("estimator", {"pressure_1", "pressure_2", "valve_state"}),
        ("controller", {"joint_estimate", "reference", "valve_state", "rig"}),
    ):
        heard = found[node]["topic", "subscribe"] - {"/clock", "/parameter_events"}
        assert heard == {TOPICS[name].resolve("/pam") for name in topics}
    everything = set().union(*(mine["topic", "publish"] for mine in found.values()))
    assert not [name for name in everything if "*" in name or "?" in name]


def test_the_operator_alone_calls_services() -> None:
    found = rules()
    assert {node for node, mine in found.items() if mine["service", "request"]} == {"operator"}
    offered = set().union(*(found[node]["service", "reply"] for node in NODES))
    assert found["operator"]["service", "request"] == offered
    for node, names in SERVICES.items():
        own = {f"/pam/{node}/{name}" for name in names}
        assert own <= found[node]["service", "reply"]
        assert all(name.startswith(f"/pam/{node}/") for name in found[node]["service", "reply"])


@pytest.mark.ros
def test_the_policy_allows_what_the_nodes_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every entity of the running nodes is in the policy, and no node may publish what it never does."""
    rclpy = pytest.importorskip("rclpy")
    from rclpy.node import Node

    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from pam_antagonist.nodes.watch import Watch

    names = ("plant", "estimator", "controller", "recorder")
    found = rules()
    with Processes(tmp_path) as processes:
        processes.start("record", ["--out", str(tmp_path / "bag")])
        for name in names[:3]:
            processes.start(name)
        with Watch() as watch:
            processes.wait(watch.missing)
        context = rclpy.Context()
        rclpy.init(args=[], context=context)
        node = Node("auditor", context=context)
        looks = {
            ("topic", "publish"): node.get_publisher_names_and_types_by_node,
            ("topic", "subscribe"): node.get_subscriber_names_and_types_by_node,
            ("service", "reply"): node.get_service_names_and_types_by_node,
            ("service", "request"): node.get_client_names_and_types_by_node,
        }
        try:
            import time

            end = time.monotonic() + 20.0
            while time.monotonic() < end and not set(names) <= set(node.get_node_names()):
                time.sleep(0.1)
            time.sleep(1.0)
            for name in names:
                for (kind, verb), look in looks.items():
                    there = {entity for entity, _ in look(name, "/pam")}
                    assert there <= found[name][kind, verb], (name, kind, verb)
                published = {entity for entity, _ in looks["topic", "publish"](name, "/pam")}
                optional = {"/pam/measured/external_torque"}
                assert found[name]["topic", "publish"] - published <= optional
        finally:
            node.destroy_node()
            rclpy.shutdown(context=context)
