"""Resets that nobody marked, and sensors slower than the log: found, and not taken for a joint's own motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from csv_files import Lab

from pam_antagonist import load_rig, simulate
from pam_antagonist.checks import check_recording
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.stamps import repeated
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.rows import between, curve, own_readings, reading_times, resets, slow, slow_sentence

TRIAL_S = 2.0


@pytest.fixture(scope="module")
def trials() -> list[Recording]:
    """Short recordings of one joint, each of which begins anew."""
    return [
        simulate("shin2022_regulators", profile="steps", duration=TRIAL_S, mismatch=0.01, seed=seed)
        for seed in range(4)
    ]


def joined(trials: list[Recording], rows: int = 1, **lost: None) -> Recording:
    """Recordings one behind the other, as if no time were between them; every so many rows are kept."""
    arrays = {
        name: np.concatenate([getattr(one, name)[::rows] for one in trials])
        for name in ("pressure", "voltage", "angle", "torque")
    }
    count = len(arrays["angle"])
    period = round(trials[0].sample_period_s * rows * 1e9)
    stamps = trials[0].stamp_ns[0] + np.arange(count) * period
    return replace(trials[0], stamp_ns=stamps, **{**arrays, **lost})


@pytest.mark.parametrize("rows", [1, 10])
def test_resets_are_found_where_they_are(trials: list[Recording], rows: int) -> None:
    found = resets(joined(trials, rows))
    assert found is not None
    np.testing.assert_allclose(found.times, [TRIAL_S, 2 * TRIAL_S, 3 * TRIAL_S], atol=0.02)
    assert "the measured angle jumps at 3 places" in found.sentence and "episode: COLUMN" in found.sentence


def test_pressures_tell_it_where_no_angle_was_measured(trials: list[Recording]) -> None:
    found = resets(joined(trials, angle=None))
    assert found is not None and found.signal.startswith("pressure_") and 2.0 == pytest.approx(found.times[0], abs=0.01)
    assert resets(joined(trials, 10, angle=None)) is None, "within rows of 10 ms the air may really move"


@pytest.mark.parametrize(
    ("rig", "joint"), [("shin2022", "free"), ("shin2022", "locked"), ("shin2022_regulators", "free")]
)
def test_a_joint_that_steps_has_none(rig: str, joint: str) -> None:
    whole = simulate(rig, duration=10.0, mismatch=0.01, seed=7, profile="steps", joint=joint)
    for rows in (1, 5, 10, 20):
        assert resets(joined([whole], rows)) is None, rows


def test_a_push_a_glitch_and_lost_samples_are_no_resets() -> None:
    whole = simulate("shin2022", profile="steps", duration=6.0, seed=3)
    assert whole.angle is not None
    angle = whole.angle.copy()
    angle[2000] += 0.5
    assert resets(replace(whole, angle=angle)) is None
    pushed = whole.angle.copy()
    pushed[3000:] += 0.4 * (1.0 - np.exp(-np.arange(3000) * 1e-3 / 0.01))  # a blow: 40 rad/s from one row to the next
    assert resets(replace(whole, angle=pushed)) is None
    kept = np.r_[0:1500, 1900:6000]
    gap = replace(whole, **{name: getattr(whole, name)[kept] for name in ("stamp_ns", "pressure", "voltage", "angle")},
                  torque=None)  # fmt: skip
    assert resets(gap) is None
    coarse = replace(whole, angle=np.round(np.degrees(whole.angle) / 4.0) * 4.0)
    assert resets(coarse) is None


def test_marked_episodes_have_none(trials: list[Recording]) -> None:
    whole = joined(trials)
    begins = whole.stamp_ns[:: len(trials[0])]
    assert resets(replace(whole, episode_ns=begins)) is None
    assert resets(replace(whole, episode_ns=begins[:3])) is not None


def test_check_says_so_before_anything_else_and_episodes_are_asked_for(trials: list[Recording]) -> None:
    rig = load_rig("shin2022_regulators", regulators=True)
    (finding,) = check_recording(joined(trials), rig).wrong
    assert "jumps at 3 places" in finding.text
    with pytest.raises(BadInput, match="jumps at 3 places.*episode: COLUMN"):
        PressureDriven.of(joined(trials), rig)


def test_import_says_so(tmp_path: Path) -> None:
    rows = [(0.01 * k, 300 + 0.1 * k, 400, 5, 5, (k % 100) * 0.2) for k in range(300)]
    lab = Lab(tmp_path).rows(rows, ("t", "p1", "p2", "u1", "u2", "a")).entries(angle={"column": "a", "unit": "deg"})
    (said,) = [issue for issue in lab.read().issues if "jumps" in issue]
    assert "at 2 places" in said and "1.000, 2.000 s" in said


RNG = np.random.default_rng(4)
MOVING = 3e5 + np.cumsum(RNG.normal(0.0, 2e3, (600, 2)), axis=0)
ROWS = np.arange(600)


def held(every: float) -> np.ndarray:
    """Readings of a sensor with ``every`` rows a reading, as a log repeats them."""
    return MOVING[np.floor(np.floor(ROWS / every) * every).astype(int)]


def stamps(period_s: float, rows: int = 600) -> np.ndarray:
    return 10**9 + np.rint(np.arange(rows) * period_s * 1e9).astype(np.int64)


def recording(pressure: np.ndarray, angle: np.ndarray, period_s: float) -> Recording:
    return Recording(Path("log"), stamps(period_s), pressure, np.full((600, 2), 5.0), angle=angle)


@pytest.mark.parametrize("every", [1.5, 2, 3, 10, 40])
@pytest.mark.parametrize("period_s", [0.02, 0.0005])
def test_rows_between_the_readings_of_a_slow_sensor_are_found(every: float, period_s: float) -> None:
    again = np.append(False, (np.diff(held(every), axis=0) == 0.0).all(axis=1))
    assert np.mean(repeated(held(every), stamps(period_s)) == again) > 0.98


@pytest.mark.parametrize("step", [1e-3, 1e3, 4e3, 2e4])
def test_a_sensor_as_quick_as_the_log_repeats_nothing_whatever_its_converter(step: float) -> None:
    assert not repeated(np.round(MOVING / step) * step, stamps(0.02)).any()
    for rows in (1, 2, 5):  # nor do a few rows tell
        assert not repeated(held(2)[:rows], stamps(0.02, rows)).any()


def test_a_quick_sensor_that_rests_between_steps_is_not_slow() -> None:
    steps = np.repeat(RNG.uniform(2e5, 5e5, (30, 2)), 20, axis=0)
    follows = 1.0 - np.exp(-np.arange(1, 21) / 2.0)
    before = np.repeat(np.vstack([steps[:1], steps[:-20:20]]), 20, axis=0)
    shown = np.round((before + (steps - before) * np.tile(follows, 30)[:, None]) / 250.0) * 250.0
    assert not repeated(shown, stamps(0.05)).any()


def test_a_pressure_at_rest_is_measured_at_the_sensor_s_own_rate() -> None:
    resting = held(2)
    resting[200:500] = resting[200]
    found = repeated(resting, stamps(0.02))
    assert found[1:200:2].all()
    assert found[210:490].mean() == pytest.approx(0.5, abs=0.02)
    assert not repeated(np.full((600, 2), 3e5), stamps(0.02)).any()


def test_a_joint_that_stands_still_has_no_slow_encoder() -> None:
    """Between two moves of a row or two its readings stay the same, and are readings."""
    rng = np.random.default_rng(8)
    moves = np.where(rng.random(600) < 0.15, rng.normal(0.0, 0.02, 600), 0.0)
    still = recording(MOVING, np.cumsum(moves), 0.005)
    assert slow(still) == {}


def test_each_sensor_of_a_recording_has_its_own_rate() -> None:
    angle = 1e-6 * MOVING[ROWS // 7 * 7, 0]
    log = recording(held(2), angle, 0.005)
    assert list(slow(log)) == ["pressures", "angle"]
    pressure, own, torque = own_readings(log)
    assert torque is None and own is not None
    assert np.isfinite(pressure).all(axis=1).mean() == pytest.approx(1 / 2, abs=0.02)
    assert np.isfinite(own).mean() == pytest.approx(1 / 7, abs=0.02)
    assert slow_sentence("angle", slow(log)["angle"]).startswith(
        "the measured angle repeats the last reading in 86 % of the rows"
    )
    assert list(slow(recording(MOVING, np.round(angle / 0.01) * 0.01, 0.005))) == []


def test_between_its_readings_a_slow_sensor_is_on_straight_lines() -> None:
    time, course = 0.005 * ROWS, np.sin(0.03 * ROWS)
    log = course[ROWS // 4 * 4]
    found = between(time, log, repeated(log[:, None], stamps(0.005)))
    late = found[20:-20] - course[20:-20]
    assert np.std(late) < 0.1 * np.std(log[20:-20] - course[20:-20])


def logged(taken: np.ndarray, period: float) -> np.ndarray:
    """Times of the rows of a log, with some jitter, that show these readings first."""
    return np.ceil(taken / period) * period + RNG.uniform(0.0, 2e-4, len(taken))


def test_readings_get_their_own_times_back_but_for_a_constant() -> None:
    taken = 0.0303 * np.arange(1500) + 0.004
    shown = logged(taken, 0.02)
    assert np.std(shown - taken) > 5e-3
    assert np.std(reading_times(shown, 0.02) - taken) < 3e-4


def test_a_sensor_without_a_period_keeps_the_times_of_the_log() -> None:
    shown = logged(np.cumsum(RNG.uniform(0.02, 0.045, 1500)), 0.02)
    assert np.array_equal(reading_times(shown, 0.02), shown)
    assert np.array_equal(reading_times(shown[:20], 0.02), shown[:20])


def test_a_delay_moves_the_readings_of_a_slow_sensor_and_not_its_rows() -> None:
    course = 0.6 * np.sin(0.05 * ROWS)
    log = recording(held(4), course[ROWS // 6 * 6], 0.005)
    later = Corrections(delay_angle=0.002, delay_pressure=0.005).applied(log)
    assert later.angle is not None and resets(later) is None
    rows = slice(30, -30)
    assert np.std(later.angle[rows] - np.interp(ROWS - 0.4, ROWS, course)[rows]) < 0.02
    assert np.array_equal(later.pressure[1:], log.pressure[:-1])
    assert list(slow(later)) == ["pressures"]


def test_a_delay_follows_the_bends_of_a_quick_motion_and_a_straight_line_does_not() -> None:
    """At 50 rows a second a joint that swings at 5 Hz goes through a bend in each row."""
    time = 0.02 * np.arange(600)
    swing = 0.5 * np.sin(10.0 * np.pi * time)
    there = time[5:-5] - 0.0053
    true = 0.5 * np.sin(10.0 * np.pi * there)
    by_rows = np.std(curve(there, time, swing) - true)
    by_velocity = np.std(curve(there, time, swing, 5.0 * np.pi * np.cos(10.0 * np.pi * time)) - true)
    straight = np.std(np.interp(there, time, swing) - true)
    assert by_velocity < 0.1 * by_rows < 0.03 * straight
    swing[300:310] = np.nan
    found = curve(time - 0.0053, time, swing)
    assert np.flatnonzero(np.isnan(found)).tolist() == [0, *range(300, 311)]
    assert np.array_equal(curve(time, time, swing), swing, equal_nan=True)
