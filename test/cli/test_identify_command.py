"""The command as users meet it."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist.cli import simulate
from pam_antagonist.cli.identify import main
from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import Recording, read_bag, write_bag
from pam_antagonist.rig import load_rig

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "rig_a" / "nominal"
# Everything is kept but what two short recordings tell in a second.
FEW = ["--freeze", "muscle_1", "--freeze", "muscle_2", "--freeze", "gas", "--freeze", "joint", "--freeze", "friction"]


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Nine seconds of a free and of a locked joint, both of one plant whose valves are not quite the declared ones."""
    folder = tmp_path_factory.mktemp("bags")
    plant = folder / "plant.yaml"
    plant.write_text(
        "based_on: shin2022\nvalve_1: {inflow_area: 5.3e-8, outflow_area: 7.6e-8}\n"
        "valve_2: {inflow_area: 5.0e-8, outflow_area: 8.0e-8}\n"
    )
    for joint in ("free", "locked"):
        arguments = ["--rig", str(plant), "--out", str(folder / joint), "--duration", "9", "--profile", "steps"]
        assert simulate.main([*arguments, "--seed", "3", "--mismatch", "0", "--joint", joint]) == 0
    return folder / "free", folder / "locked"


def changed(bag: Path, out: Path, **arrays: Any) -> Path:
    recording = read_bag(bag)
    kept = {name: getattr(recording, name) for name in ("stamp_ns", "pressure", "voltage", "angle", "torque")}
    write_bag(out, Recording(path=out, **{**kept, **arrays}))
    return out


def report(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "report.json").read_text(), parse_constant=pytest.fail)


