"""A joint with pressure regulators: what nodes and calibration refuse, and the device's voltages."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter, load_calibration
from pam_antagonist.safety import SafeAction


@pytest.mark.ros
@pytest.mark.parametrize(
    ("kind", "given", "words"),
    [
        ("controller.ControllerNode", {}, "law: pi puts voltages on valves.*set law to model"),
        (
            "controller.ControllerNode",
            {"law": "model", "safe_pressure": [5.5, 5.5]},
            "safe_pressure.*expected two pressures within 110000 to 700000 Pa",
        ),
        *(
            (
                kind,
                {"rig": "shin2022", "pressure_sensors": "none"},
                "rig shin2022 has valves, whose voltages do not determine",
            )
            for kind in ("plant.PlantNode", "estimator.EstimatorNode", "controller.ControllerNode")
        ),
    ],
)
def test_what_does_not_suit_the_drive_is_refused_with_what_to_set(
    kind: str, given: dict[str, Any], words: str, new_node: Callable[..., Any]
) -> None:
    module, _, name = kind.partition(".")
    node = getattr(importlib.import_module(f"pam_antagonist.nodes.{module}"), name)
    with pytest.raises(BadInput, match=words):
        new_node(node, **{"rig": "shin2022_regulators", **given})


def test_a_device_puts_out_voltages_that_ask_for_the_pressures() -> None:
    converter = Converter(load_calibration("example_regulators"))
    assert converter.output((401.3e3, 101.3e3)) == pytest.approx((5.0, 0.0))
    assert converter.asked((5.0, 0.0)) == pytest.approx((401.3e3, 101.3e3))
    safe = converter.action(SafeAction((401.3e3, 341.3e3), (101.3e3, 101.3e3), 30e3))
    assert safe.hold == pytest.approx((5.0, 4.0)) and safe.vent == pytest.approx((0.0, 0.0))
    assert safe.rate == pytest.approx(0.5)
    with pytest.raises(BadInput, match="calibration example has no regulators, but the rig has"):
        Converter(load_calibration("example")).adapt("regulator")
