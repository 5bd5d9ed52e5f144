"""Faults of a wiring that the emulator can have: each changes what the device sees, and ends with its fault."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pam_antagonist.hardware.line_faults import FaultPlan, Miswired, parse_fault
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
VOLTAGE = (6.6, 5.0)


def run(*faults: str, seconds: float = 3.0) -> NDArray[np.float64]:
    """Pressures and angle at the end (3,), of a joint whose first valve fills while the second one empties."""
    plan = FaultPlan([parse_fault(text) for text in faults], 0)
    joint = Miswired(Plant(RIG, substeps=1, noise=False), plan)
    for k in range(round(seconds / RIG.sample_period)):
        plan.at(k * RIG.sample_period)
        sample = joint.step((5.5, 5.5) if k < 10 else VOLTAGE)
    return np.array([*sample.pressure, sample.angle])


@pytest.fixture(scope="module")
def right() -> NDArray[np.float64]:
    return run()


def test_without_a_fault_it_is_the_joint_itself(right: NDArray[np.float64]) -> None:
    plant = Plant(RIG, substeps=1, noise=False)
    for k in range(round(3.0 / RIG.sample_period)):
        sample = plant.step((5.5, 5.5) if k < 10 else VOLTAGE)
    assert np.array_equal(right, [*sample.pressure, sample.angle])
    assert right[0] > right[1] + 100e3


def test_each_fault_shows(right: NDArray[np.float64]) -> None:
    assert np.array_equal(run("swap_sensors"), right[[1, 0, 2]])
    assert np.array_equal(run("flip_encoder"), right * [1, 1, -1])
    swapped = run("swap_valves")
    assert swapped[1] > swapped[0] + 100e3 and np.sign(swapped[2]) == -np.sign(right[2])
    assert run("leak=1")[0] < right[0] - 50e3
    assert run("stuck=1")[0] == pytest.approx(450e3, abs=20e3)
    off = run("no_supply")
    assert np.all(off[:2] < 430e3)
