"""Values that cannot be true, and readings that repeat: they count as missing, are flagged, and the filter says why."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from recordings import trial

from pam_antagonist import Recording, replay, simulate
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator, possible
from pam_antagonist.estimation.memory import MISSING_PRESSURE_1, MISSING_PRESSURE_2, MISSING_VALVE, OUTLIER
from pam_antagonist.rig import load_rig

RIG = load_rig("shin2022")
CLEAN = trial(2.0, seed=7)
BOTH = MISSING_PRESSURE_1 | MISSING_PRESSURE_2
WRONG = {
    "above the supply": lambda p: np.full_like(p, 1.1e6), "bar": lambda p: p / 1e5, "kPa": lambda p: p / 1e3,
    "MPa": lambda p: p / 1e6, "psi": lambda p: p / 6894.76, "hPa": lambda p: p / 100.0, "negative": lambda p: -p,
    "zero": lambda p: 0.0 * p,
}  # fmt: skip


def _run(pressure: np.ndarray, voltage: np.ndarray = CLEAN.voltage):
    return Estimator(RIG).run(CLEAN.stamp_ns, pressure, voltage)


@pytest.mark.parametrize("what", WRONG)
def test_a_pressure_that_cannot_be_is_flagged_and_bridged_as_a_missing_one(what: str) -> None:
    missing, wrong = CLEAN.pressure.copy(), CLEAN.pressure.copy()
    missing[800:1500] = np.nan
    wrong[800:1500] = WRONG[what](wrong[800:1500])
    bridged, run = _run(missing), _run(wrong)
    flags = run.rows["flags"].astype(int)
    assert np.all(flags[800:1500] == BOTH | OUTLIER) and not flags[:800].any() and not flags[1500:].any()
    for field in ("angle", "torque", "covariance"):
        assert np.array_equal(run.rows[field], bridged.rows[field])
    assert run.rows["covariance"][1499, 2, 2] > run.rows["covariance"][799, 2, 2]
    assert run.counts.outliers == run.counts.missing == 700


def test_one_pressure_that_cannot_be_leaves_the_other_in_use() -> None:
    pressure = CLEAN.pressure.copy()
    pressure[1000:, 1] = 1.1e6
    run = _run(pressure)
    assert np.all(run.rows["flags"][1000:] == MISSING_PRESSURE_2 | OUTLIER)
    assert np.isfinite(run.rows["nis"][1000:]).all()
    assert np.degrees(np.abs(run.rows["angle"] - _run(CLEAN.pressure).rows["angle"])).max() < 0.3


def test_voltages_that_cannot_be_are_held_and_flagged() -> None:
    voltage = CLEAN.voltage.copy()
    voltage[1000:1010] *= 10.0
    run = _run(CLEAN.pressure, voltage)
    assert np.all(run.rows["flags"][1000:1010] == MISSING_VALVE | OUTLIER)


@pytest.mark.parametrize(
    ("rig", "low", "high"),
    [
        ("shin2022", 79e3, 800e3),
        ("sealed_joint", 79e3, 600e3),  # charged to 470 kPa and pressed together
        ("shin2022_regulators", 79e3, 930e3),  # regulators overshoot
        ("regulator_joint", -1e6, 1e9),  # its pressures have no unit
    ],
)
def test_what_a_rig_can_have_is_possible(rig: str, low: float, high: float) -> None:
    bounds = possible.bounds(load_rig(rig, regulators=True))
    assert np.all(bounds[:2, 0] < low) and np.all(bounds[:2, 1] > high)


def test_an_uncertain_supply_widens_the_bounds() -> None:
    unsure = RIG.with_value("priors.supply.pressure", 70e3)
    assert possible.bounds(unsure)[0, 1] == pytest.approx(710e3 + 5 * 70e3)


def test_the_estimator_says_what_it_expected() -> None:
    estimator = Estimator("shin2022")
    said = {
        (450.0, 5.5): "pressure 1 is 450, expected 5.065e.04 to 8.52e.05 Pa, absolute; it looks like kPa",
        (4.5, 5.5): "it looks like bar",
        (1.1e6, 5.5): "pressure 1 is 1.1e.06, expected",
        (-1.0, 5.5): "pressure 1 is -1",
        (450e3, 55.0): "voltage 1 is 55, expected -0.5 to 10.5 V; it looks like mV or percent",
        (450e3, 11.0): "voltage 1 is 11, expected -0.5 to 10.5 V$",
    }
    for k, ((p1, u1), words) in enumerate(said.items()):
        assert estimator.step(k * 1_000_000 + 1, p1, 450e3, u1, 5.5) is None
        assert re.search(words, estimator.complaint), estimator.complaint
    assert estimator.step(10_000_000, 450e3, math.nan, 5.5, 5.5) is None and estimator.complaint == ""
    assert estimator.step(11_000_000, 450e3, 450e3, 5.5, 5.5) is not None and estimator.complaint == ""


@pytest.mark.parametrize("unit", [1, 1_000, 1e-3])
def test_stamps_in_another_unit_are_refused(unit: float) -> None:
    estimator = Estimator(RIG)
    with pytest.raises(BadInput, match="ns"):
        for k in range(10):
            estimator.step(type(unit)(k * unit), 450e3, 450e3, 5.5, 5.5)
    with pytest.raises(BadInput, match="ns"):
        estimator.run(np.arange(10) * unit, CLEAN.pressure[:10], CLEAN.voltage[:10])


@pytest.mark.parametrize(
    ("pressure", "voltage", "said"),
    [
        (CLEAN.pressure[:5], CLEAN.voltage, r"pressure has shape \(5, 2\)"),
        (CLEAN.pressure, CLEAN.voltage[:, 0], r"voltage has shape \(2000,\)"),
        ([["a", "b"]] * 2000, CLEAN.voltage, "pressure: expected numbers"),
    ],
)
def test_arrays_of_other_shapes_are_refused(pressure, voltage, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        _run(pressure, voltage)


def test_an_encoder_in_degrees_is_refused_for_good() -> None:
    rig = RIG.with_value("encoder.std", 5e-4)
    estimator = Estimator(rig, angle_sensor="encoder")
    angle = np.degrees(CLEAN.truth[:, 0]) + 3.0
    run = estimator.run(CLEAN.stamp_ns, CLEAN.pressure, CLEAN.voltage, angle)
    assert "expected within ±1.571 rad: let the driver publish rad" in estimator.encoder_complaint
    assert np.all(run.rows["flags"].astype(int) & OUTLIER)
    assert np.degrees(np.abs(run.rows["angle"] - CLEAN.truth[:, 0])).max() < 0.5


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
