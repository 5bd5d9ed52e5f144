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
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..optional import needs
from ..shown import few

Floats = NDArray[np.float64]


class _Array(NamedTuple):
    """An array that is read when it is needed."""

    shape: tuple[int, ...]
    read: Callable[[], NDArray[Any]]


Arrays = dict[str, _Array]

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
    with _readable(path, what), contextmanager(reader)(path) as there:
        for name, array in there.items():
            if max(array.shape, default=0) > most:
                rows = f"has {max(array.shape):,} rows, expected at most {most:,}: cut the file into parts"
                raise BadInput(f"{path}: {name} {rows}")
        names = {quantity: _name(path, quantity, column, there) for quantity, column in columns.items()}
        out = {quantity: _column(path, quantity, name, there) for quantity, name in names.items()}
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


def _name(path: Path, quantity: str, column: int | str, there: Arrays) -> str:
    """The column's name in the file."""
    if isinstance(column, int):
        wide = [name for name, array in there.items() if len(array.shape) == 2 and min(array.shape) > 1]
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
    return few(list(map(shown, names)), _LISTED)


def shown(text: str) -> str:
    """Text of a file for a message: in one line, and shortened."""
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."


def _column(path: Path, quantity: str, name: str, arrays: Arrays) -> Floats:
    match = _MATRIX.fullmatch(name)
    array = arrays[match[1] if match else name].read()
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


def _matlab(path: Path) -> Iterator[Arrays]:
    """Variables and fields of structures, of a MATLAB file up to version 7."""
    from scipy.io import loadmat, whosmat

    def load(name: str) -> Any:
        return loadmat(str(path), variable_names=[name], struct_as_record=False, squeeze_me=False)[name]

    out: Arrays = {}
    for name, shape, kind in whosmat(str(path)):
        if kind == "struct":
            out |= {
                field: _Array(values.shape, partial(np.asarray, values)) for field, values in _fields(name, load(name))
            }
        else:
            out[name] = _Array(shape, partial(load, name))
    yield out


def _fields(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """Numeric fields of a structure, by their dotted names."""
    while isinstance(value, np.ndarray) and value.dtype == object and value.size == 1:
        value = value.item()
    if hasattr(value, "_fieldnames"):
        for field in value._fieldnames:
            yield from _fields(f"{name}.{field}", getattr(value, field))
    elif isinstance(value, np.ndarray):
        yield name, value


def _hdf5(path: Path) -> Iterator[Arrays]:
    """Data sets of MATLAB 7.3 and other HDF5 files; those of MATLAB are stored by columns and are transposed."""
    with needs("import", str(path)):
        import h5py
    with path.open("rb") as stream:
        turn = -1 if stream.read(6) == b"MATLAB" else 1
    out: Arrays = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            axes = tuple(range(item.ndim))[::turn]
            out[name.replace("/", ".")] = _Array(item.shape[::turn], lambda: np.transpose(item[()], axes))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        yield out


def _npz(path: Path) -> Iterator[Arrays]:
    """Arrays of a numpy archive; numpy refuses Python objects, which could run code."""
    heads = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    with zipfile.ZipFile(path) as archive:

        def load(member: str) -> NDArray[Any]:
            with archive.open(member) as stream:
                return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))

        out: Arrays = {}
        for member in archive.namelist():
            if member.endswith(".npy"):
                with archive.open(member) as stream:
                    shape, _, _ = heads[np.lib.format.read_magic(stream)](stream)
                out[member.removesuffix(".npy")] = _Array(shape, partial(load, member))
        yield out


def _parquet(path: Path) -> Iterator[Arrays]:
    """Columns of a table."""
    with needs("import", str(path)):
        from pyarrow import parquet
    file = parquet.ParquetFile(path)

    def load(name: str) -> NDArray[Any]:
        return np.asarray(file.read(columns=[name]).column(name).to_numpy())

    yield {name: _Array((file.metadata.num_rows,), partial(load, name)) for name in file.schema_arrow.names}


_READERS: dict[str, tuple[str, Callable[[Path], Iterator[Arrays]]]] = {
    "matlab": ("a MATLAB file", _matlab),
    "hdf5": ("an HDF5 file", _hdf5),
    "npz": ("a numpy archive", _npz),
    "parquet": ("a Parquet file", _parquet),
}
