"""Columns of files that hold arrays: MATLAB (.mat of both kinds), numpy (.npz) and Parquet.

A column is named as in the file: a variable ``p1``, a field of a structure ``data.p1``, one column of a matrix
``data(:,3)``, counted from 1 as in MATLAB. Sizes are checked before anything is read.
"""

from __future__ import annotations

import difflib
import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..optional import needs
from .csv_text import shown

Floats = NDArray[np.float64]
Reader = Callable[[Path, list[str], int], dict[str, NDArray[Any]]]

_MATRIX = re.compile(r"(.+)\(:, ?(\d+)\)")
_LISTED = 20  # names in a message


def kind_of(path: Path) -> str:
    """``matlab``, ``hdf5``, ``npz`` or ``parquet`` by the file's first bytes; "" for anything else."""
    try:
        with path.open("rb") as stream:
            start = stream.read(10)
        if start.startswith((b"MATLAB 7.3", b"\x89HDF")):
            return "hdf5"
        if start.startswith(b"MATLAB 5.0"):
            return "matlab"
        if start.startswith(b"PAR1"):
            return "parquet"
        if start.startswith(b"PK\x03\x04") and zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                return "npz" if any(name.endswith(".npy") for name in archive.namelist()) else ""
    except (OSError, ValueError, zipfile.BadZipFile):
        pass  # the reader of the file reports the problem
    return ""


def read_columns(path: Path, kind: str, columns: Mapping[str, int | str], most: int) -> dict[str, Floats]:
    """Quantity -> numbers (N,), NaN where a value is missing, of a file of a kind that :func:`kind_of` knows.

    `columns`: quantity -> name of its column; a number where the file holds a single matrix or a table.
    """
    what, reader = _READERS[kind]
    with _readable(path, what):
        shapes = reader(path, [], most)
        names = {quantity: _name(path, quantity, column, shapes) for quantity, column in columns.items()}
        arrays = reader(path, sorted({_MATRIX.sub(r"\1", name) for name in names.values()}), most)
        out = {quantity: _column(path, quantity, name, arrays) for quantity, name in names.items()}
    lengths = {len(values) for values in out.values()}
    if len(lengths) > 1:
        each = ", ".join(f"{names[quantity]} {len(values)}" for quantity, values in out.items())
        raise BadInput(f"{path}: columns of different lengths ({each}), expected as many rows in each")
    return out


@contextmanager
def _readable(path: Path, what: str) -> Iterator[None]:
    """Report any error of a library about a damaged file in one line."""
    try:
        yield
    except BadInput:
        raise
    except MemoryError:
        raise BadInput(f"{path}: {what} that does not fit into memory: cut it into parts") from None
    except Exception as error:
        raise BadInput(f"{path}: {what} that cannot be read: {' '.join(str(error).split())[:200]}") from None


def _name(path: Path, quantity: str, column: int | str, there: Mapping[str, Any]) -> str:
    """The column's name in the file."""
    if isinstance(column, int):
        wide = [name for name, array in there.items() if array.ndim == 2 and min(array.shape) > 1]
        if len(wide) == 1 and len(there) == 1:
            return f"{wide[0]}(:,{column})"
        if column > len(there):
            raise BadInput(f"{path}: {quantity} is column {column}, and the file has {len(there)} ({listed(there)})")
        return list(there)[column - 1]
    name = column.strip()
    plain = _MATRIX.sub(r"\1", name)
    if plain not in there:
        raise no_column(path, quantity, name, there)
    return name


def no_column(path: Path, quantity: str, name: str, there: Iterable[str]) -> BadInput:
    """The error for a column that a file does not have."""
    known = list(there)
    lower = {other.lower(): other for other in known}
    close = difflib.get_close_matches(_MATRIX.sub(r"\1", name).lower(), lower, 1, cutoff=0.4)
    hint = f"; did you mean {lower[close[0]]!r}?" if close else ""
    return BadInput(f"{path}: {quantity}: there is no column {name!r}, expected one of {listed(known)}{hint}")


def listed(names: Iterable[str]) -> str:
    """Names of columns for a message, cut to a readable length."""
    known = list(names)
    more = f" and {len(known) - _LISTED} more" if len(known) > _LISTED else ""
    return ", ".join(shown(name) for name in known[:_LISTED]) + more


