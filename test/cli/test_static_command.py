"""``static`` from the command line: tables in, a rig file with error bars out, or one line that says why not."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import identify, simulate
from pam_antagonist.__main__ import main as dispatch
from pam_antagonist.cli import new_rig, replay
from pam_antagonist.cli.static import main
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.static_fit import VOLUME as PARABOLA
from pam_antagonist.identification.static_fit import TableForm
from pam_antagonist.rig import load_rig

MAP = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured" / "force_maps" / "dmsp_20_300.csv"
VOLUME = np.array([-2.6e-2, 7.3e-3, -4.62e-4])
FORCE = np.array([7.4e-3, -1.05e-3, -500.0, 60.0])


def written(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


def kept(path: Path, keep: Callable[[float, float], bool]) -> None:
    """Leave the rows of a table of which the first two numbers are such."""
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *(row for row in rows if keep(*map(float, row.split(",")[:2])))]) + "\n")


@pytest.fixture
def tables(tmp_path: Path) -> tuple[Path, Path]:
    """Measurements of a muscle that differs from the rig's: cylinder and force map."""
    rng = np.random.default_rng(8)
    length = np.linspace(0.148, 0.182, 7)
    volume = TableForm(PARABOLA).value(VOLUME, length) + 1e-7 * rng.standard_normal(7)
    cylinder = written(tmp_path / "cylinder.csv", "length_mm,volume_cm3", length * 1e3, volume * 1e6)
    at, held = (grid.ravel() for grid in np.meshgrid(length, np.linspace(150e3, 720e3, 9)))
    force = np.maximum(
        TableForm("linear", 0.165, 101.3e3).value(FORCE, at, held) + 0.3 * rng.standard_normal(len(at)), 0.0
    )
    header, gauge = "length_mm,pressure_kPa_gauge,force_N", (held - 101.3e3) * 1e-3
    return cylinder, written(tmp_path / "bench.csv", header, at * 1e3, gauge, force)


def arguments(tables: tuple[Path, Path], out: Path, *more: str) -> list[str]:
    return ["--volume", str(tables[0]), "--force-map", str(tables[1]), "--rig", "shin2022", "--out", str(out), *more]


