"""What stops a joint, after how long, and what does not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.memory import OUTLIER
from pam_antagonist.safety import EstimateSupervision, PressureSupervision
from pam_antagonist.safety.supervision import frozen_samples, frozen_time

MS = 1_000_000
RNG = np.random.default_rng(3)


def pressures(**changes: object) -> PressureSupervision:
    settings = {"highest": (6e5, 7e5), "over_time": 0.005, "missing_time": 0.02, "frozen_time": 0.05, **changes}
    return PressureSupervision(**settings)  # type: ignore[arg-type]


def estimates(**changes: float | None) -> EstimateSupervision:
    settings = {"highest_angle": 0.45, "angle_time": 0.01, "nis_limit": 13.8, "nis_time": 0.1, "blind_time": 0.05}
    return EstimateSupervision(**{**settings, **changes})  # type: ignore[arg-type]


def noisy(value: float) -> float:
    return value + float(RNG.normal(0.0, 600.0))


def first(supervision: PressureSupervision, one: object, two: object, count: int = 300) -> tuple[int, str]:
    """The first sample at which it has something to say, and what; one and two: functions of the sample."""
    for k in range(count):
        words = supervision.check(k * MS, one(k), two(k))  # type: ignore[operator]
        if words:
            assert supervision.present == words
            return k, words
    return -1, ""


@pytest.mark.parametrize("muscle", [1, 2])
def test_over_pressure_of_each_muscle(muscle: int) -> None:
    limit = (6e5, 7e5)[muscle - 1]
    values = [lambda k: noisy(4e5), lambda k: noisy(4e5)]
    values[muscle - 1] = lambda k: limit + 1000.0 + k % 2
    at, words = first(pressures(), *values)
    above = {1: "pressure 1 is 601.0 kPa, above 600.0 kPa", 2: "pressure 2 is 701.0 kPa, above 700.0 kPa"}
    assert at == 5 and words.startswith(above[muscle])


def test_a_spike_is_no_over_pressure() -> None:
    assert first(pressures(), lambda k: 9e5 if k % 10 < 3 else noisy(4e5), lambda k: noisy(4e5)) == (-1, "")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_missing_pressure(value: float) -> None:
    at, words = first(pressures(), lambda k: noisy(4e5), lambda k: value if k >= 100 else noisy(4e5))
    assert at == 120 and words == "pressure 2 is missing or not finite"


def test_single_missing_readings_do_not_stop() -> None:
    assert first(pressures(), lambda k: math.nan if k % 3 else noisy(4e5), lambda k: noisy(4e5))[0] == -1


def test_frozen_pressure() -> None:
    at, words = first(pressures(), lambda k: noisy(4e5) if k < 100 else 4.1e5, lambda k: noisy(4e5))
    assert at in (150, 151) and "frozen at 410000.0 Pa" in words
    assert first(pressures(frozen_time=None), lambda k: 4.1e5, lambda k: 4.1e5) == (-1, "")


def test_equal_readings_across_a_stall_are_not_frozen() -> None:
    supervision = pressures()
    for k in range(20):
        stamp = k * 400 * MS
        assert not supervision.check(stamp, 4e5 + k, 4e5 + k)
        assert not supervision.check(stamp + 300 * MS, 4e5 + k, 4e5 + k)


def test_cause_is_gone_when_it_is_gone_and_forgotten_by_a_reset() -> None:
    supervision = pressures()
    for k in range(10):
        supervision.check(k * MS, 9e5 + k, noisy(4e5))
    assert supervision.present
    supervision.check(10 * MS, noisy(4e5), noisy(4e5))
    assert not supervision.present
    for k in range(11, 15):
        supervision.check(k * MS, 9e5 + k, noisy(4e5))
    supervision.reset()
    assert not supervision.check(16 * MS, 9e5, noisy(4e5))


def test_readings_that_a_sound_sensor_does_not_give() -> None:
    """Against the distribution itself: a 12-bit sensor of rig shin2022, at rest in the middle of a code."""
    readings = np.round(RNG.normal(0.0, 600.0, 400_000) / 244.0)
    equal = np.diff(np.flatnonzero(np.diff(readings, prepend=99.0, append=99.0)))
    chance = math.erf(244.0 / (2.0 * math.sqrt(2.0) * 600.0))
    longest, expected = int(equal.max()), math.log(400_000) / -math.log(chance)
    assert longest < expected + 4
    assert frozen_samples(600.0, 244.0) == pytest.approx(20, abs=2)
    assert frozen_samples(600.0, 244.0) > 2 * longest
    assert frozen_samples(600.0, 0.0) == 2
    assert frozen_samples(0.0, 244.0) == math.inf
    assert frozen_samples(10.0, 244.0) == math.inf
    assert frozen_samples(600.0, 244.0, 0.83) == pytest.approx(29, abs=1)  # behind a low-pass of 30 Hz
    assert frozen_time(600.0, 244.0, 1e-3) == pytest.approx(0.029, abs=0.001)
    assert frozen_time(600.0, 0.0, 1e-3) == 0.02
    assert frozen_time(600.0, 244.0, 5e-3) == pytest.approx(0.1, abs=0.01)
    assert frozen_time(10.0, 244.0, 1e-3) is None and frozen_time(0.0, 0.0, 1e-3) is None


def test_over_angle() -> None:
    supervision = estimates()
    said = [supervision.check(k * MS, -0.5 if k >= 20 else 0.1, 2.0, 0) for k in range(40)]
    assert [bool(words) for words in said] == [False] * 30 + [True] * 10
    assert "-0.500 rad, beyond 0.45 rad" in said[-1]


@pytest.mark.parametrize("nis,flags", [(50.0, 0), (math.nan, 8), (0.3, 8)])
def test_measured_and_expected_pressures_disagree_for_too_long(nis: float, flags: int) -> None:
    supervision = estimates()
    said = [
        supervision.check(k * MS, 0.0, nis if k >= 200 else RNG.chisquare(2), flags if k >= 200 else 0)
        for k in range(400)
    ]
    when = [k for k, words in enumerate(said) if words]
    assert 213 <= when[0] <= 214
    assert "disagree" in said[when[0]] and when[-1] == 399


def test_a_tenth_of_outliers_and_a_cautious_filter_are_no_reason_to_stop() -> None:
    supervision = estimates()
    for k in range(2000):
        assert not supervision.check(k * MS, 0.0, 1e4 if k % 20 == 0 else 0.007, 8 if k % 20 == 9 else 0)


def test_one_bad_estimate_after_a_stall_is_no_reason_to_stop() -> None:
    supervision = estimates()
    for k in range(50):
        assert not supervision.check(k * 300 * MS, 0.0, 1e6, 16)


@pytest.mark.parametrize("flag,muscle", [(1, 1), (2, 2), (3, 1)])
def test_blind(flag: int, muscle: int) -> None:
    supervision = estimates()
    said = [supervision.check(k * MS, 0.0, math.nan, flag if k >= 10 else 0) for k in range(80)]
    when = next(k for k, words in enumerate(said) if words)
    assert when == 60 and f"without pressure {muscle}" in said[when]


def test_a_joint_whose_pressures_nobody_measures_is_not_blind() -> None:
    supervision = estimates(blind_time=None)
    assert not any(supervision.check(k * MS, 0.0, math.nan, 3) for k in range(5000))
    said = [supervision.check((5000 + k) * MS, 0.5, math.nan, 3) for k in range(20)]
    assert any("beyond 0.45 rad" in words for words in said), "the angle is still watched"


def test_a_clock_that_is_set_back_starts_the_count_anew() -> None:
    supervision = estimates()
    for k in range(80):
        supervision.check(10**12 + k * MS, 0.0, 1.0 if k < 40 else 50.0, 0)
    assert not supervision.check(5 * MS, 0.0, 50.0, 0)
    assert not any(supervision.check((6 + k) * MS, 0.0, 1.0, 0) for k in range(200))


def test_limits_have_to_be_numbers() -> None:
    with pytest.raises(BadInput):
        pressures(highest=(math.nan, 1e5))
    with pytest.raises(BadInput):
        pressures(frozen_time=0.0)
    with pytest.raises(BadInput):
        estimates(highest_angle=math.inf)


@pytest.mark.parametrize("missing", [19, 20, 500])
def test_behind_a_gap_the_filter_may_settle_before_anything_counts(missing: int) -> None:
    watch = estimates()
    for k in range(200):
        assert watch.check(k * MS, 0.1, 2.0, 0) == "" and not watch.settling
    first = 200 + missing
    settling = []
    for k in range(first, first + 30):  # as a filter refuses pressures until it gives in
        words = watch.check(k * MS, 0.1, 500.0 if k < first + 20 else 2.0, OUTLIER if k < first + 20 else 0)
        settling.append(watch.settling)
        assert bool(words) == (missing < 20 and k >= first + 14)
    assert settling == [missing >= 20] * 30
    for k in range(first + 30, first + 300):
        watch.check(k * MS, 0.1, 2.0, 0)
        assert watch.settling == (missing >= 20 and k < first + 40)
    for k in range(first + 300, first + 330):
        words = watch.check(k * MS, 0.1, 500.0, OUTLIER)
    assert "disagree" in words
    watch.check(5 * MS, 0.1, 2.0, 0)  # the clock was set back
    assert not watch.settling
