"""A recording through the estimator again: the same bits as live, and numbers under the agreed keys."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import EstimateRun, Estimator, simulate_model
from pam_antagonist.recording import RecordedEstimate, Recording, read_bag, write_bag
from pam_antagonist.recording.notes import SEALED, write_notes
from pam_antagonist.replays import ReplayReport, replay
from pam_antagonist.replays.result import JointFacts, RecordedRig, numbers
from pam_antagonist.report.document import Section
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.html import render, write
from pam_antagonist.report.replay import document, live_rig
from pam_antagonist.rig import Rig, RigIdentity, fingerprint, load_rig
from pam_antagonist.strict_json import plain


def replay_recording(recording: Recording, rig: Rig, tuning: str = "default") -> dict[str, Any]:
    """The recording's entry in ``report.json``."""
    entry = plain(replay(recording, rig, tuning).report)
    assert isinstance(entry, dict)
    return entry


@pytest.fixture(scope="module")
def report(rig: Rig, free: Recording) -> dict[str, Any]:
    return replay_recording(free, rig)


def test_the_report_stays_as_it_is(rig: Rig, free: Recording, golden: Callable[[str, Any], None]) -> None:
    golden("replay", plain(numbers([replay(free, rig)])))


def test_numbers_are_those_of_the_arrays(rig: Rig, free: Recording) -> None:
    done = replay(free, rig)
    assert done.report.samples == 6000
    assert done.report.duration_s == pytest.approx(6.0)
    assert free.angle is not None and free.torque is not None
    run = Estimator(rig).run(free.stamp_ns, free.pressure, free.voltage)
    error = np.degrees(run.rows["angle"] - free.angle)
    assert done.report.ukf.angle.rmse == pytest.approx(math.sqrt(float(np.mean(error**2))), rel=1e-12)
    assert done.report.ukf.angle.ratio == pytest.approx(np.abs(error).max() / np.degrees(np.ptp(free.angle)))
    alone = simulate_model(rig, free.voltage, free.pressure[0])
    assert done.report.model_alone.torque.largest == pytest.approx(np.abs(alone.torque - free.torque).max())
    worst = np.sqrt(np.mean((alone.pressure - free.pressure) ** 2, axis=0))
    assert done.report.model_alone.pressure.rmse_pa == pytest.approx(worst)


def test_the_published_tuning_is_another_filter(rig: Rig, free: Recording, report: dict[str, Any]) -> None:
    published = replay_recording(free, rig, tuning="published")
    assert published["ukf"]["angle"]["rmse_deg"] > 2.0 * report["ukf"]["angle"]["rmse_deg"]
    assert published["model_alone"] == report["model_alone"]


def test_a_channel_that_was_not_recorded_is_null(rig: Rig, free: Recording, tmp_path: Path) -> None:
    done = replay(dataclasses.replace(free, torque=None), rig)
    write(tmp_path, document([done], with_figures=False), numbers([done]))
    written = json.loads((tmp_path / "report.json").read_text())
    assert written["ukf"]["torque"] is None
    assert written["model_alone"]["torque"] is None
    assert written["ukf"]["angle"]["rmse_deg"] > 0.0
    assert "Torque: not measured" in (tmp_path / "report.html").read_text()


def test_nothing_measured_is_said_plainly(rig: Rig, free: Recording) -> None:
    done = replay(dataclasses.replace(free, torque=None, angle=None), rig)
    text = render(document([done], with_figures=False))
    assert "the estimate was compared with nothing" in text
    assert "taken as free" in text


def test_the_recorded_files_hash_is_the_one_of_sha256sum(report: dict[str, Any], free: Recording) -> None:
    (file,) = Path(free.path).glob("*.mcap")
    assert report["recording"]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert report["recording"]["name"] == f"{free.path.parent.name}/free"


def test_a_locked_joints_torque_is_judged_and_its_angle_is_given(rig: Rig, locked: Recording) -> None:
    done = replay(locked, rig)
    assert done.report.joint == JointFacts("locked", 0.0, "measured angle")
    assert not done.run.rows["angle"].any()
    text = render(document([done], with_figures=False))
    assert "gives the torque to within" in text
    assert "the angle to within" not in text