def test_the_rig_file_holds_the_fits_and_their_errors(tables, tmp_path, capsys, golden):
    assert dispatch(["static", *arguments(tables, tmp_path / "out")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["report.html", "report.json", "rig.yaml"]
    before, after = load_rig("shin2022"), load_rig(tmp_path / "out" / "rig.yaml")
    for number in (1, 2):
        for names, truth in (
            (("volume.d1", "volume.d2", "volume.d3"), VOLUME),
            (("force.v1", "force.v2", "force.w1", "force.w2"), FORCE),
        ):
            for name, value in zip(names, truth, strict=True):
                path = f"muscle_{number}.{name}"
                assert abs(after.value(path) - value) < 4.0 * after.priors[path], path
                assert 0.0 < after.priors[path] < abs(value), path
    assert "bench.csv (SHA-256" in after.source and after.source.startswith(before.source.strip())
    for name in ("geometry", "valve_1", "joint", "friction", "tunings", "uncertainty", "model"):
        assert getattr(after, name) == getattr(before, name), name
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    golden("static", report)
    linear = report["force"]["forms"]["linear"]
    assert linear["coefficients"]["v1"]["std"] == pytest.approx(after.priors["muscle_1.force.v1"], rel=1e-9)
    said = capsys.readouterr().out
    assert "form linear gives the force with a root mean square error of 0." in " ".join(said.split())


def test_replay_reads_the_rig(tables, tmp_path, bag):
    assert main(arguments(tables, tmp_path / "out", "--no-figures", "--form", "hildebrandt")) == 0
    rig = tmp_path / "out" / "rig.yaml"
    assert load_rig(rig).model.force == "hildebrandt"
    # The offset's name depends on the form; what is uncertain about it does not.
    assert load_rig(rig).uncertainty["muscle_1.force.c4"] == load_rig("shin2022").uncertainty["muscle_1.force.w2"]
    assert replay.main([str(bag), "--rig", str(rig), "--out", str(tmp_path / "replay"), "--no-figures"]) == 0


def test_bounds_of_what_was_measured_go(tables, tmp_path):
    start = tmp_path / "start.yaml"
    start.write_text("based_on: shin2022\nbounds: {muscle_1.force.v1: [7.0e-3, 7.1e-3], friction.shaft: [0.1, 0.3]}\n")
    line = arguments(tables, tmp_path / "out", "--no-figures")
    line[line.index("shin2022")] = str(start)
    assert main(line) == 0
    assert set(load_rig(tmp_path / "out" / "rig.yaml").bounds) == {"friction.shaft"}


def test_what_the_joint_needs_and_the_table_lacks_is_said(tables, tmp_path, capsys):
    kept(tables[1], lambda length, pressure: 150.0 < length < 175.0 and pressure < 400.0)
    assert main(arguments(tables, tmp_path / "out", "--no-figures")) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "in the joint the muscles are 149.6 to 180.4 mm long; below 153.7 mm and above 170.7 mm the fit is" in said
    assert "the supply of rig shin2022 has 710 kPa: above, the fit is extrapolated" in said
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert len(report["warnings"]) >= 2


@pytest.mark.parametrize(
    ("more", "says"),
    [
        (("--length", "0.26"), "--length 0.26 uses 244.6 to 275.4 mm: another muscle"),
        (("--length", "165"), "--length 165 m: expected the muscle's length at angle 0, 0.02 to 2 m"),
        (("--form", "sarosi", "--muscle", "1"), "has no coefficients of it for muscle 2"),
        (("--form", "quadratic"), "invalid choice: 'quadratic'"),
        (("--column", "lenght=x:mm"), "the quantity one of length, pressure, force, volume"),
        (("--column", "force=F:N:gauge"), "'gauge' after the unit"),
        (("--column", "force=load:N"), "force: there is no column 'load', expected one of length_mm"),
        (("--column", "length=length_mm:kg"), "unknown unit 'kg' of length"),
        (("--pressure", "absolute"), "is said to be gauge and absolute"),
        (("--slack-below", "-1"), "expected a force in N, 0 or more"),
    ],
)
def test_bad_input_is_one_line_and_no_output(tables, tmp_path, refused, more, says):
    refused(main, arguments(tables, tmp_path / "out", *more), says)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda line: [*line[:4], *line[6:]], "--rig: expected a rig file, or --report-only for a muscle"),
        (
            lambda line: [*line[4:6], "--out", line[-1]],
            "nothing to fit: expected --volume FILE, --force-map FILE or both",
        ),
        (
            lambda line: [*line[:2], *line[4:], "--form", "sarosi"],
            "--form: chooses the form of a force map; expected --force-map FILE as well",
        ),
        (
            lambda line: [*line[:2], *line[4:], "--column", "force=F:N"],
            "--column force: names a column of --force-map; expected --force-map FILE as well",
        ),
        (lambda line: [*line, "--column", "force=a", "--column", "force=b"], "given twice, as 'a' and 'b'"),
        (lambda line: [*line[:5], "no_such_rig", *line[6:]], "unknown rig 'no_such_rig'"),
    ],
)
def test_bad_arguments(tables, tmp_path, refused, edit, says):
    refused(main, edit(arguments(tables, tmp_path / "out")), says)


