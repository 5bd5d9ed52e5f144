"""Estimator and controller of one joint, with a simulated joint or the bridge to a real one.

ros2 launch pam_antagonist pipeline.launch.py
ros2 launch pam_antagonist pipeline.launch.py namespace:=left/elbow parameters:=/path/to/parameters.yaml \
    source:=bridge
ros2 launch pam_antagonist pipeline.launch.py source:=bridge enclave:=/pam
"""

from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration
from launch_ros.actions import Node

from pam_antagonist.paths import config_dir

PACKAGE = "pam_antagonist"


def require_parameters(context: LaunchContext) -> None:
    """Refuse a parameter file that is not there; launch would warn and start the nodes with their defaults.

    Raises:
        FileNotFoundError: there is no such file.
    """
    path = LaunchConfiguration("parameters").perform(context)
    if not Path(path).is_file():
        raise FileNotFoundError(f"parameters:={path}: no such file; expected a YAML file with parameters of the nodes")


def nodes(context: LaunchContext) -> list[Node]:
    """The nodes, each with its own enclave where there are enclaves.

    Raises:
        ValueError: the enclaves' folder is no absolute name.
    """
    enclaves = LaunchConfiguration("enclave").perform(context)
    if enclaves and not enclaves.startswith("/"):
        raise ValueError(f"enclave:={enclaves}: expected a name that begins with a slash, such as /pam")

    def node(name: str, **options: object) -> Node:
        common: dict[str, object] = {
            "package": PACKAGE,
            "executable": name,
            "name": name,
            "namespace": LaunchConfiguration("namespace"),
            "parameters": [LaunchConfiguration("parameters")],
            "output": "screen",
        }
        if enclaves:  # an argument without a value would be refused
            common["ros_arguments"] = ["--enclave", f"{enclaves.rstrip('/')}/{name}"]
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
    ]


def generate_launch_description() -> LaunchDescription:
    """The nodes and their arguments."""
    arguments = [
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
        DeclareLaunchArgument("namespace", default_value="pam", description="namespace of nodes and topics"),
        DeclareLaunchArgument(
            "enclave",
            default_value="",
            description="where the nodes' SROS2 enclaves are in the keystore, such as /pam for /pam/bridge and so on; "
            "empty: no enclaves (docs/how-to/security.md)",
        ),
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=require_parameters), OpaqueFunction(function=nodes)])
