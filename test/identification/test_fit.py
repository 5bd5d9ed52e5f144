"""Parameters come back from recordings of a plant whose parameters are known."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput, NoResult
from pam_antagonist.identification.balance import fit_force_map
from pam_antagonist.identification.stages import run_stages
from pam_antagonist.inference.determined import evidence
from pam_antagonist.inference.free_parameters import free_parameters, moved
from pam_antagonist.inference.free_run import Run, predict, start_of
from pam_antagonist.inference.joint_fit import joint_fit
from pam_antagonist.inference.joint_problem import JointProblem, step_directions
from pam_antagonist.inference.trial import PRESSURE_1, TORQUE, Trial, check, make_trial
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.excitation import profile
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
TRUE = {
    "valve_1.inflow_area": 5.3e-8,
    "valve_2.outflow_area": 7.5e-8,
    "muscle_2.force.w2": 16.4,
    "friction.shaft": 0.207,
}
SECONDS = 15.0


@lru_cache(maxsize=8)
def record(joint: str, seed: int) -> Recording:
    """The plant with the true parameters, exact otherwise, behind its sensors."""
    plant = Plant(moved(RIG, TRUE), joint=joint, seed=seed, substeps=1)
    voltage = profile("steps", SECONDS, RIG.sample_period, seed=seed)
    samples = [plant.step(row) for row in voltage]
    return Recording(
        path=Path(f"{joint}_{seed}"),
        stamp_ns=np.arange(1, len(samples) + 1, dtype=np.int64) * 1_000_000,
        pressure=np.array([sample.pressure for sample in samples]),
        voltage=voltage,
        angle=np.array([sample.angle for sample in samples]),
        torque=np.array([sample.torque for sample in samples]),
    )


def trials(seed: int) -> list[Trial]:
    return [make_trial(record(joint, seed), RIG, joint, 0.0, joint) for joint in ("free", "locked")]


def problem(rig: Rig = RIG, seed: int = 1, **options: object) -> JointProblem:
    chosen = [item for item in free_parameters(rig) if item.name in TRUE]
    return JointProblem(rig, trials(seed), chosen, **options)  # type: ignore[arg-type]


def test_true_parameters_come_back_with_error_bars_of_the_right_size() -> None:
    deviations = []
    for seed in (1, 3):
        found = joint_fit(problem(seed=seed), rounds=3)
        assert all(item.determined for item in evidence(found, found).values())
        for name, true in TRUE.items():
            assert found.values[name] == pytest.approx(true, rel=2e-3)
            deviations.append((found.values[name] - true) / found.std[name])
    # Eight values: their scatter in error bars is 1 within a factor of two or so, or the bars are wrong.
    assert 0.4 < float(np.sqrt(np.mean(np.square(deviations)))) < 2.0, deviations


def test_a_parameter_that_the_recordings_do_not_tell_stays_at_its_prior() -> None:
    chosen = [item for item in free_parameters(RIG) if item.name in ("friction.shaft", "valve_1.inflow_area")]
    locked = [trial for trial in trials(1) if trial.joint == "locked"]
    found = joint_fit(JointProblem(RIG, locked, chosen), rounds=2)
    known = evidence(found, found)
    assert {name: item.reason for name, item in known.items()} == {
        "valve_1.inflow_area": "", "friction.shaft": "stays near its prior"
    }  # fmt: skip
    assert found.values["friction.shaft"] == pytest.approx(RIG.friction.shaft, rel=1e-6)
    assert found.std["friction.shaft"] == pytest.approx(0.05 * RIG.friction.shaft, rel=0.01)


def test_a_diverged_simulation_has_no_residual_that_is_a_number() -> None:
    """A pulley without stop or friction, muscles that pull less the longer they are: the joint turns without end."""
    force = RIG.muscle_1.force.replaced(w1=-1e5)
    muscle = RIG.muscle_1.replaced(force=force)
    pulley, joint = RIG.geometry.replaced(kind="pulley"), RIG.joint.replaced(stop=None)
    friction = RIG.friction.replaced(shaft=0.0, muscle=0.0)
    lost = RIG.replaced(geometry=pulley, joint=joint, muscle_1=muscle, muscle_2=muscle, friction=friction)
    task = problem(lost)
    free, locked = task.residuals(np.zeros(task.size))
    assert np.isinf(free).all() and np.isfinite(locked).all()
    assert np.isfinite(task.local_jacobians(np.zeros(task.size))[0]).all()
    experiment = task.experiments[0]
    assert (np.abs(experiment.residual(experiment.origin)) > 100.0 * experiment.noise).all()
    with pytest.raises(NoResult, match="free: the model with the values of rig shin2022 diverges"):
        joint_fit(task)


def test_the_jacobian_is_the_slope_of_the_residuals() -> None:
    task = problem()
    theta = np.zeros(task.size)
    up, down = theta.copy(), theta.copy()
    up[0] += 0.01
    down[0] -= 0.01
    slope = (task.residuals(up)[1] - task.residuals(down)[1]) / 0.02
    moves = task.local_jacobians(theta)[1] @ task.map(1)
    assert np.allclose(moves[:, :, 0], slope, rtol=0.05, atol=0.02 * np.abs(slope).max())


def test_stages_bring_the_model_near_and_the_refinement_to_the_noise() -> None:
    free = free_parameters(RIG, frozen=["joint", "gas", "muscle_1"])
    stages, found = run_stages(RIG, trials(2), free)
    assert [stage.name for stage in stages] == ["force map", "valve curve", "friction", "flow", "joint refinement"]
    first, last = stages[0].before, stages[-1].after
    noise = RIG.sensors.pressure_std / np.sqrt(20)
    assert first[PRESSURE_1] is not None and last[PRESSURE_1] is not None and last[TORQUE] is not None
    assert last[PRESSURE_1] < 1.3 * noise < 0.5 * first[PRESSURE_1]
    assert last[TORQUE] < 1.3 * RIG.sensors.torque_std / np.sqrt(20)
    assert found.values["valve_1.inflow_area"] == pytest.approx(TRUE["valve_1.inflow_area"], rel=0.01)


def test_a_stage_without_its_recording_is_skipped_and_says_so() -> None:
    locked = [trial for trial in trials(1) if trial.joint == "locked"]
    stages, _ = run_stages(RIG, locked, free_parameters(RIG, frozen=["muscle_1", "muscle_2", "joint"]))
    notes = {stage.name: stage.note for stage in stages}
    assert notes["force map"] == "skipped: no parameter of it is free"
    assert notes["friction"] == "skipped: no recording of a free joint that slides has it"
    assert "declared curve kept" in notes["valve curve"] and "record a staircase" in notes["valve curve"]
    assert notes["flow"] == ""


def test_freeing_and_freezing_by_name() -> None:
    names = {item.name for item in free_parameters(RIG)}
    assert "friction.shaft" in names and "geometry.radius" not in names and "muscle_1.volume.d1" not in names
    assert not any(name.startswith("muscle_1.") for name in (i.name for i in free_parameters(RIG, frozen=["muscle_1"])))
    assert "atmosphere.pressure" in {item.name for item in free_parameters(RIG, free=["atmosphere.pressure"])}
    prior = next(
        i for i in free_parameters(RIG.replaced(priors={"friction.shaft": 0.01})) if i.name == "friction.shaft"
    )
    assert prior.prior_std == 0.01
    with pytest.raises(BadInput, match="did you mean 'friction.shaft'"):
        free_parameters(RIG, free=["friction.shaf"])
    with pytest.raises(BadInput, match="nothing is left"):
        free_parameters(RIG, frozen=[name.partition(".")[0] for name in par.INDEX])


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda r: r.slice(0.0, 3.0), "too short"),
        (lambda r: _changed(r, voltage=np.full_like(r.voltage, 5.5)), "valves never moved"),
        (lambda r: _changed(r, pressure=450e3 + 0.01 * (r.pressure - 450e3)), "moves by"),
        (lambda r: _changed(r, pressure=np.minimum(r.pressure, 470e3)), "saturated"),
        (lambda r: _changed(r, pressure=np.where(np.arange(len(r))[:, None] % 3 == 0, np.nan, r.pressure)), "missing"),
    ],
)
def test_recordings_that_tell_nothing_are_refused_with_the_reason(spoil, complaint: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(BadInput, match=complaint) as refusal:
        check(make_trial(spoil(record("locked", 1)), RIG, "locked", 0.0, "bag"))
    assert str(refusal.value).startswith("bag: ") and "\n" not in str(refusal.value)


def test_a_torque_meter_at_its_end_is_refused() -> None:
    recording = _changed(record("locked", 1), torque=np.minimum(record("locked", 1).torque, 0.1))  # type: ignore[type-var]
    with pytest.raises(BadInput, match=r"bag: torque stands at its upper end, 0.1 N m"):
        check(make_trial(recording, RIG, "locked", 0.0, "bag"))


def test_a_torque_from_outside_reaches_the_model() -> None:
    quiet = make_trial(record("free", 1), RIG, "free", 0.0, "bag")
    external = 0.5 * np.sin(np.arange(len(quiet)) * 1e-3)
    pushed = make_trial(_changed(record("free", 1), external_torque=external), RIG, "free", 0.0, "bag")
    p = RIG.parameters()
    angles = [predict(trial, Run(p), start_of(trial))[:, 0] for trial in (quiet, pushed)]
    assert np.abs(angles[1] - angles[0]).max() > np.radians(1.0)


def test_an_angle_that_begins_late_tells_the_start_all_the_same() -> None:
    whole = record("free", 1)
    late = np.where(np.arange(len(whole)) < 25, np.nan, whole.angle)  # type: ignore[call-overload]
    starts = [start_of(make_trial(one, RIG, "free", 0.0, "bag")) for one in (whole, _changed(whole, angle=late))]
    assert starts[1].angle == pytest.approx(starts[0].angle, abs=3e-4)
    never = _changed(whole, angle=np.full(len(whole), np.nan))
    assert start_of(make_trial(never, RIG, "free", 0.0, "bag")).angle is None


def test_the_force_map_comes_from_measured_pressures_alone() -> None:
    free = [item for item in free_parameters(RIG) if item.name == "muscle_2.force.w2"]
    values, balance = fit_force_map(trials(1), RIG.parameters(), free, RIG.sensors.torque_std)  # type: ignore[misc]
    assert values["muscle_2.force.w2"] == pytest.approx(TRUE["muscle_2.force.w2"], abs=0.1)
    assert balance.rms("after") < 1.2 * RIG.sensors.torque_std / np.sqrt(20) < 0.5 * balance.rms("before")


def test_slopes_of_a_force_map_are_taken_where_they_can_be_told_apart() -> None:
    free = free_parameters(RIG)
    steps = step_directions(RIG, free)
    assert np.linalg.matrix_rank(steps) == len(free)
    own = [k for k, item in enumerate(free) if item.name.startswith("muscle_1.force.")]
    p = RIG.parameters()
    state = np.array([0.1, 0.0, 400e3, 400e3])
    base = dynamics.forces(state, p)[0]
    for k in own:
        step = {item.name: item.start + item.prior_std * steps[j, k] for j, item in enumerate(free)}
        assert abs(dynamics.forces(state, par.changed(p, step))[0] - base) < 5e-3 * base
    one = {"muscle_1.force.v1": free[own[0]].start + 0.02 * free[own[0]].prior_std}
    assert abs(dynamics.forces(state, par.changed(p, one))[0] - base) > 5e-3 * base


def _changed(recording: Recording, **arrays: np.ndarray) -> Recording:
    kept = {name: getattr(recording, name) for name in ("stamp_ns", "pressure", "voltage", "angle", "torque")}
    return Recording(path=recording.path, **{**kept, **arrays})


def test_missing_samples_are_bridged_and_not_counted() -> None:
    whole = record("free", 1)
    keep = np.ones(len(whole), dtype=bool)
    keep[3000:3040] = False
    gappy = Recording(
        path=whole.path,
        stamp_ns=whole.stamp_ns[keep],
        pressure=whole.pressure[keep],
        voltage=whole.voltage[keep],
        angle=whole.angle[keep],
        torque=whole.torque[keep],
    )
    trial = make_trial(gappy, RIG, "free", 0.0, "gappy")
    assert len(trial) == len(whole)
    assert np.isnan(trial.measured[3000:3040]).all() and np.isfinite(trial.voltage).all()
    assert (
        np.isnan(trial.blocks(trial.measured)[150:152]).all() and np.isfinite(trial.blocks(trial.measured)[152:]).all()
    )
