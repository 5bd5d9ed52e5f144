"""Units of rig parameters, and those in which people read them."""

from __future__ import annotations

import pytest

from pam_antagonist.report.document import Comparison
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.units import readable, unit_of


@pytest.mark.parametrize(
    ("name", "unit", "shown", "value"),
    [
        ("valve_1.inflow_area", "m²", "mm²", 0.05184),
        ("supply.pressure", "Pa", "kPa", 710.0),
        ("joint.stop", "rad", "°", 25.0),
        ("friction.muscle", "N m Pa²", "N m kPa²", 400.0),
        ("gas.polytropic_flow", "-", "-", 1.1),
    ],
)
def test_a_parameter_is_shown_in_a_unit_for_people(name: str, unit: str, shown: str, value: float) -> None:
    rig = load_rig("shin2022")
    assert unit_of(rig, name) == unit
    assert readable(unit).name == shown
    assert rig.value(name) * readable(unit).scale == pytest.approx(value)


def test_a_row_of_pressures_has_one_unit_in_which_its_smallest_can_be_read() -> None:
    table = Comparison("", "UKF", "model alone")
    table.pressures("RMSE", (0.0662, 412.0))
    table.pressures("RMSE", (1520.0, None))
    assert table.table().rows == (("RMSE [Pa]", "0.0662", "412"), ("RMSE [kPa]", "1.52", "–"))
