"""Files of arrays are read as the same numbers in CSV are, and broken ones are refused in one line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from csv_files import HEADER, MAP, ROWS, Lab
from scipy.io import savemat

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording, csv_table
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map

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
