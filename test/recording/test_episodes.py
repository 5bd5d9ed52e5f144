"""Many short recordings as one: from a file with an episode column into a bag and back, with what else was recorded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from csv_files import Lab

from pam_antagonist import read_bag
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import write_bag
from pam_antagonist.recording.csv_time import LEAST_ROWS, PAUSE_NS

PERIOD = 0.02
NEXT = {"next_p": {"column": "q", "unit": "kPa", "reference": "absolute"}, "next_angle": {"column": "a", "unit": "deg"}}


@pytest.fixture
def lab(tmp_path: Path) -> Lab:
    """A regulator-driven joint, three episodes whose time begins anew."""
    return write(Lab(tmp_path), (12, 20, 15)).entries(valve_1=None, valve_2=None, also=NEXT)


def write(lab: Lab, lengths: tuple[int, ...]) -> Lab:
    rows = [
        (number, k * PERIOD, 300 + number, 500 - k, 400 + k, 10 * number, 100 * number + k)
        for number, length in enumerate(lengths)
        for k in range(length)
    ]
    return lab.rows(rows, ("episode", "t", "p1", "p2", "q", "a", "row"))


def regulated(lab: Lab, **changes: str) -> Lab:
    """The map with plain entries, which the helper's mappings cannot have."""
    entries = {"drive": "regulator", "episode": "episode", **changes}
    lab.map.write_text(lab.map.read_text() + "".join(f"{key}: {value}\n" for key, value in entries.items()))
    return lab


def test_episodes_and_further_signals_come_back_from_a_bag(lab: Lab, tmp_path: Path) -> None:
    lab.entries(valve_1=None, valve_2=None, also=NEXT)
    made = regulated(lab).read()
    write_bag(tmp_path / "bag", made)
    read = read_bag(tmp_path / "bag")
    assert [part.stop - part.start for part in read.episodes] == [12, 20, 15]
    for begin, before in zip(read.episodes[1:], read.episodes, strict=False):
        assert read.stamp_ns[begin.start] - read.stamp_ns[before.stop - 1] == PAUSE_NS
        assert np.ptp(np.diff(read.stamp_ns[begin])) <= 1
    assert read.signals["next_p"].unit == "Pa"
    assert read.signals["next_p"].values[read.episodes[1]] == pytest.approx(1e3 * (400.0 + np.arange(20)))
    assert np.degrees(read.signals["next_angle"].values[read.episodes[2]]) == pytest.approx(np.full(15, 20.0))
    assert not [issue for issue in read.issues if "no samples for" in issue]


def test_a_slice_keeps_its_episodes(lab: Lab) -> None:
    lab.entries(valve_1=None, valve_2=None, also=NEXT)
    whole = regulated(lab).read()
    part = whole.slice(0.1, 3.0)
    assert [p.stop - p.start for p in part.episodes] == [7, 20]
    assert len(part.signals["next_p"].values) == 27


def test_another_topic_can_be_asked_for(lab: Lab, tmp_path: Path) -> None:
    lab.entries(valve_1=None, valve_2=None, also=NEXT)
    write_bag(tmp_path / "bag", regulated(lab).read())
    read = read_bag(tmp_path / "bag", also=["/pam/pressure_2"])
    assert np.array_equal(read.signals["/pam/pressure_2"].values, read.pressure[:, 1])
    with pytest.raises(BadInput, match=r"no signal 'elbow'; expected one of next_angle, next_p"):
        read_bag(tmp_path / "bag", also=["elbow"])


def test_short_episodes_are_left_out_and_counted(lab: Lab) -> None:
    write(lab, (12, 3, 15)).entries(valve_1=None, valve_2=None)
    recording = regulated(lab).read()
    assert len(recording.episodes) == 2
    said = f"1 of 3 episodes have fewer than {LEAST_ROWS} rows, the first in line 14: left out"
    assert said in recording.issues


def test_resets_without_a_mark_are_refused_with_what_to_give(lab: Lab) -> None:
    lab.entries(valve_1=None, valve_2=None)
    lab.map.write_text(lab.map.read_text() + "drive: regulator\n")
    assert "runs backwards" in lab.refusal() and "episode: COLUMN" in lab.refusal()


def test_a_column_that_counts_rows_is_no_episode(lab: Lab) -> None:
    lab.entries(valve_1=None, valve_2=None)
    assert "is it the column that counts the rows?" in regulated(lab, episode="row").refusal()


def test_a_map_says_valves_or_regulators(lab: Lab) -> None:
    lab.entries(valve_1=None, valve_2=None)
    assert "valve_1 is missing" in lab.refusal() and "drive: regulator" in lab.refusal()
    lab.entries()
    assert "expected no valves" in regulated(lab).refusal()


def test_a_further_pressure_says_what_it_counts_from(lab: Lab) -> None:
    lab.entries(valve_1=None, valve_2=None, also={"q": {"column": "q", "unit": "kPa"}})
    assert "also.q.reference: expected gauge or absolute" in regulated(lab).refusal()
    lab.entries(valve_1=None, valve_2=None, also={"q": {"column": "q", "unit": "kN"}})
    assert "also.q.unit: unknown unit 'kN'" in regulated(lab).refusal()
