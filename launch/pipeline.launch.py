"""Estimator and controller of one joint, with a simulated joint or the bridge to a real one.

ros2 launch pam_antagonist pipeline.launch.py
ros2 launch pam_antagonist pipeline.launch.py namespace:=left/elbow parameters:=/path/to/parameters.yaml \
    source:=bridge
ros2 launch pam_antagonist pipeline.launch.py source:=bridge enclave:=/pam
ros2 launch pam_antagonist pipeline.launch.py rig:=my_rig.yaml joint_name:=elbow log_level:=debug
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from pam_antagonist.nodes import processes
from pam_antagonist.paths import config_dir

PACKAGE = "pam_antagonist"

PARAMETERS = ("rig", "joint_name", "use_sim_time", "autostart")
"""Parameters of every node that are arguments as well; an argument wins over the parameter file."""


def require_parameters(context: LaunchContext) -> None:
    """Refuse a parameter file that is not there; launch would warn and start the nodes with their defaults.

    Raises:
        FileNotFoundError: there is no such file.
    """
    path = LaunchConfiguration("parameters").perform(context)
    if not Path(path).is_file():
        raise FileNotFoundError(f"parameters:={path}: no such file; expected a YAML file with parameters of the nodes")


def refuse_unknown(context: LaunchContext) -> None:
    """Refuse arguments on the command line that this file does not have.

    Raises:
        ValueError: an unknown argument.
    """
    processes.refuse_unknown(Path(__file__).name, context.argv, [argument.name for argument in arguments()])


def given_parameters(context: LaunchContext) -> dict[str, object]:
    """The parameters that were given as arguments.

    Raises:
        ValueError: neither true nor false where one of them is needed.
    """
    given: dict[str, object] = {}
    for name in PARAMETERS:
        text = LaunchConfiguration(name).perform(context)
        if text:
            value = processes.value_of(name, text)
            # As text, even where it reads like a number or as true.
            given[name] = ParameterValue(value, value_type=str) if isinstance(value, str) else value
    return given


def nodes(context: LaunchContext) -> list[Node]:
    """The nodes, each with its own enclave where there are enclaves.

    Raises:
        ValueError: the enclaves' folder is no absolute name, or an argument is not what it has to be.
    """
    enclaves = LaunchConfiguration("enclave").perform(context)
    if enclaves and not enclaves.startswith("/"):
        raise ValueError(f"enclave:={enclaves}: expected a name that begins with a slash, such as /pam")
    given = given_parameters(context)
    level = LaunchConfiguration("log_level").perform(context)

    def node(name: str, **options: object) -> Node:
        common: dict[str, object] = {
            "package": PACKAGE,
            "executable": name,
            "name": name,
            "namespace": LaunchConfiguration("namespace"),
            "parameters": [LaunchConfiguration("parameters"), *([given] if given else [])],
            "output": "screen",
            "respawn": LaunchConfiguration("respawn"),
            "respawn_delay": processes.RESPAWN_DELAY,
            "sigterm_timeout": processes.STOP_TIME,
        }
        extra = ["--log-level", level] if level else []
        if enclaves:
            extra += ["--enclave", f"{enclaves.rstrip('/')}/{name}"]
        if extra:
            common["ros_arguments"] = extra
        return Node(**{**common, **options})

    return [
        node("plant", condition=IfCondition(EqualsSubstitution(LaunchConfiguration("source"), "plant"))),
        node(
            "bridge",
            package=LaunchConfiguration("bridge_package"),
            executable=LaunchConfiguration("bridge_executable"),
            condition=IfCondition(EqualsSubstitution(LaunchConfiguration("source"), "bridge")),
        ),
        node("estimator"),
        node("controller"),
        node("monitor", condition=IfCondition(LaunchConfiguration("monitor"))),
    ]


def arguments() -> list[DeclareLaunchArgument]:
    """What may be given on the command line."""
    return [
        DeclareLaunchArgument(
            "source",
            default_value="plant",
            choices=["plant", "bridge", "none"],
            description="who publishes pressures and valve voltages and takes commands: plant, the simulated joint; "
            "bridge, the node of bridge_package and bridge_executable; none, something that is started elsewhere",
        ),
        DeclareLaunchArgument(
            "bridge_package", default_value=PACKAGE, description="package of the bridge to your hardware"
        ),
        DeclareLaunchArgument("bridge_executable", default_value="bridge", description="its executable"),
        DeclareLaunchArgument(
            "parameters",
            default_value=str(config_dir() / "pipeline.yaml"),
            description="YAML file with the parameters of all nodes",
        ),
        DeclareLaunchArgument(
            "rig",
            default_value="",
            description="name of a rig or path of its YAML file, for every node; empty: as in the parameter file",
        ),
        DeclareLaunchArgument(
            "joint_name",
            default_value="",
            description="name of the joint in messages and diagnostics; empty: as in the parameter file",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="",
            description="true: the nodes follow /clock; a bridge to hardware refuses it. Empty: see parameters",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="",
            description="false: the nodes wait for `ros2 lifecycle set`; empty: as in the parameter file",
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
            description="true: a node that has ended is started again after 2 s; it forgets latched stops and the "
            "reference (docs/how-to/safety.md)",
        ),
        DeclareLaunchArgument(
            "monitor",
            default_value="false",
            choices=["true", "false"],
            description="true: monitor tests all the time whether the joint still is its rig file "
            "(docs/how-to/monitor.md)",
        ),
        DeclareLaunchArgument("namespace", default_value="pam", description="namespace of nodes and topics"),
        DeclareLaunchArgument(
            "enclave",
            default_value="",
            description="where the nodes' SROS2 enclaves are in the keystore, such as /pam for /pam/bridge and so on; "
            "empty: no enclaves (docs/how-to/security.md)",
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """The nodes and their arguments."""
    steps = [OpaqueFunction(function=function) for function in (refuse_unknown, require_parameters, nodes)]
    return LaunchDescription([*arguments(), *steps])
