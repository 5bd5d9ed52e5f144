"""Corrections of zeros, a scale and late stamps: what is typed, and what it does to a recording."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections, add_options, from_options


def recording() -> Recording:
    time = np.arange(1000) * 1e-3
    wave = np.sin(3.0 * time)
    pressure = 4e5 + 1e4 * np.column_stack([wave, -wave])
    voltage = np.column_stack([5.0 + wave, 5.0 - wave])
    return Recording(Path("one"), np.arange(1000) * 1_000_000, pressure, voltage, wave, 2.0 * wave)


def typed(*arguments: str, **known: float) -> Corrections:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return from_options(parser.parse_args(arguments), known)


def test_zeros_and_scale_are_taken_away() -> None:
    true = recording()
    read = typed("--encoder-zero", "-0.45", "--torque-zero", "0.1", "--torque-scale", "1.03").applied(true)
    assert read.angle == pytest.approx(true.angle + np.radians(0.45))
    assert read.torque == pytest.approx((true.torque - 0.1) / 1.03)


def test_a_zero_counts_in_the_direction_of_the_corrected_angle() -> None:
    read = typed("--angle-unit", "deg", "--flip-angle", "--encoder-zero", "2").angle(np.array([3.0]))
    assert read == pytest.approx(np.radians(-3.0 - 2.0))


def test_early_stamps_are_moved_between_samples() -> None:
    true = recording()
    read = typed("--delay-angle", "2.5", "--delay-torque", "-4", "--delay-pressure", "10").applied(true)
    inside = slice(20, -20)
    time = true.time_s[inside]
    assert read.angle[inside] == pytest.approx(np.sin(3.0 * (time - 0.0025)), abs=1e-5)
    assert read.torque[inside] == pytest.approx(2.0 * np.sin(3.0 * (time + 0.004)), abs=1e-5)
    assert read.pressure[inside, 0] == pytest.approx(4e5 + 1e4 * np.sin(3.0 * (time - 0.010)), abs=0.1)
    # What was not recorded is not made up, but a filter needs pressures from its first sample on.
    assert np.isnan(read.angle[:3]).all() and np.isnan(read.torque[-4:]).all()
    assert np.isfinite(read.pressure).all()


def test_what_is_to_be_typed_is_what_was_typed() -> None:
    arguments = ["--encoder-zero", "-0.45", "--torque-scale", "1.03", "--delay-voltage", "21.8"]
    corrections = typed(*arguments)
    assert " ".join(corrections.options()) == " ".join(arguments)
    assert typed().options() == []


def test_further_corrections_do_what_both_do_in_turn() -> None:
    true = recording()
    first = Corrections(encoder_zero=0.01, torque_zero=0.3, torque_scale=1.1, delay_angle=0.002, gauge=True)
    second = Corrections(encoder_zero=-0.02, torque_zero=-0.1, torque_scale=0.9, delay_angle=0.003)
    both, in_turn = first.followed_by(second).applied(true), second.applied(first.applied(true))
    inside = slice(20, -20)
    assert both.angle[inside] == pytest.approx(in_turn.angle[inside], abs=1e-5)
    assert both.torque == pytest.approx(in_turn.torque)
    assert both.pressure == pytest.approx(in_turn.pressure)


@pytest.mark.parametrize("arguments", [("--torque-scale", "0"), ("--encoder-zero", "nan"), ("--delay-angle", "2000")])
def test_what_cannot_be_is_refused(arguments: tuple[str, str]) -> None:
    with pytest.raises(BadInput, match=arguments[0]):
        typed(*arguments)


def test_what_the_rig_file_knows_counts_where_nothing_is_typed() -> None:
    known = {"encoder_zero": 0.02, "torque_scale": 1.03, "delay_angle": 0.0}
    corrections = typed("--encoder-zero", "0", "--delay-angle", "5", **known)
    assert corrections == Corrections(encoder_zero=0.0, torque_scale=1.03, delay_angle=0.005)
    assert corrections.calibration()["torque_scale"] == 1.03
