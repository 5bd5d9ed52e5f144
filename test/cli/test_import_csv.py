"""``import_csv`` from the command line: a bag that replay reads, whole or not at all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.api import import_csv as importing
from pam_antagonist.cli.import_csv import main
from pam_antagonist.recording import read_bag
from pam_antagonist.recording.notes import sealed_muscles

FILE = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured" / "sealed_joint" / "sealed_joint.csv"
MAP = """\
time: {column: "time [ms]", unit: ms}
pressure_1: {column: "p1 [bar]", unit: bar, reference: gauge}
pressure_2: {column: "p2 [bar]", unit: bar, reference: gauge}
atmosphere: {pressure: 101.3, unit: kPa}
valve_1: {column: u1, unit: V}
valve_2: {column: u2, unit: V}
angle: {column: phi, unit: deg, scale: -1}
torque: {column: tau, unit: N mm}
"""


@pytest.fixture
def as_csv(bag: Path, tmp_path: Path) -> Path:
    """The simulated recording of ``bag`` as a lab would have it, with its map beside it."""
    recording = read_bag(bag)
    assert recording.angle is not None and recording.torque is not None
    columns = np.column_stack(
        [
            np.arange(len(recording)), (recording.pressure - 101.3e3) * 1e-5, recording.voltage,
            -np.degrees(recording.angle), recording.torque * 1e3,
        ]
    )  # fmt: skip
    names = "time [ms],p1 [bar],p2 [bar],u1,u2,phi,tau"
    np.savetxt(tmp_path / "trial.csv", columns, fmt="%.17g", delimiter=",", header=names, comments="")
    (tmp_path / "map.yaml").write_text(MAP)
    return tmp_path / "trial.csv"


def arguments(file: Path, out: Path) -> list[str]:
    return [str(file), "--map", str(file.parent / "map.yaml"), "--out", str(out)]


def test_the_next_command_names_the_one_rig_file(as_csv, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(arguments(as_csv, tmp_path / "one")) == 0
    assert f"check {tmp_path / 'one'} --rig RIG\n" in capsys.readouterr().out
    (tmp_path / "bench.yaml").write_text("based_on: shin2022\nname: bench\n")
    assert main(arguments(as_csv, tmp_path / "two")) == 0
    assert f"check {tmp_path / 'two'} --rig bench.yaml\n" in capsys.readouterr().out


def test_a_recording_comes_back_from_its_csv_file(bag, as_csv, tmp_path, capsys):
    assert main(arguments(as_csv, tmp_path / "deep" / "out")) == 0
    before, after = read_bag(bag), read_bag(tmp_path / "deep" / "out")
    assert np.diff(after.stamp_ns).tolist() == np.diff(before.stamp_ns).tolist()
    for name in ("pressure", "voltage", "angle", "torque"):
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=1e-12, abs=1e-12), name
    assert after.issues == ()
    said = capsys.readouterr().out
    assert f"{len(before)} samples" in said and "one each 1 ms" in said and "external torque not in the file" in said


@pytest.mark.skipif(not FILE.exists(), reason="no ../shared/data/measured beside the project")
def test_the_sealed_joint(tmp_path, capsys):
    out = tmp_path / "sealed"
    assert main([str(FILE), "--map", "sealed_joint", "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert "valve 1 sealed, valve 2 sealed" in said
    assert "the chambers of this joint are sealed: write valves: {sealed: true} into its rig file" in said
    assert sealed_muscles(out) == (1, 2)
    recording = read_bag(out)
    assert recording.external_torque is not None and recording.angle is not None
    assert recording.pressure.min() > 450e3 and np.degrees(recording.angle.max()) == pytest.approx(6.06, abs=0.01)
    assert np.abs(recording.external_torque).max() == pytest.approx(1.0, abs=1e-3)


def test_what_was_odd_is_said(as_csv, tmp_path, capsys):
    lines = as_csv.read_text().splitlines(keepends=True)
    cells = lines[100].split(",")
    lines[100] = ",".join([*cells[:5], "", *cells[6:]])
    as_csv.write_text("".join(lines[:500] + lines[700:]))
    assert main(arguments(as_csv, tmp_path / "out")) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "! 1 of 3800 samples without angle (column 'phi')" in said
    assert "no 1 ms, the longest (201 ms) before line 501: times kept as they are" in said


@pytest.mark.parametrize("where", ["write_bag", "write_notes"])
def test_nothing_is_left_of_an_output_that_failed(as_csv, tmp_path, monkeypatch, capsys, where):
    before = sorted(tmp_path.iterdir())
    real = getattr(importing, where)

    def full_disk(folder: Path, *rest: object, **named: object) -> None:
        real(folder, *rest, **named)
        assert (folder / "metadata.yaml").exists() and not (tmp_path / "out").exists()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(importing, where, full_disk)
    assert main(arguments(as_csv, tmp_path / "out")) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_a_bad_file_is_one_line_and_no_output(as_csv, tmp_path, refused):
    as_csv.write_text(as_csv.read_text().replace("\n1000,", "\n1000,x"))
    refused(
        main, arguments(as_csv, tmp_path / "out"), f"error: {as_csv}: ", "line 1002, pressure_1 (column 'p1 [bar]')"
    )
    assert not (tmp_path / "out").exists()


def test_the_example_is_printed_and_nothing_else_is_needed(capsys):
    assert main(["--example"]) == 0
    assert "pressure_1: {column: p1, unit: kPa, reference: gauge}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "given", [[], ["trial.csv"], ["trial.csv", "--map", "m.yaml"], ["--map", "m.yaml", "--out", "o"]]
)
def test_missing_arguments_are_named(given, refused):
    error = refused(main, given, "--example")
    for name in ("FILE", "--map", "--out"):
        wanted = not (name in given or (name == "FILE" and "trial.csv" in given))
        assert (f"{name}," in error or f"{name} missing" in error) == wanted, name


def test_what_the_import_found_is_known_to_who_reads_the_bag(as_csv, tmp_path):
    lines = as_csv.read_text().splitlines(keepends=True)
    as_csv.write_text("".join([*lines[:500], lines[400], *lines[500:]]))
    text = (as_csv.parent / "map.yaml").read_text()
    assert "unit: ms" in text
    (as_csv.parent / "map.yaml").write_text(text.replace("unit: ms", "unit: ms, out_of_order: drop"))
    assert main(arguments(as_csv, tmp_path / "out")) == 0
    (found,) = read_bag(tmp_path / "out").issues
    assert found == "import: 1 rows are not later than those before them, the first in line 501: dropped"
    assert (found.kind, found.size) == ("dropped", 1)
