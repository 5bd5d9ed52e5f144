"""The filter takes a repeated reading of slow sensors for none: live, in a replay, and from a checkpoint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import Estimator, Recording, load_rig, replay, simulate

EVERY = 10
"""Samples a reading: sensors at 100 Hz in a stream at 1 kHz."""


@pytest.fixture(scope="module")
def quick() -> Recording:
    """A simulated joint whose sensors are as quick as the stream."""
    return simulate("shin2022", duration=3.0, seed=5)


@pytest.fixture(scope="module")
def log(quick: Recording) -> Recording:
    """The same with slow sensors, whose readings the stream repeats."""
    taken = np.arange(len(quick)) // EVERY * EVERY
    assert quick.angle is not None
    return Recording(Path("slow"), quick.stamp_ns, quick.pressure[taken], quick.voltage, angle=quick.angle[taken])


def test_each_reading_of_a_slow_sensor_is_used_once(quick: Recording, log: Recording) -> None:
    estimator, as_missing = Estimator("shin2022"), Estimator("shin2022")
    run = estimator.run(log.stamp_ns, log.pressure, log.voltage)
    assert 0.8 * len(log) < run.counts.repeated < 0.9 * len(log)
    assert run.counts.missing == 0
    new = np.arange(len(log)) % EVERY == 0
    once = as_missing.run(log.stamp_ns, np.where(new[:, None], log.pressure, np.nan), log.voltage)
    # Once the rate is known, the filter is as sure as one that is given each reading once.
    late = slice(1500, None)
    shown, expected = (np.sqrt(one.rows["covariance"][late, 0, 0]).mean() for one in (run, once))
    assert shown == pytest.approx(expected, rel=0.1)
    assert Estimator("shin2022").run(quick.stamp_ns, quick.pressure, quick.voltage).counts.repeated == 0


def test_a_live_filter_and_one_from_a_checkpoint_find_the_same_bits(log: Recording) -> None:
    live, whole = Estimator("shin2022"), Estimator("shin2022")
    run = whole.run(log.stamp_ns, log.pressure, log.voltage)
    live.run(log.stamp_ns[:1800], log.pressure[:1800], log.voltage[:1800])
    checkpoint = live.checkpoint()
    assert checkpoint is not None
    later = Estimator("shin2022")
    later.restore(checkpoint)
    for estimator in (live, later):
        rest = [estimator.step(int(stamp), *p, *u) for stamp, p, u in
                zip(log.stamp_ns[1800:], log.pressure[1800:], log.voltage[1800:], strict=True)]  # fmt: skip
        assert b"".join(row.tobytes() for row in rest if row is not None) == run.rows[1800:].tobytes()


def test_a_replay_says_it_and_judges_by_new_readings(log: Recording) -> None:
    found = replay(log, load_rig("shin2022"))
    text = " ".join(found.report.recording.issues)
    assert "both pressures repeat the last reading in 90 % of the rows" in text
    assert "the measured angle repeats" in text
    assert found.report.ukf.angle is not None and found.report.ukf.angle.coverage95 is not None
    assert found.report.innovation.samples < 0.25 * len(log)
