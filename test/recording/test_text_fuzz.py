"""YAML and CSV that somebody broke, or built to break what reads them: a value or one line, in time and in memory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bombs import assert_refused_in_a_gigabyte
from edits import EDIT, VALUES, edited, examples
from hypothesis import given
from hypothesis import strategies as st

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_table import read_force_map, read_volumes
from pam_antagonist.paths import config_dir
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map
from pam_antagonist.rig import load_rig

FEWER = examples(25)
FILES: dict[str, tuple[Path, Callable[[str], Any]]] = {
    "rig": (config_dir() / "rigs" / "shin2022.yaml", load_rig),
    "sealed": (config_dir() / "rigs" / "sealed_joint.yaml", load_rig),
    "map": (config_dir() / "maps" / "example.yaml", load_map),
}
EDITS = st.lists(
    st.one_of(
        st.tuples(st.just("value"), st.integers(0, 10**4), st.sampled_from(VALUES)),
        st.tuples(st.just("key"), st.integers(0, 10**4), st.sampled_from(VALUES)),
        st.tuples(st.just("drop"), st.integers(0, 10**4), st.just("")),
        st.tuples(st.just("twice"), st.integers(0, 10**4), st.just("")),
        st.tuples(st.just("indent"), st.integers(0, 10**4), st.just("   ")),
        st.tuples(st.just("bytes"), st.integers(0, 10**4), st.binary(min_size=1, max_size=6)),
        st.tuples(st.just("cut"), st.integers(0, 10**4), st.just("")),
    ),
    min_size=1,
    max_size=3,
)


def edited_lines(text: str, edits: list[tuple[str, int, Any]]) -> bytes:
    lines: list[Any] = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    raw = None
    for kind, where, what in edits:
        if not lines:
            break
        at = where % len(lines)
        key, colon, value = lines[at].partition(":")
        if kind == "value":
            lines[at] = f"{key}: {what}"
        elif kind == "key":
            lines[at] = key[: len(key) - len(key.lstrip())] + what + colon + value
        elif kind == "drop":
            del lines[at]
        elif kind == "twice":
            lines.insert(at, lines[at])
        elif kind == "indent":
            lines[at] = what + lines[at]
        elif kind == "cut":
            lines[at:] = [lines[at][: where % 17]]
        else:
            raw = (where, what)
    data = "\n".join(lines).encode("utf-8", "surrogatepass")
    if raw is not None and data:
        at = raw[0] % len(data)
        data = data[:at] + raw[1] + data[at + len(raw[1]) :]
    return data


def refused(read: Callable[[], Any]) -> bool:
    """Whether something is refused, which takes one line."""
    began = time.monotonic()
    try:
        read()
    except BadInput as error:
        said = " ".join(str(error).splitlines())
        assert len(said) < 3000 and "Traceback" not in said
        result = True
    else:
        result = False
    assert time.monotonic() - began < 20.0
    return result


@pytest.mark.parametrize("name", FILES)
def test_damaged_yaml(tmp_path: Path, name: str) -> None:
    source, load = FILES[name]
    text, path = source.read_text(encoding="utf-8"), tmp_path / "file.yaml"

    @FEWER
    @given(EDITS)
    def run(edits: list[tuple[str, int, Any]]) -> None:
        path.write_bytes(edited_lines(text, edits))
        refused(lambda: load(str(path)))

    run()
    assert [file.name for file in tmp_path.iterdir()] == ["file.yaml"]


NAMES = "t,p1,p2,u1,u2,angle,torque,load"
"""Columns of the example's map."""
CELLS = [
    "", " ", "nan", "inf", "-inf", "1e999", "1e-400", "1_000", "0x10", "١٢", "1,5", "--", "NaN", '"', '""', '"1', "'1'",
    "1" * 5000, "=cmd()", "\x00", "\ufeff", "\r", "\t", ";", "1;2;3", "2026-01-01", "12:00:00", "1e308", "-1e308", "é",
]  # fmt: skip
CELL = st.tuples(st.just("cell"), st.integers(0, 10**4), st.sampled_from(CELLS))
CSV = st.lists(st.one_of(CELL, EDIT), min_size=1, max_size=4)


