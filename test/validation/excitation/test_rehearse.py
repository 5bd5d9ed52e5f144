"""``rehearse``: the joints have the size that is said, and outcomes that are there are counted, not made again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.rig import load_rig
from validation.excitation import rehearse
from validation.excitation.pairs import usual
from validation.excitation.sizes import Sizes

RIG = load_rig("shin2022")


def test_a_joint_has_one_number_of_its_effect_in_a_size_of_the_battery() -> None:
    joint, path, size = rehearse.joint_with(RIG, "valve_offset", 1)
    values = joint.effects["valve_offset"]
    assert [name for name, value in values.items() if value] == [path.rpartition(".")[2]]
    assert any(size == pytest.approx(level, rel=0.1) for level in (4.0, 8.0, 16.0))
    # Of the same order in another minute, by the simulation that makes recordings.
    moved, plain = (simulate(rig, duration=20.0, seed=5, noise=False) for rig in (joint, RIG))
    assert moved.torque is not None and plain.torque is not None
    sensors, off = RIG.sensors, np.column_stack([moved.torque - plain.torque, moved.pressure - plain.pressure])
    noises = np.sqrt(np.mean(off**2, axis=0)) / [sensors.torque_std, sensors.pressure_std, sensors.pressure_std]
    assert size / 4.0 < noises.max() < size * 4.0


def outcome(effect: str, found: list[str], **more: Any) -> dict[str, Any]:
    given = {"effect": effect, "number": f"effects.{effect}.area_1", "noises": 8.0, "found": found, "beyond": 0.0}
    return {
        **given,
        "verdict": "effect",
        "apart": False,
        "rig_s": 85.0,
        "settling_s": 3.1,
        "angle_error_deg": 0.1,
        **more,
    }


def test_what_is_done_is_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept = {
        "leak": outcome("leak", ["leak"]),
        "creep": outcome("creep", ["thermal", "creep"], apart=True, rig_s=120.0, settling_s=None, beyond=0.02),
    }
    for name, one in kept.items():
        (tmp_path / f"{name}_1").mkdir()
        (tmp_path / f"{name}_1" / "outcome.json").write_text(json.dumps(one))
    page = tmp_path / "page.md"
    assert rehearse.main(["--out", str(tmp_path), "--effect", "leak", "--effect", "creep", "--docs", str(page)]) == 0
    said = capsys.readouterr().out
    assert "right first: 1 (1.3 to 98.7 %); rig time at most 2.0 min; settled: 1; limits kept: 1; of 2 joints" in said
    assert "thermal creep" in said
    written = page.read_text()
    assert "./run rehearse --out DIR --seeds 1 --effect leak --effect creep --docs FILE" in written
    assert "| leak.area_1 | 8.0 | yes | leak |" in written


def test_a_usual_size_that_nobody_would_find_is_enlarged() -> None:
    sizes = Sizes(RIG, np.random.default_rng(0))
    small = moved(RIG, dict.fromkeys(("effects.creep.share_1", "effects.creep.share_2"), 0.02))
    assert sizes.of(small) < 2.5
    assert sizes.of(usual(RIG, "creep")) == pytest.approx(4.0, rel=0.1)
    leak = usual(RIG, "leak").effects["leak"]
    assert leak["area_1"] == leak["area_2"] == 1e-9, "one that is large enough stays as it is"
