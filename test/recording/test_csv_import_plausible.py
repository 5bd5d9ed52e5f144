"""A wrong unit is caught where the numbers tell, with the unit that they look like."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from csv_files import HEADER, Lab


def swing(low: float, high: float, count: int = 60) -> list[float]:
    return np.linspace(low, high, count).tolist()


def pressures(lab: Lab, low: float, high: float, unit: str, reference: str, **second: Any) -> Lab:
    """Both muscles between two values, in one declared unit unless the second is declared otherwise."""
    lab.rows([(0.01 * k, p, second.get("value", high + low - p), 5, 5) for k, p in enumerate(swing(low, high))])
    entry = {"unit": unit, "reference": reference}
    return lab.entries(
        pressure_1={"column": "p1", **entry},
        pressure_2={"column": "p2", **entry, **second.get("entry", {})},
        atmosphere={"pressure": 101.325, "unit": "kPa"},
    )


@pytest.mark.parametrize("reference", ["gauge", "absolute"])
@pytest.mark.parametrize(
    ("low", "high", "declared", "says"),
    [
        (0.2, 0.37, "kPa", "0.368 looks like MPa"),
        (0.2, 0.37, "Pa", "0.368 looks like MPa"),
        (200, 366, "MPa", "364 looks like kPa"),
        (200, 366, "bar", "364 looks like kPa"),
        (200, 366, "Pa", "364 looks like kPa"),
        (2.0, 3.66, "kPa", "3.64 looks like bar"),
        (2.0, 3.66, "MPa", "3.64 looks like bar"),
        (30, 53, "bar", "52.8 looks like psi"),
        (200e3, 366e3, "kPa", "3.64e+05 looks like Pa"),
        (200e3, 366e3, "psi", "3.64e+05 looks like Pa"),
        (2000, 3660, "kPa", "3.64e+03 looks like hPa"),
    ],
)
def test_a_wrong_unit_of_pressure(lab: Lab, reference: str, low: float, high: float, declared: str, says: str) -> None:
    said = pressures(lab, low, high, declared, reference).refusal()
    assert said.endswith(says)
    assert f"pressure_1 (column 'p1') goes from {low:.4g} to {high:.4g} {declared} {reference}, which makes" in said


def test_gauge_pressure_that_was_declared_absolute(lab: Lab) -> None:
    assert pressures(lab, 0, 366, "kPa", "absolute").refusal().endswith("362 looks like gauge pressure")
    assert pressures(lab, -0.002, 0.366, "MPa", "absolute").refusal().endswith("0.362 looks like gauge pressure")


def test_nothing_is_guessed_where_nothing_fits(lab: Lab) -> None:
    said = pressures(lab, -4, 4, "kPa", "gauge").refusal()
    assert said.endswith("80 to 2000 kPa absolute")
    said = pressures(lab, 0, 0, "kPa", "gauge").refusal()
    assert said.endswith("it is the same throughout: is the sensor connected?")


def test_usual_pressures_pass_without_a_word(lab: Lab) -> None:
    for low, high, unit, reference in (
        (0, 366, "kPa", "gauge"), (101, 800, "kPa", "absolute"), (0.0, 0.55, "MPa", "gauge"), (0, 6, "bar", "gauge"),
        (-0.5, 80, "psi", "gauge"), (1.0, 7.0, "bar", "absolute"),
    ):  # fmt: skip
        assert pressures(lab, low, high, unit, reference).read().issues == ()


def test_one_vented_muscle_is_a_way_to_use_a_joint(lab: Lab) -> None:
    recording = pressures(lab, 100, 366, "kPa", "gauge", value=0.2).read()
    assert recording.pressure[:, 1] == pytest.approx(101525.0)
    (said,) = recording.issues
    assert said.startswith("pressure_2 (column 'p2') stays at the atmosphere's pressure, 0.2 to 0.2 kPa gauge")


def test_a_slack_muscle_with_a_unit_of_its_own_is_a_wrong_unit(lab: Lab) -> None:
    said = pressures(lab, 100, 366, "kPa", "gauge", value=0.3, entry={"unit": "psi"}).refusal()
    assert "pressure_2 (column 'p2')" in said and said.endswith("0.3 looks like MPa")
    assert pressures(lab, 100, 366, "kPa", "gauge", value=0.0, entry={"unit": "psi"}).read().issues


def test_a_single_odd_value_is_left_to_the_estimator(lab: Lab) -> None:
    lab.rows([(0.01 * k, 5000 if k == 7 else 300, 400, 5, 5) for k in range(100)])
    recording = lab.read()
    assert recording.pressure[7, 0] == 5e6
    assert any(
        "1 of 100 values on pressure_1 (column 'p1') lie outside 80 to 2000 kPa absolute: kept" in text
        for text in recording.issues
    )


def measured(lab: Lab, values: list[float], **entries: Any) -> Lab:
    rows = [(0.01 * k, 300 + k, 400 - k, 5, 5, value) for k, value in enumerate(values)]
    return lab.rows(rows, (*HEADER, "x")).entries(**entries)


def test_degrees_that_were_declared_radians(lab: Lab) -> None:
    said = measured(lab, swing(-20, 25), angle={"column": "x", "unit": "rad"}).refusal()
    assert "angle (column 'x') goes from -20 to 25 rad" in said
    assert said.endswith("; 24.5 looks like deg")


def test_an_angle_beyond_half_a_turn_in_any_unit_may_have_an_offset(lab: Lab) -> None:
    said = measured(lab, swing(200, 250), angle={"column": "x", "unit": "deg"}).refusal()
    assert said.endswith("; 250 looks like mrad; give offset if the sensor counts from elsewhere")
    said = measured(lab, swing(8000, 9000), angle={"column": "x", "unit": "deg"}).refusal()
    assert said.endswith("; give offset if the sensor counts from elsewhere")


def test_an_angle_that_hardly_moves_is_worth_a_word(lab: Lab) -> None:
    """It may be a locked joint; so it is not refused."""
    (said,) = measured(lab, swing(-0.2, 0.2), angle={"column": "x", "unit": "deg"}).read().issues
    assert said == "angle (column 'x') goes from -0.2 to 0.2 deg: a locked joint? 0.4 could be rad"
    assert measured(lab, swing(-20, 20), angle={"column": "x", "unit": "deg"}).read().issues == ()
    assert measured(lab, swing(-1e-4, 1e-4), angle={"column": "x", "unit": "deg"}).read().issues == ()


@pytest.mark.parametrize("quantity", ["torque", "external_torque"])
def test_a_torque_in_newton_millimetres(lab: Lab, quantity: str) -> None:
    said = measured(lab, swing(-2500, 2500), **{quantity: {"column": "x", "unit": "N m"}}).refusal()
    assert f"{quantity} (column 'x') goes from -2500 to 2500 N m, expected up to 1000 N m" in said
    assert "looks like N mm" in said


@pytest.mark.parametrize(
    ("low", "high", "unit", "says"),
    [
        (4000, 6000, "V", "looks like mV"),
        (4, 6, "mV", "looks like V"),
        (30, 70, "V", "looks like percent: give scale: 0.1"),
        (-8, 20e6, "V", "give scale and offset"),
    ],
)
def test_a_wrong_unit_of_voltage(lab: Lab, low: float, high: float, unit: str, says: str) -> None:
    lab.rows([(0.01 * k, 300, 400, 5, u) for k, u in enumerate(swing(low, high))])
    said = lab.entries(valve_2={"column": "u2", "unit": unit}).refusal()
    assert "valve_2 (column 'u2') goes from" in said and "expected 0 to 10 V" in said
    assert says in said


def test_constant_voltages_are_judged_as_well(lab: Lab) -> None:
    said = lab.entries(valve_1={"constant": 5500, "unit": "V"}).refusal()
    assert "valve_1 (constant) goes from 5500 to 5500 V" in said and said.endswith("looks like mV")
    said = lab.entries(valve_1={"constant": 5.5, "unit": "mV"}).refusal()
    assert said.endswith("5.5 looks like V")
    assert lab.entries(valve_1={"constant": 0, "unit": "mV"}).read().voltage[0, 0] == 0.0


@pytest.mark.parametrize("column", range(1, 5))
def test_a_column_without_a_value(lab: Lab, column: int) -> None:
    rows = [[0.01 * k, 300, 400, 5, 5] for k in range(10)]
    for row in rows:
        row[column] = ""  # type: ignore[call-overload]
    names = ["pressure_1 (column 'p1')", "pressure_2 (column 'p2')", "valve_1 (column 'u1')", "valve_2 (column 'u2')"]
    assert f"{names[column - 1]} holds no value in 10 rows" in lab.rows(rows).refusal()
