"""Recordings of other rates than the rig's: all lengths are in seconds, and every model takes steps of 1 ms at most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.checks.check import check_recording
from pam_antagonist.diagnosis import diagnose
from pam_antagonist.estimation import Estimator, simulate_model
from pam_antagonist.identification.air_stage import fit_air
from pam_antagonist.identification.runs import runs_of
from pam_antagonist.inference.free_parameters import free_parameters, moved
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.recording import Recording, read_bag, write_bag
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.replays import ReplayReport, replay
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
RATES = (50, 250, 2000)
_FASTEST = 2000
_START_NS = 1_800_000_000_000_000_000
_LEAK = {"leak": {"area_1": 1.2e-9}}


@lru_cache(maxsize=8)
def _fine(joint: str, seconds: float, leaking: bool) -> Recording:
    """A joint whose valves are moved every 0.3 s, recorded at 2 kHz."""
    rig = RIG.replaced(sample_period=1.0 / _FASTEST, effects=_LEAK if leaking else {})
    held = round(0.3 * _FASTEST)
    levels = np.random.default_rng(5).uniform(4.2, 7.4, (int(seconds / 0.3) + 1, 2))
    voltage = np.repeat(levels, held, axis=0)[: round(seconds * _FASTEST)]
    plant = Plant(rig, joint=joint, seed=3, substeps=1)
    run = [plant.step(row) for row in voltage]
    return Recording(
        path=Path(f"{joint}_joint"),
        stamp_ns=_START_NS + np.arange(1, len(run) + 1, dtype=np.int64) * round(1e9 / _FASTEST),
        pressure=np.array([sample.pressure for sample in run]),
        voltage=voltage,
        angle=np.array([sample.angle for sample in run]),
        torque=np.array([sample.torque for sample in run]),
    )


def recorded(
    hz: int, joint: str = "free", seconds: float = 6.0, leaking: bool = False, jitter: float = 0.0
) -> Recording:
    """The same joint at another rate; a sample is taken off its place by up to ``jitter`` periods."""
    whole = _fine(joint, seconds, leaking)
    every = _FASTEST // hz
    rows = np.arange(every - 1, len(whole), every)
    if jitter:
        off = np.rint(np.random.default_rng(9).uniform(-jitter, jitter, len(rows)) * every).astype(int)
        rows = np.clip(rows + off, 0, len(whole) - 1)
    assert whole.angle is not None and whole.torque is not None
    return replace(
        whole, stamp_ns=whole.stamp_ns[rows], pressure=whole.pressure[rows], voltage=whole.voltage[rows],
        angle=whole.angle[rows], torque=whole.torque[rows],
    )  # fmt: skip


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Recording], ReplayReport]:
    """Replays a recording from a bag, each once."""
    folder = tmp_path_factory.mktemp("rates")

    def make(recording: Recording) -> ReplayReport:
        bag = folder / str(len(recording))
        if not bag.exists():
            write_bag(bag, recording)
        return replay(read_bag(bag), RIG, joint="free").report

    return make


def _angle_errors(report: ReplayReport) -> tuple[float, float]:
    assert report.ukf.angle is not None and report.model_alone.angle is not None
    return report.ukf.angle.rmse, report.model_alone.angle.rmse


@pytest.mark.parametrize("hz", RATES)
def test_a_replay_errs_as_at_1_khz(replayed: Callable[[Recording], ReplayReport], hz: int) -> None:
    report = replayed(recorded(hz))
    filtered, alone = _angle_errors(report)
    usual, usual_alone = _angle_errors(replayed(recorded(1000)))
    assert filtered < 1.4 * usual + 0.05
    assert alone == pytest.approx(usual_alone, abs=0.05)
    counts = report.estimator.counts
    assert (counts.gaps, counts.missing, counts.restarts) == (0, 0, 0)


@pytest.mark.parametrize("hz", [100, 1000])
def test_uneven_stamps_are_no_gaps(replayed: Callable[[Recording], ReplayReport], hz: int) -> None:
    uneven = recorded(hz, jitter=0.2)
    # One sample less, so that its bag is another than that of even stamps.
    report = replayed(uneven.slice(0.0, uneven.duration_s))
    filtered, alone = _angle_errors(report)
    usual, usual_alone = _angle_errors(replayed(recorded(1000)))
    assert filtered < 1.4 * usual + 0.05
    assert alone == pytest.approx(usual_alone, abs=0.1)
    assert report.estimator.counts.gaps == 0
    trial = make_trial(uneven, RIG, "free", 0.0, "uneven")
    assert trial.dt == pytest.approx(1.0 / hz, rel=1e-3)
    # Each measurement is on the grid, and none is invented.
    shown = trial.measured[np.isfinite(trial.measured[:, 0]), 0]
    assert len(shown) >= 0.99 * len(uneven) and np.isin(shown, uneven.angle).all()


@pytest.mark.parametrize("hz", RATES)
def test_the_model_alone_goes_the_same_way_at_every_rate(hz: int) -> None:
    fast, slow = recorded(1000), recorded(hz)
    one = simulate_model(RIG, fast.voltage, fast.pressure[0])
    other = simulate_model(RIG, slow.voltage, fast.pressure[0], period=1.0 / hz)
    at = np.rint(np.arange(1, len(other.angle)) * 1000 / hz).astype(int)
    at = at[at < len(one.angle)]
    assert other.angle[1 : len(at) + 1] == pytest.approx(one.angle[at], abs=np.radians(0.6))
    assert np.sqrt(np.mean((other.angle[1 : len(at) + 1] - one.angle[at]) ** 2)) < np.radians(0.1)


@pytest.mark.parametrize("hz", [100, 2000])
def test_live_steps_are_those_of_a_run_and_near_those_of_1_khz(hz: int) -> None:
    given, usual = recorded(hz), recorded(1000)
    whole = Estimator(RIG).run(given.stamp_ns, given.pressure, given.voltage)
    live = Estimator(RIG)
    for k in range(len(given)):
        row = live.step(int(given.stamp_ns[k]), *given.pressure[k], *given.voltage[k])
        assert row is not None and row.tobytes() == whole.rows[k].tobytes()
    assert live.counts.gaps == 0
    reference = Estimator(RIG).run(usual.stamp_ns, usual.pressure, usual.voltage)
    _, here, there = np.intersect1d(whole.stamp_ns, reference.stamp_ns, return_indices=True)
    late = here >= hz  # a second, until the start is forgotten
    apart = whole.rows["angle"][here[late]] - reference.rows["angle"][there[late]]
    assert np.sqrt(np.mean(apart**2)) < np.radians(0.3)
    # The variance says how long nothing was measured, not how often it was worked out.
    ratio = whole.rows["covariance"][here[late], 2, 2] / reference.rows["covariance"][there[late], 2, 2]
    assert 0.5 < np.median(ratio) < 4.0


@pytest.mark.parametrize("hz", [100, 2000])
def test_only_samples_missing_from_the_stream_are_gaps(hz: int) -> None:
    given = recorded(hz)
    kept = np.delete(np.arange(len(given)), [len(given) // 2])
    run = Estimator(RIG).run(given.stamp_ns[kept], given.pressure[kept], given.voltage[kept])
    assert run.counts.gaps == 1


@pytest.mark.parametrize("hz", RATES)
def test_blocks_are_20_ms(hz: int) -> None:
    trial = make_trial(recorded(hz), RIG, "free", 0.0, "free")
    assert trial.dt == 1.0 / hz
    assert trial.block_s == pytest.approx(0.02) and trial.step <= 1e-3
    assert trial.noise(2) == pytest.approx(
        np.hypot(RIG.sensors.pressure_std, RIG.sensors.pressure_step / np.sqrt(12.0)) / np.sqrt(trial.block), rel=0.15
    )


@pytest.mark.parametrize("hz", RATES)
def test_a_wrong_orifice_area_is_identified(hz: int) -> None:
    name = "valve_1.inflow_area"
    wrong = moved(RIG, {name: 1.04 * RIG.value(name)})
    free = [item for item in free_parameters(wrong) if item.name == name]
    recording = recorded(hz, "locked")
    found = fit_air(wrong, runs_of(recording, joint_condition(recording), ""), 0.0, free=free, refine=True)
    assert found is not None
    assert found.values[name] == pytest.approx(RIG.value(name), rel=0.01)


@pytest.mark.parametrize("hz", [50, 250])
def test_a_leak_is_found_by_name(hz: int) -> None:
    leaking = recorded(hz, "locked", seconds=24.0, leaking=True)
    found = diagnose([leaking], RIG, joint="locked", jobs=1, profiles=False, estimator=False)
    assert [(effect.name, effect.muscle) for effect in found.effects] == [("leak", 1)]


@pytest.mark.parametrize("hz", RATES)
def test_a_check_finds_nothing_wrong(hz: int) -> None:
    checked = check_recording(recorded(hz, seconds=6.0), RIG, joint="free")
    assert not checked.wrong
    assert all(finding.status != "doubtful" for finding in checked.findings)
