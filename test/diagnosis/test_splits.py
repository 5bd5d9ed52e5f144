"""Blocks that are held out in turn, effects that begin during a recording, and stretches above noise."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pam_antagonist.diagnosis import change_point, description
from pam_antagonist.diagnosis.hypotheses import Ranking, Work
from pam_antagonist.diagnosis.judgement import Case
from pam_antagonist.diagnosis.models import recalibrated
from pam_antagonist.diagnosis.preparation import Group
from pam_antagonist.diagnosis.splits import in_turn
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.point import THROUGHOUT, Point, Span

LEAK = {"effects.leak.area_1": 3e-8}


@pytest.fixture(scope="module")
def joint(recorded, experiment_of) -> Experiment:
    return experiment_of(recorded(seconds=12.0), "locked")


@pytest.mark.parametrize("edges", [(), (430,)])
def test_every_block_is_held_out_once_and_none_next_to_a_fitted_one(edges: tuple[int, ...]) -> None:
    splits = in_turn(600, 5, 60.0, 20, 0, edges)
    assert np.array_equal(sum(split.held.astype(int) for split in splits), np.ones(600))
    for split in splits:
        assert not np.any(split.fitted & split.held)
        gap = np.abs(np.flatnonzero(split.fitted)[:, None] - np.flatnonzero(split.held))
        assert gap.min() == 21
        assert 0.1 <= split.held[430:].mean() <= 0.3 or not edges


def test_what_is_fitted_and_held_out_are_the_blocks_of_the_split(joint) -> None:
    count = len(joint.trial) // joint.trial.block
    split = in_turn(count, 5, 100.0, 5, 0)[1]
    parted = replace(joint, fitted=count * joint.trial.block, split=split)
    whole = parted.residual(parted.origin, whole=True)
    assert np.array_equal(parted.residual(parted.origin), whole[split.fitted])
    assert np.array_equal(parted.held(whole), whole[split.held])
    fitted = refit(parted, parted.origin, rounds=2, renewals=1)
    assert fitted.residual.shape == (split.fitted.sum(), len(joint.channels))


def test_an_effect_acts_from_its_onset_on(joint) -> None:
    def shown(span: Span, effects: dict[str, float]) -> np.ndarray:
        return replace(joint, span=span).simulated(Point(joint.origin.theta, effects), whole=True)

    without, late, throughout = shown(THROUGHOUT, {}), shown(Span(5.0), LEAK), shown(THROUGHOUT, LEAK)
    assert np.array_equal(late[:5000], without[:5000])
    assert np.max(np.abs(late[5000:, 2] - without[5000:, 2])) > 1e3
    assert np.max(np.abs(late[:, 2] - throughout[:, 2])) > 1e3
    states, _ = replace(joint, span=Span(5.0)).states(Point(joint.origin.theta, LEAK))
    assert np.max(np.abs(np.diff(states[:, 2]))) < 3e3


def test_an_added_state_starts_settled_at_the_onset(joint) -> None:
    creep = {"effects.creep.share_1": 0.1, "effects.creep.time": 3.0}
    late = replace(joint, span=Span(5.0))
    point = Point(joint.origin.theta, creep)
    shown, states = late.simulated(point, whole=True), late.states(point)[0]
    assert np.isfinite(shown[:, 2:]).all() and np.isfinite(states).all()
    assert np.allclose(states[5000, 4:], states[4999, 4:], rtol=0.05)


def test_an_effect_that_ends_leaves_what_it_left_and_no_more(joint) -> None:
    def shown(spans: dict[str, Span], effects: dict[str, float]) -> np.ndarray:
        return replace(joint, spans=spans).simulated(Point(joint.origin.theta, effects), whole=True)

    offset = {"effects.pressure_sensor.offset_1": 5e3}
    without, both = (
        shown({}, {}),
        shown({"leak": Span(3.0, 6.0), "pressure_sensor": Span(8.0, 9.0)}, {**LEAK, **offset}),
    )
    apart = np.abs(both[:, 2] - without[:, 2])
    assert apart[:3000].max() == 0.0
    assert apart[4000:6000].min() > 1e3
    # The chamber fills again; the sensor is right at once.
    assert apart[7900] < 0.6 * apart[5999]
    steps = np.diff(both[:, 2] - without[:, 2])
    assert steps[[7999, 8999]] == pytest.approx([5e3, -5e3], abs=100.0)


def test_long_steps_see_the_same_phases(joint) -> None:
    late = replace(joint, spans={"leak": Span(3.0, 6.0)})
    point = Point(joint.origin.theta, LEAK)
    moved = Point(joint.origin.theta, {"effects.leak.area_1": 3.1e-8})
    (coarse,) = late.differences(point, late.residual(point), [moved])
    fine = late.residual(moved) - late.residual(point)
    assert np.max(np.abs(coarse - fine)) < 0.1 * np.max(np.abs(fine))


def test_what_was_held_out_is_named_in_seconds(joint) -> None:
    block = joint.trial.block
    split = in_turn(600, 2, 150.0, 10, 0)[1]
    parted = replace(joint, fitted=600 * block, split=split)
    assert parted.held_parts == (Span(3.0, 6.0), Span(9.0, 12.0))
    assert parted.held_samples.sum() == 6000
    assert joint.held_parts == (Span(joint.fitted * joint.trial.dt, 12.0),)


@pytest.fixture(scope="module")
def long(recorded, experiment_of) -> Experiment:
    return experiment_of(recorded(seconds=30.0), "locked")


def noise_of(long: Experiment, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((len(long.trial) // long.trial.block, len(long.channels))) * long.noise


def test_noise_alone_is_not_above_noise(long) -> None:
    assert all(change_point.clearest(long, noise_of(long, seed)) is None for seed in range(200))


@pytest.mark.parametrize(("begin", "end", "size"), [(4.0, 6.0, 4.0), (20.0, 30.0, 2.5)])
def test_a_stretch_above_noise_is_found_where_it_is(long, begin: float, end: float, size: float) -> None:
    residual = noise_of(long, 1)
    residual[int(begin * 50) : int(end * 50), 1] += size * long.noise[1]
    found = change_point.clearest(long, residual)
    assert found is not None
    assert found.channel == "Pressure 1"
    assert found.begin_s < end and found.end_s > begin
    assert found.end_s - found.begin_s <= 2.0 * (end - begin)


def test_a_noise_that_is_known_to_a_tenth_decides_nothing(long) -> None:
    assert change_point.clearest(long, 1.08 * noise_of(long, 2)) is None


def test_what_the_base_parameters_explain_is_not_above_noise(long) -> None:
    wrong = Point(long.origin.theta + 0.05 * np.eye(long.size)[0], {})
    assert change_point.clearest(long, long.residual(wrong, whole=True)) is not None
    assert change_point.stretches_above_noise([(long, wrong)], 1) == ()


def test_a_reading_that_is_rounded_is_off_by_half_a_step_while_the_joint_rests(recorded, experiment_of) -> None:
    """A joint with nothing wrong was unexplained: it rested for seconds near the edge of a step of its encoder."""
    free = experiment_of(recorded(joint="free", seconds=20.0), "free")
    step = np.radians(0.1)
    measured = free.trial.measured.copy()
    measured[:, 0] = step * np.rint(measured[:, 0] / step)
    rounded = replace(free, trial=replace(free.trial, measured=measured))
    assert rounded.noise_at_rest == pytest.approx(rounded.noise * [3.0**0.5, 1.0, 1.0, 1.0])
    residual = noise_of(rounded, 3)
    residual[400:600, 0] = 0.5 * step
    assert change_point.clearest(rounded, residual) is None
    residual[400:600, 0] = step
    found = change_point.clearest(rounded, residual)
    assert found is not None and found.channel == "Angle"


@pytest.fixture(scope="module")
def shaken(long) -> Case:
    """A joint at its noise, but for 2 s at its end in which the first pressure swings by some hundred pascals."""
    measured, time = long.trial.measured.copy(), long.trial.time
    swing = (time > 24.0) & (time < 26.0)
    measured[swing, 2] += 600.0 * np.sin(2.0 * np.pi * 3.0 * time[swing])
    experiment = replace(long, trial=replace(long.trial, measured=measured))
    base = recalibrated([experiment])
    group = Group("joint", base.experiments, (0,), ())
    prepared: Any = SimpleNamespace(holds_out_recordings=False)
    return Case(prepared, group, Ranking(base, base), Work())


def test_what_is_unexplained_has_channel_time_and_size(shaken: Case) -> None:
    assert not shaken.ranking.base.has_significant_excess and shaken.without_effects == "unexplained"
    judged = shaken.judged("unexplained", 0.0)
    (left,) = description.left(replace(judged, left=shaken.left))
    assert left.channel == "pressure 1" and left.times_noise > 2.0
    assert 23.5 <= left.begin_s <= 24.1 and 25.9 <= left.end_s <= 26.5
    assert left.bands["1 to 3 Hz"] + left.bands["3 to 10 Hz"] > 0.6
    assert re.fullmatch(r"pressure 1 in locked, \d\.\d times its noise from 24 to 26 s", left.in_short())
    assert {"begin_s", "end_s", "times_noise", "channel"} <= set(left.to_json())


def test_a_verdict_that_explains_nothing_never_leaves_nothing(shaken: Case) -> None:
    """Where effects fall away afterwards, the largest residual is named, though it is at the noise."""
    (left, *more) = description.left(shaken.judged("unexplained", 0.0))
    assert left.times_noise > 0.9 and left.end_s > left.begin_s and not more
    assert description.left(shaken.judged("none", 0.0)) == []


def test_how_a_joint_bounces_at_its_stop_decides_nothing(recorded, experiment_of) -> None:
    """A joint with nothing wrong was unexplained: at 700 °/s a bounce took another course than the model's."""
    free = experiment_of(recorded(joint="free", seconds=20.0), "free")
    without = free.simulated(free.origin, whole=True)
    stop = 0.97 * float(np.max(np.abs(without[:, 0])))
    free = replace(free, rig=free.rig.replaced(joint=free.rig.joint.replaced(stop=stop)))
    within = free.simulated(free.origin, whole=True)
    measured = within + free.noise * np.sqrt(free.trial.block) * np.random.default_rng(5).standard_normal(within.shape)
    hit = int(np.flatnonzero(np.abs(within[:, 0]) >= stop)[0])

    def stretches(begin: int) -> list[str]:
        wrong = measured.copy()
        wrong[begin : begin + 300, 0] += 0.02
        trial = replace(free.trial, measured=wrong)
        found = change_point.stretches_above_noise([(replace(free, trial=trial), free.origin)], 1)
        return [one.channel for one in found]

    assert stretches(hit) == []
    assert stretches(hit - 4000) == ["Angle"]
