"""A recording made ready: noise, directions, derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.estimation.divergence import DIVERGED
from pam_antagonist.inference.free_parameters import Candidate, base_directions, candidates
from pam_antagonist.inference.free_run import stride_blocks
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import PRESSURE_1, block_noise, blocks, make_trial
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE


def test_noise_is_told_from_what_changes_between_samples() -> None:
    rng = np.random.default_rng(0)
    slow = 1e5 * np.sin(np.arange(60000) / 3000.0)
    assert block_noise(slow + 600.0 * rng.standard_normal(60000), 20) == pytest.approx(600.0 / np.sqrt(20), rel=0.03)


def test_a_coarse_converter_does_not_average_out() -> None:
    slow = 0.2 * np.sin(np.arange(60000) / 9000.0)
    step = 1e-3
    noise = block_noise(np.rint(slow / step) * step, 20)
    assert noise == pytest.approx(step / np.sqrt(12.0), rel=0.2)


def test_a_converter_is_seen_where_a_joint_jumps_over_most_of_its_levels() -> None:
    step, rng = 1.745e-4, np.random.default_rng(4)
    levels = np.cumsum(rng.choice([1, 2, 3, 5, 8], 300))
    assert block_noise(step * np.repeat(levels, 40), 20) == pytest.approx(step / np.sqrt(12.0), rel=0.2)


def test_blocks_leave_out_what_is_missing() -> None:
    values = np.ones((40, 1))
    values[:5] = np.nan
    values[20:35] = np.nan
    assert blocks(values, 20)[:, 0].tolist()[0] == 1.0
    assert np.isnan(blocks(values, 20)[1, 0])


def test_a_slope_turns_the_force_map_about_the_middle(rig) -> None:
    direction = next(k for k in base_directions(rig) if k.name == "muscle_1.force.v, slope")
    middle = rig.geometry.length
    assert direction.adds["muscle_1.force.v1"] * middle + direction.adds["muscle_1.force.v2"] == pytest.approx(
        0.0, abs=1e-18
    )


def test_a_recording_may_start_while_its_muscles_fill(rig) -> None:
    voltage = np.full((60, 2), (7.4, 4.4))
    exact = simulate(rig, voltage, joint="locked", noise=False).pressure[0]
    deviations = []
    for seed in range(30):
        trial = make_trial(simulate(rig, voltage, joint="locked", seed=seed), rig, "locked", 0.0, "filling")
        experiment = ValveDriven(rig, trial, trial.whole_blocks(len(trial)))
        first, sample = experiment.first, np.hypot(rig.sensors.pressure_std, rig.sensors.pressure_step / np.sqrt(12.0))
        deviations.append((first.pressure - exact) / (sample * first.share))
        # Clocks need not agree to a sample: the faster a pressure changes, the less is known of its start.
        rate = np.abs(np.polyfit(trial.time, trial.measured[:, PRESSURE_1:], 1)[0])
        assert experiment.start_std[1:] == pytest.approx(np.hypot(sample * first.share, 0.02 * rate), rel=1e-3)
    assert np.abs(np.mean(deviations, axis=0)).max() < 0.7
    assert np.std(deviations) == pytest.approx(1.0, abs=0.3)


def test_a_locked_joint_tells_nothing_of_friction(rig, recorded, experiment_of) -> None:
    experiment = experiment_of(recorded(seconds=20.0), "locked")
    point = experiment.origin
    jacobian = experiment.jacobian(point, experiment.residual(point))
    dead = [k for k, direction in enumerate(experiment.directions) if direction.name.startswith("friction.")]
    alive = [k for k, direction in enumerate(experiment.directions) if direction.name == "valve_1.inflow_area"]
    assert dead and not np.any(jacobian[:, :, dead])
    assert np.any(jacobian[:, :, alive])


def test_a_model_that_runs_away_is_wrong_and_finite(recorded, experiment_of) -> None:
    experiment = experiment_of(recorded(seconds=20.0), "locked")
    far = Point(experiment.origin.theta, {"effects.thermal.share_1": 0.5, "effects.thermal.time": 1e-9})
    assert not np.all(np.abs(experiment.simulated(far)) < DIVERGED)
    # Not one sample is left out from there on, and none looks right.
    residual = experiment.residual(far)
    assert np.all(np.isfinite(residual)) and np.all(np.abs(residual[1:]) > 1e3 * experiment.noise)


@pytest.mark.parametrize("stride", [2, 4])
def test_means_over_blocks_are_told_from_every_few_samples(stride) -> None:
    time = np.arange(401) * 1e-3
    values = np.column_stack([time, np.sin(10.0 * time)])
    told = stride_blocks(values[::stride], stride, 20, 20)
    assert told[:, 0] == pytest.approx(blocks(values, 20)[:, 0], abs=1e-12)
    assert told[:, 1] == pytest.approx(blocks(values, 20)[:, 1], abs=2e-4)


def _differences(experiment, effects, moves):
    """Changes of the residual as derivatives are told from, and by the model itself; in noises."""
    point = Point(experiment.origin.theta, effects)
    residual = experiment.residual(point)
    moved = [Point(point.theta, {**effects, **move}) for move in moves]
    told = experiment.differences(point, residual, moved)
    return [
        (t / experiment.noise, (experiment.residual(m) - residual) / experiment.noise)
        for t, m in zip(told, moved, strict=True)
    ]


@pytest.mark.parametrize("joint", ["free", "locked"])
def test_derivatives_need_no_steps_as_fine_as_the_model(recorded, experiment_of, joint) -> None:
    experiment = experiment_of(recorded(seconds=30.0, joint=joint), joint)
    effects = {"effects.valve_lag.time_2": 0.02, "effects.creep.share_1": 0.05}
    moves = [
        {"effects.valve_lag.time_2": 0.022},
        {"effects.creep.share_1": 0.06},
        {"effects.pressure_sensor.offset_1": 300.0},
        {"effects.leak.area_1": 1e-9},
        {"effects.friction.coulomb": 0.01},
    ]
    for told, own in _differences(experiment, effects, moves):
        assert np.linalg.norm(told - own) <= 0.03 * np.linalg.norm(own)
        # Longer steps were taken: or there would be no difference at all.
        assert not np.any(own) or np.any(told != own)


@pytest.mark.parametrize(
    ("effects", "move"),
    [
        ({}, {"effects.valve_lag.time_1": 1e-3, "effects.valve_lag.reach": 0.2}),
        ({"effects.valve_lag.time_1": 8e-4}, {"effects.valve_lag.time_1": 9e-4}),
        ({"effects.valve_lag.time_1": 8e-4}, {"effects.valve_lag.time_1": 8e-3}),
        (
            {"effects.line_resistance.resistance_1": 5e9, "effects.line_resistance.time": 1e-3},
            {"effects.leak.area_1": 1e-9},
        ),
    ],
)
def test_what_is_too_quick_for_longer_steps_is_not_simulated_in_them(recorded, experiment_of, effects, move) -> None:
    experiment = experiment_of(recorded(seconds=20.0), "locked")
    ((told, own),) = _differences(experiment, effects, [move])
    assert np.any(own)
    assert np.array_equal(told, own)


@pytest.mark.parametrize(
    ("effect", "form", "start"),
    [
        ("valve_lag", "limited slew", {"time_2": 0.1, "reach": 0.05}),
        ("line_resistance", "turbulent line", {"resistance_2": 1e8, "exponent": 1.5}),
    ],
)
def test_what_acts_from_the_first_sample_on_is_fitted(recorded, experiment_of, effect, form, start) -> None:
    """A recording that begins while a muscle fills: a wrong first state would stay for seconds."""
    recording = recorded(effect, 2, form, 10.0, seed=20)
    assert np.ptp(recording.pressure[:200, 1]) > 5e3
    experiment = experiment_of(recording, "locked")
    base = refit(experiment, experiment.origin, rounds=6)
    begun = Point(base.point.theta, {f"effects.{effect}.{name}": value for name, value in start.items()})
    found = refit(experiment, begun, Candidate(effect).free, base.base)
    before, after = (float(np.max(experiment.times_noise(fitted.residual))) for fitted in (base, found))
    assert before > 5.0
    assert after < 2.0


def test_every_effect_but_the_unknown_input_is_a_candidate() -> None:
    with_valves = {name for name, effect in CATALOGUE.items() if "valve" in effect.tested_with}
    assert {c.effect for c in candidates({})} == with_valves - {DISTURBANCE}
    assert "leak" not in {c.effect for c in candidates({"effects.leak.area_1": 1e-9})}


@pytest.mark.parametrize("effect", sorted(set(CATALOGUE) - {DISTURBANCE}))
def test_coordinates_go_there_and_back(effect: str) -> None:
    for unknown in Candidate(effect).free:
        value = unknown.item.scale
        assert unknown.value(unknown.coordinate(value)) == pytest.approx(value)
        assert unknown.item.low <= unknown.bounded(1e30) <= unknown.item.high
    assert Candidate(effect).sizes and Candidate(effect).grid()
