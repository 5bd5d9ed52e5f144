"""``close_loop`` of a joint that only a ruler described: the missing effect is named, and the filter gets better."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from other_rigs import described, drawn, recorded

from pam_antagonist.cli import close_loop
from pam_antagonist.recording import write_bag
from pam_antagonist.rig import load_rig
from pam_antagonist.rig.write import write_rig

TRIALS = 4


@pytest.mark.slow(30)
def test_a_supply_that_droops_is_named(tmp_path: Path) -> None:
    guessed = described(0.01)
    true = drawn(guessed, 3).with_value("effects.supply_droop.stiffness", 4e8)
    for seed in range(TRIALS):
        write_bag(tmp_path / f"free_{seed}", recorded(true, 8.0, seed))
    write_rig(guessed, tmp_path / "rig.yaml", [])
    names = [str(tmp_path / f"free_{seed}") for seed in range(TRIALS)]
    status = close_loop.main([*names, "--rig", str(tmp_path / "rig.yaml"), "--out", str(tmp_path / "out")])
    assert status == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "effect"
    assert [effect["name"] for effect in report["effects"]] == ["supply_droop"]
    assert "learned" not in {item["name"] for item in report["candidates"]}
    assert "supply_droop" in load_rig(tmp_path / "out" / "rig_extended.yaml").effects
