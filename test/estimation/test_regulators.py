"""A joint with pressure regulators: the same simulation, filter, bag and replay, with pressures as commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from pam_antagonist import load_rig, read_bag, replay, simulate
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import Recording, write_bag

RIG = load_rig("shin2022_regulators", regulators=True)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(RIG, duration=8.0, mismatch=0.01, seed=3)


def test_the_filter_tells_the_angle_with_and_without_measured_pressures(recording: Recording) -> None:
    for measured in (True, False):
        pressure = recording.pressure if measured else np.full_like(recording.pressure, np.nan)
        run = Estimator(RIG).run(recording.stamp_ns, pressure, recording.voltage)
        assert len(run.rows) == len(recording)
        error = run.rows["angle"] - recording.angle
        assert np.ptp(recording.angle) > np.radians(10.0)
        assert np.sqrt(np.mean(error**2)) < np.radians(0.5)
        inside = np.abs(error) < 1.96 * np.sqrt(run.rows["covariance"][:, 0, 0])
        assert np.mean(inside) > 0.85


@pytest.mark.slow(7)
def test_without_measured_pressures_the_covariance_is_as_honest_as_with_them() -> None:
    """Twenty joints that differ by 1 % from the rig file, as docs/how-to/regulators.md reports them."""
    found = []
    for seed in range(100, 120):
        recording = simulate(RIG, duration=10.0, mismatch=0.01, seed=seed)
        blind = replace(recording, pressure=np.full_like(recording.pressure, np.nan))
        for one in (recording, blind):
            errors = replay(one, RIG).report.ukf
            found.append([errors.angle.rmse, errors.angle.coverage95, errors.torque.coverage95])
    measured, commanded = (np.array(found[k::2]).T for k in (0, 1))
    assert np.sqrt(np.mean(commanded[0] ** 2)) < 1.1 * np.sqrt(np.mean(measured[0] ** 2))
    assert commanded[1].mean() == pytest.approx(0.88, abs=0.04) and measured[1].mean() == pytest.approx(0.86, abs=0.04)
    assert commanded[2].mean() > 0.95 and measured[2].mean() > 0.95


def test_a_bag_keeps_what_was_asked_for_and_replays(recording: Recording, tmp_path: Path) -> None:
    live = Estimator(RIG).run(recording.stamp_ns, recording.pressure, recording.voltage)
    write_bag(tmp_path / "bag", recording)
    read = read_bag(tmp_path / "bag")
    assert read.drive == "regulator" and read.topics["pressure_state"] == "/pam/pressure_state"
    assert np.array_equal(read.voltage, recording.voltage)
    report = replay(tmp_path / "bag", RIG).report
    assert report.ukf.angle is not None and report.ukf.angle.rmse < 0.5
    assert np.array_equal(replay(tmp_path / "bag", RIG).run.rows["angle"], live.rows["angle"])
    blind = replace(recording, pressure=np.full_like(recording.pressure, np.nan), path=tmp_path / "blind")
    write_bag(blind.path, blind)
    assert replay(blind.path, RIG).report.ukf.angle.rmse < 0.5


def test_valves_and_regulators_are_not_taken_for_each_other(recording: Recording) -> None:
    with pytest.raises(BadInput, match="of a joint with pressure regulators; expected a rig with drive: regulator"):
        replay(recording, "shin2022")
    with pytest.raises(BadInput, match="holds no pressure_state"):
        replay(simulate("shin2022", duration=0.1), RIG)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"drive": "valve"}, "effects.regulator_lag: the rig has valves; expected drive: regulator with it"),
        ({"effects": {"regulator_lag": {"frequency_1": 0.0}}}, "effects.regulator_lag is missing"),
        ({"effects": {"regulator_limits": {"lowest": 8e5}}}, "expected lowest below highest"),
        ({"effects": {"regulator_dead_time": {"time_1": 1e-4}}}, "one step of the integration would not follow it"),
    ],
)
def test_what_a_rig_file_has_to_say(tmp_path: Path, changes: dict[str, object], words: str) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"based_on": "shin2022_regulators", **changes}))
    with pytest.raises(BadInput) as error:
        load_rig(tmp_path / "rig.yaml", regulators=True)
    assert words in str(error.value)
