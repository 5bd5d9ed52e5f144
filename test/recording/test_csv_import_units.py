"""Every unit, against values that were worked out by hand; signs, offsets, gauge and absolute."""

from __future__ import annotations

import math

import numpy as np
import pytest
from csv_files import HEADER, ROWS, Lab
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pam_antagonist.recording.units import UNITS

# 400 kPa in each unit. psi: 1 psi = 6.894757293168361 kPa (NIST SP 811).
FOUR_HUNDRED = {
    "Pa": "400000", "hPa": "4000", "kPa": "400", "MPa": "0.4", "mbar": "4000", "bar": "4", "psi": "58.015095",
}  # fmt: skip


@pytest.mark.parametrize("unit", UNITS["pressure"])
def test_absolute_pressure(lab: Lab, unit: str) -> None:
    lab.rows([(0.0, FOUR_HUNDRED[unit], 500, 5, 5), (0.01, FOUR_HUNDRED[unit], 500, 5, 5)])
    lab.entries(pressure_1={"column": "p1", "unit": unit, "reference": "absolute"})
    assert lab.read().pressure[:, 0] == pytest.approx(400e3, rel=1e-7)
    assert lab.read().pressure[:, 1] == pytest.approx(500e3, rel=1e-12)


@pytest.mark.parametrize(
    ("atmosphere", "unit", "expected"),
    [(101.325, "kPa", 501325.0), (0.95, "bar", 495000.0), (79000, "Pa", 479000.0), (14.5, "psi", 499973.98)],
)
def test_gauge_pressure_counts_from_the_declared_atmosphere(
    lab: Lab, atmosphere: float, unit: str, expected: float
) -> None:
    lab.rows([(0.0, "0.4", 500, 5, 5), (0.01, "0.4", 500, 5, 5)])
    lab.entries(
        pressure_1={"column": "p1", "unit": "MPa", "reference": "gauge"},
        atmosphere={"pressure": atmosphere, "unit": unit},
    )
    pressure = lab.read().pressure
    assert pressure[:, 0] == pytest.approx(expected, rel=1e-8)
    assert pressure[:, 1] == pytest.approx(500e3, rel=1e-12), "absolute pressure is left alone"


@pytest.mark.parametrize(
    ("quantity", "unit", "cell", "expected"),
    [
        ("angle", "rad", "0.25", 0.25),
        ("angle", "mrad", "250", 0.25),
        ("angle", "deg", "-18", -math.pi / 10),
        ("angle", "rev", "0.05", math.pi / 10),
        ("torque", "N m", "1.5", 1.5),
        ("torque", "N cm", "150", 1.5),
        ("torque", "N mm", "1500", 1.5),
        ("torque", "mN m", "1500", 1.5),
        ("torque", "kgf cm", "10", 0.980665),
        ("torque", "lbf in", "10", 1.1298482902762),
        ("external_torque", "Nm", "-1.5", -1.5),
        ("external_torque", "N·mm", "-1500", -1.5),
    ],
)
def test_measured_quantities(lab: Lab, quantity: str, unit: str, cell: str, expected: float) -> None:
    lab.rows([(*row, cell) for row in ROWS], (*HEADER, "x")).entries(**{quantity: {"column": "x", "unit": unit}})
    recording = lab.read()
    assert getattr(recording, quantity) == pytest.approx(expected, rel=1e-9)
    others = {"angle", "torque", "external_torque"} - {quantity}
    assert all(getattr(recording, other) is None for other in others)


def test_every_unit_of_angle_and_torque_has_a_hand_computed_value() -> None:
    """The list above is complete: a new unit needs a line there."""
    marks = test_measured_quantities.pytestmark
    tried = {(case[0], case[1]) for case in marks[0].args[1]}
    assert {unit for quantity, unit in tried if quantity == "angle"} == set(UNITS["angle"])
    assert {unit for quantity, unit in tried if quantity == "torque"} == set(UNITS["torque"])
    assert set(FOUR_HUNDRED) == set(UNITS["pressure"])


def test_voltages(lab: Lab) -> None:
    lab.rows([(0.0, 300, 500, 4500, 5.5), (0.01, 300, 500, 4600, 5.4)])
    lab.entries(valve_1={"column": "u1", "unit": "mV"})
    assert lab.read().voltage == pytest.approx(np.array([[4.5, 5.5], [4.6, 5.4]]))


