"""How CSV files are written: delimiters, decimals, headers, missing cells; what cannot be read is said in one line."""

from __future__ import annotations

import numpy as np
import pytest
from csv_files import HEADER, ROWS, Lab, table

from pam_antagonist.recording import csv_table

EXPECTED = np.array([row[1:3] for row in ROWS]) * 1e3


NUMBERED = {
    "time": {"column": 1, "unit": "s"},
    "pressure_1": {"column": 2, "unit": "kPa", "reference": "absolute"},
    "pressure_2": {"column": 3, "unit": "kPa", "reference": "absolute"},
    "valve_1": {"column": 4, "unit": "V"},
    "valve_2": {"column": 5, "unit": "V"},
}
BODY = table(HEADER, ROWS).split("\n", 1)[1]
NAMES = ",".join(HEADER) + "\n"


@pytest.mark.parametrize(
    ("text", "layout"),
    [
        (NAMES + BODY, {}),
        (NAMES + BODY.rstrip("\n"), {}),
        ((NAMES + BODY).replace("\n", "\r\n"), {}),
        ((NAMES + BODY).replace(",", ";"), {"delimiter": ";"}),
        ((NAMES + BODY).replace(",", ";").replace(".", ","), {"delimiter": ";", "decimal": ","}),
        ((NAMES + BODY).replace(",", "\t"), {"delimiter": "tab"}),
        ((NAMES + BODY).replace(",", "\t"), {"delimiter": "\t"}),
        ((NAMES + BODY).replace(",", "   ").replace("\n", " \n  "), {"delimiter": "space"}),
        ((NAMES + BODY).replace(",", " , "), {}),
        ((NAMES + BODY).replace("\n", ",\n"), {}),
        (NAMES + BODY.replace("\n", ",,\n"), {}),
        ('"t","p1","p2","u1","u2"\n' + BODY.replace("300", '"300"'), {}),
        ('"t","p1","p2","u1","u2"\n' + BODY.replace("4.5", '"4,5"').replace("0.01", '"0,01"').replace("0.02", '"0,02"')
         .replace("0.03", '"0,03"').replace("0.0,", "0,").replace("4.6", "4").replace("4.7", "4").replace("4.8", "4")
         .replace("5.5", "5").replace("5.4", "5").replace("5.3", "5").replace("5.2", "5"), {"decimal": ","}),
        ("# made by a logger\n\n" + NAMES + "# begin\n" + BODY + "\n\n# end\n", {}),
        ("% made by a logger\n" + NAMES + BODY, {"comment": "%"}),
        ("# " + NAMES + BODY, {"comment": None}),
        ("#" + NAMES + BODY, {"comment": None}),
        ("Logger 7; 3 channels\nrun,5\n" + NAMES + "s,kPa,kPa,V,V\n" + BODY, {"skip_lines": 2, "skip_after_header": 1}),
        (NAMES + BODY + ",,,,\n,,,,\n", {}),
        ("\ufeffsep=;\n" + (NAMES + BODY).replace(",", ";").replace(".", ","), {"delimiter": ";", "decimal": ","}),
    ],
)  # fmt: skip
def test_ways_to_write_the_same_file(lab: Lab, text: str, layout: dict[str, object]) -> None:
    recording = lab.text(text).entries(file=layout).read()
    assert recording.pressure == pytest.approx(EXPECTED)
    assert recording.stamp_ns.tolist() == (recording.stamp_ns[0] + np.arange(4) * 10_000_000).tolist()
    assert recording.issues == ()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le"])
def test_encodings_with_a_mark(lab: Lab, encoding: str) -> None:
    mark = "\ufeff" if encoding == "utf-16-le" else ""
    assert lab.text(mark + NAMES + BODY, encoding).read().pressure == pytest.approx(EXPECTED)


