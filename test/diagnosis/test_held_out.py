"""Whole recordings held out: what is judged by them, what of them is fitted, and which are refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pam_antagonist.diagnosis import diagnose, preparation
from pam_antagonist.diagnosis.agreement import base_contradictions
from pam_antagonist.diagnosis.held_out import innovation_evidence
from pam_antagonist.diagnosis.models import recalibrated
from pam_antagonist.diagnosis.preparation import Settings
from pam_antagonist.diagnosis.result import MODELS, HeldOutComparison
from pam_antagonist.diagnosis.splits import in_turn
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.replays import replay


@pytest.fixture(scope="module")
def pair(recorded):
    return [recorded("leak", 1, "seeping", 15.0, seconds=21.0, take=take) for take in (0, 1)]


@pytest.fixture(scope="module")
def judged(rig, pair):
    return diagnose([pair[0]], rig, joint="locked", held_out=[pair[1]], jobs=1, profiles=False, estimator=False)


@pytest.mark.slow(20)
def test_the_effect_is_judged_by_the_recording_that_no_fit_saw(judged) -> None:
    assert judged.verdict == "effect"
    assert (judged.effects[0].name, judged.effects[0].muscle) == ("leak", 1)
    assert judged.effects[0].recordings == (judged.by_recording[0].recording,)
    fitted, other = judged.by_recording
    assert (fitted.role, other.role) == ("fitted", "held out")
    assert fitted.errors is None and fitted.held_out_from_s is None
    before, after = (model.rmse_pa[0] for model in other.errors.all[1:])
    assert after < 0.3 * before
    # With nothing but that recording held out, the totals are its errors.
    assert judged.errors.extended.rmse_pa == pytest.approx(other.errors.extended.rmse_pa)
    assert [row.channel for row in other.residuals["extended"]][:2] == ["mass flow 1", "mass flow 2"]


def test_the_files_intervals_hold_what_no_fit_saw_and_the_report_says_how_they_were_without_it(rig, recorded) -> None:
    """Nothing explains this joint: what is fitted to its begin errs more at its end, under other voltages."""
    recording = recorded("bend", 1, "force bends with pressure", 8.0, joint="free", seconds=24.0)
    found = diagnose([recording], rig, joint="free", jobs=1, profiles=False, catalogue=False)
    entry, reported = found.by_recording[0], found.of_one_rig["extended"].ukf
    assert entry.ukf is not None and reported is not None and reported.angle == entry.ukf.extended.angle
    assert reported.angle is not None and (reported.angle.coverage95 or 0.0) < 0.9
    end = recording.slice((entry.held_out_from_s or 0.0) - preparation.START, recording.duration_s)
    now = replay(end, found.rig_extended, joint="free").report.ukf.angle
    assert now is not None and 0.93 < (now.coverage95 or 0.0)


def test_only_the_start_of_a_held_out_recording_is_fitted(judged) -> None:
    fitted, other = judged.compared
    assert fitted.experiment.fitted == len(fitted.experiment.trial)
    assert other.experiment.fitted * other.experiment.trial.dt == pytest.approx(preparation.START)
    count = len(other.experiment.directions)
    for model in ("recalibrated", "extended"):
        np.testing.assert_array_equal(other.points[model].theta[:count], fitted.points[model].theta[:count])
        assert other.points[model].effects == fitted.points[model].effects
        assert np.any(other.points[model].theta[count:])


def test_what_follows_the_start_does_not_change_it(rig, pair, experiment_of) -> None:
    whole = experiment_of(pair[1], "locked")
    start = dataclasses.replace(whole, fitted=5000)
    other = start.trial.measured.copy()
    other[5000:] *= 1.1
    bent = ValveDriven(rig, dataclasses.replace(start.trial, measured=other), 5000)
    np.testing.assert_allclose(start.started(start.origin).theta, bent.started(bent.origin).theta, rtol=0.2, atol=0.05)


def test_a_channel_that_was_not_measured_there_counts_as_noise(rig, pair) -> None:
    trials = [make_trial(recording, rig, "locked", 0.0, "a") for recording in pair]
    bare = dataclasses.replace(trials[1], measured=np.where([True, False, True, True], trials[1].measured, np.nan))
    (experiment,), _ = preparation.valve_driven_experiments(trials[:1], [bare], rig, 1.0 / 3.0, 0)
    held = experiment.held(experiment.residual(experiment.origin, whole=True))
    assert len(held) == (len(bare) - 5000) // 20
    assert experiment.times_noise(held)[0] == pytest.approx(1.0)
    assert np.all(experiment.times_noise(held)[1:] > 1.5)


def test_recordings_are_judged_by_those_of_the_same_condition(rig, recorded) -> None:
    trials = [make_trial(recorded(seconds=20.0, joint=j), rig, j, 0.0, j) for j in ("free", "locked")]
    (free, locked), held = preparation.valve_driven_experiments(trials, [trials[1]], rig, 1.0 / 3.0, 0)
    assert free.judged == () and locked.judged == held
    nothing = free.held(free.residual(free.origin, whole=True))
    assert len(nothing) == 0 and free.times_noise(nothing).tolist() == [1.0] * 4
    (alone,), held = preparation.valve_driven_experiments(trials[:1], [trials[1]], rig, 1.0 / 3.0, 0)
    assert alone.judged == held


def test_a_recording_cannot_judge_itself(rig, pair) -> None:
    with pytest.raises(BadInput, match="also among those that are fitted"):
        diagnose([pair[0]], rig, joint="locked", held_out=[dataclasses.replace(pair[0])], jobs=1)
    with pytest.raises(BadInput, match="given twice"):
        diagnose([pair[0]], rig, joint="locked", held_out=[pair[1], dataclasses.replace(pair[1])], jobs=1)


def test_a_held_out_recording_that_is_too_short_is_refused(rig, recorded, pair) -> None:
    with pytest.raises(BadInput, match="too short"):
        diagnose([pair[0]], rig, joint="locked", held_out=[recorded(seconds=12.0, take=2)], jobs=1)


def test_a_recording_that_seems_to_be_of_another_rig_is_a_sentence(rig, recorded, pair) -> None:
    """Valves that let in much more: no day makes that of a rig. A fit that left its priors says nothing."""
    sound = recorded(seconds=24.0)
    trial = make_trial(sound, rig, "locked", 0.0, "mine")
    theirs = make_trial(pair[1], rig, "locked", 0.0, "theirs")
    (experiment,), held = preparation.valve_driven_experiments([trial], [theirs], rig, 0.3, 0)
    base = recalibrated([experiment])
    assert base_contradictions(base, held) == []

    def said(shift: float) -> list[str]:
        theta = base.fits[0].point.theta.copy()
        theta[0] += shift
        far = dataclasses.replace(base.fits[0], point=dataclasses.replace(base.fits[0].point, theta=theta))
        return base_contradictions(dataclasses.replace(base, fits=(far,)), held)

    (sentence,) = said(0.4)
    assert "in theirs from that in mine; are both recordings of one rig?" in sentence
    assert said(2.0) == []


def test_the_innovations_of_held_out_samples_count_and_no_others(rig, pair) -> None:
    """With all blocks held out in turn, each sample counts once: the evidence is that of the whole recording."""
    settings = Settings("locked", jobs=1, profiles=False)
    prepared = preparation.prepare([pair[0]], [], rig, settings)
    (group,) = prepared.groups
    (experiment,) = group.experiments
    leaking = Point(experiment.origin.theta, {"effects.leak.area_1": 1e-9})

    def evidence(**cut) -> float:
        points = dict(zip(MODELS, (experiment.origin, experiment.origin, leaking), strict=True))
        part = HeldOutComparison(prepared, dataclasses.replace(experiment, **cut), points, "both", 0)
        return innovation_evidence([part], 1)

    count = len(experiment.trial) // experiment.trial.block
    turns = [evidence(fitted=len(experiment.trial), split=split) for split in in_turn(count, 2, 250.0, 0, 0)]
    assert all(abs(value) > 1.0 for value in turns)
    assert sum(turns) == pytest.approx(evidence(fitted=0))
