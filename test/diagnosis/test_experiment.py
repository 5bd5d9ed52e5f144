"""A recording made ready: noise, directions, derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.diagnosis.candidates import UNKNOWN_INPUT, Candidate, candidates
from pam_antagonist.diagnosis.experiment import Point, block_noise
from pam_antagonist.diagnosis.knobs import base_knobs
from pam_antagonist.diagnosis.refit import excess, refit
from pam_antagonist.diagnosis.simulation import BLOCK, blocks
from pam_antagonist.model.effects import CATALOGUE


def test_noise_is_told_from_what_changes_between_samples() -> None:
    rng = np.random.default_rng(0)
    slow = 1e5 * np.sin(np.arange(60000) / 3000.0)
    assert block_noise(slow + 600.0 * rng.standard_normal(60000)) == pytest.approx(600.0 / np.sqrt(BLOCK), rel=0.03)


def test_a_coarse_converter_does_not_average_out() -> None:
    slow = 0.2 * np.sin(np.arange(60000) / 9000.0)
    step = 1e-3
    noise = block_noise(np.rint(slow / step) * step)
    assert noise == pytest.approx(step / np.sqrt(12.0), rel=0.2)


def test_blocks_leave_out_what_is_missing() -> None:
    values = np.ones((40, 1))
    values[:5] = np.nan
    values[20:35] = np.nan
    assert blocks(values)[:, 0].tolist()[0] == 1.0
    assert np.isnan(blocks(values)[1, 0])


def test_a_slope_turns_the_force_map_about_the_middle(rig) -> None:
    knob = next(k for k in base_knobs(rig) if k.name == "muscle_1.force.v, slope")
    middle = rig.geometry.length
    assert knob.changes["muscle_1.force.v1"] * middle + knob.changes["muscle_1.force.v2"] == pytest.approx(
        0.0, abs=1e-18
    )


def test_a_locked_joint_tells_nothing_of_friction(rig, recorded, experiment_of) -> None:
    experiment = experiment_of(recorded(seconds=20.0), "locked")
    point = experiment.origin
    jacobian = experiment.jacobian(point, experiment.residual(point))
    dead = [k for k, knob in enumerate(experiment.knobs) if knob.name.startswith("friction.")]
    alive = [k for k, knob in enumerate(experiment.knobs) if knob.name == "valve_1.inflow_area"]
    assert dead and not np.any(jacobian[:, :, dead])
    assert np.any(jacobian[:, :, alive])


def test_a_model_that_runs_away_is_wrong_and_finite(recorded, experiment_of) -> None:
    experiment = experiment_of(recorded(seconds=20.0), "locked")
    far = Point(experiment.origin.theta, {"effects.thermal.share_1": 0.5, "effects.thermal.time": 1e-9})
    assert not np.all(np.isfinite(experiment.simulated(far)))
    assert np.all(np.isfinite(experiment.residual(far)))


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
    found = refit(experiment, begun, Candidate(effect).unknowns, base.base)
    before, after = (float(np.max(excess(experiment, fitted.residual))) for fitted in (base, found))
    assert before > 5.0
    assert after < 2.0


def test_every_effect_but_the_unknown_input_is_a_candidate() -> None:
    assert {c.effect for c in candidates({})} == set(CATALOGUE) - {UNKNOWN_INPUT}
    assert "leak" not in {c.effect for c in candidates({"effects.leak.area_1": 1e-9})}


@pytest.mark.parametrize("effect", sorted(set(CATALOGUE) - {UNKNOWN_INPUT}))
def test_coordinates_go_there_and_back(effect: str) -> None:
    for unknown in Candidate(effect).unknowns:
        value = unknown.item.scale
        assert unknown.value(unknown.coordinate(value)) == pytest.approx(value)
        assert unknown.item.low <= unknown.bounded(1e30) <= unknown.item.high
    assert Candidate(effect).sizes and Candidate(effect).grid()