def test_an_old_encoding_is_declared(lab: Lab) -> None:
    lab.rows([(*row, 10.0) for row in ROWS], (*HEADER, "Winkel [°]"))
    lab.text(lab.csv.read_text(encoding="utf-8"), "cp1252")
    lab.entries(angle={"column": "Winkel [°]", "unit": "deg"})
    assert "is not utf-8; give file.encoding in the map, cp1252" in lab.refusal()
    lab.entries(angle={"column": "Winkel [°]", "unit": "deg"}, file={"encoding": "cp1252"})
    assert lab.read().angle == pytest.approx(np.radians(10.0))


def test_without_a_header_columns_have_numbers(lab: Lab) -> None:
    lab.text(BODY).entries(file={"header": False}, **NUMBERED)
    recording = lab.read()
    assert recording.pressure == pytest.approx(EXPECTED), "the first line is a row, too"
    assert recording.voltage[:, 1].tolist() == [5.5, 5.4, 5.3, 5.2]


def test_numbers_count_from_one_with_a_header_as_well(lab: Lab) -> None:
    assert lab.entries(**NUMBERED).read().pressure == pytest.approx(EXPECTED)
    lab.entries(pressure_1={"column": 6, "unit": "kPa", "reference": "absolute"})
    assert "pressure_1 is column 6, and the file has 5 (t, p1, p2, u1, u2)" in lab.refusal()


def test_cells_without_a_value_are_missing(lab: Lab) -> None:
    rows = [list(row) + [k] for k, row in enumerate(ROWS * 3)]
    for k, row in enumerate(rows):
        row[0] = k / 100
    for row, cell in zip(rows, ["", "NaN", "n/a", "-", "null", "-9999", "  ", "bad", "inf"], strict=False):
        row[5] = cell
    rows[1][1] = ""
    rows[2][3] = "nan"
    lab.rows(rows, (*HEADER, "angle")).entries(
        angle={"column": "angle", "unit": "deg"}, file={"missing": [-9999.0, "bad"]}
    )
    recording = lab.read()
    assert recording.angle is not None
    assert np.isnan(recording.angle).tolist() == [True] * 9 + [False] * 3
    assert recording.angle[9:] == pytest.approx(np.radians([9, 10, 11]))
    assert np.isnan(recording.pressure).tolist() == [[k == 1, False] for k in range(12)]
    assert np.isnan(recording.voltage).tolist() == [[k == 2, False] for k in range(12)]
    said = " | ".join(recording.issues)
    assert "1 cells of angle (column 'angle') are infinite" in said
    assert "9 of 12 samples without angle (column 'angle')" in said
    assert "1 of 12 samples without pressure_1 (column 'p1')" in said


def test_a_validation_column_without_a_value_is_left_out(lab: Lab) -> None:
    lab.rows([(*row, "") for row in ROWS], (*HEADER, "angle")).entries(angle={"column": "angle", "unit": "deg"})
    recording = lab.read()
    assert recording.angle is None
    assert any("angle (column 'angle') holds no value" in text for text in recording.issues)


