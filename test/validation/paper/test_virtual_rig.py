"""The virtual rig is the plant that live nodes run, with the mismatches that its file declares and no others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.simulation.plant import Plant
from validation.paper import scenario as scenarios
from validation.paper.scenario import VirtualRig, drive, load_scenario, virtual_rig


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_a_recording_is_what_the_plant_shows_step_by_step(scenario, joint):
    rig = virtual_rig(scenario, 4)
    exact_sensors = rig.actual.sensors.replaced(angle_std=0.0, torque_std=0.0)
    rig = VirtualRig(rig.declared, rig.actual.replaced(sensors=exact_sensors), rig.seed, rig.spread)
    voltage = drive(scenario, 10.0)[3000:9000]  # two steps of the profile
    recording = rig.record(voltage, joint)
    plant = Plant(rig.actual, joint, seed=4, mismatch=rig.spread, noise=False)
    samples = [plant.step(row) for row in voltage]
    assert recording.angle == pytest.approx([sample.angle for sample in samples], abs=1e-9)
    assert recording.torque == pytest.approx([sample.torque for sample in samples], abs=1e-9)
    noise = recording.pressure - np.array([sample.pressure for sample in samples])
    sensors = rig.actual.sensors
    assert noise.std() == pytest.approx(np.hypot(sensors.pressure_std, sensors.pressure_step / 12**0.5), rel=0.05)
    if joint == "free":
        assert np.ptp(recording.angle) > 0.05, "the joint has to move for this to mean anything"


def test_only_the_plant_has_the_mismatches(scenario):
    rig = virtual_rig(scenario, 0)
    assert rig.declared.effects == {}
    assert rig.actual.effects["hysteresis"]["amplitude_1"] > 0.0
    assert rig.declared.valve_1.curve != rig.actual.valve_1.curve
    assert rig.actual.valve_1.curve != rig.actual.valve_2.curve
    true, declared = rig.plant().parameters, rig.declared.parameters()
    scattered = [
        name for name in ("friction.shaft", "supply.pressure") if true[par.INDEX[name]] != declared[par.INDEX[name]]
    ]
    assert scattered == ["friction.shaft", "supply.pressure"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("valve_curve: 0.08", "valve_cruve: 0.08", "valve_cruve"),
        ("parameters: 0.02", "parameters: 2.0", "parameters"),
        ("name: paper", "", "name"),
    ],
)
def test_a_bad_scenario_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, says: str
) -> None:
    text = (scenarios.config_dir() / "scenarios" / "paper.yaml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "paper.yaml").write_text(text.replace(old, new), encoding="utf-8")
    monkeypatch.setattr(scenarios, "config_dir", lambda: tmp_path)
    with pytest.raises(BadInput, match=says):
        load_scenario()
