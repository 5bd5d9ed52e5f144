"""``observability``: what Proposition 1 and friction say, the Gramian says too."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from pam_antagonist.rig import load_rig
from pam_antagonist.validation.observability import maps
from pam_antagonist.validation.observability.command import main, measure


def test_at_rest_nothing_tells_the_torque_and_an_encoder_alone_the_angle(capsys: pytest.CaptureFixture[str]) -> None:
    rig = load_rig("shin2022_external_torque")
    prior = rig.value("effects.external_torque.prior")
    for place in measure(rig):
        blind, seeing = place["std"]["pressures alone"], place["std"]["encoder"]
        assert math.degrees(seeing["angle"]) < 0.1
        if place["joint"] == "rest":  # it sticks, and steady pressures do not depend on it
            assert blind["external_torque"] > 0.99 * prior and seeing["external_torque"] > 0.99 * prior
            assert math.degrees(blind["angle"]) > 9.0
        else:
            assert seeing["external_torque"] < blind["external_torque"] < 0.1 * prior
    assert main(["--rig", "shin2022"]) == 2
    assert "prior" in capsys.readouterr().err


def test_the_filter_claims_no_more_than_can_be_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In motion by the Gramian; at rest by pressures alone it knows less than in motion, and an encoder helps."""
    monkeypatch.setattr(maps, "ANGLES", (0.0, 10.0))
    monkeypatch.setattr(maps, "_COLUMNS", tuple("abcd"))
    rig = load_rig("shin2022_external_torque")
    best, claimed = maps.at_best(rig), maps.claimed(rig)
    rest, motion = slice(0, 2), slice(2, 4)
    for sensor, name in (("none", "pressures alone"), ("encoder", "encoder")):
        torque = claimed[sensor][1]
        assert (torque[:, motion] > best[f"open valves, {name}"][1][:, motion]).all()
        assert (torque < rig.value("effects.external_torque.prior")).all()
    blind, seeing = claimed["none"], claimed["encoder"]
    assert (blind[1][:, rest] > blind[1][:, motion]).all()
    assert (seeing[1] < blind[1]).all() and (seeing[0] < blind[0]).all()
    maps.write(tmp_path / "new", rig)
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"torque.png", "angle.png"}