def test_a_last_line_that_was_cut_off_is_left_out(lab: Lab) -> None:
    recording = lab.text(NAMES + BODY + "0.04,340,46").read()
    assert len(recording) == 4
    assert recording.issues == ("line 6 is cut off: left out",)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("\n\n# nothing\n\n", "no rows in it"),
        (NAMES, "fewer than two rows"),
        (NAMES + "0.0,300,500,5,5\n", "1 row of numbers, expected at least two"),
        (BODY, "line 1 should name the columns and holds numbers only (0.0,300,500,4.5,5.5)"),
        (
            NAMES + "0,00,300,0,500,0,4,5,5,5\n" * 2,
            "expected 5 as in the header; commas stand before decimals and between cells",
        ),
        (NAMES + BODY + "0.04,340\n0.05,340,460,5,5\n", "line 6 has 2 cells (0.04,340), expected 5 as in the header"),
        (NAMES + BODY + "0.04,340,460,5,5,7\n", "line 6 has 6 cells"),
        (NAMES + BODY + "0.04,340,460\n", "line 6 has 3 cells"),
        (NAMES + BODY + "0.04,34x,460,5,5\n", "line 6, pressure_1 (column 'p1'): '34x' is not a number"),
        (NAMES + "\n# c\n" + BODY + "0.04,34x,460,5,5\n", "line 8, pressure_1"),
        (NAMES + BODY + "0.04,340,4_60,5,5\n", "line 6, pressure_2 (column 'p2'): '4_60' is not a number"),
        (NAMES + BODY + '0.04,"340,460,5,5\n0.05,340,460,5,5\n', "line 6 opens a quotation mark"),
        (NAMES + BODY + '0.04,340,460,5,"5\n6"\n', "line 6 opens a quotation mark"),
        (NAMES + "s,kPa,kPa,V,V\n" + BODY, "line 2, time (column 't'): 's' is not a number; a line of units?"),
        (NAMES + BODY.replace("0.02", "12:30:01.02"), "'12:30:01.02' is not a number; dates and times of day"),
        (NAMES + BODY.replace("0.02", "2024-05-01T12"), "dates and times of day are not read: give time: {rate:"),
        ((NAMES + BODY).replace(",", ";"), "one column only (t;p1;p2;u1;u2): is the delimiter ';'?"),
        ((NAMES + BODY).replace(",", "\t"), "is the delimiter tab?"),
        ((NAMES + BODY).replace(",", " "), "is the delimiter space?"),
        (
            (NAMES + BODY).replace("p1,", "p_1,"),
            "no column 'p1', expected one of t, p_1, p2, u1, u2; did you mean 'p_1'?",
        ),
        ((NAMES + BODY).replace("p2", "p1"), "pressure_1: 2 columns are named 'p1', expected one; give its number"),
        (NAMES + BODY + "0" * 2_000_000, "line 6 has over a million characters"),
        (NAMES + BODY + "x" * 200_000 + "\n", "between lines 2 and 6"),
        (NAMES + BODY + "\0\0\n", "zero bytes"),
        (NAMES + BODY + "0.04,340,460,5,5\n" * 1000 + "\0\n", "line 1006 holds a zero byte"),
    ],
)
def test_what_cannot_be_read_is_said(lab: Lab, text: str, says: str) -> None:
    assert says in lab.text(text).refusal()


def test_a_wrong_decimal_is_seen(lab: Lab) -> None:
    comma = (NAMES + BODY).replace(",", ";").replace(".", ",")
    lab.text(comma).entries(file={"delimiter": ";"})
    assert "'0,0' is not a number; decimals after a comma? give file.decimal: \",\"" in lab.refusal()
    lab.text(comma.replace("0,03", "0.03")).entries(file={"delimiter": ";", "decimal": ","})
    assert "line 5, time (column 't'): '0.03' is not a number; decimals after a point?" in lab.refusal()


@pytest.mark.parametrize(
    ("start", "says"),
    [
        (b"PK\x03\x04\x14\0", "save it as CSV"), (b"\x1f\x8b\x08\0", "unpack it first"),
        (b"\x89HDF\r\n", "an HDF5 file"), (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
        (b"\x89MCAP0\r\n", "a bag already"), (b"\x7fELF\0\0", "not a text file"),
        (bytes(range(128, 256)) * 8, "is not utf-8"),
    ],
)  # fmt: skip
def test_files_of_another_kind(lab: Lab, start: bytes, says: str) -> None:
    lab.csv.write_bytes(start + b"\0" * 64 if b"\0" in start else start)
    assert says in lab.refusal()


def test_files_that_are_not_there(lab: Lab) -> None:
    lab.csv.unlink()
    assert "no such file" in lab.refusal()
    lab.csv.mkdir()
    assert "not a file" in lab.refusal()


def test_a_file_that_is_too_long_is_refused(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [(f"{k / 100:.2f}", 300, 500, 5, 5) for k in range(60_000)]
    lab.rows(rows)
    assert len(lab.read()) == 60_000
    monkeypatch.setattr(csv_table, "MAX_ROWS", 59_999)
    assert "more than 59,999 rows" in lab.refusal()