def test_samples_that_are_missing_do_not_shift_the_model(rig: Rig, free: Recording) -> None:
    # Half a second is gone while the voltages hold: the model runs on through it.
    whole = replay(free, rig)
    level = np.flatnonzero(np.abs(np.diff(free.voltage, axis=0)).any(axis=1)) + 1
    first = int(level[np.argmax(np.diff(level))]) + 1
    kept = np.delete(np.arange(len(free)), slice(first, first + 400))
    holed = replay(free.take(kept), rig)
    assert len(holed.run.index) == len(free.stamp_ns) - 400
    assert np.array_equal(holed.model.angle, whole.model.angle[kept])
    assert holed.report.estimator.counts.gaps == 1


def test_after_a_long_pause_filter_and_model_start_afresh(rig: Rig, free: Recording) -> None:
    stamps = free.stamp_ns.copy()
    stamps[3000:] += 20_000_000_000
    done = replay(dataclasses.replace(free, stamp_ns=stamps), rig)
    assert done.report.estimator.started_ns == (int(stamps[0]), int(stamps[3000]))
    assert done.report.estimator.counts.restarts == 1
    assert done.model.pressure[3000] == pytest.approx(free.pressure[3000])


def test_without_a_complete_sample_there_is_nothing_to_replay(rig: Rig, free: Recording) -> None:
    pressure = free.pressure.copy()
    pressure[::2, 0] = np.nan
    pressure[1::2, 1] = np.nan
    with pytest.raises(BadInput, match="no sample has both pressures"):
        replay(dataclasses.replace(free, pressure=pressure), rig)


def test_sealed_muscles_are_said_to_be_beyond_the_rig(rig: Rig, free: Recording, tmp_path: Path) -> None:
    write_bag(tmp_path / "sealed", free)
    assert replay_recording(free, rig)["recording"]["issues"] == []
    write_notes(tmp_path / "sealed", {SEALED: "1 2"})
    (said,) = replay_recording(read_bag(tmp_path / "sealed"), rig)["recording"]["issues"]
    assert "both muscles were sealed" in said and "shin2022" in said


# ------------------------------------------------------------------ equal to what was published live


def _live(rig: Rig, recording: Recording, starts: tuple[int, ...], end: int) -> RecordedEstimate:
    """What a live node published that was started at these samples, sample by sample."""
    estimator = Estimator(rig)
    parts: list[EstimateRun] = []
    for first, last in zip(starts, (*starts[1:], end), strict=True):
        estimator.reset()
        for k in range(first, last):
            one = slice(k, k + 1)
            parts.append(estimator.run(recording.stamp_ns[one], recording.pressure[one], recording.voltage[one]))
    return RecordedEstimate.from_rows(
        np.concatenate([part.stamp_ns for part in parts]),
        np.concatenate([part.started_ns for part in parts]),
        np.concatenate([part.rows for part in parts]),
    )


@pytest.mark.parametrize("starts", [(0,), (700,), (700, 2000)], ids=["first sample", "later", "restarted by hand"])
def test_a_replay_gives_the_bits_of_the_live_node(rig: Rig, free: Recording, starts: tuple[int, ...]) -> None:
    live = _live(rig, free, starts, 3000)
    equal = replay_recording(dataclasses.replace(free, estimate=live), rig)["live_equal"]
    assert equal == {
        "compared": 3000 - starts[0], "equal": 3000 - starts[0], "only_live": 0, "only_replay": 0,
        "first_difference_ns": None, "differing": {}, "not_compared": 0, "why_not": [], "apart_deg": None,
    }  # fmt: skip


def test_what_the_live_filter_went_without_is_left_out_here_as_well(rig: Rig, free: Recording) -> None:
    """The recorder got messages that came too late for the estimator: a pressure here, a whole sample there."""
    pressure, voltage = free.pressure.copy(), free.voltage.copy()
    pressure[1000:1100, 1] = np.nan
    voltage[1500:1520] = np.nan
    had = np.delete(np.arange(len(free)), slice(2000, 2050))
    live = _live(rig, dataclasses.replace(free, pressure=pressure, voltage=voltage).take(had), (0,), 3000)
    report = replay_recording(dataclasses.replace(free, estimate=live), rig)
    assert report["live_without"] == 100 + 20 + 50
    assert report["live_equal"]["equal"] == report["live_equal"]["compared"] == 3000
    assert not report["live_equal"]["only_replay"]