@pytest.mark.parametrize(
    ("unit", "cells"), [("s", "0.01"), ("ms", "10"), ("us", "10000"), ("ns", "1e7"), ("µs", "1e4")]
)
def test_time(lab: Lab, unit: str, cells: str) -> None:
    lab.rows([(0, *ROWS[0][1:]), (cells, *ROWS[1][1:])]).entries(time={"column": "t", "unit": unit})
    assert np.diff(lab.read().stamp_ns).tolist() == [10_000_000]


def test_scale_and_offset_come_before_the_unit(lab: Lab) -> None:
    """A sensor that gives 0 to 10 V for 0 to 10 bar, one that counts the other way from 90 deg, valves in percent."""
    lab.rows([(0.0, 3.0, 500, 45, 55, 100.0), (0.01, 3.0, 500, 46, 54, 80.0)], (*HEADER, "phi"))
    lab.entries(
        pressure_1={"column": "p1", "unit": "bar", "reference": "absolute", "scale": 1.5, "offset": -0.5},
        angle={"column": "phi", "unit": "deg", "scale": -1, "offset": 90},
        valve_1={"column": "u1", "unit": "V", "scale": 0.1},
        valve_2={"column": "u2", "unit": "V", "scale": 0.1, "offset": 0.5},
    )
    recording = lab.read()
    assert recording.pressure[:, 0] == pytest.approx(400e3)
    assert recording.angle == pytest.approx(np.radians([-10.0, 10.0]))
    assert recording.voltage == pytest.approx(np.array([[4.5, 6.0], [4.6, 5.9]]))


def test_two_valves_may_be_driven_by_one_signal(lab: Lab) -> None:
    lab.rows([(0.0, 300, 500, 0.5, 0), (0.01, 300, 500, -0.5, 0)])
    lab.entries(
        valve_1={"column": "u1", "unit": "V", "offset": 5},
        valve_2={"column": "u1", "unit": "V", "scale": -1, "offset": 5},
    )
    assert lab.read().voltage.tolist() == [[5.5, 4.5], [4.5, 5.5]]


def test_constant_valves(lab: Lab) -> None:
    lab.entries(valve_1={"constant": 5.5, "unit": "V"}, valve_2={"constant": 4500, "unit": "mV"})
    assert lab.read().voltage.tolist() == [[5.5, 4.5]] * len(ROWS)


def test_a_voltage_that_holds_from_its_row_on_belongs_to_the_next_sample(lab: Lab) -> None:
    lab.entries(valve_1={"column": "u1", "unit": "V", "holds": "from_row"})
    voltage = lab.read().voltage
    assert voltage[:, 0].tolist() == [4.5, 4.5, 4.6, 4.7]
    assert voltage[:, 1].tolist() == [5.5, 5.4, 5.3, 5.2]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=25)
@given(
    pressure=st.lists(st.floats(90e3, 900e3), min_size=6, max_size=40),
    unit=st.sampled_from(sorted(UNITS["pressure"])),
    reference=st.sampled_from(["gauge", "absolute"]),
    delimiter=st.sampled_from([(",", "."), (";", ","), ("tab", "."), ("space", ","), ("|", ".")]),
)
def test_what_is_written_in_any_unit_and_layout_is_read_back(
    lab: Lab, pressure: list[float], unit: str, reference: str, delimiter: tuple[str, str]
) -> None:
    gauge = 100e3 if reference == "gauge" else 0.0
    pressure = [*pressure, 600e3]  # filled at least once
    cells = [repr((value - gauge) / UNITS["pressure"][unit]) for value in pressure]
    mark, decimal = delimiter
    rows = [[repr(0.01 * k), cell, "500000.0", "5.0"] for k, cell in enumerate(cells)]
    between = {"tab": "\t", "space": "  "}.get(mark, mark)
    lines = [between.join(row).replace(".", decimal) for row in rows]
    lab.text("\n".join([between.join(("t", "p1", "p2", "u")), *lines]) + "\n")
    lab.entries(
        file={"delimiter": mark, "decimal": decimal},
        pressure_1={"column": "p1", "unit": unit, "reference": reference},
        pressure_2={"column": "p2", "unit": "Pa", "reference": "absolute"},
        atmosphere={"pressure": 1.0, "unit": "bar"},
        valve_1={"column": "u", "unit": "V"},
        valve_2={"column": 4, "unit": "V"},
    )
    assert lab.read().pressure[:, 0] == pytest.approx(np.array(pressure), rel=1e-12, abs=1e-6)
