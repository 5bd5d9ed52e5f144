"""Friction of joints that stick, which decides along the measured motion."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from pam_antagonist import load_rig, simulate
from pam_antagonist.diagnosis import judgement, law_evidence
from pam_antagonist.diagnosis.hypotheses import Ranking, Work
from pam_antagonist.diagnosis.law_search import search
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.measured_motion import MeasuredMotion, along_motion
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.rig.learned import Law


@pytest.fixture
def asked(recorded, experiment_of) -> Callable[..., Ranking | None]:
    """Looks for friction in a free recording of a joint."""

    def ask(effect: str, form: str, amount: float) -> Ranking | None:
        experiment = experiment_of(recorded(effect, None, form, amount, "free", 20.0), "free")
        base = Model((experiment,), (refit(experiment, experiment.origin, rounds=4, renewals=1),))
        return judgement.friction_along_motion(Ranking(base, base), Work())

    return ask


def test_friction_that_falls_with_speed_is_found(asked) -> None:
    found = asked("friction", "stribeck", 20.0)
    assert found is not None
    assert isinstance(found.model.experiments[0], MeasuredMotion)
    assert found.model.effects == ("friction",)
    # Fitted at the noise, and still with priors that weigh as much as without it.
    paces = [model.fits[0].scale.blocks_per_error for model in (found.base, found.model)]
    assert paces[0] == paces[1]
    values = found.model.fits[0].point.effects
    # 0.09 N m times 1.2 at rest.
    at_rest = values.get("effects.friction.coulomb", 0.0) + values.get("effects.friction.stribeck", 0.0)
    assert at_rest == pytest.approx(0.108, rel=0.1)


def test_friction_that_a_rig_of_regulators_declares_is_no_candidate() -> None:
    rig = load_rig("regulator_joint", regulators=True).with_value("effects.friction.coulomb", 0.5)
    rng = np.random.default_rng(2)
    asked = np.repeat(2.5e5 + 5e4 * rng.standard_normal((20, 2)), round(1.0 / rig.sample_period), axis=0)
    trial = make_trial(simulate(rig, asked, joint="free", seed=1), rig, "free", 0.0, "free")
    experiment = ValveDriven(rig, trial, len(trial) * 2 // 3)
    assert isinstance(along_motion(experiment), MeasuredMotion)
    base = Model((experiment,), (refit(experiment, experiment.origin, rounds=4, renewals=1),))
    assert judgement.friction_along_motion(Ranking(base, base), Work()) is None


@pytest.mark.slow(4)
def test_friction_of_another_form_is_found(asked) -> None:
    found = asked("friction", "hess and soom", 10.0)
    assert found is not None
    assert found.model.effects == ("friction",)


def test_exchanged_air_is_not_called_friction(asked) -> None:
    assert asked("exchange", "chambers exchange air", 8.0) is None


@pytest.mark.thorough(19)
def test_cogging_is_learned_as_a_torque_by_the_angle(recorded, experiment_of) -> None:
    experiment = along_motion(experiment_of(recorded("cogging", None, "cogging", 16.0, "free", 40.0), "free"))
    assert isinstance(experiment, MeasuredMotion)
    base = Model((experiment,), (refit(experiment, experiment.origin, rounds=4, renewals=1),))
    found = search(base, lambda text: None)
    law = found.law
    assert law is not None
    assert (law.place, law.argument, law.operator) == ("torque", "angle", "none")
    # It pulls to and fro on the way, and not to one side as a spring does.
    assert len({value > 0.0 for value in law.values}) == 2
    swings = [a * b < 0.0 for a, b in itertools.pairwise(law.values)]
    assert sum(swings) >= 3
    # A law that held-out data do not show is not taken.
    assert not law_evidence.is_better(base, base, base, law)


@pytest.mark.slow(8)
def test_where_a_bearing_sticks_friction_is_learned_by_the_angle(recorded, experiment_of) -> None:
    made = recorded("stick", None, "bearing that sticks near an angle", 8.0, "free", 40.0)
    experiment = along_motion(experiment_of(made, "free"))
    base = Model((experiment,), (refit(experiment, experiment.origin, rounds=4, renewals=1),))
    law = search(base, lambda text: None).law
    assert law is not None
    assert (law.place, law.argument, law.operator) == ("friction", "angle", "none")
    # True: 0.08 N m more at -0.048 rad, within 0.048 rad to either side.
    assert -0.07 < law.nodes[int(np.argmax(law.values))] < -0.03
    assert 0.06 < max(law.values) < 0.1
    assert abs(law.values[0]) < 0.01 and abs(law.values[-1]) < 0.01
    model = law_evidence.with_it(base, law)
    assert law_evidence.is_better(base, base, model, law)
    assert not law_evidence.is_better(base, base, base, law)


def test_friction_is_judged_with_the_standstill_and_other_laws_without(recorded, experiment_of) -> None:
    made = recorded("stick", None, "bearing that sticks near an angle", 8.0, "free", 20.0)
    both = experiment_of(recorded(seconds=20.0), "locked"), along_motion(experiment_of(made, "free"))
    model = Model(both, tuple(refit(one, one.origin, rounds=1, renewals=1) for one in both))
    for place, sliding in (("friction", False), ("torque", True)):
        (judged,) = law_evidence.acting(Law(place, (0.0,), (0.01,)), model).experiments
        assert isinstance(judged, MeasuredMotion)
        assert judged.sliding is sliding
    known = [np.isfinite(one.experiments[0].measured_samples).sum() for one in law_evidence.parts(model)[:2]]
    assert known[0] > known[1] > 0
