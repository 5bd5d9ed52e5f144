"""Predictions over short spans, of a joint that sticks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.short_runs import ShortRuns, in_short_runs
from pam_antagonist.inference.trial import ANGLE
from pam_antagonist.inference.valve_driven import ValveDriven
from pam_antagonist.model import muscle
from pam_antagonist.model import parameters as par

FRICTION = {
    "effects.friction.coulomb": 0.01, "effects.friction.stribeck": 0.08, "effects.friction.velocity": 0.1
}  # fmt: skip


@pytest.fixture(scope="module")
def free_run(recorded, experiment_of) -> ValveDriven:
    """A joint as configured, with friction that falls with speed and the noise of its sensors."""
    quiet = experiment_of(recorded(joint="free", seconds=20.0), "free")
    noise = np.random.default_rng(1).standard_normal((len(quiet.trial), 4)) * [2e-4, 5e-3, 300.0, 300.0]
    made = quiet.simulated(Point(quiet.origin.theta, FRICTION), whole=True) + noise
    return replace(quiet, trial=replace(quiet.trial, measured=made))


def test_a_joint_that_sticks_is_predicted_over_spans_and_another_is_not(free_run, recorded, experiment_of) -> None:
    assert isinstance(in_short_runs(free_run), ShortRuns)
    locked = experiment_of(recorded(seconds=20.0), "locked")
    assert in_short_runs(locked) is locked
    moving = replace(free_run.trial, measured=free_run.trial.measured.copy())
    moving.measured[:, ANGLE] += 0.05 * np.sin(np.arange(len(moving)) / 50.0)
    slides = replace(free_run, trial=moving)
    assert in_short_runs(slides) is slides


def right(experiment: Experiment, point: Point) -> float:
    """Share of all blocks in which the angle is right to a twentieth of a degree."""
    shown = experiment.trial.blocks(experiment.simulated(point, whole=True))
    return float(np.mean(np.abs(shown[:, ANGLE] - experiment.measured[:, 0]) < np.radians(0.05)))


def test_a_model_that_is_nearly_right_shows_the_angle_over_spans_and_not_for_long(free_run) -> None:
    nearly = Point(free_run.origin.theta, {**FRICTION, "effects.friction.stribeck": 0.084})
    assert right(free_run, nearly) < 0.7
    assert right(in_short_runs(free_run), nearly) > 0.85


def test_friction_decides_over_spans(free_run) -> None:
    spans = in_short_runs(free_run)
    assert isinstance(spans, ShortRuns)
    assert spans.right(Point(spans.origin.theta, FRICTION)) > 0.9
    assert spans.right(spans.origin) < 0.6


def test_an_error_counts_by_its_logarithm(free_run) -> None:
    spans = in_short_runs(free_run)
    off = spans.measured + np.array([[2.0], [2000.0]]).repeat(len(spans.measured) // 2 + 1, axis=0)[
        : len(spans.measured)
    ] * spans.noise  # fmt: skip
    left = np.abs(spans.residual_of(off) / spans.noise)
    assert left[0] == pytest.approx(np.arcsinh(2.0))
    assert left[-1] == pytest.approx(np.arcsinh(2000.0))


def test_what_a_start_moves_the_angle_compresses_the_air(free_run) -> None:
    spans = in_short_runs(free_run)
    # Without friction at all the model is far from where the next span begins.
    states, _ = spans.states(spans.origin)
    jumps = np.flatnonzero(np.abs(np.diff(states[:, ANGLE])) > np.radians(0.2))
    assert len(jumps) > 3
    p = spans.vector
    for k in jumps:
        for i in (0, 1):
            before, after = (
                muscle.volume(i, muscle.length(i, np.sin(angle), p), p)[0] for angle in states[k : k + 2, ANGLE]
            )
            compressed = (before / after) ** p[par.POLYTROPIC_VOLUME]
            # Within a millisecond air flows as well, some hundred pascals at most.
            assert states[k + 1, 2 + i] == pytest.approx(states[k, 2 + i] * compressed, abs=400.0)


def test_a_report_shows_the_model_that_runs_by_itself(free_run) -> None:
    shown = in_short_runs(free_run).free_run
    point = Point(free_run.origin.theta, FRICTION)
    assert np.array_equal(shown.simulated(point), free_run.simulated(point))
