"""Whether any stretch of a recording is above its noise."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.diagnosis import change_point
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.point import Point


@pytest.fixture(scope="module")
def joint(recorded, experiment_of) -> Experiment:
    return experiment_of(recorded(seconds=30.0), "locked")


def noise_of(joint: Experiment, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((len(joint.trial) // joint.trial.block, len(joint.channels))) * joint.noise


def test_noise_alone_is_not_above_noise(joint) -> None:
    assert all(change_point.clearest(joint, noise_of(joint, seed)) is None for seed in range(200))


@pytest.mark.parametrize(("begin", "end", "size"), [(4.0, 6.0, 4.0), (20.0, 30.0, 2.5)])
def test_a_stretch_above_noise_is_found_where_it_is(joint, begin: float, end: float, size: float) -> None:
    residual = noise_of(joint, 1)
    residual[int(begin * 50) : int(end * 50), 1] += size * joint.noise[1]
    found = change_point.clearest(joint, residual)
    assert found is not None
    assert found.channel == "Pressure 1"
    assert found.begin_s < end and found.end_s > begin
    assert found.end_s - found.begin_s <= 2.0 * (end - begin)


def test_a_noise_that_is_known_to_a_tenth_decides_nothing(joint) -> None:
    assert change_point.clearest(joint, 1.08 * noise_of(joint, 2)) is None


def test_what_the_base_parameters_explain_is_not_above_noise(joint) -> None:
    wrong = Point(joint.origin.theta + 0.05 * np.eye(joint.size)[0], {})
    assert change_point.clearest(joint, joint.residual(wrong, whole=True)) is not None
    assert change_point.stretches_above_noise([(joint, wrong)], 1) == ()


def test_a_sensor_that_jumps_in_the_held_out_part_is_above_noise(joint) -> None:
    residual = noise_of(joint, 3)
    residual[int(25.0 * 50) :, 2] += 8.0 * joint.noise[2]
    found = change_point.clearest(joint, residual)
    assert found is not None
    assert found.begin_s >= 20.0
