"""A correction that makes a good recording wrong is to be left out; one that is right is kept."""

from __future__ import annotations

from dataclasses import replace
from math import radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pam_antagonist import check
from pam_antagonist.checks import check_recording
from pam_antagonist.cli import check as check_command
from pam_antagonist.cli import replay
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import Rig

CERTAIN: list[dict[str, Any]] = [
    {"flip_angle": True}, {"flip_torque": True}, {"swap_pressures": True}, {"swap_valves": True}, {"gauge": True},
    {"swap_pressures": True, "flip_angle": True}, {"pressure_unit": "kPa"}, {"angle_unit": "deg"},
    {"torque_unit": "N mm"},
]  # fmt: skip
NUMBERS: list[dict[str, Any]] = [
    {"encoder_zero": radians(20.0)}, {"torque_zero": 2.0}, {"torque_scale": 0.4}, {"delay_voltage": 0.3},
    {"delay_pressure": 0.1}, {"delay_angle": -0.2}, {"delay_torque": 0.2},
]  # fmt: skip
"""They may be doubtful only."""


@pytest.mark.parametrize("given", [*CERTAIN, *NUMBERS], ids=" ".join)
def test_what_makes_it_wrong_is_left_out_and_never_typed(free: Recording, rig: Rig, given: dict[str, Any]) -> None:
    typed = Corrections(**given)
    checked = check_recording(free, rig, typed=typed)
    found = checked.wrong if given in CERTAIN else checked.findings
    assert [option for finding in found for option in finding.leave_out] == typed.options()
    assert not [finding.options for finding in checked.findings if finding.options]
    assert given in NUMBERS or checked.corrections == Corrections()


def test_what_is_right_is_kept(free: Recording, rig: Rig) -> None:
    assert free.angle is not None and free.torque is not None
    wrong = replace(
        free, pressure=(free.pressure[:, ::-1] - 101_325.0) / 1e3, angle=-np.degrees(free.angle) + 12.0,
        torque=1.5 * free.torque + 3.0,
    )  # fmt: skip
    typed = Corrections(
        pressure_unit="kPa", gauge=True, swap_pressures=True, angle_unit="deg", flip_angle=True,
        encoder_zero=radians(-12.0), torque_zero=3.0, torque_scale=1.5,
    )  # fmt: skip
    checked = check_recording(wrong, rig, typed=typed)
    assert not [finding.text for finding in checked.findings if finding.status in ("wrong", "doubtful")]
    assert checked.corrections == typed


def test_a_missing_one_is_typed_beside_one_to_be_left_out(free: Recording, rig: Rig) -> None:
    assert free.angle is not None
    degrees = replace(free, angle=np.degrees(free.angle))
    checked = check_recording(degrees, rig, typed=Corrections(flip_torque=True))
    assert {finding.todo for finding in checked.wrong} == {"type --angle-unit deg", "leave out --flip-torque"}


def test_muscles_may_be_counted_the_other_way_round(free: Recording, rig: Rig) -> None:
    other = Corrections(swap_pressures=True, swap_valves=True, flip_angle=True, flip_torque=True)
    assert not check_recording(free, rig, typed=other).wrong


def test_a_number_of_the_rig_file_is_named_as_such(free: Recording, rig: Rig) -> None:
    calibrated = rig.replaced(calibration={"encoder_zero": radians(20.0)})
    found = check(free, calibrated)
    assert any("it is calibration.encoder_zero of the rig file" in finding.text for finding in found.findings)
    assert not [finding.leave_out for finding in found.findings if finding.leave_out]


def test_values_converted_twice_name_the_map(free: Recording, rig: Rig) -> None:
    assert free.torque is not None
    found = check_recording(replace(free, torque=free.torque * 1e-3), rig).findings
    assert any("values in N m were converted from" in finding.text for finding in found)


def test_commands_say_so(free: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / "bag"
    write_bag(bag, free)
    assert check_command.main([str(bag), "--rig", "shin2022", "--flip-angle"]) == 2
    out = capsys.readouterr().out
    assert "Leave out --flip-angle" in out and "Type --flip-angle" not in out
    for options, expected in (
        (["--flip-angle"], "leave out --flip-angle"),
        (["--pressure-unit", "kPa"], "without --pressure-unit kPa: leave that out"),
        (["--joint", "locked"], "leave out --joint locked"),
    ):
        out_dir = str(tmp_path / f"out{len(options)}{options[0]}")
        assert replay.main([str(bag), "--rig", "shin2022", "--out", out_dir, "--no-figures", *options]) == 2
        error = capsys.readouterr().err
        assert expected in error and error.count("\n") == 1


def test_findings_as_values_have_it(free: Recording, rig: Rig) -> None:
    found = check(free, rig, corrections=Corrections(flip_angle=True)).to_json()
    assert found["findings"][0]["leave_out"] == ["--flip-angle"] and found["findings"][0]["options"] == []