def test_one_bit_is_a_difference_and_the_late_flag_is_none(rig: Rig, free: Recording) -> None:
    live = _live(rig, free, (0,), 500)
    torque, flags = live.torque.copy(), live.flags.copy()
    torque[123] = np.nextafter(torque[123], np.inf)
    flags[200] |= 64
    touched = RecordedEstimate(**{**vars(live), "torque": torque, "flags": flags})
    equal = replay_recording(dataclasses.replace(free, estimate=touched), rig)["live_equal"]
    assert (equal["compared"], equal["equal"]) == (500, 499)
    assert equal["differing"] == {"torque": 1}
    assert equal["first_difference_ns"] == int(free.stamp_ns[123])


# ------------------------------------------------------------------ the documents


def test_one_recording_stands_at_the_top_and_several_in_a_list(rig: Rig, free: Recording, locked: Recording) -> None:
    one, other = replay(free, rig), replay(locked, rig)
    single = numbers([one])
    assert single["ukf"] == plain(one.report.ukf)
    assert single["settings"]["rig"] == "shin2022"
    assert single["settings"]["tuning"]["name"] == "default"
    assert set(single["software"]) == {"pam_antagonist", "python", "numpy", "numba"}
    both = numbers([one, other])
    assert set(both) == {"recordings", "settings", "software"}
    assert [entry["joint"]["condition"] for entry in both["recordings"]] == ["free", "locked"]

    # The first figure comes before the tables, so that it is seen without scrolling.
    page = document([one, other])
    lede, verdict, figure, *below = page.blocks
    assert [getattr(block, "kind", None) for block in (lede, verdict)] == ["lede", "verdict"]
    assert isinstance(figure, Figure) and figure.title.startswith(f"{one.name}: Joint angle")
    sections = [block for block in below if isinstance(block, Section) and block.anchor]
    assert [section.title for section in sections] == [one.name, other.name]
    shown = [[block.title for block in section.blocks if isinstance(block, Figure)] for section in sections]
    assert not any(title.startswith("Joint angle") for title in shown[0]) and all(shown)


def test_a_report_names_no_folder_of_this_machine(rig: Rig, free: Recording, tmp_path: Path) -> None:
    done = [replay(free, rig)]
    write(tmp_path, document(done), numbers(done))
    for name in ("report.json", "report.html"):
        assert str(free.path.parent.parent) not in (tmp_path / name).read_text(encoding="utf-8")


def test_a_recording_with_another_rig_is_said(rig: Rig, free: Recording) -> None:
    def replayed(*told: tuple[str, Rig]) -> ReplayReport:
        texts = tuple(RigIdentity.of(used, node).text() for node, used in told)
        return replay(dataclasses.replace(free, rigs=("rubbish", *texts)).slice(0.0, 0.2), rig).report

    other = load_rig("shin2022_as_printed")
    refined = rig.replaced(name="refined", joint=rig.joint.replaced(inertia=5e-4))
    same = replayed(("plant", rig), ("estimator", rig)).recording
    assert same.issues == tuple(free.issues)
    assert same.rigs["plant"] == RecordedRig(rig.name, fingerprint(rig), True)
    told = replayed(("plant", rig), ("estimator", refined))
    assert told.recording.issues == tuple(free.issues)
    assert told.recording.rigs["estimator"].same is False
    assert f"rig refined ({fingerprint(refined)})" in live_rig(told)
    told = replayed(("plant", rig), ("estimator", other), ("estimator", other))
    (issue,) = told.recording.issues[len(free.issues) :]
    assert issue.startswith("recorded with rig shin2022_as_printed (") and "as its estimator said" in issue
    assert "force of muscle 2 at angle 0 and supply pressure" in issue
