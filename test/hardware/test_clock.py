"""Device time to host time: drift, jitter, stalls, and a counter that begins anew."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.hardware.link import ClockMap, Unwrapped

MS = 1_000_000
OFFSET = 1_795_000_000_000_000_000


def arrivals(
    count: int, drift: float, delay_ms: float, jitter_ms: float, seed: int = 0, stalls: tuple[tuple[int, int], ...] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Device times, true host times and arrivals [ns], a millisecond apart; (sample, length [ms]) of stalls."""
    rng = np.random.default_rng(seed)
    device = np.arange(1, count + 1, dtype=np.int64) * MS
    true = OFFSET + device + np.rint(np.arange(1, count + 1) * drift * MS).astype(np.int64)
    late = delay_ms + rng.exponential(jitter_ms, count)
    arrival = true + np.rint(late * MS).astype(np.int64)
    for first, length in stalls:
        end = arrival[first] + length * MS
        held = (np.arange(count) >= first) & (arrival < end)
        arrival[held] = end
    return device, true, np.maximum.accumulate(arrival)


def stamped(device: np.ndarray, arrival: np.ndarray) -> tuple[np.ndarray, np.ndarray, ClockMap]:
    """Stamps, and which samples got one."""
    clock = ClockMap()
    stamps, index = [], []
    for k in range(len(device)):
        clock.add(int(device[k]), int(arrival[k]))
        if clock.ready:
            stamps.append(clock.host_ns(int(device[k])))
            index.append(k)
    return np.array(stamps), np.array(index), clock


@pytest.mark.parametrize("drift", [0.0, 50e-6, -50e-6, 200e-6])
def test_drift_is_followed_without_a_jump(drift: float) -> None:
    device, true, arrival = arrivals(60_000, drift, delay_ms=0.3, jitter_ms=0.3)
    stamps, index, clock = stamped(device, arrival)
    assert len(stamps) > 59_000
    # evenly, and at the host's pace: no more than drift and correction together
    assert np.all(np.abs(np.diff(stamps) - MS) <= 1e-3 * MS + 1)
    settled = index > 20_000
    error = (stamps - true[index])[settled] / MS
    assert abs(error.mean() - 0.3) < 0.02  # the least delay cannot be known
    assert error.std() < 0.02
    assert clock.drift == pytest.approx(drift, abs=2e-6)
    assert np.std(np.diff(stamps)[settled[1:]]) < 50e-6 * MS
    assert clock.restarts == 0


def test_stalls_do_not_move_the_stamps() -> None:
    """0.3 s in which nothing arrives, every two seconds, and one of them right at the start."""
    stalls = tuple((first, 300) for first in range(100, 30_000, 2000))
    device, true, arrival = arrivals(30_000, 50e-6, delay_ms=0.3, jitter_ms=0.1, stalls=stalls)
    stamps, index, clock = stamped(device, arrival)
    error = (stamps - true[index]) / MS
    assert np.all(np.abs(error) < 1.0)
    assert np.all(np.diff(stamps) > 0)
    assert clock.restarts == 0


def test_a_line_that_becomes_slower_for_good_is_followed_slowly() -> None:
    device, true, arrival = arrivals(60_000, 0.0, delay_ms=0.3, jitter_ms=0.1)
    arrival[20_000:] += 5 * MS
    stamps, index, clock = stamped(device, arrival)
    assert np.all(np.abs(np.diff(stamps) - MS) <= 1e-3 * MS + 1)
    assert (stamps - true[index])[-1] / MS == pytest.approx(5.3, abs=0.2)
    assert clock.restarts == 0


def test_what_is_too_far_off_to_follow_begins_anew() -> None:
    device, true, arrival = arrivals(40_000, 0.0, delay_ms=0.3, jitter_ms=0.1)
    arrival[20_000:] -= 100 * MS
    stamps, index, clock = stamped(device, arrival)
    assert clock.restarts == 1
    assert (stamps - true[index])[-1] / MS == pytest.approx(-99.7, abs=0.2)
    assert 300 <= 40_000 - len(stamps) - 300 < 2000


def test_an_hour_and_more_of_a_counter_of_32_bits() -> None:
    unwrapped = Unwrapped()
    first = 2**32 - 5_000_000
    times = [unwrapped((first + k * 100_000_000) % 2**32) for k in range(100)]
    assert times == [k * 100_000_000 for k in range(100)]
    assert 100 * 100_000_000 > 2 * 2**32


def test_a_counter_that_goes_back_is_another_device() -> None:
    unwrapped = Unwrapped()
    assert unwrapped(5_000_000) == 0
    assert unwrapped(5_001_000) == 1000
    assert unwrapped(1_000) is None
    assert unwrapped(5_002_000) == 2000
