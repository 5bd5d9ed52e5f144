"""Recordings of every kind become runs without holes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import load_rig
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import simulate_model
from pam_antagonist.identification import air_stage
from pam_antagonist.identification.runs import Run, notes_of, runs_of
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition, joint_condition


def made(rate: float, seconds: float = 6.0) -> Recording:
    rng, count = np.random.default_rng(2), round(rate * seconds)
    stamp = 10**18 + np.rint(np.arange(count) * 1e9 / rate).astype(np.int64)
    time = (stamp - stamp[0]) * 1e-9
    pressure = 3e5 + 1e5 * np.sin(np.outer(time, [2.0, 3.0])) + rng.normal(0.0, 300.0, (count, 2))
    return Recording(
        path=Path("made"), stamp_ns=stamp, pressure=pressure, voltage=np.full((count, 2), 5.0),
        angle=0.4 * np.sin(2.0 * time), torque=None,
    )  # fmt: skip


def runs(recording: Recording) -> list[Run]:
    return runs_of(recording, free(recording), "made")


def free(recording: Recording) -> JointCondition:
    return joint_condition(recording, "free", None)


@pytest.mark.parametrize("rate", [20.0, 100.0, 1000.0, 2000.0])
def test_a_recording_of_any_rate_is_one_run_of_at_most_250_rows_a_second(rate: float) -> None:
    (run,) = runs(made(rate))
    assert 1.0 / run.period == pytest.approx(min(rate, 250.0), rel=0.02)
    assert np.abs(run.velocity[5:-5] - 0.8 * np.cos(2.0 * run.time[5:-5])).max() < 0.02
    assert np.abs(run.angle - 0.4 * np.sin(2.0 * run.time)).max() < 1e-3
    assert not run.slow and not run.locked


def test_holes_missing_pressures_and_episodes_divide() -> None:
    recording = made(100.0)
    pressure = recording.pressure.copy()
    pressure[200:230, 1] = np.nan
    assert [len(run) for run in runs(replace(recording, pressure=pressure))] == [200, 370]
    keep = np.ones(600, bool)
    keep[300:320] = False
    arrays = {name: getattr(recording, name)[keep] for name in ("stamp_ns", "pressure", "voltage", "angle")}
    assert [len(run) for run in runs(replace(recording, **arrays))] == [300, 280]
    trials = replace(recording, episode_ns=recording.stamp_ns[[0, 150, 400]])
    assert [len(run) for run in runs(trials)] == [150, 250, 200]


def test_stretches_under_a_second_are_left_out_and_nothing_else_is_refused() -> None:
    with pytest.raises(BadInput, match=r"made: no stretch of 1 s without a hole"):
        runs(made(100.0, 0.8))
    (run,) = runs(made(100.0))
    assert run.part(5.5, 9.0) is None
    cut = run.part(2.0, 4.0)
    assert cut is not None and cut.time[0] == 2.0 and len(cut) == 200


def test_readings_of_a_slow_sensor_are_joined_by_lines_and_named() -> None:
    recording = made(50.0)
    pressure = recording.pressure.copy()
    pressure[1::2] = pressure[::2]
    (run,) = runs(replace(recording, pressure=pressure))
    assert run.slow == ("pressures",)
    assert np.allclose(run.pressure[1:-1:2], 0.5 * (run.pressure[:-2:2] + run.pressure[2::2]), atol=200.0)
    assert "the sensor is slower than the log" in notes_of([run])[0]
    assert notes_of(runs(recording)) == ()


def test_a_finer_run_has_the_same_rows_and_pressures_between_them_that_are_ahead_of_a_line() -> None:
    recording = made(20.0, 5.0)
    recording = replace(recording, angle=np.where(recording.time_s < 1.0, np.nan, recording.angle))
    (run,) = runs(recording)
    fine = run.finer()
    assert np.array_equal(fine.pressure[::2], run.pressure)
    assert np.array_equal(fine.angle[::2], run.angle, equal_nan=True)
    assert np.isnan(fine.angle[1::2]).all()
    assert fine.period == pytest.approx(0.5 * run.period)
    moved = (fine.pressure[1::2] - run.pressure[:-1]) / np.diff(run.pressure, axis=0)
    assert moved == pytest.approx(np.full(moved.shape, 0.5625))


def test_pressures_that_swing_from_row_to_row_are_named_and_those_that_rest_are_not() -> None:
    calm, rest = made(50.0), made(50.0)
    rest = replace(
        rest, pressure=np.full((len(rest), 2), 3e5) + np.random.default_rng(0).normal(0.0, 300.0, (len(rest), 2))
    )
    assert notes_of([*runs(calm), *runs(rest)]) == ()
    (note,) = notes_of(
        runs(replace(calm, pressure=calm.pressure + 6e4 * np.resize([[1.0, 0.0], [-1.0, 0.0]], (len(calm), 2))))
    )
    assert note.startswith("The pressures of made swing from row to row")


@pytest.mark.parametrize(("jitter", "rows"), [(0.0, 1000), (0.1, 4000)])
def test_commands_that_scatter_within_a_row_are_not_averaged(jitter: float, rows: int) -> None:
    """A loop passes on its sensors' noise: a valve about its closed centre opens and closes by turns."""
    rng, rig = np.random.default_rng(1), load_rig("shin2022")
    one = rig.valve_1
    wide = {"overlap": 0.05, "inflow_area": 30.0 * one.inflow_area, "outflow_area": 30.0 * one.outflow_area}
    rig = rig.replaced(valve_1=one.replaced(**wide), valve_2=rig.valve_2.replaced(**wide))
    voltage = (
        5.0 + 0.3 * np.repeat(rng.uniform(-1.0, 1.0, (8, 2)), 500, axis=0) + jitter * rng.standard_normal((4000, 2))
    )
    shown = simulate_model(rig, voltage, np.full(2, 4e5))
    stamps = np.arange(1, 4001) * 1_000_000
    recording = Recording(Path("loop"), stamps, shown.pressure, voltage, shown.angle, None)
    found = runs_of(recording, free(recording), "loop")
    assert [len(run) for run in found] == [rows]
    of_model, of_rest = air_stage.errors(rig, found)
    assert of_model < 0.01 * of_rest
