"""Simulated recordings are bags like any other, and the same arguments give the same one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.api.simulate import FIRST_STAMP_NS
from pam_antagonist.cli.simulate import main
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import simulate_model
from pam_antagonist.recording import read_bag
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation import excitation


def _bag(folder: Path, *arguments: str) -> Path:
    assert main(["--rig", "shin2022", "--out", str(folder), *arguments]) == 0
    return folder


def test_a_bag_holds_what_a_live_joint_publishes(tmp_path, capsys):
    recording = read_bag(_bag(tmp_path / "bag", "--duration", "2", "--profile", "multisine"))
    assert recording.issues == ()
    assert len(recording.stamp_ns) == 2000
    assert recording.stamp_ns[0] == FIRST_STAMP_NS + 1_000_000
    assert set(np.diff(recording.stamp_ns)) == {1_000_000}
    expected = excitation.profile("multisine", 2.0, 1e-3)
    assert np.array_equal(recording.voltage, expected)
    assert recording.angle is not None and recording.torque is not None
    assert np.isfinite(recording.pressure).all()
    assert "2000 samples" in capsys.readouterr().out


def test_the_same_arguments_give_the_same_recording_and_another_seed_another(tmp_path):
    arguments = ("--duration", "1", "--profile", "steps", "--mismatch", "0.01")
    seeds = {"a": (), "b": (), "c": ("--seed", "1")}
    first, again, other = (read_bag(_bag(tmp_path / name, *arguments, *seed)) for name, seed in seeds.items())
    for name in ("stamp_ns", "pressure", "voltage", "angle", "torque"):
        assert np.array_equal(getattr(first, name), getattr(again, name)), name
    assert not np.array_equal(first.pressure, other.pressure)


def test_without_noise_and_mismatch_the_pressures_are_the_models(tmp_path):
    recording = read_bag(_bag(tmp_path / "bag", "--duration", "2", "--no-noise", "--joint", "locked"))
    assert recording.angle is not None and not recording.angle.any()
    model = simulate_model(load_rig("shin2022"), recording.voltage, recording.pressure[0], joint="locked", substeps=4)
    assert recording.pressure == pytest.approx(model.pressure, rel=1e-9)


def test_a_table_of_voltages_is_held_between_its_rows(tmp_path):
    (tmp_path / "u.csv").write_text("t_s,u1,u2\n10.0,5.5,5.5\n10.003,6.0,5.0\n10.005,5.0,6.0\n")
    recording = read_bag(_bag(tmp_path / "bag", "--profile", str(tmp_path / "u.csv")))
    assert recording.voltage[:, 0].tolist() == [5.5, 5.5, 5.5, 6.0, 6.0, 5.0]
    assert recording.voltage[:, 1].tolist() == [5.5, 5.5, 5.5, 5.0, 5.0, 6.0]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "missing"),
        ("t,u1,u2\n0,5,5\n1,5,5\n", "expected t_s,u1,u2"),
        ("t_s,u1,u2\n0,5,5\n", "1 rows"),
        ("t_s,u1,u2\n0,5,5\n1,five,5\n", "row 3"),
        ("t_s,u1,u2\n0,5,5\n1,5\n", "row 3"),
        ("t_s,u1,u2\n0,5,5\n1,nan,5\n", "row 3"),
        ("t_s,u1,u2\n0,5,5\n1,5,5\n1,6,5\n", "row 4"),
        ("t_s,u1,u2\n0,5,5\n1,5,12\n", "row 3 is outside the rig's valve voltages, 0 to 10 V"),
    ],
)
def test_a_bad_table_is_refused(tmp_path, refused, content, says):
    (tmp_path / "u.csv").write_text(content)
    arguments = ["--rig", "shin2022", "--out", str(tmp_path / "bag"), "--profile", str(tmp_path / "u.csv")]
    refused(main, arguments, "u.csv", says)
    assert not (tmp_path / "bag").exists()


# ------------------------------------------------------------------ profiles


def test_the_papers_profile_reaches_the_papers_pressures_and_angles():
    rig = load_rig("shin2022")
    voltage = excitation.profile("paper", excitation.PAPER_DURATION, rig.sample_period)
    assert len(voltage) == 130_000
    model = simulate_model(rig, voltage, np.array([450e3, 450e3]))
    assert model.pressure.min(axis=0) == pytest.approx([200e3, 200e3], abs=10e3)
    assert model.pressure.max(axis=0) == pytest.approx([700e3, 700e3], abs=10e3)
    assert np.degrees(model.angle.min()) < -20.0
    assert np.degrees(model.angle.max()) > 20.0


@pytest.mark.parametrize("name", sorted(excitation.PROFILES))
def test_profiles_start_at_rest_and_stay_within_their_span(name):
    span = excitation.DriveVoltages(4.0, 5.0, 8.0)
    voltage = excitation.profile(name, 150.0, 1e-3, seed=4, span=span)
    assert voltage[0] == pytest.approx([5.0, 5.0], abs=0.01)
    assert voltage.min() >= 4.0
    assert voltage.max() <= 8.0
    assert np.ptp(voltage, axis=0).min() > 1.5, "both valves are used"
    assert np.corrcoef(voltage.T)[0, 1] < 0.9, "and not always together"


def test_an_unknown_profile_is_refused():
    with pytest.raises(BadInput, match="paper, steps, multisine"):
        excitation.profile("square", 1.0, 1e-3)


def test_voltages_may_have_the_signs_of_typesetting(tmp_path):
    (tmp_path / "u.csv").write_text("t_s,u1,u2\n\u22120.5,5.5,5.5\n0,6.0,5.0\n1D0,5,5\n", encoding="utf-8")
    time, voltage = excitation.read_table(tmp_path / "u.csv")
    assert time.tolist() == [-0.5, 0.0, 1.0] and voltage[1].tolist() == [6.0, 5.0]
