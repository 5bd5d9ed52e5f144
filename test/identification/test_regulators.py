"""Regulators are identified, and commands that are none are recognised."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist import check, identify, load_rig, simulate
from pam_antagonist.cli.check import main
from pam_antagonist.identification.regulators import beside_the_lag
from pam_antagonist.inference.trial import make_trial
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.simulation.excitation import for_rig

RIG = load_rig("shin2022_regulators", regulators=True)


def recorded(**lag: float) -> Recording:
    """30 s of a joint whose regulators answer otherwise than the rig file says."""
    effects = {**RIG.effects, "regulator_lag": {**RIG.effects["regulator_lag"], **lag}}
    return simulate(RIG.replaced(effects=effects), duration=30.0, seed=3)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded()


@pytest.mark.slow(4)
def test_frequency_and_damping_are_found_with_error_bars() -> None:
    true = {"frequency_1": 44.0, "frequency_2": 70.0, "damping": 0.5}
    frozen = ["muscle_1", "muscle_2", "friction", "joint"]
    result = identify(recorded(**true), RIG, freeze=frozen)
    table = result.to_dataframe()
    for name, value in true.items():
        row = table.loc[f"effects.regulator_lag.{name}"]
        assert row["value"] == pytest.approx(value, rel=0.01)
        assert abs(row["value"] - value) < 4.0 * row["std"]
    assert not [name for name in table.index if name.startswith(("valve_", "supply")) or "limits" in name]


def overdriven(**limits: float) -> Recording:
    """30 s of a joint whose regulators hold back commands that the rig file lets through."""
    rig = RIG.replaced(effects={**RIG.effects, "regulator_limits": limits})
    return simulate(rig, for_rig(RIG, "steps", 30.0, 3), seed=3, mismatch=0.01)


@pytest.mark.slow(7)
@pytest.mark.parametrize(
    ("made", "expected"),
    [
        pytest.param(
            lambda: recorded(largest_rate=1.2e6, dead_zone=4e3),
            {"regulator_lag.largest_rate": 1.2e6, "regulator_lag.dead_zone": 4e3},
            marks=pytest.mark.thorough(6),
        ),
        (lambda: overdriven(lowest=110e3, highest=450e3), {"regulator_limits.highest": 450e3}),
    ],
)
def test_rate_zone_and_range_are_found_in_one_long_recording_and_nothing_else(made, expected: dict[str, float]) -> None:
    values, note = beside_the_lag(RIG, [make_trial(made(), RIG, "free", 0.0, "steps")], 1)
    assert set(values) == {f"effects.{path}" for path in expected}
    for path, value in expected.items():
        assert values[f"effects.{path}"] == pytest.approx(value, rel=0.1)
    assert "stretches determine" in note


def statuses(recording: Recording) -> dict[str, str]:
    return {finding.text: finding.status for finding in check(recording, RIG).findings}


def test_a_good_recording_is_good(recording: Recording) -> None:
    found = statuses(recording)
    assert set(found.values()) <= {"good", "untested"}
    assert not [text for text in found if "voltage" in text or "valve" in text]


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        (lambda r: replace(r, voltage=r.voltage * 1e-5), "wrong", "the commanded pressures are in bar"),
        (lambda r: replace(r, pressure=r.voltage), "wrong", "pressure_1 is what regulator 1 was asked for"),
        (lambda r: replace(r, voltage=r.voltage + 200e3), "doubtful", "or is regulator_limits wrong?"),
        (lambda r: replace(r, pressure=r.pressure[:, ::-1]), "wrong", "the pressure lines are exchanged"),
        (lambda r: replace(r, pressure=r.pressure - 101.3e3), "wrong", "these are gauge pressures"),
        (lambda r: replace(r, angle=-r.angle), "wrong", "the encoder counts the wrong way round"),
    ],
)
def test_what_is_wrong_with_a_recording_is_said(recording: Recording, change, status: str, words: str) -> None:
    found = statuses(change(recording))
    assert [text for text, what in found.items() if words in text and what == status], found


def test_a_bag_with_commands_in_bar_is_refused_and_checked(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    in_bar = replace(recording.slice(0.0, 6.0), voltage=np.array(recording.voltage[:6000]) * 1e-5, estimate=None)
    write_bag(tmp_path / "bar", in_bar)
    assert main([str(tmp_path / "bar"), "--rig", "shin2022_regulators"]) == 2
    assert "the commanded pressures are in bar, expected absolute pressures in Pa" in " ".join(
        capsys.readouterr().out.split()
    )
    from pam_antagonist.cli.replay import main as replay

    assert replay([str(tmp_path / "bar"), "--rig", "shin2022_regulators", "--out", str(tmp_path / "out")]) == 2
    assert "looks like bar" in capsys.readouterr().err


def test_commands_that_never_rest_leave_the_regulators_to_the_joint_refinement(recording: Recording) -> None:
    time = np.arange(len(recording.stamp_ns)) * RIG.sample_period
    sines = 450e3 + 60e3 * np.column_stack([np.sin(2.5 * time), np.cos(3.5 * time)])
    trial = make_trial(replace(recording, voltage=sines), RIG, "free", 0.0, "sines")
    values, note = beside_the_lag(RIG, [trial, trial], 1)
    assert values == {} and "before 0 stretches" in note
