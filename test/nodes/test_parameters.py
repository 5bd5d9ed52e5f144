"""Parameters as a running node declares them, and what may change while it runs."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import Parameter, refuse_base_8
from pam_antagonist.nodes.sections import applies, unused

CLASSES = {"plant": "PlantNode", "estimator": "EstimatorNode", "controller": "ControllerNode", "bridge": "BridgeNode"}


@pytest.fixture
def made(new_node: Callable[..., Any]) -> Callable[..., Any]:
    """A node by its name."""
    return lambda name, **given: new_node(
        getattr(importlib.import_module(f"pam_antagonist.nodes.{name}"), CLASSES[name]), **given
    )


def change(node: Any, name: str, value: object) -> bool:
    from rclpy.parameter import Parameter as RosParameter

    (result,) = node.set_parameters([RosParameter(name, value=value)])
    return bool(result.successful)


@pytest.mark.ros
@pytest.mark.parametrize("name", CLASSES)
def test_every_parameter_has_a_descriptor(name: str, made: Callable[..., Any]) -> None:
    node = made(name)
    for parameter in importlib.import_module(f"pam_antagonist.nodes.{name}").PARAMETERS:
        descriptor = node.describe_parameter(parameter.name)
        assert descriptor.description == parameter.description
        assert descriptor.read_only is parameter.read_only
        ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
        if isinstance(parameter.default, (int, float)) and not isinstance(parameter.default, bool):
            (bounds,) = ranges
            # A value beside the range leaves the parameter to the rig file.
            low = min(parameter.low, parameter.low if parameter.left is None else parameter.left)
            assert (bounds.from_value, bounds.to_value) == (low, parameter.high)
        value = node.get_parameter(parameter.name).value
        assert (list(value) if isinstance(parameter.default, list) else value) == parameter.default


@pytest.mark.ros
def test_gains_may_change_within_their_range_and_nothing_else_may(made: Callable[..., Any]) -> None:
    from pam_antagonist.control.command import Mode

    node = made("controller")
    assert change(node, "angle_proportional", 3.0)
    for name, value in (
        *(("angle_proportional", value) for value in (-1.0, math.nan, "fast")),
        ("bias", 10.0),  # within its range, but not between the rig's limits
        ("rig", "shin2022_as_printed"),
        ("max_age", 0.1),
    ):
        assert not change(node, name, value)
    assert node.get_parameter("angle_proportional").value == 3.0
    assert node._laws.pi._gains[Mode.ANGLE].proportional == 3.0


@pytest.mark.ros
def test_what_is_set_before_a_node_is_configured_counts_then(made: Callable[..., Any]) -> None:
    node = made("plant", autostart=False)
    assert change(node, "push", 1.5) and not change(node, "push", "hard")
    node.trigger_configure()
    assert node.values["push"] == node._push == 1.5


@pytest.mark.parametrize(
    ("parameter", "good", "bad"),
    [
        (Parameter("x", 1.0, 0.0, 2.0), [0, 2.0, 1.5], [-0.1, math.nan, math.inf, "1", True, None]),
        (Parameter("x", 1, 0, 2), [0, 2], [1.0, 3, True, "1"]),
        (Parameter("x", True), [False], [1, "true"]),
        (Parameter("x", "a", choices=("a", "b")), ["b"], ["c", 1]),
        (Parameter("x", ["a"]), [["b", "c"], ("b",)], [[""], [1], 1, ["b", None]]),
        (Parameter("x", "a", solid=True), ["left_elbow", "ü"], ["", "a b", "a\n", 1]),
        (
            Parameter("x", [1.0, 1.0], 0.0, 2.0),
            [[0, 2], (1.0, 2.0)],
            [[1.0], [1.0, 3.0], [1.0, math.nan], 1.0, "ab"],
        ),
    ],
)
def test_values_are_checked(parameter: Parameter, good: list[Any], bad: list[Any]) -> None:
    for value in good:
        checked = parameter.check(value)
        assert type(checked) is type(parameter.default)
        assert checked == (list(value) if isinstance(value, tuple) else value)
    for value in bad:
        with pytest.raises(BadInput, match=r"parameter x is .*: expected"):
            parameter.check(value)


@pytest.mark.parametrize("number", ["0512", "-01", "[1, 012]"])
def test_a_leading_zero_is_refused_since_ros_reads_base_8(number: str, tmp_path: Path) -> None:
    path = tmp_path / "parameters.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    bias: {number}\n", encoding="utf-8")
    for arguments in (["--params-file", str(path)], ["-p", f"bias:={number}"]):
        with pytest.raises(BadInput, match=r"(parameters.yaml|bias): .* begins with a zero"):
            refuse_base_8(["--ros-args", *arguments])
    path.write_text("/**:\n  ros__parameters: {a: 0.5, b: 0, c: 10, d: '007', e: 089}\n", encoding="utf-8")
    refuse_base_8(["--ros-args", "--params-file", str(path), "-p", "a:=0", "-p", 'b:="007"'])


@pytest.mark.ros
@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("controller", {"law": "pi"}, "law: pi puts voltages on valves.*set law to model"),
        (
            "controller",
            {"law": "model", "safe_pressure": [5.5, 5.5]},
            "safe_pressure.*expected two pressures within 110000 to 700000 Pa",
        ),
        *(
            (
                name,
                {"rig": "shin2022", "pressure_sensors": "none"},
                "rig shin2022 has valves, whose voltages do not determine",
            )
            for name in ("plant", "estimator", "controller")
        ),
    ],
)
def test_what_does_not_suit_the_drive_is_refused_with_what_to_set(
    name: str, given: dict[str, Any], words: str, made: Callable[..., Any]
) -> None:
    with pytest.raises(BadInput, match=words):
        made(name, **{"rig": "shin2022_regulators", **given})


# ------------------------------------------------------------------------------------------------ parameter files

BODY = "  ros__parameters:\n    joint_name: elbow\n"


@pytest.mark.parametrize(
    ("text", "joints", "words"),
    [
        ("/**:\n" + BODY, (), ""),
        ("/pam/estimator:\n" + BODY + "/pam/plant:\n" + BODY, (), ""),  # one file for several processes
        ("pam:\n  estimator:\n    ros__parameters:\n      joint_name: elbow\n", (), ""),
        (
            "/arm/**:\n" + BODY,
            (),
            "none of its sections is for /pam/estimator, which runs without it. It has /arm/**; expected "
            "/pam/estimator or /**",
        ),
        ("pam_estimator:\n" + BODY + "plant:\n" + BODY, (), "It has /pam_estimator and /plant; expected"),
        ("/pam/*:\n" + BODY + "/pam/controller:\n" + BODY + "/**/bridge:\n" + BODY, ("/pam",), ""),
        (
            "/**/estimator:\n" + BODY + "/left/wrist/**:\n" + BODY,
            ("/pam",),
            "/left/wrist/** is for no joint that is started here. The joints are /pam",
        ),
        ("", (), ""),
    ],
)
def test_a_parameter_file_without_a_section_for_the_node_is_told(
    tmp_path: Path, text: str, joints: tuple[str, ...], words: str
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(text)
    said = unused(file, ["/pam/estimator"], joints)
    assert said == "" if not words else said.startswith(f"{file}: ") and words in said, said


@pytest.mark.ros
@pytest.mark.parametrize(
    "section",
    ["/**", "/*", "/*/*", "/pam/**", "/pam/*", "/**/one", "/pam/one", "one", "/one", "/pam", "/arm/**", "/**/other"],
)
def test_a_section_applies_where_ros_applies_it(section: str, tmp_path: Path, ros: None) -> None:
    from rclpy.node import Node

    file = tmp_path / "parameters.yaml"
    file.write_text(f"{section}:\n{BODY}")
    node = Node(
        "one", namespace="/pam", cli_args=["--ros-args", "--params-file", str(file)], use_global_arguments=False,
        automatically_declare_parameters_from_overrides=True,
    )  # fmt: skip
    try:
        assert node.has_parameter("joint_name") == applies(f"/{section.lstrip('/')}", "/pam/one")
    finally:
        node.destroy_node()


@pytest.mark.ros
def test_a_node_warns_of_a_file_that_is_not_for_it_and_says_which_rig_it_has(
    tmp_path: Path, domain: None, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    from pam_antagonist.nodes import controller, joints

    def spin(node: Any) -> None:
        for one in (*node.members, node):
            one.start()

    monkeypatch.setattr("pam_antagonist.nodes.spin.spin", spin)
    file = tmp_path / "other.yaml"
    file.write_text("/arm/**:\n" + BODY)
    assert controller.main(["--ros-args", "--params-file", str(file)]) == 0
    said = capfd.readouterr().err
    assert said.count("none of its sections is for /pam/controller, which runs without it. It has /arm/**") == 1
    assert "active with rig shin2022 (" in said
    file.write_text("/**:\n  ros__parameters:\n    joints: [left/elbow]\n/left/wrist/**:\n" + BODY)
    assert joints.main(["--ros-args", "--params-file", str(file)]) == 0
    assert capfd.readouterr().err.count("/left/wrist/** is for no joint that is started here") == 1
