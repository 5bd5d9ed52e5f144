"""``observability``: what Proposition 1 and friction say, the Gramian says too."""

from __future__ import annotations

import math

import pytest

from pam_antagonist.rig import load_rig
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
