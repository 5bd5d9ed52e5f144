"""The PI on the plant model itself (no estimator): the printed integral gain against the corrected one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.command import Mode, Status
from pam_antagonist.control.pi import PiController
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

STEPS_DEG = (0.0, 10.0, -10.0)
STEP_SECONDS = 6.0


@pytest.fixture(scope="module")
def rig():
    return load_rig("shin2022")


class Printed(PiController):
    """The paper's law: the printed gains, and nothing against windup."""

    def _integrate(self, mode, gains, error, half):
        self.integral += gains.integral / self._period * error


def run(rig, kind=PiController):
    """Angle [rad], reference [rad] and whether a valve was at its limit, a sample (N,)."""
    plant = Plant(rig, noise=False)
    controller = kind(sample_period=rig.sample_period)
    angle, valves = 0.0, (5.5, 5.5)
    log = []
    for degrees in STEPS_DEG:
        for _ in range(round(STEP_SECONDS / rig.sample_period)):
            sample = plant.step(valves)
            angle = float(sample.angle)
            valves, status = controller.step(Mode.ANGLE, math.radians(degrees), angle)
            log.append((angle, math.radians(degrees), status is Status.SATURATED))
    return np.array(log)


def test_as_printed_the_valves_sit_in_saturation(rig):
    log = run(rig, Printed)
    assert log[:, 2].mean() > 0.6
    moving = log[round(STEP_SECONDS / rig.sample_period) :]
    assert np.degrees(np.abs(moving[:, 0] - moving[:, 1])).mean() > 5.0


def test_corrected_the_loop_settles_without_saturation(rig):
    log = run(rig)
    assert log[:, 2].mean() < 0.01
    n = round(STEP_SECONDS / rig.sample_period)
    for end in (n, 2 * n, 3 * n):
        assert abs(np.degrees(log[end - 1, 0] - log[end - 1, 1])) < 2.0
