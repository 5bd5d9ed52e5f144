"""What the estimator does with samples as they come on a rig: missing, late, repeated, wrong."""

from __future__ import annotations

import numpy as np
import pytest
from recordings import PERIOD_NS, trial

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.filter import process_all
from pam_antagonist.estimation.memory import GAP, MISSING_PRESSURE_1, MISSING_PRESSURE_2, MISSING_VALVE, OUTLIER
from pam_antagonist.estimation.stamps import PATIENCE
from pam_antagonist.rig import load_rig

RIG = load_rig("shin2022")
CLEAN = trial(4.0, seed=7)


def _run(pressure=CLEAN.pressure, voltage=CLEAN.voltage, stamp_ns=CLEAN.stamp_ns, **options):
    return Estimator(RIG, **options).run(stamp_ns, pressure, voltage)


def _error_deg(rows: np.ndarray, index: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs(rows["angle"] - CLEAN.truth[index, 0]))


@pytest.mark.parametrize("tuning", ["default", "published"])
@pytest.mark.parametrize("joint", ["free", "locked"])
def test_one_by_one_gives_the_same_bits_as_a_whole_recording(tuning: str, joint: str) -> None:
    recording = trial(2.0, seed=8, joint=joint)
    whole = Estimator(RIG, tuning, joint).run(recording.stamp_ns, recording.pressure, recording.voltage)
    live = Estimator(RIG, tuning, joint)
    for k in range(len(recording.stamp_ns)):
        row = live.step(int(recording.stamp_ns[k]), *recording.pressure[k], *recording.voltage[k])
        assert row is not None
        assert row.tobytes() == whole.rows[k].tobytes()
    assert live.counts == whole.counts
    assert live.started_ns == recording.stamp_ns[0] == whole.started_ns[-1]


def test_arrays_that_are_read_only_compile_nothing_more() -> None:
    arrays = [array.copy() for array in (CLEAN.pressure, CLEAN.voltage, CLEAN.stamp_ns)]
    free = _run(*arrays)
    known = len(process_all.signatures)
    for array in arrays:
        array.setflags(write=False)
    assert _run(*arrays).rows.tobytes() == free.rows.tobytes()
    assert len(process_all.signatures) == known


def test_a_missing_pressure_is_bridged_by_the_other_one() -> None:
    pressure = CLEAN.pressure.copy()
    pressure[1000:1200, 0] = np.nan
    pressure[2000:2100] = np.nan
    run = _run(pressure)
    flags = run.rows["flags"].astype(int)
    assert np.all(flags[1000:1200] == MISSING_PRESSURE_1)
    assert np.all(flags[2000:2100] == MISSING_PRESSURE_1 | MISSING_PRESSURE_2)
    assert np.all(np.isnan(run.rows["nis"][2000:2100])) and np.all(np.isfinite(run.rows["nis"][1000:1200]))
    assert np.all(np.isnan(run.rows["innovation"][1000:1200, 0]))
    assert run.counts.missing == 300 and run.counts.predicted_only == 100
    assert np.isfinite(run.rows["angle"]).all()
    # Uncertainty grows while nothing is measured and comes back after it.
    variance = run.rows["covariance"][:, 2, 2]
    assert variance[2099] > variance[1999] and variance[2400] < variance[2099]
    assert _error_deg(run.rows, run.index).max() < _error_deg(_run().rows, run.index).max() + 0.3


def test_infinite_values_count_as_missing() -> None:
    pressure = CLEAN.pressure.copy()
    pressure[500, 1] = np.inf
    voltage = CLEAN.voltage.copy()
    voltage[600, 0] = -np.inf
    run = _run(pressure, voltage)
    assert int(run.rows["flags"][500]) == MISSING_PRESSURE_2
    assert int(run.rows["flags"][600]) == MISSING_VALVE


def test_missing_voltages_are_taken_to_hold() -> None:
    voltage = CLEAN.voltage.copy()
    held = slice(1401, 2099)  # no step of the voltages within
    assert np.ptp(voltage[1400:2100], axis=0).max() == 0.0
    voltage[held] = np.nan
    run = _run(voltage=voltage)
    for field in ("angle", "torque", "covariance"):
        assert np.array_equal(run.rows[field], _run().rows[field])
    assert np.all(run.rows["flags"][held].astype(int) == MISSING_VALVE)


def test_late_and_repeated_samples_change_nothing_but_the_counts() -> None:
    order = np.arange(len(CLEAN.stamp_ns))
    order = np.insert(order, 1500, [1499, 1400, 1499])  # a repeat, a late one, a repeat of the last
    run = _run(CLEAN.pressure[order], CLEAN.voltage[order], CLEAN.stamp_ns[order])
    assert run.rows.tobytes() == _run().rows.tobytes()
    assert run.counts.duplicates == 2 and run.counts.late == 1


def test_a_gap_is_predicted_over_in_steps_of_the_sample_period() -> None:
    keep = np.r_[0:1500, 1530:4000]
    run = _run(CLEAN.pressure[keep], CLEAN.voltage[keep], CLEAN.stamp_ns[keep])
    assert run.counts.gaps == 1
    at = int(np.flatnonzero(run.rows["flags"].astype(int) & GAP)[0])
    assert run.stamp_ns[at] == CLEAN.stamp_ns[1530]
    # The same as stepping through the gap without measurements.
    pressure = CLEAN.pressure.copy()
    pressure[1500:1530] = np.nan
    stepped = _run(pressure)
    assert abs(run.rows["angle"][at] - stepped.rows["angle"][1530]) < 1e-12
    assert abs(run.rows["pressure"][at] - stepped.rows["pressure"][1530]).max() < 1e-3


