"""The balance of torques along the measured motion, of a joint that sticks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.inference.measured_motion import MeasuredMotion, along_motion, motion_of
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import ANGLE
from pam_antagonist.inference.valve_driven import ValveDriven

FRICTION = {
    "effects.friction.coulomb": 0.01, "effects.friction.stribeck": 0.08, "effects.friction.velocity": 0.1
}  # fmt: skip


@pytest.fixture(scope="module")
def exact(recorded, experiment_of) -> ValveDriven:
    """A joint as configured, with friction that falls with speed, without noise."""
    quiet = experiment_of(recorded(joint="free", seconds=20.0), "free")
    made = quiet.simulated(Point(quiet.origin.theta, FRICTION), whole=True)
    return replace(quiet, trial=replace(quiet.trial, measured=made))


@pytest.fixture(scope="module")
def free_run(exact) -> ValveDriven:
    """The same with the noise of its sensors."""
    noise = np.random.default_rng(1).standard_normal((len(exact.trial), 4)) * [5e-4, 0.01, 600.0, 600.0]
    return replace(exact, trial=replace(exact.trial, measured=exact.trial.measured + noise))


def test_a_joint_that_sticks_is_judged_along_its_motion_and_another_is_not(free_run, recorded, experiment_of) -> None:
    assert isinstance(along_motion(free_run), MeasuredMotion)
    locked = experiment_of(recorded(seconds=20.0), "locked")
    assert along_motion(locked) is locked
    moving = replace(free_run.trial, measured=free_run.trial.measured.copy())
    moving.measured[:, ANGLE] += 0.05 * np.sin(np.arange(len(moving)) / 50.0)
    slides = replace(free_run, trial=moving)
    assert along_motion(slides) is slides


def test_the_motion_is_told_with_its_noise(free_run, exact) -> None:
    motion = motion_of(free_run.trial)
    true = exact.trial.measured[:, ANGLE]
    velocity = np.gradient(true, exact.trial.dt)
    acceleration = np.gradient(velocity, exact.trial.dt)
    found = (motion.angle, motion.velocity, motion.acceleration)
    for told, truth, std in zip(found, (true, velocity, acceleration), motion.noise, strict=True):
        # The median, since a parabola is off within jumps that it follows well enough to be clear.
        assert np.median(np.abs(told - truth)[motion.clear]) == pytest.approx(0.6745 * std, rel=0.3)
    assert np.all(motion.direction[motion.direction != 0.0] == np.sign(motion.velocity)[motion.direction != 0.0])
    slides = motion.clear & (motion.direction != 0.0)
    assert np.all(np.sign(velocity) == motion.direction, where=slides)


def test_the_right_friction_balances_the_torques_and_none_does_not(free_run) -> None:
    along = along_motion(free_run)
    assert isinstance(along, MeasuredMotion)
    right, origin = Point(along.origin.theta, FRICTION), along.origin
    assert along.right(right) > 0.97
    assert along.right(origin) < along.right(right) - 0.1
    column = along.channels.index(ANGLE)
    assert along.times_noise(along.residual(right))[column] < 1.3
    assert along.times_noise(along.residual(origin))[column] > 5.0


def test_friction_moves_nothing_but_the_balance(free_run) -> None:
    along = along_motion(free_run)
    others = [k for k, channel in enumerate(along.channels) if channel != ANGLE]
    change = along.residual(along.origin) - along.residual(Point(along.origin.theta, FRICTION))
    assert np.max(np.abs(change[:, others])) < 1e-9
    assert along.times_noise(along.residual(Point(along.origin.theta, FRICTION)))[others] == pytest.approx(1.0, abs=0.2)


def test_a_joint_that_stands_still_has_any_friction_up_to_its_level(free_run) -> None:
    along = along_motion(free_run)
    assert isinstance(along, MeasuredMotion)
    still = (along.motion.direction == 0.0) & along.motion.clear
    much = Point(along.origin.theta, {**FRICTION, "effects.friction.stribeck": 0.5})
    assert not np.any(along.simulated(much, whole=True)[still, ANGLE])
    assert np.mean(np.abs(along.simulated(along.origin, whole=True)[still, ANGLE]) > 5e-3) > 0.05


def test_a_report_shows_the_model_that_runs_by_itself(free_run) -> None:
    shown = along_motion(free_run).free_run
    point = Point(free_run.origin.theta, FRICTION)
    assert np.array_equal(shown.simulated(point), free_run.simulated(point))
