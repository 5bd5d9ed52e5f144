"""Several joints in one process, as a parameter file names them.

ros2 launch pam_antagonist robot.launch.py joints:=/path/to/robot.yaml
ros2 launch pam_antagonist robot.launch.py joints:=robot.yaml source:=bridge record:=/path/to/new_bag
"""

import json
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from pam_antagonist.nodes import processes
from pam_antagonist.paths import config_dir
from pam_antagonist.strict_yaml import read_mapping

PACKAGE = "pam_antagonist"

PARAMETERS = ("source", "rig", "use_sim_time", "autostart")
"""Parameters that are arguments as well; an argument wins over the parameter file, for every joint."""


def refuse_unknown(context: LaunchContext) -> None:
    """Refuse arguments on the command line that this file does not have.

    Raises:
        ValueError: an unknown argument.
    """
    processes.refuse_unknown(Path(__file__).name, context.argv, [argument.name for argument in arguments()])


def namespaces(path: str) -> list[str]:
    """The joints that a parameter file names.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it names no joints.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"joints:={path}: no such file; expected a YAML file with parameters of all joints")
    for name, section in read_mapping(Path(path), "parameter", "config/robot.yaml").items():
        if name.rsplit("/", 1)[-1] == "joints" and isinstance(section, dict):
            joints = (section.get("ros__parameters") or {}).get("joints")
            if isinstance(joints, list) and joints:
                return [f"/{str(joint).strip('/')}" for joint in joints]
    raise ValueError(f"joints:={path}: no section /**/joints with a parameter joints, such as [left/elbow, left/wrist]")


def nodes(context: LaunchContext) -> list[Node]:
    """The process with the joints and, where that is asked for, the recorder.

    Raises:
        FileNotFoundError: there is no such parameter file.
        ValueError: an argument is not what it has to be.
    """
    path = LaunchConfiguration("joints").perform(context)
    found = namespaces(path)
    given: list[str] = []
    for name in PARAMETERS:
        text = LaunchConfiguration(name).perform(context)
        if text:  # as text, even where it reads like a number or as true
            given += ["-p", f"{name}:={json.dumps(processes.value_of(name, text))}"]
    level = ["--log-level", LaunchConfiguration("log_level").perform(context)]
    common: dict[str, object] = {"package": PACKAGE, "output": "screen", "sigterm_timeout": processes.STOP_TIME}
    # Without a name or a namespace: these would be for every node of the process.
    started = [
        Node(
            executable="joints",
            parameters=[path],
            ros_arguments=[*level, *given],
            respawn=LaunchConfiguration("respawn"),
            respawn_delay=processes.RESPAWN_DELAY,
            **common,
        )
    ]
    if LaunchConfiguration("monitor").perform(context) == "true":
        started += [
            Node(executable="monitor", namespace=namespace, parameters=[path], ros_arguments=[*level, *given], **common)
            for namespace in found
        ]
    bag = LaunchConfiguration("record").perform(context)
    if bag:
        chosen = [word for namespace in found for word in ("--namespace", namespace)]
        started.append(Node(executable="record", arguments=["--out", bag, *chosen], ros_arguments=level, **common))
    return started


def arguments() -> list[DeclareLaunchArgument]:
    """What may be given on the command line."""
    return [
        DeclareLaunchArgument(
            "joints",
            default_value=str(config_dir() / "robot.yaml"),
            description="YAML file with the joints and their parameters",
        ),
        DeclareLaunchArgument(
            "source",
            default_value="",
            description="plant, bridge or none, for every joint; empty: as in the parameter file",
        ),
        DeclareLaunchArgument(
            "rig",
            default_value="",
            description="name of a rig or path of its YAML file, for every joint; empty: as in the parameter file",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="",
            description="true: the nodes follow /clock; a bridge to hardware refuses it. Empty: as in the file",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="",
            description="false: the nodes wait for `ros2 lifecycle set`; empty: as in the parameter file",
        ),
        DeclareLaunchArgument(
            "record", default_value="", description="folder of a new bag with all joints; empty: none"
        ),
        DeclareLaunchArgument(
            "monitor",
            default_value="false",
            choices=["true", "false"],
            description="true: a monitor of each joint, which tests whether it still is its rig file",
        ),
        DeclareLaunchArgument(
            "log_level",
            default_value="info",
            description="of every node: debug, info, warn, error or fatal",
            choices=["debug", "info", "warn", "error", "fatal"],
        ),
        DeclareLaunchArgument(
            "respawn",
            default_value="false",
            choices=["true", "false"],
            description="true: the process is started again 2 s after its end; it forgets latched stops and references",
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """The process and its arguments."""
    return LaunchDescription([*arguments(), *(OpaqueFunction(function=step) for step in (refuse_unknown, nodes))])