def test_a_joint_with_regulators(tables, tmp_path, capsys):
    line = arguments(tables, tmp_path / "out", "--no-figures")
    line[line.index("shin2022")] = "shin2022_regulators"
    assert main(line) == 0
    after, before = load_rig(tmp_path / "out" / "rig.yaml", regulators=True), load_rig("shin2022_regulators", True)
    assert after.drive == "regulator" and after.effects == before.effects
    assert abs(after.value("muscle_2.force.w1") - FORCE[2]) < 4.0 * after.priors["muscle_2.force.w1"]
    capsys.readouterr()
    # The pressures that count are those of the regulators, not of the supply.
    kept(tables[1], lambda length, pressure: pressure < 400.0)
    line[line.index(str(tmp_path / "out"))] = str(tmp_path / "low")
    assert main(line) == 0
    assert "the regulators of rig shin2022_regulators hold up to 700 kPa" in " ".join(capsys.readouterr().out.split())


def test_a_rig_in_units_of_its_own_gets_no_table(tables, tmp_path, refused):
    line = arguments(tables, tmp_path / "out", "--no-figures")
    line[line.index("shin2022")] = "regulator_joint"
    refused(main, line, "its pressures are not in a known unit (units.pressure: unknown)")
    assert main([*line, "--report-only"]) == 0