def edited_csv(text: str, edits: list[tuple[str, int, Any]]) -> bytes:
    data = text.encode()
    for kind, where, what in edits:
        if kind == "cell":
            at = where % (len(data) + 1)
            begin = max(data.rfind(b",", 0, at), data.rfind(b"\n", 0, at)) + 1
            end = min((k for k in (data.find(b",", at), data.find(b"\n", at)) if k >= 0), default=len(data))
            data = data[:begin] + what.encode() + data[max(begin, end) :]
        else:
            data = edited(data, [(kind, where, what)], [])
    return data


@pytest.mark.parametrize("name", ["recording", "force_map", "volumes"])
def test_damaged_csv(tmp_path: Path, name: str) -> None:
    path = tmp_path / "file.csv"
    if name == "recording":
        rows = [f"{k * 0.001:.3f},{300 + k},{500 - k},{4.5 + 0.1 * (k % 7)},5.5,{k % 11},0.1,0" for k in range(30)]
        text = "t,p1,p2,u1,u2,angle,torque,load\n" + "\n".join(rows) + "\n"
        found = load_map(str(config_dir() / "maps" / "example.yaml"))

        def load() -> Any:
            return read_csv(path, found)
    elif name == "force_map":
        rows = [f"{0.2 - 0.001 * k},{100 + 50 * (k % 6)},{10 * k}" for k in range(30)]
        text = "length [m],pressure [kPa],force [N]\n" + "\n".join(rows) + "\n"

        def load() -> Any:
            return read_force_map(path, 101_325.0)
    else:
        rows = [f"{0.2 - 0.001 * k},{1e-4 + 1e-6 * k}" for k in range(30)]
        text = "length [m],volume [m3]\n" + "\n".join(rows) + "\n"

        def load() -> Any:
            return read_volumes(path)

    @FEWER
    @given(CSV)
    def run(edits: list[tuple[str, int, Any]]) -> None:
        path.write_bytes(edited_csv(text, edits))
        refused(load)

    run()


HEAD = NAMES.encode()
CSV_BOMBS: dict[str, Callable[[], bytes]] = {
    "one line": lambda: b"1," * 30_000_000,
    "one cell": lambda: HEAD + b"\n" + b"1" * 60_000_000,
    "one quotation": lambda: HEAD + b'\n"' + b"1,2\n" * 15_000_000,
    "many columns": lambda: HEAD + b",x" * 400_000 + b"\n" + (b"1," * 400_008 + b"\n") * 20,
    "empty lines": lambda: HEAD + b"\n" * 1_000_001,
}
IMPORTS = """
from pam_antagonist.paths import config_dir
from pam_antagonist.recording.csv_import import read_csv
from pam_antagonist.recording.csv_map import load_map
found = load_map(str(config_dir() / "maps" / "example.yaml"))
"""


@pytest.mark.parametrize("name", CSV_BOMBS)
def test_csv_bombs(tmp_path: Path, name: str) -> None:
    path = tmp_path / "file.csv"
    path.write_bytes(CSV_BOMBS[name]())
    assert_refused_in_a_gigabyte(IMPORTS, "read_csv(sys.argv[1], found)", str(path), seconds=60.0)


@pytest.mark.parametrize("name", ["/dev/zero", "/dev/stdin", "/proc/self/mem", "fifo", "folder", "a\0b", "x" * 300])
@pytest.mark.parametrize("load", [load_rig, load_map], ids=["rig", "map"])
def test_files_that_are_no_files(tmp_path: Path, name: str, load: Callable[[str], Any]) -> None:
    os.mkfifo(tmp_path / "fifo.yaml")
    (tmp_path / "folder.yaml").mkdir()
    path = tmp_path / f"{name}.yaml"
    if name.startswith("/"):
        path = tmp_path / "link.yaml"
        path.symlink_to(name)
    assert refused(lambda: load(str(path)))
