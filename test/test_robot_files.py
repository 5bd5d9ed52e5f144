"""Files for the tools of a robot: each is opened as its tool would, and names what there is."""

from __future__ import annotations

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import yaml

from pam_antagonist.nodes import bridge, controller, estimator, plant
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import load_rig

ROOT = Path(__file__).resolve().parents[1]
XACRO = "{http://www.ros.org/wiki/xacro}"
URDF = ROOT / "urdf" / "joint.urdf.xacro"
CONTROL = config_dir() / "ros2_control" / "joint.ros2_control.xacro"


@pytest.mark.parametrize("path", [URDF, CONTROL])
def test_descriptions_are_xml_whose_arguments_are_declared(path: Path) -> None:
    text = path.read_text()
    root = ET.fromstring(text)
    declared = {item.attrib["name"] for item in root.iter(f"{XACRO}arg")}
    if path == CONTROL:
        declared |= {item.attrib["name"] for item in ET.parse(URDF).getroot().iter(f"{XACRO}arg")}
    assert set(re.findall(r"\$\(arg (\w+)\)", text)) <= declared
    for included in re.findall(r"\$\(find pam_antagonist\)/([\w./]+)", text):
        assert (ROOT / included).is_file()
    macros = {item.attrib["name"]: item.attrib["params"].split() for item in root.iter(f"{XACRO}macro")}
    for name, parameters in macros.items():
        for call in root.iter(f"{XACRO}{name}"):
            assert set(call.attrib) == set(parameters)


def test_the_description_takes_what_a_rig_file_has() -> None:
    """The keys that it reads are those of the rigs, and it says of the links and joints what URDF wants."""
    text = URDF.read_text()
    rig = load_rig("shin2022")
    for first, second in re.findall(r"values\['(\w+)'\](?:\['(\w+)'\])", text):
        assert rig.value(f"{first}.{second}") > 0.0
    root = ET.fromstring(text)
    links = {item.attrib["name"] for item in root.iter("link")}
    for joint in root.iter("joint"):
        for end in ("parent", "child"):
            element = joint.find(end)
            assert element is not None
            link = element.attrib["link"]
            assert link in links or any(link == f"${{name}}_muscle_{k}" for k in (1, 2))


def test_xacro_expands_the_descriptions(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    text = CONTROL.read_text() + URDF.read_text()
    assert "$(find pam_antagonist)" in text
    # Without an installed package there is nothing to find: the checkout's own files.
    for source in (URDF, CONTROL):
        made = source.read_text().replace("$(find pam_antagonist)/urdf", str(tmp_path))
        (tmp_path / source.name).write_text(made.replace("$(find pam_antagonist)", str(ROOT)))
    code = "import sys, xacro; print(xacro.process_file(sys.argv[1], mappings={'joint_name': 'elbow'}).toxml())"
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / CONTROL.name)], capture_output=True, text=True, check=True
    )
    root = ET.fromstring(done.stdout)
    joint = next(item for item in root.findall("joint") if item.attrib["name"] == "elbow")
    limit = joint.find("limit")
    assert limit is not None and float(limit.attrib["upper"]) == load_rig("shin2022").joint.stop
    links = [item.attrib["name"] for item in root.findall("link")]
    assert len(links) == len(set(links)) == 4
    assert all(item.find(end).attrib["link"] in links for item in root.findall("joint") for end in ("parent", "child"))
    assert [item.attrib["name"] for item in root.findall("ros2_control/joint")] == ["elbow"]


def test_parameters_for_ros2_control_are_the_controllers_and_their_topics_agree() -> None:
    (section,) = yaml.safe_load((config_dir() / "ros2_control" / "pipeline.yaml").read_text()).values()
    table = {parameter.name: parameter for parameter in controller.PARAMETERS}
    for name, value in section["ros__parameters"].items():
        table[name].check(value)
    source = section["ros__parameters"]["reference_source"]
    parameters = {item.attrib["name"]: item.text for item in ET.parse(CONTROL).getroot().iter("param")}
    assert parameters["joint_commands_topic"] == f"$(arg namespace)/{source}"
    assert parameters["joint_states_topic"] == "$(arg namespace)/joint_states"
    # Otherwise a command that is reached is not sent any more, and times out.
    assert float(parameters["trigger_joint_command_threshold"] or 0.0) < 0.0
    controllers = yaml.safe_load((config_dir() / "ros2_control" / "controllers.yaml").read_text())
    named = controllers["controller_manager"]["ros__parameters"]
    started = {name for name, value in named.items() if isinstance(value, dict)}
    assert {name for name in controllers if name != "controller_manager"} <= started


def test_the_aggregators_groups_name_parts_that_nodes_have() -> None:
    text = (config_dir() / "tools" / "diagnostic_aggregator.yaml").read_text()
    analyzers = yaml.safe_load(text)["analyzers"]["ros__parameters"]["joint"]["analyzers"]
    nodes = {module.__name__.rsplit(".", 1)[1] for module in (plant, bridge, estimator, controller)}
    sources = "\n".join(path.read_text() for path in (ROOT / "pam_antagonist" / "nodes").glob("*.py"))
    for analyzer in analyzers.values():
        assert analyzer["type"] == "diagnostic_aggregator/GenericAnalyzer"
        for name in (*analyzer.get("contains", ()), *analyzer.get("startswith", ())):
            node, _, part = name.rpartition(": ") if ": " in name else (name, "", "")
            assert not node or node.removeprefix("pam/") in nodes
            assert not part or f'"{part}"' in sources, f"no node has a part {part}"
