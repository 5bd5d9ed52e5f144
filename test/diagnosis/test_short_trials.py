"""``close_loop`` of short trials, of a joint that a ruler described or of shin2022: the missing effect is named."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from other_rigs import commands, described, drawn, recorded

from pam_antagonist import diagnose, simulate
from pam_antagonist.cli import close_loop
from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.hypotheses import ResumeFolder
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.file import write_rig

TRIALS = 4


def closed(rig: Rig, trials: list[Recording], folder: Path) -> dict[str, Any]:
    """What the command says of trials; its files are in ``out``."""
    bags = [folder / f"free_{seed}" for seed in range(len(trials))]
    for bag, trial in zip(bags, trials, strict=True):
        write_bag(bag, trial)
    write_rig(rig, folder / "rig.yaml", [])
    out = folder / "out"
    assert close_loop.main([*map(str, bags), "--rig", str(folder / "rig.yaml"), "--out", str(out)]) == 0
    return json.loads((out / "report.json").read_text())  # type: ignore[no-any-return]


@pytest.mark.thorough(28)
def test_a_supply_that_droops_is_named(tmp_path: Path) -> None:
    guessed = described(0.01)
    true = drawn(guessed, 3).with_value("effects.supply_droop.stiffness", 4e8)
    report = closed(guessed, [recorded(true, 8.0, seed) for seed in range(TRIALS)], tmp_path)
    assert report["verdict"] == "effect"
    assert [effect["name"] for effect in report["effects"]] == ["supply_droop"]
    assert report["effects"][0]["splits"]["agree"] >= 3
    (best,) = [item for item in report["ranking"] if item["taken"]]
    assert (best["name"], best["part"]) == ("supply_droop", report["effects"][0]["part"])
    assert best["part"] == "chambers and valves"
    assert best["held_out_evidence"] >= thresholds.STRONG
    # What a data sheet's law leaves makes nothing unexplained.
    assert "unexplained" not in {part["verdict"] for part in report["parts"]}
    assert all((item["delta_bic"] or 0.0) < best["delta_bic"] for item in report["ranking"] if item is not best)
    assert "learned" not in {item["name"] for item in report["ranking"]}
    assert "supply_droop" in load_rig(tmp_path / "out" / "rig_extended.yaml").effects


@pytest.mark.thorough(40)
def test_short_trials_go_on_with_what_an_interrupted_run_has_finished(tmp_path: Path) -> None:
    rig = load_rig("shin2022").with_value("sample_period", 0.01)
    true = rig.with_value("effects.leak.area_1", 3e-8)
    trials = [simulate(true, commands(rig, 8.0, seed), joint="free", seed=seed) for seed in range(TRIALS)]
    store, said = ResumeFolder(tmp_path / "kept"), list[str]()
    first = diagnose(trials, rig, store=store)
    kept = {file.name: file.stat().st_mtime_ns for file in (tmp_path / "kept").iterdir()}
    again = diagnose(trials, rig, store=store, progress=said.append)
    assert kept and {file.name: file.stat().st_mtime_ns for file in (tmp_path / "kept").iterdir()} == kept
    (one,), (other,) = first.effects, again.effects
    assert (one.name, one.part) == (other.name, other.part) == ("leak", "chambers and valves")
    assert other.parameters["area_1"].value == pytest.approx(one.parameters["area_1"].value, rel=1e-6)


@pytest.mark.slow(14)
def test_an_encoder_that_reads_too_high_is_a_calibration_and_no_effect() -> None:
    rig = load_rig("shin2022").with_value("sample_period", 0.01)
    trials = [simulate(rig, commands(rig, 8.0, seed), joint="free", seed=seed) for seed in range(TRIALS)]
    high = math.radians(1.5)
    found = diagnose([replace(one, angle=one.angle + high) for one in trials], rig)
    assert found.verdict == "none" and found.effects == ()
    sizes = {one.name: (one.value, one.std) for one in found.calibrations}
    assert sizes.keys() == {"encoder_zero"}
    value, std = sizes["encoder_zero"]
    assert abs(value - high) < 3.0 * std < math.radians(0.2)
    errors = {name: one.ukf.angle.rmse for name, one in found.of_one_rig.items()}
    assert errors["recalibrated"] < 0.1 * errors["as_configured"]
    # An encoder that is right stays as it is.
    assert not diagnose(trials, rig).calibrations


@pytest.mark.slow(16)
def test_a_leak_of_a_known_rig_is_found_in_short_trials(tmp_path: Path) -> None:
    rig = load_rig("shin2022").with_value("sample_period", 0.01)
    true = rig.with_value("effects.leak.area_1", 3e-8)
    trials = [simulate(true, commands(rig, 8.0, seed), joint="free", seed=seed) for seed in range(TRIALS)]
    report = closed(rig, trials, tmp_path)
    # The report has the keys of all others.
    kept = json.loads((Path(__file__).parents[1] / "golden" / "close_loop.json").read_text(encoding="utf-8"))
    assert list(report) == list(kept) and list(report["ranking"][0]) == list(kept["ranking"][0])
    (effect,) = report["effects"]
    assert list(effect) == list(kept["effects"][0])
    assert (effect["name"], effect["muscle"]) == ("leak", 1)
    assert effect["parameters"]["area_1"]["value"] == pytest.approx(3e-8, rel=0.2)
    errors = {name: one["angle"] for name, one in report["filter_errors"].items()}
    assert errors["extended"]["rmse_deg"] < 0.2 * errors["as_configured"]["rmse_deg"]
    assert report["next_rig"] == "rig_extended.yaml" and report["next_steps"][-1].startswith("Next: repair the joint")
    # One trial of four is held out, and no other.
    roles = {entry["recording"]: entry["role"] for entry in report["recordings"]}
    assert sorted(roles.values()) == ["fitted"] * (TRIALS - 1) + ["held out"]
    assert report["effects"][0]["recordings"] == [name for name, role in roles.items() if role == "fitted"]
    assert report["settings"]["holdout"] == [name for name, role in roles.items() if role == "held out"]
    coverage = next(entry["ukf"] for entry in report["recordings"] if entry["role"] == "held out")["extended"]["angle"]
    assert errors["extended"]["coverage95"] == coverage["coverage95"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Found: leak" in page and "leak, muscle 1: area_1 [mm²]" in page
