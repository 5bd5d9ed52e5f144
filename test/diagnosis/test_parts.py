"""The parts of a rig of data sheets in which close_loop looks for effects: what counts there, and what does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist import load_rig, simulate
from pam_antagonist.diagnosis.law_evidence import is_better, with_it
from pam_antagonist.diagnosis.law_search import search
from pam_antagonist.diagnosis.model_parts import JOINT, group_of
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import Settings
from pam_antagonist.diagnosis.remaining import surroundings
from pam_antagonist.identification import joint_stage
from pam_antagonist.identification.runs import runs_of
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, with_law

LOCKED_AT = 0.1


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("shin2022")


@pytest.fixture(scope="module")
def free(rig: Rig) -> Recording:
    return simulate(rig, duration=12.0, seed=3, path="free")


@pytest.fixture(scope="module")
def locked(rig: Rig) -> Recording:
    """A locked joint, whose muscles pull ten times as hard as those of a free one do."""
    made = simulate(rig, duration=12.0, seed=4, joint="locked", lock_angle=LOCKED_AT, path="locked")
    assert made.torque is not None
    return replace(made, angle=np.full(len(made), LOCKED_AT), torque=10.0 * made.torque)


def part(rig: Rig, *recordings: Recording, free: Sequence[Unknown] = ()) -> Experiment:
    given = [
        (one, JointCondition(str(one.path), LOCKED_AT if str(one.path) == "locked" else 0.0, "given"), str(one.path))
        for one in recordings
    ]
    start = Fit(tuple(free), np.zeros(len(free)), np.eye(len(free)), 0.0)
    group = group_of(JOINT, rig, start, given, [8.0] * len(given), Settings(jobs=1))
    assert group is not None
    return group.experiments[0]


def test_errors_of_a_free_joint_are_not_hidden_by_the_torque_of_a_locked_one(rig, free, locked) -> None:
    """A share of the torque that was seen was five times as large with two locked recordings: hysteresis was lost."""
    alone, both = part(rig, free), part(rig, free, locked)
    angle, torque = both.tolerated
    assert torque == pytest.approx(alone.tolerated[1]) and angle == pytest.approx(alone.tolerated[0], rel=0.05)
    assert 0.005 * joint_stage.torque_scale(rig) < torque < 0.05 * joint_stage.torque_scale(rig)


def test_the_course_of_a_joint_has_an_angle_where_it_was_locked(rig, free, locked) -> None:
    """It was NaN there, and close_loop ended in a traceback."""
    both = part(rig, free, locked)
    around = surroundings(both, Point(np.zeros(0)))
    assert around.angle is not None
    assert all(np.isfinite(values).all() for values in around.library().values())
    still = np.abs(around.angle - LOCKED_AT) < 1e-9
    assert 0.4 < np.mean(still) < 0.6


def test_a_stop_takes_its_share_of_the_torque_of_a_free_joint_only(rig, free, locked) -> None:
    reached = float(np.nanmax(np.abs(free.angle)))
    near = rig.replaced(joint=rig.joint.replaced(stop=reached + np.radians(1.0)))
    for one, leaves_out in ((free, True), (locked, False)):
        state = JointCondition(str(one.path), LOCKED_AT, "given")
        runs = runs_of(one, state, "one")
        counted = {
            stop: sum(len(left) for kind, _, left in joint_stage.errors_of(each, runs, (), [{}])[0] if kind == "torque")
            for stop, each in (("far", rig.replaced(joint=rig.joint.replaced(stop=None))), ("near", near))
        }
        beyond = sum(int((np.abs(run.angle) >= joint_stage.off_stop(near)).sum()) for run in runs)
        assert 0 < beyond < counted["far"] or not leaves_out
        assert counted["far"] - counted["near"] == (beyond if leaves_out else 0)
    measured = part(near, free).measured
    assert np.isfinite(measured[:, 0]).all() and np.isnan(measured[:, 1]).any()
    assert not np.isnan(measured[:, 1]).all()


def test_an_effect_that_takes_energy_does_not_give_it(rig, free) -> None:
    """A Coulomb torque of -0.17 N m was called friction that the model lacks."""
    offered = {one.effect: one for one in part(rig, free).candidates({})}
    for name in ("friction", "hysteresis"):
        assert all(free.bounded(-1.0) == 0.0 for free in offered[name].sizes)
    assert any(free.bounded(-1e-3) < 0.0 for one in offered.values() for free in one.sizes)


@pytest.mark.slow(5)
def test_what_the_muscles_lack_at_low_pressures_is_learned_as_a_law_of_their_strength(rig) -> None:
    weak = Law("strength", (2e5, 4e5, 6e5), (-0.2, -0.02, 0.0), "both", "pressure")
    inertia = Unknown("joint.inertia", ("joint.inertia",), rig.joint.inertia, 0.05, True)
    experiment = part(rig, simulate(with_law(rig, weak), duration=12.0, seed=3, path="free"), free=[inertia])
    base = Model((experiment,), (refit(experiment, experiment.origin),))
    found = search(base, lambda text: None)
    assert found.law is not None and len(found.laws) == 1
    assert (found.law.place, found.law.argument) == ("strength", "pressure")
    low, high = (found.law.value(pressure) - weak.value(pressure) for pressure in (3e5, 5e5))
    assert low == pytest.approx(high, abs=0.02)
    with_law_of_part = with_it(base, found.law)
    assert is_better(base, base, with_law_of_part, found.law)
    assert not is_better(base, with_law_of_part, with_law_of_part, found.law)
