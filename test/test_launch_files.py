"""Launch files and files for the tools of a robot: they start what is there, and name what there is."""

from __future__ import annotations

import re
import runpy
import subprocess
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml

from pam_antagonist.__main__ import COMMANDS
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes import bridge, controller, estimator, plant
from pam_antagonist.paths import config_dir
from pam_antagonist.rig import load_rig

ROOT = Path(__file__).resolve().parents[1]
LAUNCH_FILE = ROOT / "launch" / "pipeline.launch.py"
TABLES = {node.__name__.rsplit(".", 1)[1]: node.PARAMETERS for node in (plant, bridge, estimator, controller)}


class Context(dict):
    """Double of ``LaunchContext``: the values of the arguments; ``argv`` is what was typed."""

    argv: tuple[str, ...] = ()


class Configuration(str):
    """Double of ``LaunchConfiguration``: a name; the context is a dictionary."""

    def perform(self, context: dict[str, str]) -> str:
        return context[self]


@pytest.fixture
def launch_doubles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Doubles of launch, which is not among the wheels: launch files run against them."""
    doubles: dict[str, dict[str, object]] = {
        "launch": {"LaunchDescription": list, "LaunchContext": Context},
        "launch.actions": {
            "DeclareLaunchArgument": lambda name, **options: types.SimpleNamespace(name=name, **options),
            "OpaqueFunction": lambda function: ("function", function),
        },
        "launch.conditions": {"IfCondition": lambda predicate: predicate},
        "launch.substitutions": {
            "EqualsSubstitution": lambda left, right: (left, right),
            "LaunchConfiguration": Configuration,
        },
        "launch_ros": {},
        "launch_ros.actions": {"Node": lambda **options: ("node", options)},
        "launch_ros.parameter_descriptions": {"ParameterValue": lambda value, value_type: value_type(value)},
    }
    for name, attributes in doubles.items():
        module = types.ModuleType(name)
        module.__dict__.update(attributes)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def launch_file(launch_doubles: None) -> dict[str, Any]:
    """Names of pipeline.launch.py."""
    return runpy.run_path(str(LAUNCH_FILE))


@pytest.fixture
def robot_launch_file(launch_doubles: None) -> dict[str, Any]:
    """Names of robot.launch.py."""
    return runpy.run_path(str(LAUNCH_FILE.with_name("robot.launch.py")))


def defaults(launch_file: dict[str, Any], **given: str) -> Context:
    """What the file's functions see where these arguments were given."""
    return Context({argument.name: argument.default_value for argument in launch_file["arguments"]()} | given)


def test_launch_file_starts_what_exists(launch_file: dict[str, Any]) -> None:
    entities = launch_file["generate_launch_description"]()
    functions = [item[1] for item in entities if isinstance(item, tuple)]
    assert functions == [launch_file[name] for name in ("refuse_unknown", "require_parameters", "nodes")]
    arguments = {item.name: vars(item) for item in entities if not isinstance(item, tuple)}
    nodes = [options for _, options in functions[-1](defaults(launch_file))]

    plant, bridge, *always = nodes
    assert [node["executable"] for node in (plant, *always)] == ["plant", "estimator", "controller", "monitor"]
    assert all(node["package"] == "pam_antagonist" and node["executable"] in COMMANDS for node in (plant, *always))
    assert (bridge["package"], bridge["executable"]) == ("bridge_package", "bridge_executable")
    assert arguments["bridge_package"]["default_value"] == "pam_antagonist"
    assert arguments["bridge_executable"]["default_value"] in COMMANDS
    assert all(node["namespace"] == "namespace" and node["parameters"] == ["parameters"] for node in nodes)
    assert [node.get("condition") for node in nodes] == [
        *(("source", name) for name in ("plant", "bridge")), None, None, "monitor",
    ]  # fmt: skip
    assert all(node["ros_arguments"] == ["--log-level", "info"] and node["respawn"] == "respawn" for node in nodes)
    assert set(arguments) == {
        *("source", "parameters", "namespace", "enclave", "bridge_package", "bridge_executable"),
        *("rig", "joint_name", "use_sim_time", "autostart", "log_level", "respawn", "monitor"),
    }
    assert arguments["monitor"]["default_value"] == "false"
    assert arguments["respawn"]["default_value"] == "false"
    assert arguments["enclave"]["default_value"] == ""
    assert arguments["namespace"]["default_value"] == "pam"
    assert arguments["source"]["default_value"] in arguments["source"]["choices"]
    assert Path(arguments["parameters"]["default_value"]) == config_dir() / "pipeline.yaml"


