"""Parameters as a running node declares them, and what may change while it runs."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from typing import Any

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import Parameter

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


@pytest.mark.ros
@pytest.mark.parametrize(
    ("name", "given", "words"),
    [
        ("controller", {}, "law: pi puts voltages on valves.*set law to model"),
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
