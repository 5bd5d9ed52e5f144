"""When the rows were taken: jitter and gaps are kept, what cannot be time is refused unless the map says what to do."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from csv_files import Lab

from pam_antagonist.recording.csv_time import START_NS


def at(lab: Lab, times: Iterable[Any], **time: Any) -> Lab:
    """Rows at some times, with pressures that tell which row is which."""
    lab.rows([(t, 300 + k, 500 - k, 4 + 0.01 * k, 5) for k, t in enumerate(times)])
    return lab.entries(time={"column": "t", "unit": "s", **time})


def milliseconds(stamps: np.ndarray) -> list[float]:
    return ((stamps - stamps[0]) * 1e-6).tolist()


def test_a_rate_replaces_the_column(lab: Lab) -> None:
    lab.entries(time={"rate": 300})
    assert lab.read().stamp_ns.tolist() == [START_NS, START_NS + 3_333_333, START_NS + 6_666_667, START_NS + 10_000_000]


@pytest.mark.parametrize(
    ("times", "unit", "first"),
    [
        (["1700000000.25", "1700000000.251", "1700000000.252"], "s", 1_700_000_000_250_000_000),
        (["1700000000250000000", "1700000000251000000"], "ns", 1_700_000_000_250_000_000),
        (["3800000000.000", "3800000000.001"], "s", START_NS),  # since 1904: does not fit into a stamp
    ],
)
def test_seconds_since_1970_are_kept(lab: Lab, times: list[str], unit: str, first: int) -> None:
    stamps = at(lab, times, unit=unit).read().stamp_ns
    assert stamps[0] == first
    assert milliseconds(stamps) == pytest.approx(range(len(times)), abs=1e-3)


def test_jitter_is_kept_and_a_gap_is_said(lab: Lab) -> None:
    times = 0.01 * np.arange(200) + np.random.default_rng(1).uniform(-0.002, 0.002, 200)
    recording = at(lab, times).read()
    assert milliseconds(recording.stamp_ns) == pytest.approx(((times - times[0]) * 1e3).tolist(), abs=1e-5)
    assert recording.issues == ()
    recording = at(lab, np.concatenate([np.arange(50), 60 + np.arange(50)]) * 0.01).read()
    assert np.diff(recording.stamp_ns).max() == 110_000_000
    hole, said = recording.issues
    assert (hole.kind, hole.size, round(hole.length_s, 3)) == ("hole", 10, 0.11)
    assert said == (
        "1 of 99 intervals between rows are no 10 ms, the longest (110 ms) before line 52: times kept as they are"
    )


UNEVEN = np.cumsum(np.tile([0.001, 0.03, 0.01, 0.01, 0.01], 10))


def test_uneven_rows_are_refused_unless_the_map_says_how_to_resample(lab: Lab) -> None:
    said = at(lab, UNEVEN).refusal()
    for part in ("time (column 't') is uneven", "median of 10 ms (from 1 to 30 ms)", "give time.resample"):
        assert part in said
    recording = at(lab, UNEVEN, resample=50).read()
    grid = np.arange(len(recording)) * 0.02
    assert milliseconds(recording.stamp_ns) == pytest.approx((grid * 1e3).tolist())
    assert UNEVEN[-1] - UNEVEN[0] - 0.02 < grid[-1] <= UNEVEN[-1] - UNEVEN[0]
    times = UNEVEN - UNEVEN[0]
    assert recording.pressure[:, 0] == pytest.approx(np.interp(grid, times, 300e3 + 1e3 * np.arange(50)), rel=1e-9)
    # A voltage is not interpolated: it is that of the row that comes next, whose voltage was on the valve until then.
    following = [int(np.flatnonzero(times >= moment - 1e-9)[0]) for moment in grid]
    assert recording.voltage[:, 0] == pytest.approx(4 + 0.01 * np.array(following))
    said = " | ".join(recording.issues)
    assert "resampled from about 100 to 50 Hz by interpolation" in said
    assert "there is no filter before it, so faster motion is aliased" in said


def test_resampling_leaves_gaps_empty(lab: Lab) -> None:
    recording = at(lab, np.concatenate([np.arange(50), 100 + np.arange(50)]) * 0.01, resample=100).read()
    assert np.flatnonzero(np.isnan(recording.pressure[:, 0])).tolist() == list(range(50, 100))


@pytest.mark.parametrize(
    ("times", "unit", "says"),
    [
        ([0, 1, 2, 3], "s", "1 s between rows, expected 2e-05 to 0.5 s; steps of 1 look like ms; if it only counts"),
        ([0, 0.001, 0.002], "ms", "steps of 0.001 look like s"),
        ([0, 0.001, 0.002], "us", "steps of 0.001 look like s"),
        ([0, 1000, 2000], "s", "steps of 1000 look like us"),
        ([0, 1000000, 2000000], "us", "steps of 1e+06 look like ns"),
        ([0, 30000, 60000, 90000], "s", "steps of 3e+04 look like us"),
    ],
)
def test_a_wrong_unit_of_time(lab: Lab, times: Sequence[float], unit: str, says: str) -> None:
    said = at(lab, times, unit=unit).refusal()
    assert f"time (column 't') declared in {unit} makes" in said and says in said


STRAY: list[Any] = [round(0.01 * k, 2) for k in range(100)]
LATER = [0.01 * k for k in range(50)] + [1.7e9 + 0.01 * k for k in range(50)]


@pytest.mark.parametrize(
    ("times", "time", "says"),
    [
        (["0.00"] * 3 + ["0.01"] * 2, {}, "line 3: time (column 't') repeats, 0 s (3 of 5 rows are not later than"),
        (["0.00"] * 3 + ["0.01"] * 2, {}, "where the column has too few decimals but the rows came evenly, give time:"),
        ([0.0, 0.01, 0.02, 0.0, 0.01], {}, "line 5: time (column 't') runs backwards, 0 s after 0.02 s"),
        ([0.0, 0.01, 0.02, 0.0, 0.01], {}, "of a file that holds several recordings, name the column that counts"),
        ([0.0, "", 0.02], {}, "line 3: time (column 't') is missing"),
        (STRAY * 2, {"out_of_order": "drop"}, "line 102: time (column 't') runs backwards"),
        (LATER, {}, "line 52: time (column 't') jumps by 1.7e+09 s"),
        (STRAY, {"begin": 5.0}, "no row from time.begin 5"),
    ],
)
def test_what_cannot_be_the_times_of_rows(lab: Lab, times: list[Any], time: dict[str, Any], says: str) -> None:
    assert says in at(lab, times, **time).refusal()


def test_a_few_stray_rows_are_dropped_where_the_map_says_so(lab: Lab) -> None:
    times = list(STRAY)
    times[40], times[60], times[70] = times[39], 0.05, ""
    recording = at(lab, times, out_of_order="drop").read()
    assert len(recording) == 97
    assert 300e3 + 40e3 not in recording.pressure[:, 0] and 300e3 + 41e3 in recording.pressure[:, 0]
    assert "3 rows are not later than those before them, the first in line 42: dropped" in recording.issues


def test_begin_and_end_cut_a_file(lab: Lab) -> None:
    lab.entries(time={"column": "t", "unit": "s", "begin": 0.01, "end": 0.03})
    assert lab.read().pressure[:, 0].tolist() == [310e3, 320e3]
