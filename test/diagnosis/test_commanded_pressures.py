"""A joint with pressure regulators goes the way of one with valves: its commands drive the model."""

from __future__ import annotations

from pathlib import Path

import pytest

from pam_antagonist import diagnose, load_rig, simulate
from pam_antagonist.cli.close_loop import main
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.recording import write_bag

RIG = load_rig("shin2022_regulators", regulators=True)


@pytest.mark.slow(4)
def test_creep_is_found_where_regulators_drive_the_joint() -> None:
    creeping = RIG.replaced(effects={**RIG.effects, "creep": {"share_1": 0.06, "share_2": 0.06, "time": 4.0}})
    recording = simulate(creeping, duration=24.0, mismatch=0.01, seed=5, joint="locked", path="locked")
    found = diagnose(recording, RIG, profiles=False, estimator=False)
    assert found.verdict == "effect" and [effect.name for effect in found.effects] == ["creep"]
    shares = [found.effects[0].parameters[f"share_{i}"] for i in (1, 2)]
    assert all(abs(share.value - 0.06) < 4.0 * share.std for share in shares)


def test_what_valves_and_air_alone_can_have_is_no_candidate() -> None:
    recording = simulate(RIG, duration=2.0, seed=5)
    experiment = ValveDriven(RIG, make_trial(recording, RIG, "free", 0.0, "free"), 2000)
    names = {candidate.effect for candidate in experiment.candidates({})}
    assert {"friction", "friction_by_pressure", "hysteresis", "creep", "regulator_threshold"} <= names
    assert not names & {"leak", "valve_lag", "valve_offset", "supply_droop", "line_resistance", "regulator_lag"}
    directions = {direction.name for direction in experiment.directions}
    assert "effects.regulator_lag.frequency_1" in directions
    assert not [name for name in directions if name.startswith(("valve_", "supply"))]


def test_drives_are_not_mixed_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    valves = simulate("shin2022", duration=0.5)
    with pytest.raises(BadInput, match="holds no pressure_state"):
        diagnose(valves, RIG)
    write_bag(tmp_path / "bag", simulate(RIG, duration=0.5))
    options = ["--rig", "shin2022_regulators", "--out", str(tmp_path / "out"), "--also", "elbow"]
    assert main([str(tmp_path / "bag"), *options]) == 2
    assert "no signal 'elbow'" in capsys.readouterr().err
