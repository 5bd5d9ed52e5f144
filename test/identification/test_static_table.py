"""Tables of static measurements: units and references are told, never guessed, and what cannot be is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_table import Choice, StaticTable, read_force_map, read_volumes

ATMOSPHERE = 101_300.0
LENGTHS = (0.150, 0.165, 0.180)
PRESSURES = (100e3, 300e3, 500e3)
"""Gauge."""


def rows(
    length: float = 1.0, pressure: float = 1.0, force: float = 1.0, offset: float = 0.0
) -> list[tuple[float, ...]]:
    """A map in other units: factors from SI, and what a pressure of 0 gauge reads."""
    out = []
    for held in PRESSURES:
        for at in LENGTHS:
            pull = max(0.0, (at - 0.14) * held * 3e-3 - 5.0)
            out.append((at * length, held * pressure + offset, pull * force))
    return out


def write(path: Path, header: str, cells, mark: str = ",") -> Path:
    lines = [header, *(mark.join(f"{cell:.10g}" for cell in row) for row in cells)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "map.csv"


def expected(file: Path) -> StaticTable:
    return read_force_map(write(file.parent / "si.csv", "length_m,pressure_Pa_gauge,force_N", rows()), ATMOSPHERE)


@pytest.mark.parametrize(
    ("header", "factors"),
    [
        ("length_mm,pressure_kPa_gauge,force_N", (1e3, 1e-3, 1.0, 0.0)),
        ("l [cm],p [bar] (gauge),F [kN]", (1e2, 1e-5, 1e-3, 0.0)),
        ("Length (mm),Pressure (MPa abs),Force (N)", (1e3, 1e-6, 1.0, 0.1013)),
        ("length_in,pressure_psig,force_lbf", (1 / 0.0254, 1 / 6894.757293, 1 / 4.4482216153, 0.0)),
        ("len_m,p_bara,f_kgf", (1.0, 1e-5, 1 / 9.80665, 1.013)),
    ],
)
def test_units_are_read_from_names(file, header, factors):
    found = read_force_map(write(file, header, rows(*factors)), ATMOSPHERE)
    wanted = expected(file)
    for name in ("length", "pressure", "value"):
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), rel=1e-7, abs=1e-9), name
    assert found.pressure.min() == pytest.approx(201_300.0)
    assert found.lengths == 3 and found.slack.tolist() == (wanted.value == 0.0).tolist() and found.slack.any()


def test_columns_and_units_can_be_given(file):
    write(file, "Laenge,Druck,Kraft,Temp_C", [(*row, 20.0) for row in rows(1e3, 1e-5)])
    chosen = {"length": Choice("Laenge", "mm"), "pressure": Choice("Druck", "bar"), "force": Choice("Kraft", "N")}
    found = read_force_map(file, ATMOSPHERE, chosen, reference="gauge")
    assert found.pressure == pytest.approx(expected(file).pressure, rel=1e-9)
    absolute = read_force_map(file, ATMOSPHERE, chosen, reference="absolute")
    assert found.pressure - absolute.pressure == pytest.approx(np.full(9, ATMOSPHERE))


def test_deviations_are_read(file):
    write(file, "length_m,pressure_Pa_gauge,force_N,force_std_kN", [(*row, 2e-3) for row in rows()])
    found = read_force_map(file, ATMOSPHERE)
    assert found.declared and found.spread == pytest.approx(np.full(9, 2.0))
    assert not expected(file).declared


def test_rows_without_a_value_are_left_out_and_said(file):
    lines = write(file, "length_m,pressure_Pa_gauge,force_N", rows()).read_text().splitlines()
    lines[2] = lines[2].rsplit(",", 1)[0] + ","
    file.write_text("\n".join(lines) + "\n")
    found = read_force_map(file, ATMOSPHERE)
    assert len(found) == 8 and "1 of 9 rows lack a value (the first in line 3): left out" in found.issues


def test_negative_forces_are_slack_and_said(file):
    found = read_force_map(
        write(file, "length_m,pressure_Pa_gauge,force_N", [(a, b, c - 0.5) for a, b, c in rows()]), ATMOSPHERE
    )
    assert found.slack.any() and "--slack-below" in found.issues[0]
    wider = read_force_map(file, ATMOSPHERE, slack_below=20.0)
    assert wider.slack.sum() > found.slack.sum() and wider.limit == 20.0
    with pytest.raises(BadInput, match="never exceeds 500 N, expected a contraction force"):
        read_force_map(file, ATMOSPHERE, slack_below=500.0)


def test_a_sweep_is_cut_into_bands(file):
    sweep = [(0.15 + 0.03 * k / 99, held, 50.0 + k) for held in PRESSURES for k in range(100)]
    found = read_force_map(write(file, "length_m,pressure_Pa_gauge,force_N", sweep), ATMOSPHERE)
    assert found.lengths == 8


HEAD = "length_m,pressure_Pa_gauge,force_N"


@pytest.mark.parametrize(
    ("header", "cells", "says"),
    [
        ("length_m,pressure_Pa,force_N", rows(), "does not tell whether it is gauge or absolute"),
        ("length_m,pressure_Pa_gauge_abs,force_N", rows(), "is said to be gauge and absolute"),
        ("length_m,pressure_gauge,force_N", rows(), "does not tell its unit, expected one of Pa, hPa, kPa"),
        (
            "length,pressure_Pa_gauge,force_N",
            rows(),
            "column 'length' does not tell its unit, expected one of m, cm, mm",
        ),
        ("x_m,pressure_Pa_gauge,force_N", rows(), "length: no column is called so among x_m, pressure_Pa_gauge"),
        ("length_m,pressure_Pa_gauge,force_N,force_2_N", [(*row, 1.0) for row in rows()], "2 columns are called so"),
        (HEAD, rows(length=1e3), "looks like mm"),
        (HEAD, rows(pressure=1e-6), "0.5 looks like MPa"),
        ("length_m,pressure_bar_gauge,force_N", rows(), "looks like Pa"),
        (HEAD, rows(force=1e-3), "looks like kN"),
        (HEAD, rows(force=-1.0), "does a pull count as negative?"),
        (HEAD, rows(force=0.0), "expected a largest force of 1 to 20000 N"),
        (HEAD, [row for row in rows() if row[0] == 0.165], "is 0.165 throughout, expected forces at several lengths"),
        (HEAD, [row for row in rows() if row[1] == 300e3], "throughout, expected forces at several pressures"),
        (HEAD, rows()[:2], "2 complete rows, expected at least 3"),
        (HEAD, [], "fewer than two rows of numbers"),
        (HEAD + ",force_std_N", [(*row, 0.0) for row in rows()], "expected deviations above 0"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(file, header, cells, says):
    write(file, header, cells)
    with pytest.raises(BadInput) as refused:
        read_force_map(file, ATMOSPHERE)
    assert says in str(refused.value) and str(refused.value).startswith(f"{file}: ") and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("# nothing\n", "only comments"),
        ("length_m,volume_cm3\n0.15,5\n0.16,x\n0.17,7\n", "line 3, volume (column 'volume_cm3'): 'x' is not a number"),
        ("length_m,volume_cm3\n0.15,5\n0.16,6\n0.16,7\n", "has 2 different values, expected at least 3"),
        ("length_m,volume_cm3\n0.15,5\n0.16,5\n0.17,5\n", "is the same throughout"),
        ("length_m,volume_m3\n0.15,50\n0.16,40\n0.17,30\n", "50 looks like cm3"),
        ("length_m,volume_cm3\n0.15,50\n0.16,-40\n0.17,30\n", "expected volumes of a muscle"),
    ],
)
def test_bad_tables_of_volumes(file, text, says):
    file.write_text(text)
    with pytest.raises(BadInput) as refused:
        read_volumes(file)
    assert says in str(refused.value)


SI = "length_m,pressure_Pa_gauge,force_N"


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (f"{SI}\nm,Pa,N\n0.15,2e5,10\n".encode(), "'m' is not a number; a line of units? units belong into"),
        (f"{SI},T [°C]\n0.15,2e5,10,20\n".encode("cp1252"), "is not utf-8; save the file as UTF-8"),
        (f"{SI}\n0.15,2e5,slack\n0.16,2e5,3\n".encode(), "'slack' is not a number; a line of units?"),
        (f"{SI}\n0.15,2e5,3\n0.16,2e5,slack\n".encode(), "'slack' is not a number; a cell without a value has to be"),
        (b"0.15,2e5,10\n0.16,2e5,20\n", "length: no column is called so among 0.15, 2e5, 10"),
        (b"PK\x03\x04", "not a CSV file but a zip file"),
    ],
)
def test_advice_fits_a_table(file, content, says):
    file.write_bytes(content)
    with pytest.raises(BadInput) as refused:
        read_force_map(file, ATMOSPHERE)
    assert says in str(refused.value) and "file." not in str(refused.value)


def test_volumes_in_any_unit(file):
    file.write_text("L [mm]\tV [ml]\n150\t60\n160\t52\n170\t40\n")
    found = read_volumes(file)
    assert found.value == pytest.approx([60e-6, 52e-6, 40e-6]) and found.length == pytest.approx([0.15, 0.16, 0.17])