@pytest.mark.parametrize("length", [100, 300, 700])
def test_commands_that_changed_in_a_hole_are_found_from_the_pressures_after_it(length: int) -> None:
    """The voltages step every 0.7 s; each second step lies in a hole, and the filter cannot know it."""
    steps = trial(12.0, seed=3, mismatch=0.0)
    starts = np.arange(1400, 11000, 1400) - length // 2
    keep = np.ones(len(steps.stamp_ns), dtype=bool)
    for start in starts:
        keep[start : start + length] = False
    stamp_ns, pressure, voltage = steps.stamp_ns[keep], steps.pressure[keep], steps.voltage[keep]
    run = Estimator(RIG).run(stamp_ns, pressure, voltage)
    live = Estimator(RIG)
    for k, row in enumerate(run.rows):
        assert live.step(int(stamp_ns[k]), *pressure[k], *voltage[k]).tobytes() == row.tobytes()
    assert run.counts.gaps == len(starts) and run.counts.outliers == 0
    error = np.abs(run.rows["angle"] - steps.truth[keep, 0])
    after = np.concatenate(
        [np.searchsorted(stamp_ns, steps.stamp_ns[start + length]) + np.arange(300) for start in starts]
    )
    assert np.degrees(error[after].max()) < 0.6
    std = np.sqrt(run.rows["covariance"][:, 0, 0])
    assert np.mean(error[after] <= 1.96 * std[after]) > 0.9
    # It is not sure of what it cannot know, but only for a moment.
    first = np.searchsorted(stamp_ns, steps.stamp_ns[starts + length])
    assert np.median(std[first - 1]) < np.median(std[first]) and np.median(std[first + 200]) < 2.0 * np.median(std)


def test_a_hole_without_a_pressure_after_it_leaves_the_filter_unsure() -> None:
    pressure = CLEAN.pressure.copy()
    pressure[1500:1531] = np.nan
    keep = np.r_[0:1500, 1530:4000]
    run = _run(pressure[keep], CLEAN.voltage[keep], CLEAN.stamp_ns[keep])
    stepped = _run(pressure)
    spread, known = run.rows["innovation_covariance"][1501], stepped.rows["innovation_covariance"][1531]
    assert spread[0, 0] > 4.0 * known[0, 0] and spread[1, 1] > 4.0 * known[1, 1]


def test_outliers_are_left_out_and_the_other_pressure_is_used() -> None:
    pressure = CLEAN.pressure.copy()
    rng = np.random.default_rng(4)
    hit = rng.choice(np.arange(100, 3900), 40, replace=False)
    pressure[hit, rng.integers(0, 2, 40)] += rng.choice([-1, 1], 40) * rng.uniform(3e4, 4e5, 40)
    run = _run(pressure)
    flagged = np.flatnonzero(run.rows["flags"].astype(int) & OUTLIER)
    assert set(hit) == set(flagged)
    assert run.counts.outliers == 40
    assert np.isfinite(run.rows["innovation"][hit]).any(axis=1).all()
    assert np.abs(run.rows["angle"] - _run().rows["angle"]).max() < np.radians(0.05)


def test_a_lasting_jump_is_believed_in_the_end() -> None:
    pressure = CLEAN.pressure.copy()
    pressure[2000:, 1] += 3e4
    run = _run(pressure)
    # Some more may be refused until the filter has come all the way.
    assert PATIENCE <= run.counts.outliers <= PATIENCE + 5
    assert abs(run.rows["pressure"][2500, 1] - pressure[2500, 1]) < 3e3


@pytest.mark.parametrize("jump_ns", [-2_000_000_000, 3_000_000_000])
def test_a_clock_that_jumps_starts_the_filter_again(jump_ns: int) -> None:
    stamps = CLEAN.stamp_ns.copy()
    stamps[2500:] += jump_ns
    run = _run(stamp_ns=stamps)
    assert run.counts.restarts == 1
    assert len(run.rows) == len(stamps)
    fresh = Estimator(RIG).run(stamps[2500:], CLEAN.pressure[2500:], CLEAN.voltage[2500:])
    assert run.rows[2500:].tobytes() == fresh.rows.tobytes()
    assert run.started_ns[2500] == stamps[2500]


def test_waits_for_a_first_complete_sample() -> None:
    pressure = CLEAN.pressure.copy()
    pressure[:5, 0] = np.nan
    voltage = CLEAN.voltage.copy()
    voltage[5:8, 1] = np.nan
    run = _run(pressure, voltage)
    assert run.index[0] == 8 and run.started_ns[0] == CLEAN.stamp_ns[8]


def test_half_the_rate_is_integrated_in_two_steps() -> None:
    slow = _run(CLEAN.pressure[::2], CLEAN.voltage[::2], CLEAN.stamp_ns[::2])
    # Samples that are missing by design are no gap: from the second distance on, the filter knows the stream's period.
    assert np.all(slow.rows["flags"][2:] == 0)
    assert np.abs(slow.rows["angle"] - _run().rows["angle"][::2]).max() < np.radians(0.3)
    jittered = CLEAN.stamp_ns + np.random.default_rng(1).integers(-2, 3, len(CLEAN.stamp_ns)) * (PERIOD_NS // 10)
    assert np.all(_run(stamp_ns=jittered).rows["flags"] == 0)


@pytest.mark.parametrize(
    "options", [{"tuning": "defualt"}, {"joint": "fixed"}, {"joint": "locked", "lock_angle": 20.0}]
)
def test_wrong_settings_are_refused_in_one_line(options: dict) -> None:
    with pytest.raises(BadInput, match="expected") as refusal:
        Estimator(RIG, **options)
    assert "\n" not in str(refusal.value)