@pytest.mark.parametrize("enclave", ["/pam", "/pam/", "/lab/left"])
def test_launch_file_gives_each_node_its_own_enclave(launch_file: dict[str, Any], enclave: str) -> None:
    nodes = [options for _, options in launch_file["nodes"](defaults(launch_file, enclave=enclave))]
    folder = enclave.rstrip("/")
    assert [node["ros_arguments"] for node in nodes] == [
        ["--log-level", "info", "--enclave", f"{folder}/{name}"]
        for name in ("plant", "bridge", "estimator", "controller", "monitor")
    ]
    if folder == "/pam":  # what the documentation makes, by the policy
        enclaves = ET.parse(config_dir() / "security" / "policy.xml").getroot().iter("enclave")
        assert {node["ros_arguments"][3] for node in nodes} <= {item.attrib["path"] for item in enclaves}


def test_launch_file_refuses_an_enclave_that_is_no_absolute_name(launch_file: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="begins with a slash, such as /pam"):
        launch_file["nodes"](defaults(launch_file, enclave="pam"))


def test_launch_file_refuses_parameters_that_are_not_there(launch_file: dict[str, Any], tmp_path: Path) -> None:
    require = launch_file["require_parameters"]
    assert require({"parameters": str(config_dir() / "pipeline.yaml")}) is None
    with pytest.raises(FileNotFoundError, match="no such file"):
        require({"parameters": str(tmp_path / "absent.yaml")})


def test_arguments_of_the_launch_file_win_over_its_parameters(launch_file: dict[str, Any]) -> None:
    context = defaults(launch_file, rig="7", joint_name="elbow", use_sim_time="True", autostart="false")
    for _, options in launch_file["nodes"](context):
        file, given = options["parameters"]
        assert file == "parameters"
        assert given == {"rig": "7", "joint_name": "elbow", "use_sim_time": True, "autostart": False}
    for table in TABLES.values():  # every node takes them all
        assert {"rig", "joint_name"} <= {parameter.name for parameter in table}
    with pytest.raises(ValueError, match="use_sim_time:=yes: expected true or false"):
        launch_file["nodes"](defaults(launch_file, use_sim_time="yes"))


def test_launch_file_refuses_arguments_that_it_does_not_know(
    launch_file: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    context = defaults(launch_file)
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "pam_antagonist", "pipeline.launch.py"])
    for good in ((), ("rig:=my_rig",), tuple(f"{name}:=x" for name in context)):
        context.argv = good
        assert launch_file["refuse_unknown"](context) is None
    context.argv = ("joint_name:=elbow", "rgi:=my_rig")
    with pytest.raises(ValueError, match="rgi:=my_rig: unknown argument; did you mean rig"):
        launch_file["refuse_unknown"](context)
    # Arguments of a file that includes this one are that file's.
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_robot", "all.launch.py"])
    assert launch_file["refuse_unknown"](context) is None


def test_robot_launch_file_starts_one_process_and_records_every_joint(robot_launch_file: dict[str, Any]) -> None:
    context = defaults(robot_launch_file, rig="7", use_sim_time="True", record="/tmp/bag")
    process, recorder = [options for _, options in robot_launch_file["nodes"](context)]
    assert (process["executable"], recorder["executable"]) == ("joints", "record")
    assert all(node["package"] == "pam_antagonist" and node["executable"] in COMMANDS for node in (process, recorder))
    assert "name" not in process and "namespace" not in process  # they would be for every node of the process
    assert process["parameters"] == [str(config_dir() / "robot.yaml")]
    assert process["ros_arguments"] == ["--log-level", "info", "-p", 'rig:="7"', "-p", "use_sim_time:=true"]
    both = ["--namespace", "/left/elbow", "--namespace", "/left/wrist"]
    assert recorder["arguments"] == ["--out", "/tmp/bag", *both]
    (alone,) = robot_launch_file["nodes"](defaults(robot_launch_file))
    assert alone[1]["ros_arguments"] == ["--log-level", "info"]


def test_robot_launch_file_refuses_what_it_cannot_use(
    robot_launch_file: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(FileNotFoundError, match="no such file"):
        robot_launch_file["nodes"](defaults(robot_launch_file, joints=str(tmp_path / "absent.yaml")))
    twice = tmp_path / "twice.yaml"
    twice.write_text("/**/joints: {}\n/**/joints: {}\n", encoding="utf-8")
    with pytest.raises(BadInput, match="twice.yaml: not valid YAML: key '/\\*\\*/joints' stands twice"):
        robot_launch_file["nodes"](defaults(robot_launch_file, joints=str(twice)))
    with pytest.raises(ValueError, match="no section /\\*\\*/joints"):
        robot_launch_file["nodes"](defaults(robot_launch_file, joints=str(config_dir() / "pipeline.yaml")))
    with pytest.raises(ValueError, match="autostart:=yes: expected true or false"):
        robot_launch_file["nodes"](defaults(robot_launch_file, autostart="yes"))
    context = defaults(robot_launch_file)
    context.argv = ("jionts:=robot.yaml",)
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "pam_antagonist", "robot.launch.py"])
    with pytest.raises(ValueError, match="did you mean joints"):
        robot_launch_file["refuse_unknown"](context)


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
