"""Units, signs and offsets against values by hand; a wrong unit is caught with the one that it looks like."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_files import HEADER, MAP, ROWS, Lab

from pam_antagonist.recording.plausible import UNITS

BY_HAND = [
    # 1 psi = 6.894757293168361 kPa (NIST SP 811)
    ("pressure_1", "Pa", "400000", 400e3), ("pressure_1", "hPa", "4000", 400e3), ("pressure_1", "kPa", "400", 400e3),
    ("pressure_1", "MPa", "0.4", 400e3), ("pressure_1", "mbar", "4000", 400e3), ("pressure_1", "bar", "4", 400e3),
    ("pressure_1", "psi", "58.015095", 400e3),
    ("angle", "rad", "0.25", 0.25), ("angle", "mrad", "250", 0.25), ("angle", "deg", "-18", -math.pi / 10),
    ("angle", "rev", "0.05", math.pi / 10),
    ("torque", "N m", "1.5", 1.5), ("torque", "N cm", "150", 1.5), ("torque", "N mm", "1500", 1.5),
    ("torque", "mN m", "1500", 1.5), ("torque", "kgf cm", "10", 0.980665), ("torque", "lbf in", "10", 1.1298482902762),
    ("external_torque", "Nm", "-1.5", -1.5), ("external_torque", "N·mm", "-1500", -1.5),
]  # fmt: skip


@pytest.mark.parametrize(("quantity", "unit", "cell", "expected"), BY_HAND)
def test_every_unit(lab: Lab, quantity: str, unit: str, cell: str, expected: float) -> None:
    entry = {**MAP.get(quantity, {}), "column": "x", "unit": unit}
    lab.rows([(*row, cell) for row in ROWS], (*HEADER, "x")).entries(**{quantity: entry})
    recording = lab.read()
    found = recording.pressure[:, 0] if quantity == "pressure_1" else getattr(recording, quantity)
    assert found == pytest.approx(expected, rel=1e-7)
    assert recording.pressure[:, 1] == pytest.approx([1e3 * row[2] for row in ROWS])
    others = {"angle", "torque", "external_torque"} - {quantity}
    assert all(getattr(recording, other) is None for other in others)


def test_a_new_unit_needs_a_value_by_hand() -> None:
    for quantity in ("pressure", "angle", "torque"):
        assert {unit for name, unit, _, _ in BY_HAND if name.removesuffix("_1") == quantity} == set(UNITS[quantity])


@pytest.mark.parametrize(
    ("atmosphere", "unit", "expected"),
    [(101.325, "kPa", 501325.0), (0.95, "bar", 495000.0), (79000, "Pa", 479000.0), (14.5, "psi", 499973.98)],
)
def test_gauge_pressure_counts_from_the_declared_atmosphere(
    lab: Lab, atmosphere: float, unit: str, expected: float
) -> None:
    lab.rows([(0.0, "0.4", 500, 5, 5), (0.01, "0.4", 500, 5, 5)])
    gauge = {"column": "p1", "unit": "MPa", "reference": "gauge"}
    pressure = lab.entries(pressure_1=gauge, atmosphere={"pressure": atmosphere, "unit": unit}).read().pressure
    assert pressure[0] == pytest.approx([expected, 500e3], rel=1e-8), "absolute pressure is left alone"


@pytest.mark.parametrize(("unit", "cell"), [("s", "0.01"), ("ms", "10"), ("us", "10000"), ("ns", "1e7"), ("µs", "1e4")])
def test_time(lab: Lab, unit: str, cell: str) -> None:
    lab.rows([(0, *ROWS[0][1:]), (cell, *ROWS[1][1:])]).entries(time={"column": "t", "unit": unit})
    assert np.diff(lab.read().stamp_ns).tolist() == [10_000_000]


def test_scale_and_offset_come_before_the_unit(lab: Lab) -> None:
    """A sensor that gives 0 to 10 V for 0 to 10 bar, one that counts the other way from 90 deg, valves in percent."""
    lab.rows([(0.0, 3.0, 500, 45, 5500, 100.0), (0.01, 3.0, 500, 46, 5400, 80.0)], (*HEADER, "phi"))
    lab.entries(
        pressure_1={"column": "p1", "unit": "bar", "reference": "absolute", "scale": 1.5, "offset": -0.5},
        angle={"column": "phi", "unit": "deg", "scale": -1, "offset": 90},
        valve_1={"column": "u1", "unit": "V", "scale": 0.1, "offset": 0.5},
        valve_2={"column": "u2", "unit": "mV"},
    )
    recording = lab.read()
    assert recording.pressure[:, 0] == pytest.approx(400e3)
    assert recording.angle == pytest.approx(np.radians([-10.0, 10.0]))
    assert recording.voltage == pytest.approx(np.array([[5.0, 5.5], [5.1, 5.4]]))


def test_valves_may_share_a_signal_be_constant_or_hold_from_a_row_on(lab: Lab) -> None:
    lab.entries(valve_1={"constant": 5.5, "unit": "V"}, valve_2={"constant": 4500, "unit": "mV"})
    assert lab.read().voltage.tolist() == [[5.5, 4.5]] * len(ROWS)
    lab.entries(valve_1={"column": "u1", "unit": "V", "holds": "from_row"})
    voltage = lab.read().voltage
    assert voltage.tolist() == [[4.5, 5.5], [4.5, 5.4], [4.6, 5.3], [4.7, 5.2]], "the first belongs to the next sample"
    lab.entries(valve_2={"column": "u1", "unit": "V", "scale": -1, "offset": 10})
    assert lab.read().voltage[0].tolist() == [4.5, 5.5]


# ---------------------------------------------------------------- wrong units

BOTH = ("gauge", "absolute")


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


WRONG_PRESSURES = [
    (0.2, 0.37, "kPa", "0.368 looks like MPa"), (0.2, 0.37, "Pa", "0.368 looks like MPa"),
    (200, 366, "MPa", "364 looks like kPa"), (200, 366, "bar", "364 looks like kPa"),
    (200, 366, "Pa", "364 looks like kPa"), (2.0, 3.66, "kPa", "3.64 looks like bar"),
    (2.0, 3.66, "MPa", "3.64 looks like bar"), (30, 53, "bar", "52.8 looks like psi"),
    (200e3, 366e3, "kPa", "3.64e+05 looks like Pa"), (200e3, 366e3, "psi", "3.64e+05 looks like Pa"),
    (2000, 3660, "kPa", "3.64e+03 looks like hPa"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("low", "high", "declared", "says"),
    [
        *((low, high, f"{unit} {what}", says) for low, high, unit, says in WRONG_PRESSURES for what in BOTH),
        (0, 366, "kPa absolute", "362 looks like gauge pressure"),
        (-0.002, 0.366, "MPa absolute", "0.362 looks like gauge pressure"),
        (-4, 4, "kPa gauge", "81.1 to 2000 kPa absolute"),
        (0, 0, "kPa gauge", "it is the same throughout: is the sensor connected?"),
    ],
)
def test_a_wrong_unit_of_pressure(lab: Lab, low: float, high: float, declared: str, says: str) -> None:
    said = pressures(lab, low, high, *declared.split()).refusal()
    assert said.endswith(says)
    assert f"pressure_1 (column 'p1') goes from {low:.4g} to {high:.4g} {declared}, which makes" in said


def test_usual_pressures_pass_without_a_word(lab: Lab) -> None:
    for low, high, unit, reference in (
        (0, 366, "kPa", "gauge"), (101, 800, "kPa", "absolute"), (0.0, 0.55, "MPa", "gauge"), (0, 6, "bar", "gauge"),
        (-0.5, 80, "psi", "gauge"), (1.0, 7.0, "bar", "absolute"),
    ):  # fmt: skip
        assert pressures(lab, low, high, unit, reference).read().issues == ()


def test_one_vented_muscle_is_a_way_to_use_a_joint_unless_its_own_unit_is_wrong(lab: Lab) -> None:
    recording = pressures(lab, 100, 366, "kPa", "gauge", value=0.2).read()
    assert recording.pressure[:, 1] == pytest.approx(101525.0)
    (said,) = recording.issues
    assert said.startswith("pressure_2 (column 'p2') stays at the atmosphere's pressure, 0.2 to 0.2 kPa gauge")
    said = pressures(lab, 100, 366, "kPa", "gauge", value=0.3, entry={"unit": "psi"}).refusal()
    assert "pressure_2 (column 'p2')" in said and said.endswith("0.3 looks like MPa")
    assert pressures(lab, 100, 366, "kPa", "gauge", value=0.0, entry={"unit": "psi"}).read().issues


def measured(lab: Lab, values: list[float], quantity: str, unit: str) -> Lab:
    rows = [(0.01 * k, 300 + k, 400 - k, 5, 5, value) for k, value in enumerate(values)]
    return lab.rows(rows, (*HEADER, "x")).entries(**{quantity: {"column": "x", "unit": unit}})


@pytest.mark.parametrize(
    ("quantity", "low", "high", "unit", "says"),
    [
        ("angle", -20, 25, "rad", "angle (column 'x') goes from -20 to 25 rad, expected within half a turn of 0"),
        ("angle", -20, 25, "rad", "; 24.5 looks like deg"),
        ("angle", 200, 250, "deg", "; 250 looks like mrad; give offset if the sensor counts from elsewhere"),
        ("angle", 8000, 9000, "deg", "; give offset if the sensor counts from elsewhere"),
        ("torque", -2500, 2500, "N m", "torque (column 'x') goes from -2500 to 2500 N m, expected up to 1000 N m"),
        ("external_torque", -2500, 2500, "N m", "looks like N mm"),
        (
            "valve_2",
            4000,
            6000,
            "V",
            "valve_2 (column 'x') goes from 4000 to 6000 V, expected -10 to 10 V; 5.98e+03 loo",
        ),
        ("valve_2", 4000, 6000, "V", "looks like mV"),
        ("valve_2", 4, 6, "mV", "looks like V"),
        ("valve_2", 30, 70, "V", "looks like percent: give scale: 0.1"),
        ("valve_2", -8, 20e6, "V", "give scale and offset"),
        ("valve_2", 0, 12, "V", "expected -10 to 10 V; give scale and offset"),
    ],
)
def test_a_wrong_unit(lab: Lab, quantity: str, low: float, high: float, unit: str, says: str) -> None:
    assert says in measured(lab, swing(low, high), quantity, unit).refusal()


def test_an_angle_that_hardly_moves_is_worth_a_word(lab: Lab) -> None:
    """It may be a locked joint; so it is not refused."""
    (said,) = measured(lab, swing(-0.2, 0.2), "angle", "deg").read().issues
    assert said == "angle (column 'x') goes from -0.2 to 0.2 deg: a locked joint? 0.4 could be rad"
    for span in (20, 1e-4):
        assert measured(lab, swing(-span, span), "angle", "deg").read().issues == ()


def test_constant_voltages_are_judged_as_well(lab: Lab) -> None:
    said = lab.entries(valve_1={"constant": 5500, "unit": "V"}).refusal()
    assert "valve_1 (constant) goes from 5500 to 5500 V" in said and said.endswith("looks like mV")
    assert lab.entries(valve_1={"constant": 5.5, "unit": "mV"}).refusal().endswith("5.5 looks like V")
    assert lab.entries(valve_1={"constant": 0, "unit": "mV"}).read().voltage[0, 0] == 0.0


@pytest.mark.parametrize("column", range(1, 5))
def test_a_column_without_a_value(lab: Lab, column: int) -> None:
    rows = [["" if k == column else value for k, value in enumerate((0.01 * row, 300, 400, 5, 5))] for row in range(10)]
    names = ["pressure_1 (column 'p1')", "pressure_2 (column 'p2')", "valve_1 (column 'u1')", "valve_2 (column 'u2')"]
    assert f"{names[column - 1]} holds no value in 10 rows" in lab.rows(rows).refusal()


WRITTEN = [
    # as a cell, what stands before decimals, and the number
    ("\u22121.5", ".", -1.5), ("\u20131.5", ".", -1.5), ("\uff0d1.5", ".", -1.5), ("\u22121,5e\u22121", ",", -0.15),
    ("-1.5D-01", ".", -0.15), ("+.15d+1", ".", 1.5), ("-1,5D0", ",", -1.5),
    ("-1'234.5", ".", -1234.5), ("1\u2019234,5", ",", 1234.5),
    ("\u2212123\u202f567.5", ".", -123567.5), ("1\u00a0234,5", ",", 1234.5),
    ("1.#QNAN", ".", math.nan), ("-1.#IND00", ".", math.nan), ("-nan(ind)", ".", math.nan), ("1,#QNAN", ",", None),
    ("#DIV/0!", ".", math.nan), ("\u2013", ".", math.nan),
]  # fmt: skip


@pytest.mark.parametrize(("cell", "decimal", "expected"), WRITTEN)
def test_numbers_of_other_programs(lab: Lab, cell: str, decimal: str, expected: float | None) -> None:
    """Minus signs of typesetting, Fortran's exponents, thousands set apart, and what means no number."""
    rows = [";".join([*(str(x).replace(".", decimal) for x in row), cell]) for row in ROWS]
    lab.text("\n".join([";".join((*HEADER, "x")), *rows[:-1], rows[-1].rsplit(";", 1)[0] + ";2"]) + "\n")
    lab.entries(torque={"column": "x", "unit": "N mm"}, file={"delimiter": ";", "decimal": decimal})
    if expected is None:
        assert "is not a number" in lab.refusal()
        return
    torque = lab.read().torque
    assert torque is not None and torque[:3] == pytest.approx(1e-3 * expected, nan_ok=True)


