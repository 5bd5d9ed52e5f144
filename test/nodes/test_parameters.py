"""Parameters as a running node declares them, and what may change while it runs."""

from __future__ import annotations

import importlib
import math
from typing import Any

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import Parameter

CLASSES = {"plant": "PlantNode", "estimator": "EstimatorNode", "controller": "ControllerNode"}


def make(name: str) -> Any:
    return getattr(importlib.import_module(f"pam_antagonist.nodes.{name}"), CLASSES[name])()


@pytest.mark.ros
@pytest.mark.parametrize("name", CLASSES)
def test_every_parameter_has_a_descriptor(name: str, ros: None) -> None:
    table = importlib.import_module(f"pam_antagonist.nodes.{name}").PARAMETERS
    node = make(name)
    try:
        for parameter in table:
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
    finally:
        node.destroy_node()


@pytest.mark.ros
def test_gains_may_change_within_their_range_and_nothing_else_may(ros: None) -> None:
    from rclpy.parameter import Parameter as RosParameter

    from pam_antagonist.control import Mode

    node = make("controller")
    try:

        def set_to(name: str, value: object) -> bool:
            (result,) = node.set_parameters([RosParameter(name, value=value)])
            return bool(result.successful)

        assert set_to("angle_proportional", 3.0)
        assert node._laws.pi._gains[Mode.ANGLE].proportional == 3.0
        assert not set_to("angle_proportional", -1.0)
        assert not set_to("angle_proportional", math.nan)
        assert not set_to("angle_proportional", "fast")
        assert node.get_parameter("angle_proportional").value == 3.0
        assert not set_to("bias", 10.0)  # within its range, but not between the rig's limits
        assert not set_to("rig", "shin2022_as_printed")
        assert not set_to("max_age", 0.1)
        assert node._laws.pi._gains[Mode.ANGLE].proportional == 3.0
    finally:
        node.destroy_node()


@pytest.mark.parametrize(
    ("parameter", "good", "bad"),
    [
        (Parameter("x", 1.0, "", 0.0, 2.0), [0, 2.0, 1.5], [-0.1, math.nan, math.inf, "1", True, None]),
        (Parameter("x", 1, "", 0, 2), [0, 2], [1.0, 3, True, "1"]),
        (Parameter("x", True, ""), [False], [1, "true"]),
        (Parameter("x", "a", "", choices=("a", "b")), ["b"], ["c", 1]),
        (Parameter("x", "a", "", solid=True), ["left_elbow", "ü"], ["", "a b", "a\n", 1]),
        (
            Parameter("x", [1.0, 1.0], "", 0.0, 2.0),
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
