"""Fits reach their optimum from afar, and what one recording shows goes to the others that do not rule it out."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.diagnosis.models import Model, shared, without
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.standard_errors import well_known

DROOP = Candidate("supply_droop")
LEAK = Candidate("leak")
SIZE = "effects.leak.area_1"


@pytest.fixture(scope="module")
def drooping(recorded, experiment_of):
    """A locked joint behind a regulator, and its recalibrated model."""
    experiment = experiment_of(recorded("supply_droop", None, "regulator", 15.0, seed=5), "locked")
    return experiment, refit(experiment, experiment.origin)


def test_a_fit_gets_to_its_optimum_from_where_bold_steps_lead_nowhere(drooping) -> None:
    experiment, base = drooping
    values = {"effects.supply_droop.stiffness": 4e9, "effects.supply_droop.time": 0.03}
    fitted = refit(experiment, Point(base.point.theta, values), DROOP.free, renewals=4)
    # The regulator is another law than the catalogue's, which cannot leave nothing; stuck, it left four noises.
    assert np.max(experiment.times_noise(base.residual)) > 4.0
    assert np.max(experiment.times_noise(fitted.residual)) < 1.7


def test_a_fit_that_tries_steps_in_longer_steps_of_time_ends_with_the_exact_residual(drooping) -> None:
    experiment, base = drooping
    tried = []
    original = type(experiment).near
    point = Point(base.point.theta, {"effects.supply_droop.stiffness": 1e9, "effects.supply_droop.time": 0.3})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(experiment), "near", lambda self, *a: tried.append(original(self, *a)) or tried[-1])
        near = refit(experiment, point, DROOP.free, renewals=4)
    exact = refit(experiment, point, DROOP.free, renewals=4, near=False)
    assert tried and np.array_equal(near.residual, experiment.residual(near.point))
    assert near.cost == pytest.approx(exact.cost, abs=1.0)
    # Where that leads astray, it is noticed at the end, and the fit begins again with exact residuals.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(experiment), "near", lambda _self, _there, _point, residual: 0.8 * residual)
        misled = refit(experiment, point, DROOP.free, renewals=4)
    assert misled.cost == exact.cost


@pytest.fixture(scope="module")
def leaking(recorded, experiment_of):
    """A joint with a leak, locked and free, and one without: the first with a leak in its model, the others without."""

    def both(recording, joint):
        experiment = experiment_of(recording, joint)
        return experiment, refit(experiment, experiment.origin)

    locked = both(recorded("leak", 1, "seeping", 15.0, seed=3), "locked")
    free = both(recorded("leak", 1, "seeping", 15.0, seed=3, joint="free"), "free")
    tight = both(recorded(seed=3, joint="free"), "free")
    point = Point(locked[1].point.theta, {SIZE: 1e-10, "effects.leak.exponent": 1.0})
    shown = refit(locked[0], point, LEAK.free, renewals=4)
    return (locked[0], shown), free, tight


def test_what_one_recording_shows_the_other_gets(leaking) -> None:
    (locked, shown), (free, tight), _ = leaking
    model = shared(Model((locked, free), (shown, tight), ("leak",)))
    assert model.fits[0] is shown
    given = model.fits[1]
    assert given.point.effects[SIZE] == shown.point.effects[SIZE]
    assert given.free == tight.free
    before, after = (
        np.max(free.times_noise(free.held(free.residual(fitted.point, whole=True)))) for fitted in (tight, given)
    )
    assert after < 0.5 * before
    alone = without(model, "effects.leak.")
    assert all(SIZE not in fitted.point.effects for fitted in alone.fits)


def test_what_a_recording_rules_out_it_does_not_get(leaking) -> None:
    (locked, shown), _, (tight, fitted) = leaking
    model = shared(Model((locked, tight), (shown, fitted), ("leak",)))
    assert model.fits[1] is fitted


def test_what_base_parameters_imitate_is_known_no_better_than_they_are(experiment_of, recorded) -> None:
    # Forces, inertia and friction that are all larger move a free joint alike: their priors tell the meter's scale.
    experiment = experiment_of(recorded("none", joint="free", seconds=30.0, seed=103), "free")
    (free,) = next(one.free for one in experiment.calibrations({}) if one.effect == "torque_scale")
    fitted = refit(experiment, Point(experiment.origin.theta, {free.path: 0.0}), (free,), blocks_per_error=1.0)
    error = abs(fitted.point.effects[free.path])
    said, well = (
        float(np.sqrt(each.effect_covariance[0, 0])) * free.item.scale
        for each in (fitted, well_known(experiment, fitted))
    )
    assert error < 3.0 * well < 0.06
    # One-sided differences see information where there is none.
    assert error > 3.0 * said
