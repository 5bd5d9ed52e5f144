"""The Recording type, and corrections of zeros, a scale and late stamps: what is typed, what it does."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import ESTIMATE_SHAPES, Arrival, RecordedEstimate, RecordedReference, Recording
from pam_antagonist.recording.corrections import Corrections, add_options, from_options

STAMPS = np.arange(5) * 10**6 + 10**18


def recording(**changes) -> Recording:
    fields = {"path": Path("bag"), "stamp_ns": STAMPS, "pressure": np.full((5, 2), 4e5), "voltage": np.ones((5, 2))}
    return Recording(**{**fields, **changes})


def estimate(stamps=STAMPS) -> RecordedEstimate:
    columns = {
        name: np.arange(len(stamps) * int(np.prod(shape))).reshape(len(stamps), *shape)
        for name, shape in ESTIMATE_SHAPES.items()
    }
    return RecordedEstimate(stamps, np.full(len(stamps), stamps[0]), **columns)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pressure": np.ones((5, 3))}, r"pressure has shape \(5, 3\), expected \(5, 2\)"),
        ({"voltage": np.ones((4, 2))}, r"voltage has shape \(4, 2\)"),
        ({"angle": np.ones((5, 1))}, r"angle has shape \(5, 1\), expected \(5\)"),
        ({"stamp_ns": STAMPS[[0, 1, 1, 2, 3]]}, "stamp_ns is not strictly increasing at index 2"),
        ({"stamp_ns": STAMPS[:0]}, "needs a sample"),
        ({"stamp_ns": np.arange(5) * 1e-3}, "stamp_ns: expected whole numbers of ns; of seconds, give"),
        ({"pressure": [["a", "b"]] * 5}, "pressure: expected numbers"),
        ({"received_ns": {"pressure_1": Arrival(STAMPS, STAMPS[:3])}}, r"received_ns\['pressure_1'\].stamp_ns"),
    ],
)
def test_inconsistent_arrays_are_refused(changes, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        recording(**changes)


def test_estimate_is_validated() -> None:
    with pytest.raises(BadInput, match="estimate.stamp_ns is not strictly increasing"):
        estimate(STAMPS[::-1])


def test_arrays_are_copies_and_read_only() -> None:
    pressure = np.full((5, 2), 4e5)
    made = recording(pressure=pressure, angle=np.zeros(5), estimate=estimate())
    pressure[0, 0] = 0.0
    assert made.pressure[0, 0] == 4e5
    for array in (made.pressure, made.stamp_ns, made.angle, made.estimate.covariance):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_slice_cuts_everything_at_the_same_times() -> None:
    reference = RecordedReference(STAMPS[[0, 2, 4]], [0, 1, 0], [0.1, 0.2, 0.3], [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    whole = recording(
        pressure=np.arange(10.0).reshape(5, 2), angle=np.arange(5.0), estimate=estimate(), reference=reference,
        received_ns={"pressure_1": Arrival(STAMPS + 9, STAMPS)},
    )  # fmt: skip
    part = whole.slice(1e-3, 3e-3)
    np.testing.assert_array_equal(part.stamp_ns, STAMPS[1:3])
    np.testing.assert_array_equal(part.pressure, [[2.0, 3.0], [4.0, 5.0]])
    np.testing.assert_array_equal(part.angle, [1.0, 2.0])
    np.testing.assert_array_equal(part.estimate.covariance, whole.estimate.covariance[1:3])
    np.testing.assert_array_equal(part.reference.value, [0.2])
    np.testing.assert_array_equal(part.received_ns["pressure_1"].log_ns, STAMPS[1:3] + 9)
    assert part.torque is None
    np.testing.assert_array_equal(whole.slice(0.0, np.inf).stamp_ns, STAMPS)
    with pytest.raises(BadInput, match="no sample between 7"):
        whole.slice(7.0, 8.0)


def smooth() -> Recording:
    time = np.arange(1000) * 1e-3
    wave = np.sin(3.0 * time)
    pressure = 4e5 + 1e4 * np.column_stack([wave, -wave])
    voltage = np.column_stack([5.0 + wave, 5.0 - wave])
    return Recording(Path("one"), np.arange(1000) * 1_000_000, pressure, voltage, wave, 2.0 * wave)


def typed(*arguments: str, **known: float) -> Corrections:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return from_options(parser.parse_args(arguments), Corrections(**known))


def test_zeros_and_scale_are_taken_away() -> None:
    true = smooth()
    read = typed("--encoder-zero", "-0.45", "--torque-zero", "0.1", "--torque-scale", "1.03").applied(true)
    assert read.angle == pytest.approx(true.angle + np.radians(0.45))
    assert read.torque == pytest.approx((true.torque - 0.1) / 1.03)


def test_a_zero_counts_in_the_direction_of_the_corrected_angle() -> None:
    read = typed("--angle-unit", "deg", "--flip-angle", "--encoder-zero", "2").angle(np.array([3.0]))
    assert read == pytest.approx(np.radians(-3.0 - 2.0))


def test_early_stamps_are_moved_between_samples() -> None:
    true = smooth()
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
    true = smooth()
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