@pytest.fixture(scope="module")
def result(bags: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("identify") / "out"
    assert main([*map(str, bags), "--rig", "shin2022", "--out", str(out), *FEW, "--seed", "7"]) == 0
    return out


@pytest.mark.slow
def test_two_bags_give_a_rig_that_everything_loads(result, bags):
    assert {path.name for path in result.iterdir()} == {
        "rig.yaml", "rig.log.jsonl", "rig_1.yaml", "rig_2.yaml", "report.html", "report.json"
    }  # fmt: skip
    start = load_rig("shin2022")
    for name in ("rig.yaml", "rig_1.yaml"):
        rig = load_rig(result / name)
        assert rig.name == "shin2022_identified"
        assert rig.valve_1.outflow_area != start.valve_1.outflow_area
        assert rig.muscle_1 == start.muscle_1 and rig.tunings["published"] == start.tunings["published"]
        # What was declared is more than the errors show: all of it is made smaller, by one share.
        shares = [std / start.uncertainty[name] for name, std in rig.uncertainty.items()]
        assert len(shares) == len(start.uncertainty) and max(shares) < 0.5
        assert shares == pytest.approx([shares[0]] * len(shares))
        Estimator(rig)
    text = (result / "rig.yaml").read_text()
    assert text.startswith("# Identified on ") and "seed 7" in text
    for item in report(result)["recordings"]:
        assert item["sha256"] in text and item["name"] in text


@pytest.mark.slow
def test_the_report_judges_only_what_was_held_out(result, golden):
    found = report(result)
    golden("identify", found)
    for entry in found["held_out"]:
        assert entry["from_s"] == pytest.approx(6.0, abs=2e-3)
        for rig in ("as_configured", "identified", "own"):
            assert entry[rig]["duration_s"] == pytest.approx(3.0, abs=2e-3)
        before, now = (
            np.array(entry[rig]["model_alone"]["pressure"]["rmse_pa"]) for rig in ("as_configured", "identified")
        )
        assert np.all(now < before)
        assert 1.7 < entry["identified"]["innovation"]["nis_mean"] < 2.3
    noise = found["noise"]["found"]
    assert noise["pressure_std"] == pytest.approx(600.0, rel=0.05)
    assert noise["torque_std"] == pytest.approx(0.010, rel=0.05)


@pytest.mark.slow
def test_one_recording_without_a_reference_tells_what_pressures_tell(bags, tmp_path, capsys):
    blind = changed(bags[0], tmp_path / "blind", angle=None, torque=None)
    out = tmp_path / "out"
    assert main([str(blind), "--rig", "shin2022", "--out", str(out), "--no-figures"]) == 0
    found = report(out)
    assert "pressures alone determine valve_1.inflow_area" in found["warnings"][0]
    assert "pressures alone determine" in " ".join(capsys.readouterr().out.split())
    assert all(item["name"].startswith(("valve_", "gas.", "supply.")) for item in found["parameters"])
    assert found["held_out"][0]["identified"]["ukf"]["angle"] is None
    assert found["held_out"][0]["own"] is None and not (out / "rig_1.yaml").exists()
    assert found["tuning"]["unknown_torque_nm"] == 0.0
    undetermined = {item["name"]: item["record"] for item in found["parameters"] if not item["determined"]}
    assert all(undetermined.values())


def test_bad_input_is_one_line_that_names_it(bags, tmp_path, capsys):
    free, locked = bags
    samples = len(read_bag(locked).stamp_ns)
    changed(locked, tmp_path / "still", voltage=np.full((samples, 2), 5.5))
    changed(locked, tmp_path / "flat", pressure=450e3 + 0.01 * (read_bag(locked).pressure - 450e3))
    changed(locked, tmp_path / "cut", pressure=np.minimum(read_bag(locked).pressure, 470e3))
    short = slice(0, 4000)
    whole = read_bag(locked)
    changed(
        locked, tmp_path / "short",
        **{name: getattr(whole, name)[short] for name in ("stamp_ns", "pressure", "voltage", "angle", "torque")},
    )  # fmt: skip
    cases: list[tuple[list[str], str]] = [
        ([str(tmp_path / "still")], "valves never moved"),
        ([str(tmp_path / "flat")], "moves by"),
        ([str(tmp_path / "cut")], "its range ends there; such rows are no measurement; type --leave-out-faults"),
        ([str(tmp_path / "cut"), "--no-check"], "the sensor is saturated"),
        ([str(tmp_path / "short")], "too short"),
        ([str(free), str(free)], "the same recording"),
        ([str(free), "--holdout", "0.9"], "expected a share"),
        ([str(free), "--free", "friction.shaf"], "did you mean 'friction.shaft'"),
        ([str(free), "--jobs", "0"], "expected a whole number"),
        ([str(free), "--seed", "-1"], "--seed"),
        ([str(free), "--topic", "pressure_1=/x"], "/x"),
        ([str(tmp_path / "none")], "none"),
    ]
    for arguments, says in cases:
        assert main([*arguments, "--rig", "shin2022", "--out", str(tmp_path / "out")]) == 2, arguments
        error = capsys.readouterr().err
        assert error.startswith("error: ") and error.count("\n") == 1 and says in error, error
        assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_rejected_rig_is_said_first_and_nothing_proposes_it(bags, tmp_path, capsys):
    rig, out = tmp_path / "narrow.yaml", tmp_path / "out"
    rig.write_text("based_on: shin2022\nname: narrow\nbounds: {valve_1.outflow_area: [7.775e-8, 7.777e-8]}\n")
    kept = [word for name in ("valve_1.inflow_area", "valve_2", "supply") for word in ("--freeze", name)]
    assert main([str(bags[1]), "--rig", str(rig), "--out", str(out), *FEW, *kept, "--no-figures"]) == 1
    shown = capsys.readouterr().out
    first = " ".join(shown.partition("\n\n")[0].split())
    assert first.startswith("Do not use this rig: the search ended at a bound of valve_1.outflow_area (0.077")
    assert {path.name for path in out.iterdir()} == {"rig_rejected.yaml", "report.html", "report.json"}
    assert "\nrig:" not in shown and "rig_rejected" not in shown and f"--rig {rig}" in shown.partition("next:")[2]
    (only,) = report(out)["parameters"]
    assert report(out)["rejected"] in first and not only["determined"] and only["reason"] == "met a bound"
    assert load_rig(out / "rig_rejected.yaml").valve_1.outflow_area == pytest.approx(only["bound"])


@pytest.mark.slow
def test_noise_that_no_sensor_may_have_rejects_the_rig(bags, tmp_path, capsys):
    """It is found by the fit, so it is no bad value of the rig file that was given."""
    torque = read_bag(bags[1]).torque
    assert torque is not None
    loud = changed(bags[1], tmp_path / "loud", torque=torque + np.random.default_rng(0).normal(0.0, 15.0, len(torque)))
    out = tmp_path / "out"
    assert main([str(loud), "--rig", "shin2022", "--out", str(out), *FEW, "--no-figures"]) == 1
    said = capsys.readouterr()
    assert "Do not use this rig: the values that fit best are impossible (sensors.torque_std" in said.out
    assert "replaced" not in said.out + said.err
    assert {path.name for path in out.iterdir()} == {"rig_rejected.yaml", "report.html", "report.json"}


@pytest.mark.thorough(100)
@pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of rig A are not beside the project")
def test_rig_a_comes_near_to_its_sensors_noise(tmp_path):
    out = tmp_path / "out"
    begin = time.perf_counter()
    arguments = [str(DATA / "free"), str(DATA / "locked"), "--rig", "shin2022", "--out", str(out), "--no-figures"]
    assert main(arguments) == 0
    assert time.perf_counter() - begin < 400.0, "three minutes on two cores of one's own; these are shared"
    free, locked = report(out)["held_out"]
    assert free["as_configured"]["model_alone"]["angle"]["q"] > 0.02
    assert free["identified"]["model_alone"]["angle"]["q"] <= 0.012
    assert locked["identified"]["model_alone"]["torque"]["rmse_nm"] <= 0.015
    assert free["identified"]["ukf"]["angle"]["rmse_deg"] <= 0.1
    for entry in (free, locked):
        assert max(entry["own"]["model_alone"]["pressure"]["rmse_pa"]) <= 800.0
        # Below 2: on rig A the innovations are smaller than the filter allows for. Why was not looked into.
        assert 0.5 < entry["identified"]["innovation"]["nis_mean"] < 2.2
        assert entry["identified"]["ukf"]["torque"]["coverage95"] >= 0.90
    assert free["identified"]["ukf"]["angle"]["coverage95"] >= 0.90
