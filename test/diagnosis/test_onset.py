"""Effects that begin during a recording, and whether other splits agree on an effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.diagnosis import Diagnosis, change_point, diagnose, onset, splits, warnings
from pam_antagonist.diagnosis.hypotheses import Ranking, Work
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.preparation import Group
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, refit
from pam_antagonist.inference.point import THROUGHOUT, Point, Span
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

OFFSET = {"effects.pressure_sensor.offset_1": 5e3}
AREA = "effects.leak.area_1"
LEAK = {AREA: 3e-9, "effects.leak.exponent": 1.0}


@pytest.fixture(scope="module")
def quiet(recorded, experiment_of) -> Experiment:
    return experiment_of(recorded(seconds=20.0), "locked")


def with_effect(quiet: Experiment, effect: dict[str, float], span: Span) -> Experiment:
    """The recording with what an effect from then on adds to it."""
    points = (Point(quiet.origin.theta, effect), quiet.origin)
    with_it, without = (replace(quiet, span=span).simulated(point, whole=True) for point in points)
    return replace(quiet, trial=replace(quiet.trial, measured=quiet.trial.measured + with_it - without))


@pytest.fixture(scope="module")
def late(quiet) -> tuple[Experiment, Fitted]:
    experiment = with_effect(quiet, OFFSET, Span(15.0))
    return experiment, refit(experiment, experiment.origin, rounds=4, renewals=1)


def test_a_change_of_the_residual_is_found_where_it_is() -> None:
    rng = np.random.default_rng(3)
    residual = rng.standard_normal((1000, 3))
    residual[700:, 1] += 3.0
    assert change_point.above_noise(residual, np.ones(3)) == (pytest.approx(700, abs=3), 1000)
    residual[900:] = rng.standard_normal((100, 3))
    assert change_point.above_noise(residual, np.ones(3)) == (pytest.approx(700, abs=3), pytest.approx(900, abs=3))


def test_noise_alone_has_no_part_above_noise() -> None:
    rng = np.random.default_rng(4)
    found = [change_point.above_noise(rng.standard_normal((1000, 3)), np.ones(3)) for _ in range(50)]
    assert set(found) == {(0, 1000)}


def test_an_effect_that_begins_late_is_found_with_its_onset(late) -> None:
    experiment, fitted = late
    model = Model((experiment,), (fitted,))
    found = onset.begin_and_end(Group("joint", (experiment,), (0,)), Ranking(model, model), Work())
    assert found is not None
    assert found.model.effects == ("pressure_sensor",)
    when = found.model.experiments[0].span_of("pressure_sensor")
    assert when.begin_s == pytest.approx(15.0, abs=max(3.0 * when.std_s[0], 0.1))
    assert when.end_s == np.inf
    assert when.std_s[0] < 0.5
    point = found.model.fits[0].point
    shown = point.effects["effects.pressure_sensor.offset_1"] + 450e3 * point.effects["effects.pressure_sensor.gain_1"]
    assert shown == pytest.approx(5e3, rel=0.2)


def test_several_changes_are_told_with_their_times(quiet) -> None:
    changed = quiet
    for span in (Span(14.0, 15.0), Span(18.0)):
        changed = with_effect(changed, OFFSET, span)
    fitted = refit(changed, changed.origin, rounds=4, renewals=1)
    first, second = change_point.parts_above_noise(changed, fitted)
    assert (*first.limits, *second.limits) == pytest.approx((14.0, 15.0, 18.0, np.inf), abs=0.1)
    (said,) = warnings.changes({"locked": (first, second)})
    assert said.startswith(
        "locked: something that the model lacks begins at 14.0 s and ends at 15.0 s, then begins at 18.0 s; outside of"
    )


def test_a_recording_at_its_noise_has_no_onset(quiet) -> None:
    fitted = refit(quiet, quiet.origin, rounds=4, renewals=1)
    model = Model((quiet,), (fitted,))
    assert onset.begin_and_end(Group("joint", (quiet,), (0,)), Ranking(model, model), Work()) is None


def test_what_is_there_throughout_has_no_onset(quiet) -> None:
    experiment = with_effect(quiet, LEAK, THROUGHOUT)
    fitted = refit(experiment, experiment.origin, rounds=4, renewals=1)
    assert change_point.first_change(experiment, fitted) is None


def test_splits_agree_on_an_effect_that_is_there(quiet) -> None:
    experiment = with_effect(quiet, LEAK, THROUGHOUT)
    free = tuple(
        u for c in experiment.candidates({}) if c.effect == "leak" for u in c.free if u.path.endswith("area_1")
    )
    base = refit(experiment, experiment.origin, rounds=4, renewals=1)
    right = refit(experiment, Point(base.point.theta, LEAK), free, rounds=4, renewals=2)
    firm = splits.firmness(Model((experiment,), (right,), ("leak",)), {"leak": Model((experiment,), (base,))})["leak"]
    assert (firm.agree, len(firm.evidence)) == (5, 5)
    assert firm.is_firm and firm.in_words() == "5 of 5 splits agree"


def test_a_split_that_does_not_agree_is_named() -> None:
    firm = splits.Firmness((3.0, -1.0, 2.0, 4.0, -2.0), ((0, 12), (12, 24), (24, 36), (36, 48), (48, 60)))
    assert firm.is_firm
    assert firm.in_words() == "3 of 5 splits agree; those that hold out 12 to 24 s, 48 to 60 s disagree"
    assert not replace(firm, evidence=(3.0, -1.0, 2.0, -4.0, -2.0)).is_firm
    assert splits.in_words({"leak": firm, "creep": firm}).startswith("leak: 3 of 5")


def thinned(recording: Recording, every: int, jump: float = 0.0, begins: float = np.inf) -> Recording:
    """Every so many-th sample, with the first pressure sensor off by so much from some time [s] on."""
    count = len(recording.stamp_ns) // every * every
    last = np.arange(every - 1, count, every)
    late = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9 >= begins
    pressure = recording.pressure + np.column_stack([jump * late, 0.0 * late])
    return replace(
        recording,
        stamp_ns=recording.stamp_ns[last],
        pressure=pressure[last],
        voltage=recording.voltage[:count].reshape(-1, every, 2).mean(axis=1),
        angle=None if recording.angle is None else recording.angle[last],
        torque=None if recording.torque is None else recording.torque[last],
    )


def diagnosed(recording: Recording, rig: Rig) -> Diagnosis:
    return diagnose([recording], rig, joint="locked", jobs=1, profiles=False, estimator=False)


@pytest.mark.slow(4)
def test_a_sensor_that_jumps_in_the_held_out_part_is_found_at_250_hz(recorded, rig) -> None:
    found = diagnosed(thinned(recorded(seconds=20.0), 4, 5e3, 15.0), rig)
    (effect,) = found.effects
    assert (effect.name, effect.muscle) == ("pressure_sensor", 1)
    assert effect.onset_s == pytest.approx(15.0, abs=0.2)
    assert effect.end_s is None
    assert "from 15.0" in found.sentence
    assert found.by_recording[0].held_out_s is not None and len(found.by_recording[0].held_out_s) > 1
