"""Which parameters a fit may move, and how far; zeros, scales and late stamps of sensors."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.inference import calibration, free_run, valve_driven
from pam_antagonist.inference.expected import with_known_curves
from pam_antagonist.inference.free_parameters import base_directions, free_parameters, moved
from pam_antagonist.inference.gauss_newton import refit
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.model import flow
from pam_antagonist.model import parameters as par


def test_priors_and_bounds_are_those_of_the_rig_file(rig):
    own = rig.replaced(priors={"friction.shaft": 0.03}, bounds={"friction.shaft": (0.1, 0.25)})
    by_name = {item.name: item for item in free_parameters(own)}
    shaft = by_name["friction.shaft"]
    assert (shaft.start, shaft.prior_std, shaft.low, shaft.high) == (0.2, pytest.approx(0.03), 0.1, 0.25)
    area = by_name["valve_1.inflow_area"]
    assert area.prior_std == pytest.approx(0.05 * area.start)
    assert area.low < area.start < area.high


def test_what_can_be_measured_directly_is_kept_unless_it_is_freed(rig):
    names = {item.name for item in free_parameters(rig)}
    assert "geometry.radius" not in names and "atmosphere.pressure" not in names
    assert "atmosphere.pressure" in {item.name for item in free_parameters(rig, free=["atmosphere.pressure"])}
    fewer = {item.name for item in free_parameters(rig, frozen=["muscle_1.force"])}
    assert names - fewer == {f"muscle_1.force.{name}" for name in ("v1", "v2", "w1", "w2")}


def test_a_shift_of_a_curve_that_the_file_expects_is_a_base_parameter(rig, experiment_of, recorded) -> None:
    path, std = "effects.valve_offset.voltage_2", 0.4
    expecting = rig.replaced(priors={path: std})
    (item,) = [item for item in free_parameters(expecting) if item.name == path]
    assert (item.start, item.prior_std, item.low, item.high) == (0.0, std, -2.0, 2.0)
    (direction,) = [direction for direction in base_directions(expecting) if direction.name == path]
    assert direction.prior == std and direction.in_words(0.25) == "+0.25 V"
    # What is expected is no fault: it is not looked for among the effects.
    experiment = experiment_of(recorded(seconds=5.0), "locked")
    for own, among in ((rig, True), (expecting, False)):
        names = {candidate.effect for candidate in dataclasses.replace(experiment, rig=own).candidates({})}
        assert ("valve_offset" in names) is among


def test_a_curve_that_is_known_is_shifted_itself(rig) -> None:
    path = "effects.valve_offset.voltage_2"
    expecting = rig.replaced(priors={path: 0.4, "friction.shaft": 0.01})
    found = moved(expecting, {path: 0.3})
    known = with_known_curves(found, expecting)
    assert known.effects == {} and dict(known.priors) == {"friction.shaft": 0.01}
    p, q = found.parameters(), known.parameters()
    for voltage in (0.1, 4.9, 5.0, 6.4, 9.9):
        assert flow.open_rate(1, voltage, q) == pytest.approx(flow.open_rate(1, voltage, p), abs=1e-12)
        assert flow.open_rate(0, voltage, q) == flow.open_rate(0, voltage, p)
    # A shift that the file declares already stays the effect that it is.
    declared = rig.replaced(effects={"valve_offset": {"voltage_2": 0.1}}, priors={path: 0.4})
    assert with_known_curves(moved(declared, {path: 0.3}), declared).effects == {"valve_offset": {"voltage_2": 0.3}}


def test_a_name_that_is_none_is_refused_with_a_hint(rig):
    with pytest.raises(BadInput, match=r"did you mean 'friction\.shaft'"):
        free_parameters(rig, free=["friction.shft"])
    with pytest.raises(BadInput, match="nothing is left"):
        free_parameters(rig, frozen=[name.partition(".")[0] for name in par.INDEX])


DT = 1e-3
EACH = free_run.predict_each
ALL = {
    "encoder_zero": 0.01, "torque_zero": -0.2, "torque_scale": 0.03, "delay_voltage": 0.0304, "delay_torque": -0.002,
}  # fmt: skip


def waves(time: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(2.0 * time + k) for k in range(4)])


def test_sensors_show_zeros_scales_and_what_was_earlier_or_later() -> None:
    time = np.arange(3000) * DT
    shown = calibration.readings(waves(time), DT, ALL)
    inside = slice(100, -100)
    assert shown[inside, ANGLE] == pytest.approx(waves(time - 0.0304)[inside, ANGLE] + 0.01, abs=1e-6)
    assert shown[inside, PRESSURE_1] == pytest.approx(waves(time - 0.0304)[inside, PRESSURE_1], abs=1e-6)
    assert shown[inside, TORQUE] == pytest.approx(1.03 * waves(time - 0.0324)[inside, TORQUE] - 0.2, abs=1e-6)
    # The model says nothing of the time before it starts.
    assert np.isnan(shown[:31, ANGLE]).all() and np.isfinite(shown[31:, ANGLE]).all()


def test_a_corrected_trial_is_that_of_exact_sensors() -> None:
    time = np.arange(3000) * DT
    values = {**ALL, "delay_angle": 0.005}
    # Voltages that are stamped early hold what they will be.
    shown = calibration.readings(waves(time), DT, {k: v for k, v in values.items() if k != "delay_voltage"})
    trial = Trial("one", "free", 0.0, DT, waves(time + 0.0304)[:, :2], shown)
    back = calibration.corrected(trial, values)
    inside = slice(100, -100)
    assert back.measured[inside] == pytest.approx(waves(time)[inside], abs=1e-5)
    assert back.voltage[inside] == pytest.approx(waves(time)[inside, :2], abs=1e-5)


def test_the_angle_of_a_locked_joint_moves_with_the_zero_of_its_encoder() -> None:
    measured = np.tile([np.radians(3.02), 0.0, 4e5, 4e5], (100, 1))
    trial = Trial("one", "locked", np.radians(3.0), DT, np.zeros((100, 2)), measured)
    assert calibration.is_lock_measured(trial)
    assert calibration.corrected(trial, {"encoder_zero": 0.01}).lock_angle == pytest.approx(np.radians(3.0) - 0.01)
    told = Trial("one", "locked", 0.0, DT, np.zeros((100, 2)), measured)
    assert not calibration.is_lock_measured(told)
    assert calibration.corrected(told, {"encoder_zero": 0.01}).lock_angle == 0.0


def test_only_what_a_recording_can_show_is_a_candidate(experiment_of, recorded) -> None:
    locked = experiment_of(recorded("none", joint="locked", seconds=10.0), "locked")
    names = [candidate.effect for candidate in locked.calibrations({})]
    assert names == ["encoder_zero", "torque_zero", "torque_scale", "delay_voltage", "delay_torque", "delay_pressure"]
    # Two of three clocks say all: the third is what they are compared with.
    late = {calibration.path("delay_voltage"): 0.01, calibration.path("delay_torque"): 0.01}
    assert not any(candidate.effect.startswith("delay") for candidate in locked.calibrations(late))


def test_a_fit_finds_calibrations_beside_the_base_parameters(experiment_of, recorded) -> None:
    experiment = experiment_of(recorded("none", joint="locked", seconds=15.0), "locked")
    values = {"torque_zero": 1.0, "delay_voltage": 0.012}
    shown = calibration.readings(experiment.trial.measured, DT, values)
    wrong = replace(experiment, trial=replace(experiment.trial, measured=shown))
    free = tuple(one for candidate in wrong.calibrations({}) if candidate.effect in values for one in candidate.free)
    point = Point(wrong.origin.theta, {one.path: 0.0 for one in free})
    fitted = refit(wrong, point, free)
    found = calibration.values_of(fitted.point.effects)
    assert found["delay_voltage"] == pytest.approx(0.012, abs=1e-3)
    # The force map has a prior, and gives way a little.
    assert found["torque_zero"] == pytest.approx(1.0, abs=0.3)
    assert np.max(wrong.times_noise(fitted.residual)) < 1.2


def test_calibrations_are_tried_on_one_simulation(experiment_of, recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = recorded("none", joint="locked", seconds=10.0)
    experiment, fresh = experiment_of(recording, "locked"), experiment_of(recording, "locked")
    runs = []
    monkeypatch.setattr(valve_driven, "predict_each", lambda _, models, *a: runs.extend(models) or EACH(_, models, *a))
    for values in ({}, {"torque_zero": 0.1}, {"delay_torque": 0.01, "torque_scale": 0.02}):
        point = Point(np.zeros(experiment.size), {f"calibration.{name}": value for name, value in values.items()})
        assert np.array_equal(experiment.simulated(point), fresh.simulated(point), equal_nan=True)
        fresh._recent.clear()
    assert len(runs) == 1 + 3
    moved = np.zeros(experiment.size)
    moved[0] = 0.5
    other = experiment.simulated(Point(moved, {}))
    assert not np.array_equal(other, experiment.simulated(Point(np.zeros(experiment.size), {})))
    assert len(runs) == 1 + 3 + 1
    # What a caller does to its copy changes no other.
    other[:] = 0.0
    assert np.any(experiment.simulated(Point(moved, {})) != 0.0)
    # Side by side as well: two calibrations of a model are one simulation, which is known by now.
    tried = [Point(moved, {"calibration.torque_zero": value}) for value in (0.1, 0.2)]
    assert len(experiment.residuals(tried)) == 2
    assert len(runs) == 1 + 3 + 1
