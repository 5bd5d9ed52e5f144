"""A recording that was begun while the estimator ran, and a part of a long one: both bit for bit from a checkpoint."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.memory import Checkpoint
from pam_antagonist.recording import RecordedEstimate, Recording, read_bag, write_bag
from pam_antagonist.replays import Replay, replay
from pam_antagonist.report.replay import findings
from pam_antagonist.rig import Rig

EVERY = 1000
BEGUN = 1700


class Live(NamedTuple):
    estimate: RecordedEstimate
    checkpoints: tuple[Checkpoint, ...]


def run_live(rig: Rig, recording: Recording, end: int, set_at: int | None = None, **options: Any) -> Live:
    """What a live node publishes that is started with the first sample; its state is set after number ``set_at``."""
    estimator = Estimator(rig, **options)
    parts, checkpoints = [], []
    for k in range(end):
        one = slice(k, k + 1)
        parts.append(estimator.run(recording.stamp_ns[one], recording.pressure[one], recording.voltage[one]))
        if k % EVERY == EVERY - 1:
            checkpoints.append(estimator.checkpoint())
        if k == set_at:
            row = parts[-1].rows[0]
            pressure, voltage = tuple(row["pressure"]), tuple(recording.voltage[k])
            estimator.set_state(int(recording.stamp_ns[k]), float(row["angle"]) + 0.05, 0.0, pressure, voltage)
            checkpoints.append(estimator.checkpoint())
    fields = ("stamp_ns", "started_ns", "rows")
    return Live(
        RecordedEstimate.from_rows(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields)),
        tuple(checkpoints),
    )


def recorded(recording: Recording, live: Live, begin: int = 0) -> Recording:
    """What a recorder has of both that was started with sample number ``begin``."""
    rest = recording.take(np.arange(begin, len(recording)))
    return replace(rest, estimate=live.estimate.take(slice(begin, None)), checkpoints=live.checkpoints)


@pytest.fixture(scope="module")
def live(rig: Rig, free: Recording) -> Live:
    return run_live(rig, free, 5000)


@pytest.fixture(scope="module")
def begun_later(free: Recording, live: Live, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """The last of 5 s from 1.7 s on, through a bag."""
    folder = tmp_path_factory.mktemp("later") / "bag"
    write_bag(folder, recorded(free, live, BEGUN))
    return read_bag(folder)


def said(done: Replay) -> str:
    return " ".join(item.text for item in findings(done.report))


def test_it_replays_bit_for_bit_from_its_first_checkpoint(rig: Rig, begun_later: Recording) -> None:
    done = replay(begun_later, rig)
    equal = done.report.live_equal
    assert equal is not None
    assert (equal.compared, equal.equal, equal.only_live, equal.only_replay) == (3000, 3000, 0, 0)
    assert equal.not_compared == 300 and equal.why_not == ("the recording was begun while the live filter ran",)
    assert done.report.estimator.resumed_ns == (int(begun_later.stamp_ns[299]),)
    assert "bit for bit, in all 3000 samples that were compared" in said(done)
    assert (
        "300 live estimates were not compared bit for bit: the recording was begun while the live filter ran"
        in said(done)
    )
    assert "no checkpoint" not in said(done)


def test_without_a_checkpoint_it_says_why_the_estimates_differ(rig: Rig, begun_later: Recording) -> None:
    done = replay(replace(begun_later, checkpoints=()), rig)
    equal = done.report.live_equal
    assert equal is not None and (equal.compared, equal.not_compared) == (0, 3300)
    assert equal.apart_deg is not None and equal.apart_deg[0] > equal.apart_deg[1] >= 0.0, "both end alike, at rest"
    assert "begun while the live filter ran" in said(done) and "holds no checkpoint" in said(done)
    assert "no sample in common" not in said(done)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        (
            {"state": np.array([np.nan, 0.0, 4e5, 4e5])},
            "the checkpoint is damaged: state holds a value that is not finite",
        ),
        ({"fingerprint": "0" * 16}, "the checkpoint was made with rig shin2022 (0000000000000000) rather than"),
    ],
    ids=["not finite", "other rig"],
)
def test_a_bad_checkpoint_is_refused_in_one_line_and_the_next_one_serves(
    rig: Rig, begun_later: Recording, tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    _, first, *others = begun_later.checkpoints  # the very first one is of a sample before the recording
    own = {item.name for item in fields(first)}
    identity = replace(first.identity, **{name: changes[name] for name in set(changes) - own})
    bad = replace(first, **{name: changes[name] for name in set(changes) & own}, identity=identity)
    write_bag(tmp_path / "bag", replace(begun_later, checkpoints=(bad, *others)))
    done = replay(read_bag(tmp_path / "bag"), rig)
    equal = done.report.live_equal
    assert equal is not None and (equal.compared, equal.equal, equal.not_compared) == (2000, 2000, 1300)
    (refused,) = done.report.estimator.refused
    assert refused.startswith("the checkpoint ") and why in refused and "\n" not in refused
    assert f"A checkpoint was of no use: {refused}." in said(done)


def test_a_checkpoint_without_its_sample_is_of_no_use(rig: Rig, begun_later: Recording) -> None:
    """What the recorder did not get, the live filter had: nothing can be compared before the next one."""
    equal = replay(begun_later.take(np.delete(np.arange(len(begun_later)), 299)), rig).report.live_equal
    assert equal is not None and (equal.compared, equal.equal) == (2000, 2000)


def test_what_a_recorder_left_out_at_its_end_is_not_compared(rig: Rig, free: Recording, live: Live) -> None:
    """It leaves the topics one after the other: the last samples lack a pressure, and estimates go on after them."""
    pressure = free.pressure.copy()
    pressure[4900:, 0] = np.nan
    done = replay(replace(free, pressure=pressure, estimate=live.estimate).take(np.arange(4960)), rig)
    equal = done.report.live_equal
    assert equal is not None and (equal.compared, equal.equal, equal.only_live) == (4900, 4900, 0)
    assert equal.not_compared == 100 and equal.why_not == ("the recording ended while the live filter ran",)
    assert "bit for bit, in all 4900 samples that were compared" in said(done) and "checkpoint" not in said(done)


def test_a_sensor_that_fails_for_the_rest_is_compared_to_the_end(rig: Rig, free: Recording) -> None:
    pressure = free.pressure.copy()
    pressure[1000:, 1] = np.nan
    failed = replace(free, pressure=pressure)
    live = run_live(rig, failed, 1500)
    equal = replay(replace(failed, estimate=live.estimate), rig).report.live_equal
    assert equal is not None and (equal.compared, equal.equal, equal.not_compared) == (1500, 1500, 0)


def test_a_state_set_by_hand_is_gone_on_from(rig: Rig, free: Recording) -> None:
    live = run_live(rig, free, 1500, set_at=400)
    done = replay(recorded(free, live), rig)
    equal = done.report.live_equal
    assert equal is not None and (equal.compared, equal.equal, equal.not_compared) == (1500, 1500, 0)
    assert len(set(live.estimate.started_ns.tolist())) == 2
    without = replay(replace(free, estimate=live.estimate), rig).report.live_equal
    assert without is not None and (without.compared, without.equal) == (401, 401)
    assert without.why_not == ("the state of the live filter was set by hand",)


def test_a_locked_joint_goes_on_with_its_angle(rig: Rig, locked: Recording) -> None:
    live = run_live(rig, locked, 2500, joint="locked", lock_angle=0.1234567890123)
    equal = replay(recorded(locked, live, BEGUN), rig).report.live_equal
    assert equal is not None and (equal.compared, equal.equal) == (500, 500)


# ------------------------------------------------------------------ a part of a recording


@pytest.mark.parametrize("begin_s", [0.5, 3.25, 4.999])
def test_a_part_has_the_estimates_and_the_model_of_the_whole(
    rig: Rig, free: Recording, live: Live, begin_s: float
) -> None:
    recording = recorded(free, live)
    whole = replay(recording, rig)
    steps: list[int] = []
    part = replay(recording, rig, begin_s=begin_s, progress=steps.append)
    first = round(begin_s * 1000)
    assert part.run.rows.tobytes() == whole.run.rows[first:].tobytes()
    assert part.run.stamp_ns.tobytes() == whole.run.stamp_ns[first:].tobytes()
    assert part.model.angle.tobytes() == whole.model.angle[first:].tobytes()
    assert sum(steps) == len(recording) and steps[0] == first // EVERY * EVERY
    report = part.report
    assert report.samples == 6000 - first and report.duration_s == pytest.approx(6.0 - begin_s)
    equal = report.live_equal
    assert equal is not None and equal.compared == equal.equal == 5000 - first and not equal.only_live
    assert report.ukf.angle is not None and report.ukf.angle.rmse > 0.0


def test_a_part_of_a_recording_that_was_begun_later(rig: Rig, begun_later: Recording) -> None:
    whole = replay(begun_later, rig)
    for begin_s in (0.1, 1.5):  # before and behind its first checkpoint
        part = replay(begun_later, rig, begin_s=begin_s)
        first = round(begin_s * 1000)
        assert part.run.rows.tobytes() == whole.run.rows[first:].tobytes()
        assert part.model.angle.tobytes() == whole.model.angle[first:].tobytes()


def test_another_rig_runs_from_the_start_and_says_why(rig: Rig, free: Recording, live: Live) -> None:
    recording = recorded(free, live)
    part = replay(recording, rig, tuning="published", begin_s=3.0)
    whole = replay(recording, rig, tuning="published")
    assert part.run.rows.tobytes() == whole.run.rows[3000:].tobytes()
    assert "The filter ran from its start: the checkpoint was made with tuning default rather than published." in said(
        part
    )


def test_without_a_live_estimate_a_part_is_cut_out_of_the_whole(rig: Rig, free: Recording) -> None:
    part = replay(free, rig, begin_s=2.0)
    assert part.run.rows.tobytes() == replay(free, rig).run.rows[2000:].tobytes()


@pytest.mark.parametrize("begin_s", [-1.0, 6.5, float("inf"), float("nan")])
def test_a_time_that_is_not_in_the_recording_is_refused(rig: Rig, free: Recording, begin_s: float) -> None:
    with pytest.raises(BadInput, match=r"cannot begin at .* expected 0 to 5\.999 s, its|begin_s nan: expected a"):
        replay(free, rig, begin_s=begin_s)
