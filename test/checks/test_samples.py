"""Holes, held rows and what was found on reading are said first; nothing is said across a hole; ticks have a bound."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from pam_antagonist import simulate
from pam_antagonist.checks import Checked, check_recording
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.notes import Issue
from pam_antagonist.rig import Rig

MODEL = ("each pressure follows", "delay", "off (RMS", "turn", "kPa lower")
"""Words of the tests against the model."""


@pytest.fixture(scope="module")
def twelve(rig: Rig) -> Recording:
    """Twelve seconds of a free joint."""
    return simulate(rig, profile="steps", duration=12.0, mismatch=0.01, seed=3)


def without(recording: Recording, begin: float, end: float) -> Recording:
    """The recording without the samples of some time."""
    return recording.take(np.flatnonzero((recording.time_s < begin) | (recording.time_s >= end)))


def of(checked: Checked, status: str) -> list[str]:
    return [finding.text for finding in checked.findings if finding.status == status]


def test_a_hole_has_its_place_and_length_and_no_test_crosses_it(twelve: Recording, rig: Rig) -> None:
    checked = check_recording(without(twelve, 5.6, 6.9), rig)
    assert of(checked, "doubtful") == ["a hole: no samples for 1.301 s, from 5.599 s on (of 12.0 s)"]
    # Only the piece of 5.6 s is long enough, and it is compared with the model as a whole one.
    assert any("each pressure follows its own valve" in text for text in of(checked, "good"))
    assert checked.corrections == Corrections()


def test_pieces_too_short_for_the_model_are_not_compared_with_it(free: Recording, rig: Rig) -> None:
    checked = check_recording(without(free, 2.6, 4.0), rig)
    assert any("a hole: no samples for 1.401 s, from 2.599 s on" in text for text in of(checked, "doubtful"))
    assert any("no piece without a hole lasts 5 s" in text for text in of(checked, "untested"))
    for status in ("good", "doubtful", "wrong"):
        assert not [text for text in of(checked, status) if any(word in text for word in MODEL)]


def test_a_topic_that_pauses_is_a_hole_and_is_named(twelve: Recording, rig: Rig) -> None:
    voltage = twelve.voltage.copy()
    voltage[3000:3600] = np.nan
    found = of(check_recording(replace(twelve, voltage=voltage), rig), "doubtful")
    assert found == ["a hole: no valve_state for 0.601 s, from 2.999 s on (of 12.0 s)"]


def test_single_lost_samples_are_counted(free: Recording, rig: Rig) -> None:
    lost = np.random.default_rng(2).choice(np.arange(10, 5990), 100, replace=False)
    kept = free.take(np.delete(np.arange(len(free)), lost))
    checked = check_recording(replace(kept, angle=None, torque=None), rig)
    (text,) = of(checked, "doubtful")
    assert text.startswith("100 samples are missing one by one") and "expected 0.5 % at most" in text


def test_held_rows_are_found(twelve: Recording, rig: Rig) -> None:
    arrays = {name: getattr(twelve, name).copy() for name in ("pressure", "angle", "torque")}
    for values in arrays.values():
        values[7000:7800] = values[6999]
    (text,) = of(check_recording(replace(twelve, **arrays), rig), "doubtful")
    assert "stay exactly the same for 0.8" in text and "from 6.999 s on" in text


def test_all_that_the_reader_found_is_said_in_its_order(free: Recording, rig: Rig) -> None:
    issues = (
        Issue("7 messages of /pressure_1 came out of order, by 3 ms at most: sorted by stamp", "late", 7),
        Issue("12 messages of /pressure_1 without a stamp: dropped", "unstamped", 12),
        Issue("5000 bytes were damaged", "damage", 5000),
    )
    found = of(check_recording(replace(free, issues=issues), rig), "doubtful")
    assert [text.split()[0] for text in found] == ["5000", "12", "7"]


def test_every_tick_has_its_bound(free: Recording, locked: Recording, rig: Rig) -> None:
    for recording in (free, locked):
        ticks = of(check_recording(recording, rig), "good")
        assert len(ticks) >= 6
        for text in ticks:
            assert re.search(r"at most|or more|expected|within", text), text


@pytest.mark.parametrize("off", [25e3, 31.5e3])
def test_a_model_that_is_far_off_has_no_tick(free: Recording, rig: Rig, off: float) -> None:
    pressure = free.pressure.copy()
    pressure[:, 0] += off * np.minimum(1.0, free.time_s)  # it drifts, from the start at which the model begins
    ticks = of(check_recording(replace(free, pressure=pressure), rig), "good")
    assert not [text for text in ticks if "off (RMS" in text or "on average" in text]


def test_another_rate_is_no_tick(twelve: Recording, rig: Rig) -> None:
    checked = check_recording(twelve.take(np.arange(0, len(twelve), 5)), rig)
    assert any(text.startswith("200 samples a second; the rig file has 1000") for text in of(checked, "untested"))


def test_a_joint_that_moves_was_not_locked(free: Recording, rig: Rig) -> None:
    (finding,) = check_recording(free, rig, "locked").wrong
    assert "deg in all" in finding.text and "2 at most" in finding.text
    assert finding.leave_out == ("--joint locked",)


def test_a_locked_joint_that_is_called_free_is_doubted(locked: Recording, rig: Rig) -> None:
    doubts = [item for item in check_recording(locked, rig, "free").findings if item.status == "doubtful"]
    assert doubts[0].options == ("--joint locked",)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("hz", [20, 100, 1000])
@pytest.mark.parametrize("joint", ["auto", "locked"])
def test_no_input_stops_it(twelve: Recording, rig: Rig, hz: int, joint: str) -> None:
    recording = twelve.take(np.arange(0, len(twelve), 1000 // hz))
    some = np.arange(len(recording))
    typed = Corrections(angle_unit="deg", gauge=True, swap_valves=True, delay_pressure=0.05, encoder_zero=0.1)
    for changes in (
        {},
        {"angle": None}, {"torque": None}, {"angle": None, "torque": None},
        {"pressure": np.full((len(some), 2), 3e5)}, {"voltage": np.full((len(some), 2), 5.0)},
        {"pressure": np.random.default_rng(1).uniform(1e5, 7e5, (len(some), 2))},
        {"pressure": np.where(some[:, None] % 2, np.nan, recording.pressure)},
        {"angle": np.where(some % 3, np.nan, recording.angle), "torque": 1e9 * recording.torque},
    ):  # fmt: skip
        for given in (Corrections(), typed):
            changed = replace(recording, **changes) if changes else recording.slice(0.0, 5.5)
            texts = [item.text for item in check_recording(changed, rig, joint, typed=given).findings]
            assert texts and not [text for text in texts if re.search(r"\bnan\b|\binf\b", text)]
