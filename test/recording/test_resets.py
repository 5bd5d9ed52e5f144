"""Resets that nobody marked are found, and nothing is taken for one that is a joint's own motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from csv_files import Lab

from pam_antagonist import load_rig, simulate
from pam_antagonist.checks import check_recording
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording
from pam_antagonist.recording.rows import resets

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
    ("rig", "options"),
    [
        ("shin2022", {"profile": "steps"}),
        ("shin2022", {"profile": "steps", "joint": "locked"}),
        ("shin2022_regulators", {"profile": "steps"}),
    ],
)
@pytest.mark.parametrize("rows", [1, 5, 10, 20])
def test_a_joint_that_steps_has_none(rig: str, options: dict[str, str], rows: int) -> None:
    whole = simulate(rig, duration=10.0, mismatch=0.01, seed=7, **options)
    assert resets(joined([whole], rows)) is None


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
