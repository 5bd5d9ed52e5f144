"""Experiments where their right answer is known: rigs without mismatch, or with one mismatch alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.command import Mode
from pam_antagonist.control.tracking import tracking
from validation.paper import bench, control, influence, kappa, offline
from validation.paper.scenario import Hysteresis
from validation.paper.seed_work import SeedWork


def test_without_mismatch_only_the_sensors_noise_is_left(exact):
    work = SeedWork(exact, 3, seconds=20.0)
    found = offline.of_seed(work)
    sensors = work.rig.declared.sensors
    assert found["angle"]["model"]["rmse"] == pytest.approx(math.degrees(sensors.angle_std), rel=0.5)
    assert found["torque"]["model"]["rmse"] == pytest.approx(sensors.torque_std, rel=0.2)
    assert found["torque"]["default"]["rmse"] == pytest.approx(sensors.torque_std, rel=0.2)
    assert found["angle"]["default"]["nis_mean"] == pytest.approx(2.0, rel=0.15)
    # The published tuning takes the sensors for 17 times as noisy, and forgets that the joint sticks.
    assert found["angle"]["published"]["nis_mean"] < 0.02
    assert found["angle"]["published"]["rmse"] > 5.0 * found["angle"]["default"]["rmse"]


def test_a_mismatch_shows(scenario, exact):
    off, right = (offline.of_seed(SeedWork(item, 3, seconds=20.0)) for item in (scenario, exact))
    for quantity in ("angle", "torque"):
        assert off[quantity]["model"]["ratio"] > 5.0 * right[quantity]["model"]["ratio"]


def test_the_static_test_gives_the_muscles_own_map_back(scenario):
    steady = scenario.static.replaced(force_std=0.0)
    for amplitude, allowed in ((0.0, 1e-6), (3.0, 0.05)):
        loop = Hysteresis(amplitude=amplitude, spread=0.0, width=2e-3)
        case = scenario.replaced(static=steady, mismatch=scenario.mismatch.replaced(hysteresis=loop))
        work = SeedWork(case, 5)
        for which, fit in zip((1, 2), bench.static_fits(work, "linear"), strict=True):
            true = bench.true_map(work, which)
            found = dict(zip(fit.names, fit.coefficients, strict=True))
            for name, value in true.items():
                # Both ways are measured, so the loop cancels; what it leaves is seen in the residuals.
                assert found[name] == pytest.approx(value, rel=1e-6), name
            assert fit.fitted_rmse == pytest.approx(amplitude, abs=allowed)


def test_three_steps_bring_back_a_curve_that_is_off(scenario):
    # With the curve alone off, the declared model's first step is right and the curve comes back.
    alone = scenario.mismatch.replaced(parameters=0.0)
    found = kappa.of_seed(SeedWork(scenario.replaced(mismatch=alone), 2))
    assert found["levels"] == len(kappa.LEVELS)
    assert found["declared"]["largest"] > 0.02
    assert found["found"]["largest"] < 0.1 * found["declared"]["largest"]


def test_proposition_and_guideline_by_computation(scenario):
    rig = SeedWork(scenario, 0).rig.declared
    base = influence.response(rig, {})
    areas = influence.response(rig, dict.fromkeys(influence.AREAS, 1.5))
    shaft = influence.response(rig, {"friction.shaft": 1.5})
    assert areas.pressures == pytest.approx(base.pressures, abs=1.0)
    assert areas.slow_angle == pytest.approx(base.slow_angle, abs=1e-6)
    assert areas.angle_time < 0.8 * base.angle_time
    assert shaft.pressures == pytest.approx(base.pressures, abs=1.0)
    assert shaft.slow_angle < base.slow_angle - math.radians(0.2)
    # A joint that is thrown sticks elsewhere: what the proposition leaves out.
    assert np.max(np.abs(np.subtract(areas.pulse_angles, base.pulse_angles))) > math.radians(0.5)


def test_the_loop_in_one_process_follows_torque(exact):
    work = SeedWork(exact, 1)
    wanted, measured, estimated = control.closed_loop(work, Mode.TORQUE, "default")
    steps, seconds = control.references(Mode.TORQUE)
    assert len(wanted) == round(seconds * 1000)
    assert sorted(set(wanted)) == sorted({value for _, value in steps})
    stamps = np.arange(len(wanted), dtype=np.int64) * 1_000_000
    assert tracking(stamps, wanted, measured).performance > 0.98
    assert np.sqrt(np.mean((estimated - measured) ** 2)) < 0.015