@pytest.mark.parametrize(
    ("cell", "hint"),
    [
        ("\u22121,5", 'decimals after a comma? give file.decimal: ","'),
        ("1 234.5", "are the thousands set apart?"),
        ("1,234.5", "are the thousands set apart?"),
        ("1.234.567", "are the thousands set apart?"),
        ("1.5 N m", "is 'N m' a unit? leave it out of the cells"),
        ("\u22121.5\u00a0mV", "is 'mV' a unit?"),
        ("12 %", "is '%' a unit?"),
    ],
)
def test_a_cell_that_is_no_number_is_refused_with_a_hint(lab: Lab, cell: str, hint: str) -> None:
    lab.text(";".join((*HEADER, "x")) + "\n" + "".join(";".join((*map(str, row), cell)) + "\n" for row in ROWS))
    said = lab.entries(torque={"column": "x", "unit": "N m"}, file={"delimiter": ";"}).refusal()
    assert "line 2, torque (column 'x')" in said and hint in said


@pytest.mark.parametrize("reference", BOTH)
def test_vented_muscles_of_a_laboratory_at_2600_m(tmp_path: Path, reference: str) -> None:
    above = 0.0 if reference == "gauge" else 74.7
    rows = [(0.01 * k, above + max(0.0, 3.0 * k - 100.0), above + 200.0, 5, 5, 0.1 * k) for k in range(100)]
    air = {"atmosphere": {"pressure": 74.7, "unit": "kPa"}} if reference == "gauge" else {}
    entries = {f"pressure_{k}": {"column": f"p{k}", "unit": "kPa", "reference": reference} for k in (1, 2)}
    lab = Lab(tmp_path).rows(rows, ("t", "p1", "p2", "u1", "u2", "a")).entries(**entries, **air)
    read = lab.read()
    assert read.pressure.min() == pytest.approx(74.7e3) and not [text for text in read.issues if "outside" in text]