def test_a_muscle_without_a_rig(tables, tmp_path, capsys):
    line = ["--force-map", str(tables[1]), "--volume", str(tables[0]), "--report-only"]
    assert main([*line, "--out", str(tmp_path / "out")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "form linear gives the force with a root mean square error of 0." in said
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    errors = {name: entry["left_out"]["rmse_n"] for name, entry in report["force"]["forms"].items()}
    assert report["rig"] is None and report["joint"] is None
    assert report["force"]["form"] == min(errors, key=lambda name: errors[name])
    # Contractions count from the longest length, or from the one that was given.
    assert report["force"]["forms"]["hildebrandt"]["contraction_from_m"] == pytest.approx(0.182)
    assert main([*line, "--out", str(tmp_path / "own"), "--length", "0.165", "--form", "sarosi", "--no-figures"]) == 0
    report = json.loads((tmp_path / "own" / "report.json").read_text())
    assert report["force"]["form"] == "sarosi"
    assert report["force"]["forms"]["hildebrandt"]["contraction_from_m"] == 0.165


@pytest.mark.skipif(not MAP.exists(), reason="no ../shared/data/measured beside the project")
@pytest.mark.parametrize("drive", ["valve", "regulator"])
def test_one_muscle_of_a_data_sheet_gets_its_table(tmp_path, drive):
    start, out = tmp_path / "bench.yaml", tmp_path / "out"
    parts = "--valve MPYE-5-M5" if drive == "valve" else "--drive regulator --regulator ITV2050"
    words = (
        "--kind pulley --radius 29mm --muscle DMSP-20 --nominal-length 300mm --length 272mm --supply 6bar --stop 24deg "
        f"--inertia 0.022 --mass 2.5kg {parts}"
    )
    assert new_rig.main(["--out", str(start), *words.split()]) == 0
    line = ["--force-map", str(MAP), "--no-figures", "--muscle", "1"]
    assert main([*line, "--rig", str(start), "--out", str(out)]) == 0
    rig = load_rig(out / "rig.yaml", regulators=True)
    # Muscles of a data sheet are braided ones, in an identification and here; the other one keeps its data sheet's.
    assert rig.model.force == "braided" and rig.drive == drive
    measured, other = (rig.value(f"muscle_{i}.force.c1") for i in (1, 2))
    assert measured == pytest.approx(272.0, rel=0.02) and other != measured
    assert other == pytest.approx(measured, rel=0.3)
    assert rig.value("muscle_2.force.c6") == pytest.approx(0.3, rel=1e-4)
    assert rig.priors["muscle_1.force.c1"] < 0.2 * rig.priors["muscle_2.force.c1"], "the other one was not measured"
    assert rig.is_from_data_sheets
    if drive == "valve":
        (tmp_path / "pushes.yaml").write_text(f"based_on: {out / 'rig.yaml'}\nmuscle_1: {{force: {{c2: -3.0}}}}\n")
        with pytest.raises(BadInput, match=r"muscle_1.force.c2: -3, expected above 0 with model.force: braided"):
            load_rig(tmp_path / "pushes.yaml")


@pytest.mark.slow(20)
def test_a_braided_form_does_not_make_a_known_rig_a_guess(tables, tmp_path):
    """It was identified as a rig of which nothing but data sheets is known, with priors of 15 %."""
    assert main(arguments(tables, tmp_path / "out", "--form", "braided", "--no-figures")) == 0
    rig = load_rig(tmp_path / "out" / "rig.yaml")
    assert rig.model.force == "braided" and not rig.is_from_data_sheets
    recording = simulate(rig, duration=24.0, seed=1)
    found = identify([recording], rig, jobs=1)
    assert {item.name for item in found.parameters} >= {"muscle_1.force.c1", "joint.inertia", "supply.pressure"}
    assert found.rig.value("muscle_1.force.c1") == pytest.approx(rig.value("muscle_1.force.c1"), rel=0.02)


@pytest.mark.skipif(not MAP.exists(), reason="no ../shared/data/measured beside the project")
@pytest.mark.slow(3)
def test_the_measured_map_of_another_muscle(tables, tmp_path, capsys, refused):
    line = ["--force-map", str(MAP), "--rig", "shin2022", "--no-figures"]
    at = "measured at 222 to 296 mm, but rig shin2022 with L_0 = 0.165 m uses 149.6 to 180.4 mm"
    refused(main, [*line, "--out", str(tmp_path / "a")], at, "--length", "--report-only")
    # Its length makes it a joint, but not with the volume of the other muscle.
    own = "give this muscle's --volume as well, or --report-only"
    refused(main, [*line, "--out", str(tmp_path / "b"), "--length", "0.26"], own)
    assert main([*line, "--out", str(tmp_path / "c"), "--report-only"]) == 0
    assert sorted(path.name for path in (tmp_path / "c").iterdir()) == ["report.html", "report.json"]
    report = json.loads((tmp_path / "c" / "report.json").read_text())
    assert report["force"]["forms"]["hildebrandt"]["left_out"]["rmse_n"] == pytest.approx(57.1, abs=0.1)
    assert report["force"]["slack"] == 66 and not report["rig_written"]
    assert "consider --form hildebrandt" in " ".join(capsys.readouterr().out.split())
    more = np.linspace(0.0, 40.0, 6)
    written(tables[0], "length_mm,volume_cm3", 240.0 + more, 90.0 - 0.8 * more - 0.004 * more**2)
    whole = f"--volume {tables[0]} --length 0.26 --form hildebrandt --out {tmp_path / 'd'}"
    assert main([*line, *whole.split()]) == 0
    assert load_rig(tmp_path / "d" / "rig.yaml").geometry.length == 0.26


def test_a_volume_that_grows_with_length_is_doubted(tables, tmp_path, capsys):
    length = np.linspace(148.0, 182.0, 7)
    written(tables[0], "length_mm,volume_cm3", length, 20.0 + 0.3 * length)
    assert main(arguments(tables, tmp_path / "out", "--no-figures")) == 0
    assert "The volume grows with length at 100% of the joint's lengths" in " ".join(capsys.readouterr().out.split())


def test_tables_that_determine_no_fit_say_which_they_determine(tables, tmp_path, refused):
    kept(tables[1], lambda length, pressure: length < 154.0)
    words = "does not determine a force map of form hildebrandt", "it determines linear: choose by --form"
    refused(main, arguments(tables, tmp_path / "out", "--form", "hildebrandt"), *words)
    tables[0].write_text("length_mm,volume_cm3\n165,50\n165.000000001,51\n165.000000002,52\n")
    apart = "cannot tell its coefficients apart; expected at least 3 lengths that are"
    refused(main, arguments(tables, tmp_path / "out"), apart)
