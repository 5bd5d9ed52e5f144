"""``close_loop`` of short trials, of a joint that a ruler described or of shin2022: the missing effect is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from other_rigs import commands, described, drawn, recorded

from pam_antagonist import simulate
from pam_antagonist.cli import close_loop
from pam_antagonist.diagnosis import thresholds
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
    best, *others = report["candidates"]
    assert (best["name"], best["place"]) == ("supply_droop", "chambers and valves")
    assert best["held_out_evidence"] >= thresholds.STRONG
    # What a data sheet's law leaves makes nothing unexplained.
    assert report["unexplained"] == []
    assert all((item["delta_bic"] or 0.0) < best["delta_bic"] for item in others)
    assert "learned" not in {item["name"] for item in report["candidates"]}
    assert "supply_droop" in load_rig(tmp_path / "out" / "rig_extended.yaml").effects


@pytest.mark.slow(16)
def test_a_leak_of_a_known_rig_is_found_in_short_trials(tmp_path: Path) -> None:
    rig = load_rig("shin2022").with_value("sample_period", 0.01)
    true = rig.with_value("effects.leak.area_1", 3e-8)
    trials = [simulate(true, commands(rig, 8.0, seed), joint="free", seed=seed) for seed in range(TRIALS)]
    report = closed(rig, trials, tmp_path)
    (effect,) = report["effects"]
    assert (effect["name"], effect["muscle"]) == ("leak", 1)
    assert effect["parameters"]["area_1"]["value"] == pytest.approx(3e-8, rel=0.2)
    errors = report["filter_errors_deg"]
    assert errors["extended"] < 0.2 * errors["as_configured"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Found: leak" in page and "leak, muscle 1: area_1 [mm²]" in page
