"""Many short episodes through identify, replay and check; where they are not taken, that is said.

The joint and regulators of the first tests are simulated by scipy, not by the package's model.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lsim, lti

from pam_antagonist import check, diagnose, identify, load_rig, replay, simulate
from pam_antagonist.api.history import entry
from pam_antagonist.cli.identify import main
from pam_antagonist.errors import BadInput
from pam_antagonist.identification import episodes as of_episodes
from pam_antagonist.identification.episode_filter import with_filter
from pam_antagonist.identification.episodes import identify as identify_episodes
from pam_antagonist.identification.regulators import of_commands
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.episodes import whole_episodes
from pam_antagonist.inference.held_episodes import held_out
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.report.identify import IdentifyResult
from pam_antagonist.report.identify_episodes import EpisodesIdentifyResult

EPISODES, ROWS, PERIOD = 40, 80, 0.01
GAIN, VISCOUS, STIFFNESS = 2e-4, 8.0, 60.0  # [rad/s² by Pa], [1/s], [1/s²]
RIG = load_rig("shin2022_regulators", regulators=True)
UNKNOWN = load_rig("regulator_joint", regulators=True)


def commanded(dead_time: int, damping: float = 0.35) -> Recording:
    """A joint with viscous friction; regulators with 25 and 31 1/s behind a dead time of so many milliseconds."""
    rng = np.random.default_rng(5)
    fine = 10
    time = np.arange(ROWS * fine) * PERIOD / fine
    asked = 3e5 + 1e5 * np.repeat(rng.uniform(-1.0, 1.0, (EPISODES, 2, ROWS // 10)), 10, axis=2)
    pressure = np.empty((EPISODES, ROWS, 2))
    angle = np.empty((EPISODES, ROWS))
    for e in range(EPISODES):
        pull = np.zeros(len(time))
        for k, omega in enumerate((25.0, 31.0)):
            held = np.repeat(asked[e, k], fine)
            late = np.concatenate([np.full(dead_time, held[0]), held])[: len(held)]
            _, out, _ = lsim(lti([omega**2], [1.0, 2 * damping * omega, omega**2]), late - held[0], time, interp=False)
            pull += (1 - 2 * k) * (held[0] + out)
            pressure[e, :, k] = held[0] + out[::fine] + 200.0 * rng.standard_normal(ROWS)
        # At rest where the first pressures hold it.
        _, out, _ = lsim(lti([GAIN], [1.0, VISCOUS, STIFFNESS]), pull - pull[0], time)
        angle[e] = GAIN / STIFFNESS * pull[0] + out[::fine]
    # A row of a recording holds what was asked for over the step that ends there.
    command = np.concatenate([asked[:, :, :1], asked[:, :, :-1]], axis=2).transpose(0, 2, 1)
    stamps = 10**18 + (np.arange(EPISODES)[:, None] * 3 * 10**9 + np.rint(time[::fine] * 1e9).astype(np.int64)).ravel()
    return Recording(
        Path("arm"), stamps, pressure.reshape(-1, 2), command.reshape(-1, 2), angle.ravel(),
        episode_ns=stamps[::ROWS], drive="regulator",
    )  # fmt: skip


def found_in(recording: Recording) -> tuple[dict[str, float], set[str]]:
    joint = PressureDriven.of(recording, UNKNOWN)
    found = of_commands(joint, held_out(len(joint), 1.0 / 3.0), lambda text: None)
    assert max(found.errors) < 2e3 < min(found.command_errors)
    values = {name.removeprefix("effects."): value.value for name, value in found.values.items()}
    return values, {item.name for item in found.tried if item.taken}


def test_regulators_are_found_without_what_they_have_not() -> None:
    values, taken = found_in(commanded(dead_time=0))
    assert not taken
    assert values["regulator_lag.frequency_1"] == pytest.approx(25.0, rel=0.01)
    assert values["regulator_lag.frequency_2"] == pytest.approx(31.0, rel=0.01)
    assert values["regulator_lag.damping"] == pytest.approx(0.35, rel=0.02)


@pytest.mark.slow(5)
def test_a_dead_time_is_found_beside_the_lag() -> None:
    values, taken = found_in(commanded(dead_time=23))
    assert "dead time" in taken
    assert values["regulator_dead_time.time_1"] == pytest.approx(0.023, abs=2e-3)
    assert values["regulator_lag.frequency_1"] == pytest.approx(25.0, rel=0.05)


def episodes(pause_ns: int, count: int = 3) -> tuple[Recording, list[Recording]]:
    """A joint with regulators in episodes with other starts, and each by itself."""
    long = simulate(RIG, duration=1.0 + 1.2 * count, mismatch=0.01, seed=3)
    alone = [long.slice(1.0 + 1.2 * k, 2.2 + 1.2 * k) for k in range(count)]
    begin, shifted = 10**18, []
    for one in alone:
        shifted.append(replace(one, stamp_ns=begin + one.stamp_ns - one.stamp_ns[0], estimate=None, received_ns={}))
        begin = int(shifted[-1].stamp_ns[-1]) + pause_ns
    names = ("stamp_ns", "pressure", "voltage", "angle", "torque")
    whole: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in shifted]) for name in names}
    begins = np.array([one.stamp_ns[0] for one in shifted])
    return Recording(Path("series"), **whole, episode_ns=begins, drive="regulator"), shifted


def test_a_replay_starts_anew_with_each_episode() -> None:
    """The pause is so short that the filter would go on by itself."""
    whole, alone = episodes(pause_ns=20_000_000)
    done = replay(whole, RIG)
    assert done.report.estimator.started_ns == tuple(int(stamp) for stamp in whole.episode_ns)
    assert np.array_equal(done.run.rows["angle"], np.concatenate([replay(one, RIG).run.rows["angle"] for one in alone]))
    assert np.array_equal(done.model.angle, np.concatenate([replay(one, RIG).model.angle for one in alone]))
    assert any("3 episodes: filter and model start anew" in issue for issue in done.report.recording.issues)


def test_a_check_compares_each_episode_from_its_own_start() -> None:
    whole, _ = episodes(pause_ns=1_500_000_000, count=6)
    assert {finding.status for finding in check(whole, RIG).findings} <= {"good", "untested"}
    backwards = check(replace(whole, angle=-whole.angle), RIG)
    assert any("counts the wrong way round" in item.text for item in backwards.findings if item.status == "wrong")


@pytest.mark.slow(8)
def test_the_filter_of_episodes_is_as_sure_as_it_is_right_on_later_ones() -> None:
    """A rig a little off the joint, whose file is sure of itself."""
    whole, _ = episodes(pause_ns=1_500_000_000, count=24)
    sure = RIG.replaced(uncertainty={}, directions={})
    found = with_filter(sure, whole, whole.episodes, 1.0 / 3.0)
    assert found is not None and found.rig.uncertainty
    assert 0.9 <= found.coverage <= 1.0 and f"{found.error_deg:.3g}"[:4] in found.sentence
    later = whole.slice(whole.time_s[whole.episodes[16].start], np.inf)
    for rig, holds in ((found.rig, True), (sure, False)):
        angle = replay(later, rig).report.ukf.angle
        assert angle is not None and angle.coverage95 is not None
        assert (angle.coverage95 >= 0.9) == holds
        assert not holds or (angle.rmse, angle.coverage95) == (found.error_deg, found.coverage)
    assert with_filter(sure, replace(whole, voltage=np.full_like(whole.voltage, np.nan)), whole.episodes, 1 / 3) is None


def test_the_filter_is_judged_on_the_episodes_that_the_fits_have_held_out() -> None:
    """Two of the first episodes are left out, as they are of the fits: the later ones are still those of the fits."""
    whole = commanded(dead_time=0)
    pressure = whole.pressure.copy()
    pressure[np.r_[whole.episodes[1], whole.episodes[4]]] = np.nan
    broken = replace(whole, pressure=pressure)
    there, joint = whole_episodes(broken), PressureDriven.of(broken, UNKNOWN)
    assert len(there) == len(joint) == EPISODES - 2
    later = held_out(len(there), 1.0 / 3.0).later
    assert [broken.angle[there[k].start] for k in later] == joint.angle[joint.first[later]].tolist()


@pytest.mark.slow(6)
def test_identify_writes_a_rig_with_the_regulators_that_it_found(tmp_path: Path, capsys: Any) -> None:
    write_bag(tmp_path / "bag", commanded(dead_time=0))
    options = ["--rig", "regulator_joint", "--out", str(tmp_path / "out")]
    assert main([str(tmp_path / "bag"), *options, "--free", "joint"]) == 2
    assert "--free: not for many episodes of a joint with pressure regulators" in capsys.readouterr().err
    assert main([str(tmp_path / "bag"), *options]) == 0
    assert "Value of the regulators" in capsys.readouterr().out
    rig = load_rig(tmp_path / "out" / "rig.yaml", regulators=True)
    assert rig.joint.stiffness / rig.joint.inertia == pytest.approx(STIFFNESS, rel=0.03)
    assert rig.joint.viscous_friction / rig.joint.inertia == pytest.approx(VISCOUS, rel=0.05)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert rig.value("effects.regulator_lag.frequency_1") == pytest.approx(25.0, rel=0.01)
    kept = json.loads((Path(__file__).parents[1] / "golden" / "identify.json").read_text(encoding="utf-8"))
    assert list(report)[: len(kept)] == list(kept), "the report has the keys of all others"
    assert report["episodes"] == {"fitted": 22, "later": 13, "interleaved": 5}
    again = identify(tmp_path / "bag", "regulator_joint")
    assert isinstance(again, EpisodesIdentifyResult)
    assert again.rig.value("joint.stiffness") == rig.value("joint.stiffness")
    assert list(again.hashes) == report["recordings_sha256"]
    # A value without an interval says nothing of a change: the log book leaves it out.
    values = {**again.found.values, "joint.stiffness": Interval(60.0, np.nan, np.nan)}
    unknown = replace(again, found=replace(again.found, values=values))
    kept = [set(entry("identify", [], rig, one).values) for one in (again, unknown)]
    assert kept[0] - kept[1] == {"joint.stiffness"}


def test_a_joint_that_does_not_move_is_refused() -> None:
    recording = commanded(dead_time=0)
    still = PressureDriven.of(replace(recording, angle=np.zeros(len(recording))), UNKNOWN)
    with pytest.raises(BadInput, match="the angle never changes"):
        identify_episodes(still, 1.0 / 3.0)


@pytest.mark.slow(4)
def test_an_impossible_optimum_is_no_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.setattr(of_episodes, "unphysical", lambda rig: "gas: these constants give no finite flow")
    write_bag(tmp_path / "bag", commanded(dead_time=0))
    assert main([str(tmp_path / "bag"), "--rig", "regulator_joint", "--out", str(tmp_path / "out")]) == 1
    assert "the values that fit it best are impossible: gas: these constants" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_commands_in_the_place_of_measured_pressures_are_refused() -> None:
    recording = commanded(dead_time=0)
    with pytest.raises(BadInput, match="pressure_1 is the command of regulator 1, row by row"):
        PressureDriven.of(replace(recording, pressure=recording.voltage), UNKNOWN)


def test_parameters_cannot_be_chosen_for_episodes_and_one_recording_is_enough() -> None:
    recording = commanded(dead_time=0)
    with pytest.raises(BadInput, match="free: not for many episodes"):
        identify(recording, UNKNOWN, free=["joint"])
    for door in (identify, diagnose):
        with pytest.raises(BadInput, match="expected the recording of episodes alone|expected one recording"):
            door([recording, recording], UNKNOWN)


def test_where_episodes_are_not_taken_that_is_said() -> None:
    part = simulate("shin2022", duration=0.2, seed=1)
    valves = replace(part, episode_ns=np.array([part.stamp_ns[0], part.stamp_ns[100]]))
    with pytest.raises(BadInput, match="holds 2 episodes; expected a recording in one piece"):
        diagnose(valves, "shin2022")


def test_trials_of_a_joint_with_valves_are_identified_whatever_its_force_map() -> None:
    trials = [simulate("shin2022", duration=5.0, seed=seed, mismatch=0.02) for seed in (1, 1, 1)]
    later = [k * 7 * 10**9 for k in range(3)]
    stamps = np.concatenate([one.stamp_ns + late for one, late in zip(trials, later, strict=True)])
    pressure, voltage = (np.vstack([getattr(one, name) for one in trials]) for name in ("pressure", "voltage"))
    angle, torque = (np.concatenate([getattr(one, name) for one in trials]) for name in ("angle", "torque"))
    whole = Recording(
        Path("trials"), stamps, pressure, voltage, angle=angle, torque=torque,
        episode_ns=trials[0].stamp_ns[0] + np.array(later),
    )  # fmt: skip
    found = identify(whole, "shin2022")
    assert isinstance(found, IdentifyResult)
    assert found.found.pooled("identified") < found.found.pooled("as_configured")
    assert not found.found.rejected, found.found.rejected
