"""Readings that are no measurement: found by their values alone, and nothing is said of readings that are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import read_bag, write_bag
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.faults import faults, faults_of, in_words, without_faults

TIME = 1e-3 * np.arange(12_000)
NOISE = np.random.default_rng(5).normal(0.0, 1.0, (len(TIME), 4))
MOVES = np.sin(0.9 * TIME) + 0.4 * np.sin(2.3 * TIME)
STEP = 250.0


def log(**changes: np.ndarray) -> Recording:
    """A recording as twelve-bit sensors make it."""
    pressure = 4e5 + 1.2e5 * np.column_stack([-MOVES, MOVES]) + 200.0 * NOISE[:, :2]
    arrays = {
        "pressure": np.round(pressure / STEP) * STEP,
        "angle": np.round((0.2 * MOVES + 1e-4 * NOISE[:, 2]) / 3e-3) * 3e-3,
        "torque": 0.8 * MOVES + 0.01 * NOISE[:, 3],
    }  # fmt: skip
    stamps = 10**9 + np.rint(1e9 * TIME).astype(np.int64)
    return Recording(Path("log"), stamps, voltage=np.full((len(TIME), 2), 5.0), **{**arrays, **changes})


def kinds(recording: Recording) -> list[tuple[str, str]]:
    return [(one.sensor, one.fault.kind) for one in faults_of(recording)]


def test_nothing_is_said_of_readings() -> None:
    assert kinds(log()) == []
    # Coarse, slow, without noise, vented, at rest, and a few rows of each.
    good = log()
    assert good.angle is not None and good.torque is not None
    assert kinds(log(pressure=np.round(good.pressure / 2e4) * 2e4)) == []
    assert kinds(log(pressure=good.pressure[np.arange(len(TIME)) // 7 * 7])) == []
    assert kinds(log(torque=np.clip(np.round(2.0 * MOVES), -1, 1))) == [], "it stands still at other values too"
    assert kinds(log(pressure=np.maximum(good.pressure - 2e5, 101_325.0))) == []
    assert kinds(log(angle=np.where(TIME < 5.0, good.angle[0], good.angle))) == []
    assert kinds(good.slice(3.0, 3.2)) == []
    assert kinds(log(angle=np.where(NOISE[:, 0] > 3.0, 7.0 + NOISE[:, 1], good.angle))) == [], "spikes differ"


@pytest.mark.parametrize("share", [0.002, 0.01, 0.04])
@pytest.mark.parametrize("value", [101_325.0, 9e5])
def test_lost_readings_are_one_value_far_from_its_neighbours(share: float, value: float) -> None:
    good = log()
    assert good.angle is not None
    lost = np.random.default_rng(3).random(len(TIME)) < share
    bad = log(pressure=np.where(lost[:, None], value, good.pressure), angle=np.where(lost, 0.0, good.angle))
    found = faults_of(bad)
    assert [(one.sensor, one.fault.kind) for one in found[:2]] == [("pressure_1", "lost"), ("pressure_2", "lost")]
    assert np.array_equal(found[0].fault.rows, lost) and found[0].fault.value == value
    ((_, text),) = in_words(found, bad.time_s)
    first = bad.time_s[int(np.argmax(lost))]
    assert text.startswith(f"{lost.sum()} rows hold exactly one value") and f"first at {first:.3f} s" in text
    assert f"pressure_1 {value / 1e3:g} kPa" in text and "measured angle 0 rad" in text
    cleaned = without_faults(bad)
    assert cleaned.angle is not None and np.array_equal(np.isnan(cleaned.angle), lost)
    assert np.array_equal(np.isnan(cleaned.pressure).any(axis=1), lost)
    assert cleaned.issues[0].endswith("lost: left out") and cleaned.issues[0].kind == "dropped"
    assert faults_of(cleaned) == []


def test_a_sensor_that_ends_below_the_signal() -> None:
    good = log()
    assert good.torque is not None
    bad = log(pressure=np.minimum(good.pressure, [9e5, 4.6e5]), torque=np.maximum(good.torque, -0.5))
    (pressure, torque) = faults_of(bad)
    assert (pressure.sensor, pressure.fault.value) == ("pressure_2", 4.6e5)
    assert np.array_equal(pressure.fault.rows, good.pressure[:, 1] >= 4.6e5)
    assert (torque.sensor, torque.fault.value) == ("measured torque", -0.5)
    share = 100 * np.mean(good.pressure[:, 1] >= 4.6e5)
    (_, text), _ = in_words([pressure, torque], bad.time_s)
    assert text.startswith(f"pressure_2 reads exactly 460 kPa in {share:.0f} % of the rows") and "range ends" in text


def test_a_sensor_that_hangs_while_others_go_on() -> None:
    good = log()
    values = good.pressure[:, 0] + 40.0 * NOISE[:, 3]  # of a finer converter
    values[4000:4600] = values[4000]
    ((kind, text),) = in_words(faults_of(log(pressure=np.column_stack([values, good.pressure[:, 1]]))), TIME)
    assert kind == "held" and "pressure_1 stays exactly the same in 599 rows, first from 4.001 s on" in text


def test_a_short_window_of_a_live_stream_is_judged_as_well() -> None:
    values = log().pressure[2000:2200, 0].copy()
    assert list(faults(values, 1e-3)) == []
    values[::50] = 0.0
    assert [(one.kind, int(one.rows.sum())) for one in faults(values, 1e-3)] == [("lost", 3)]
    assert list(faults(np.full(200, np.nan), 1e-3)) == [] and list(faults(values[:10], 1e-3)) == []


def test_a_bag_is_read_without_them(tmp_path: Path) -> None:
    good = log()
    assert good.angle is not None
    lost = np.arange(len(TIME)) % 100 == 7
    write_bag(tmp_path / "lost", replace(good, pressure=np.where(lost[:, None], 101_325.0, good.pressure)))
    as_it_is = read_bag(tmp_path / "lost")
    assert np.isfinite(as_it_is.pressure).all() and not as_it_is.corrected
    read = read_bag(tmp_path / "lost", corrections=Corrections(leave_out_faults=True, delay_angle=0.01))
    assert np.array_equal(np.isnan(read.pressure).all(axis=1), lost) and read.corrected
    assert any(issue.startswith("120 rows hold exactly one value") for issue in read.issues)