def _column(path: Path, quantity: str, name: str, arrays: Mapping[str, NDArray[Any]]) -> Floats:
    match = _MATRIX.fullmatch(name)
    array = np.asarray(arrays[match[1] if match else name])
    if not (np.issubdtype(array.dtype, np.number) or array.dtype == bool) or np.iscomplexobj(array):
        raise BadInput(f"{path}: {quantity} ({name}) holds {array.dtype}, expected real numbers")
    if match:
        number = int(match[2])
        if array.ndim != 2 or not 1 <= number <= array.shape[1]:
            raise BadInput(
                f"{path}: {quantity}: {match[1]} has shape {array.shape}, expected a matrix with that column"
            )
        return np.array(array[:, number - 1], dtype=np.float64)
    if array.size != max(array.shape, default=0) or array.size < 2:
        raise BadInput(
            f"{path}: {quantity}: {name} has shape {array.shape}, expected a column; one of a matrix is {name}(:,1)"
        )
    return np.array(array.ravel(), dtype=np.float64)


class _Shape:
    """Shape of an array that has not been read yet."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape, self.ndim = shape, len(shape)


def _check_rows(path: Path, name: str, shape: tuple[int, ...], most: int) -> None:
    if max(shape, default=0) > most:
        raise BadInput(f"{path}: {name} has {max(shape):,} rows, expected at most {most:,}: cut the file into parts")


def _matlab(path: Path, names: list[str], most: int) -> dict[str, Any]:
    """Variables and fields of structures, of a MATLAB file up to version 7."""
    from scipy.io import loadmat, whosmat

    variables = {name: (shape, kind) for name, shape, kind in whosmat(str(path))}
    for name, (shape, _) in variables.items():
        _check_rows(path, name, shape, most)
    tops = sorted(
        {name.split(".")[0] for name in names} or {name for name, (_, kind) in variables.items() if kind == "struct"}
    )
    loaded = loadmat(str(path), variable_names=tops, struct_as_record=False, squeeze_me=False) if tops else {}
    out: dict[str, Any] = {}
    for name, (shape, kind) in variables.items():
        if kind == "struct" and name in loaded:
            out |= dict(_fields(name, loaded[name]))
        elif kind != "struct":
            out[name] = loaded.get(name, _Shape(shape))
    return out


def _fields(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """Numeric fields of a structure, by their dotted names."""
    while isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        value = value.item()
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _fields(f"{name}.{field}", getattr(value, field))
    elif isinstance(value, np.ndarray):
        yield name, value


def _hdf5(path: Path, names: list[str], most: int) -> dict[str, Any]:
    """Data sets of MATLAB 7.3 and other HDF5 files; those of MATLAB are stored by columns and are transposed."""
    with needs("import", str(path)):
        import h5py
    out: dict[str, Any] = {}
    with path.open("rb") as stream:
        transposed = stream.read(6) == b"MATLAB"
    with h5py.File(path, "r") as file:

        def visit(name: str, item: Any) -> None:
            dotted = name.replace("/", ".")
            if not isinstance(item, h5py.Dataset) or name.startswith("#"):
                return
            _check_rows(path, dotted, item.shape, most)
            shape = item.shape[::-1] if transposed else item.shape
            if dotted in names:
                values = item[()]
                out[dotted] = values.T if transposed else values
            elif not names:
                out[dotted] = _Shape(shape)

        file.visititems(visit)
    return out


def _npz(path: Path, names: list[str], most: int) -> dict[str, Any]:
    """Arrays of a numpy archive; numpy refuses Python objects, which could run code."""
    out: dict[str, Any] = {}
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            if not member.endswith(".npy"):
                continue
            name = member.removesuffix(".npy")
            with archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                read = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
                shape, _, _ = read[version](stream)
            _check_rows(path, name, shape, most)
            if not names:
                out[name] = _Shape(shape)
            elif name in names:
                with archive.open(member) as stream:
                    out[name] = np.lib.format.read_array(stream, allow_pickle=False)
    return out


def _parquet(path: Path, names: list[str], most: int) -> dict[str, Any]:
    """Columns of a table."""
    with needs("import", str(path)):
        from pyarrow import parquet
    file = parquet.ParquetFile(path)
    _check_rows(path, "the table", (file.metadata.num_rows,), most)
    if not names:
        return {name: _Shape((file.metadata.num_rows,)) for name in file.schema_arrow.names}
    table = file.read(columns=names)
    return {name: table.column(name).to_numpy() for name in names}


_READERS: dict[str, tuple[str, Reader]] = {
    "matlab": ("a MATLAB file", _matlab),
    "hdf5": ("an HDF5 file", _hdf5),
    "npz": ("a numpy archive", _npz),
    "parquet": ("a Parquet file", _parquet),
}
