"""Tables as others write them: LabVIEW, absolute encoders, one topic a row, ragged rows; and files of arrays."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from csv_files import HEADER, MAP, ROWS, Lab
from scipy.io import savemat

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording, csv_table
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map

SIZE = 200
TIME = 0.01 * np.arange(SIZE)
ANGLE = 25.0 * np.sin(6.0 * TIME) - 5.0  # [deg]


def rows_of(**columns: Any) -> list[list[float]]:
    """Rows of a joint that moves; columns replace those of the same name or are added."""
    known = {"t": TIME, "p1": 300 + ANGLE, "p2": 400 - ANGLE, "u1": 5 + 0.1 * ANGLE, "u2": 5 - 0.1 * ANGLE}
    return [list(row) for row in zip(*{**known, **columns}.values(), strict=True)]


def labview(decimal: str, comments: Sequence[int], segments: int = 1) -> str:
    separator = "\t" if decimal == "," else ","
    head = ["LabVIEW Measurement\t", "Writer_Version\t2", f"Separator{separator}{'Tab' if decimal == ',' else 'Comma'}",
            f"Decimal_Separator{separator}{decimal}", "***End_of_Header***\t"]  # fmt: skip
    head += ["\t", "Channels\t4", "Samples\t200\t200", "***End_of_Header***\t\t\t"] * segments
    lines = [*head, separator.join(["X_Value", *HEADER[1:], "Comment"])]
    for number, row in enumerate(rows_of()):
        cells = [f"{cell:.6f}".replace(".", decimal) for cell in row]
        lines.append(separator.join([*cells, "start"] if number in comments else cells))
    return "\r\n".join(lines) + "\r\n"


@pytest.mark.parametrize("decimal", [",", "."])
@pytest.mark.parametrize("comments", [(0,), (), (7, 90)])
def test_a_labview_header_declares_the_layout(lab: Lab, decimal: str, comments: Sequence[int]) -> None:
    lab.text(labview(decimal, comments)).entries(time={"column": "X_Value", "unit": "s"})
    recording = lab.read()
    assert len(recording) == SIZE
    assert recording.pressure[:, 0] == pytest.approx(1e3 * (300 + ANGLE), abs=1e-2)
    layout = {"delimiter": "tab" if decimal == "," else ",", "decimal": decimal, "skip_lines": 9}
    lab.entries(time={"column": "X_Value", "unit": "s"}, file=layout)
    assert np.array_equal(lab.read().pressure, recording.pressure)


def test_ragged_rows_are_read_where_only_unused_last_columns_are_missing(lab: Lab) -> None:
    rows = rows_of()
    for texts in ({3: "start"}, {3: "start", 50: "stop, or so"}, dict.fromkeys(range(0, SIZE, 5), "7")):
        named = [[*row, f'"{texts[k]}"'] if k in texts else row for k, row in enumerate(rows)]
        recording = lab.rows(named, (*HEADER, "remark")).read()
        assert len(recording) == SIZE and recording.issues[0].size == SIZE - len(texts)
        assert (
            "rows have fewer or more cells than the header, in columns that the map does not use" in recording.issues[0]
        )
    unnamed = [[*row, "start"] if k == 3 else row for k, row in enumerate(rows)]
    assert lab.rows(unnamed).read().issues[0].size == 1


def test_ragged_rows_that_may_lack_another_cell_are_refused(lab: Lab) -> None:
    marked = [[*row, 1] for row in rows_of()]
    del marked[20][2]  # all behind it stand one column too far left
    assert "line 22 has 5 cells" in lab.rows(marked, (*HEADER, "mark")).refusal()
    more = [[*row, 5] if k == 20 else row for k, row in enumerate(rows_of())]
    assert "line 22 has 6 cells" in lab.rows(more).refusal()
    names = ("t", "p1", "p2", "u1", "u2", "remark (a", "b)")
    assert "line 2 has 6 cells" in lab.rows([[*row, 1] for row in rows_of()], names).refusal()


@pytest.mark.parametrize(
    ("unit", "wraps", "turn", "per_degree"),
    [("deg", 360.0, 360.0, 1.0), ("rad", 2 * np.pi, 2 * np.pi, np.pi / 180), ("rev", 1.0, 1.0, 1 / 360),
     ("deg", 180.0, 180.0, 1.0), ("mrad", 2000 * np.pi, 2000 * np.pi, np.pi / 0.18)],
)  # fmt: skip
@pytest.mark.parametrize("low", [0.0, -0.5])
def test_an_absolute_encoder_is_unwrapped_on_request(
    lab: Lab, unit: str, wraps: float, turn: float, per_degree: float, low: float
) -> None:
    moving = ANGLE * per_degree + (0.0 if low == 0.0 else turn / 2)
    cells = (moving - low * turn) % turn + low * turn
    lab.rows(rows_of(angle=cells), (*HEADER, "angle")).entries(angle={"column": "angle", "unit": unit})
    assert f"it jumps as an absolute encoder that begins again: give wraps: {wraps:.7g}" in lab.refusal()
    offset = 0.0 if low == 0.0 else -turn / 2
    lab.entries(angle={"column": "angle", "unit": unit, "wraps": wraps, "offset": offset})
    recording = lab.read()
    assert recording.angle == pytest.approx(np.radians(ANGLE), abs=1e-9)
    assert "begins again after" in recording.issues[0] and recording.issues[0].size > 0


def test_an_absolute_encoder_in_another_unit(lab: Lab) -> None:
    lab.rows(rows_of(angle=ANGLE % 360), (*HEADER, "angle")).entries(angle={"column": "angle", "unit": "rad"})
    assert "give unit: deg, wraps: 360" in lab.refusal()
    lab.rows(rows_of(angle=(ANGLE % 360) * 4096 / 360), (*HEADER, "angle"))
    assert (
        "of an absolute encoder give scale and wraps" in lab.entries(angle={"column": "angle", "unit": "deg"}).refusal()
    )


def by_topic(groups: Sequence[Sequence[int]], apart_s: float, every: Sequence[int] | None = None) -> list[list[Any]]:
    """Rows that hold the cells of one group of columns each."""
    out = []
    for number, group in enumerate(groups):
        for k, row in enumerate(rows_of()):
            if every is None or k % every[number] == 0:
                cells = [value if column in group else "" for column, value in enumerate(row)]
                out.append([round(row[0] + number * apart_s, 6), *cells[1:]])
    return sorted(out, key=lambda row: row[0])


@pytest.mark.parametrize("groups", [((1,), (2,), (3, 4)), ((3,), (2, 4), (1,)), ((1, 2), (3, 4))])
@pytest.mark.parametrize("apart_s", [4e-4, 0.0])
def test_rows_of_one_topic_each(lab: Lab, groups: Sequence[Sequence[int]], apart_s: float) -> None:
    recording = lab.rows(by_topic(groups, apart_s)).read()
    assert len(recording) == SIZE
    first = next(number for number, group in enumerate(groups) if 1 in group)
    at = next(number for number, group in enumerate(groups) if 2 in group)
    moved = np.interp(TIME[1:-1] + first * apart_s, TIME + at * apart_s, 400 - ANGLE)
    assert recording.pressure[:, 0] == pytest.approx(1e3 * (300 + ANGLE))
    assert recording.pressure[1:-1, 1] == pytest.approx(1e3 * moved)
    held = [next(number for number, group in enumerate(groups) if column in group) for column in (3, 4)]
    for number, sign in zip(held, (1, -1), strict=True):
        index = np.arange(SIZE) + (number < first and apart_s > 0.0)  # the next row with a voltage
        index = np.minimum(index, SIZE - 1)
        assert recording.voltage[:, (1 - sign) // 2] == pytest.approx(5 + sign * 0.1 * ANGLE[index])
    assert bool(recording.issues) == (apart_s > 0.0)
    assert not recording.issues or "the rows hold the cells of some columns each" in recording.issues[-1]


def test_commands_that_are_written_when_they_change_are_held(lab: Lab) -> None:
    lab.rows(by_topic(((1, 2), (3, 4)), 1e-3, every=(1, 20)))
    lab.entries(
        **{name: {"column": f"u{name[-1]}", "unit": "V", "holds": "from_row"} for name in ("valve_1", "valve_2")}
    )
    recording = lab.read()
    last = np.maximum((np.arange(SIZE) - 1) // 20 * 20, 0)
    assert recording.voltage[:, 0] == pytest.approx(5 + 0.1 * ANGLE[last])
    assert "held between such rows" in " ".join(recording.issues)


COLUMNS = {name: np.array([row[k] for row in ROWS], dtype=float) for k, name in enumerate(HEADER)}
COLUMNS["p1"] = COLUMNS["p1"].astype(np.int16)  # as a converter gives them


def matlab(path: Path) -> None:
    savemat(path, {name: values[:, None] for name, values in COLUMNS.items()}, do_compression=True)


def matlab_73(path: Path) -> None:
    """As MATLAB writes it: a block of 512 bytes before HDF5, rows and columns exchanged."""
    h5py = pytest.importorskip("h5py", reason="the extra [import] is not installed")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file[name] = values[None, :]
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512))


def numpy_archive(path: Path) -> None:
    with path.open("wb") as stream:
        np.savez_compressed(stream, **COLUMNS)


def parquet_table(path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="the extra [import] is not installed")
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(COLUMNS), path)


WRITERS = (matlab, matlab_73, numpy_archive, parquet_table)


def same(first: Recording, second: Recording) -> None:
    for name in ("stamp_ns", "pressure", "voltage"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name


@pytest.mark.parametrize("write", WRITERS)
def test_it_reads_as_csv_does(lab: Lab, write: Callable[[Path], None]) -> None:
    text = lab.read()
    write(lab.csv)
    same(lab.read(), text)


@pytest.mark.parametrize("write", WRITERS)
def test_what_cannot_be_read_is_refused(
    lab: Lab, write: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(lab.csv)
    lab.entries(pressure_1={**MAP["pressure_1"], "column": "P1"})
    said = lab.refusal()
    assert "there is no column 'P1'" in said and "did you mean 'p1'" in said and "u2" in said
    monkeypatch.setattr(csv_table, "MAX_ROWS", 3)
    assert "has 4 rows, expected at most 3" in lab.refusal(), "before anything is read"
    lab.csv.write_bytes(lab.csv.read_bytes()[:-300])
    assert str(lab.csv) in lab.refusal()


def test_fields_of_a_structure_and_columns_of_a_matrix(lab: Lab) -> None:
    text = lab.read()
    matrix = np.column_stack([COLUMNS["u1"], COLUMNS["u2"]])
    savemat(lab.csv, {"data": {"t": COLUMNS["t"], "p": {"one": COLUMNS["p1"], "two": COLUMNS["p2"]}}, "u": matrix})
    fields = {"pressure_1": "data.p.one", "pressure_2": "data.p.two", "valve_1": "u(:,1)", "valve_2": "u(:, 2)"}
    entries = {name: {**MAP[name], "column": column} for name, column in fields.items()}
    lab.entries(time={"column": "data.t", "unit": "s"}, **entries)
    same(lab.read(), text)
    lab.entries(time={"column": "data.t", "unit": "s"}, **{**entries, "valve_2": {"column": "u(:,3)", "unit": "V"}})
    assert "u has shape (4, 2)" in lab.refusal()
    lab.entries(time={"column": "data.t", "unit": "s"}, **{**entries, "valve_2": {"column": "u", "unit": "V"}})
    assert "one of a matrix is u(:,1)" in lab.refusal()


def test_columns_have_one_length(lab: Lab) -> None:
    savemat(lab.csv, {**COLUMNS, "u2": np.zeros(3)})
    assert "different lengths" in lab.refusal() and "u2 3" in lab.refusal()


def test_what_is_no_number_is_refused(lab: Lab) -> None:
    with lab.csv.open("wb") as stream:
        np.savez(stream, **{**COLUMNS, "u2": np.array([print, None, 1, 2], dtype=object)})
    assert "a numpy archive that cannot be read" in lab.refusal(), "objects could run code"
    with lab.csv.open("wb") as stream:
        np.savez(stream, **{**COLUMNS, "u2": np.array(["a", "b", "c", "d"])})
    assert "expected real numbers" in lab.refusal()


@pytest.mark.parametrize(("write", "library"), [(matlab_73, "h5py"), (parquet_table, "pyarrow")])
def test_a_library_that_is_missing_is_named(
    lab: Lab, write: Callable[[Path], None], library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(lab.csv)
    for name in (library, f"{library}.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(BadInput, match=rf"{library} is not installed.*'pam_antagonist\[import\]'"):
        lab.read()


def test_scale_offset_and_the_part_that_is_wanted(lab: Lab) -> None:
    """The published file of the measured joint: F = torque / r, x = angle * r."""
    radius, angle, torque = 6.875e-3, np.linspace(-0.05, 0.09, 30_000), np.linspace(-1.0, 1.0, 30_000)
    pressure = np.full((30_000, 1), 366.0)
    columns = {"F": torque[:, None] / radius, "x": angle[:, None] * radius, "dx": pressure, "p1": pressure}
    savemat(lab.csv, {**columns, "p2": pressure})
    recording = read_csv(lab.csv, load_map("sealed_joint_mat"))
    assert len(recording) == 18_700 and recording.external_torque is not None
    assert recording.angle == pytest.approx(angle[:18_700], abs=1e-9)
    assert recording.external_torque == pytest.approx(torque[:18_700], abs=1e-9)
    assert recording.pressure[0, 0] == pytest.approx(366e3 + 101325.0)
