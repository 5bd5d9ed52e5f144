"""A torque from outside that comes and goes, against one that is always there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.diagnosis import disturbance
from pam_antagonist.diagnosis.hypotheses import Work
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.trial import BLOCK_S
from pam_antagonist.model.effects import DISTURBANCE
from validation.battery.forms import SINGLE

SEED = 13
SIZE = 8.0
"""Multiples of the noise: so small that pushes which bend the base parameters hide themselves."""


@pytest.fixture(scope="module")
def free(recorded, experiment_of):
    """Makes an experiment with a free joint and its recalibrated model."""

    def make(effect: str, form: str, size: float, seed: int = SEED):
        experiment = experiment_of(recorded(effect, None, form, size, joint="free", seed=seed), "free")
        return experiment, refit(experiment, experiment.origin, rounds=6, renewals=2)

    return make


@pytest.fixture(scope="module")
def pushed(free):
    return disturbance.estimate(*free("external_torque", "smooth pushes", SIZE))


def test_pushes_are_found_when_they_were(pushed, rig) -> None:
    assert pushed is not None and pushed.explains
    assert pushed.episodes >= 2
    assert pushed.squares > 0.85
    assert pushed.shares[1] > 0.5
    form = next(form for form in SINGLE if form.name == "smooth pushes")
    push = form.make(SIZE, None, np.random.default_rng([SEED, 1])).push
    middle = (np.arange(len(pushed.torque)) + 0.5) * BLOCK_S
    true = push(middle)
    strong = np.abs(true) > 0.5 * np.abs(true).max()
    assert np.all(np.sign(pushed.torque[strong]) == np.sign(true[strong]))
    # Friction holds a joint against a part of a push: nobody can tell that part from the motion.
    error = np.sqrt(np.mean((pushed.torque - true) ** 2))
    assert error < 0.4 * np.sqrt(np.mean(true**2))
    quiet = true == 0.0
    assert np.mean(pushed.torque[quiet] != 0.0) < 0.1


def test_where_nothing_is_held_out_no_share_of_it_is_claimed(free) -> None:
    """The recordings that judge the model are others: they have pushes of their own, or none."""
    experiment, fitted = free("external_torque", "smooth pushes", SIZE)
    whole = replace(experiment, fitted=experiment.trial.whole_blocks(len(experiment.trial)))
    fitted = refit(whole, fitted.point, rounds=2, renewals=1)
    found = disturbance.beside_effects(Model((whole,), (fitted,)), Work())
    assert found is not None
    assert [effect.holdout_gain for effect in found[1].effects if effect.name == DISTURBANCE] == [None]


def test_a_law_that_always_holds_is_no_push(free) -> None:
    found = disturbance.estimate(*free("load_torque", "geared pendulum", 20.0))
    assert found is not None and not found.explains


def test_a_torque_that_returns_at_the_same_angle_is_no_push(free, pushed) -> None:
    found = disturbance.estimate(*free("cogging", "cogging", 20.0, seed=11))
    assert found is not None and found.episodes >= 2 and found.active < 0.5
    assert found.recurring > 0.8
    # It would have passed for pushes if it had explained more.
    all_of_it = replace(found, shares=(1.0, 1.0), squares=1.0)
    assert not all_of_it.explains
    assert replace(all_of_it, recurring=pushed.recurring).explains
    assert pushed.recurring < 0.3


def test_events_in_what_a_law_leaves_are_no_pushes(pushed) -> None:
    assert pushed.explains
    # Hysteresis, 82 % of whose squares were gone with a torque that came and went, had only a tenth of its level.
    assert not replace(pushed, shares=(0.1, 0.1)).explains
    assert not replace(pushed, squares=0.5).explains


def test_one_push_alone_may_have_been_anything(pushed) -> None:
    once = np.zeros_like(pushed.torque)
    once[100:150] = 0.2
    assert replace(pushed, torque=once).episodes == 1
    assert not replace(pushed, torque=once).explains


def test_a_locked_joint_shows_no_push(recorded, experiment_of) -> None:
    experiment = experiment_of(recorded(seconds=5.0), "locked")
    assert disturbance.estimate(experiment, refit(experiment, experiment.origin, rounds=0)) is None
