"""The Recording type: validation, joint, slices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pam_antagonist.errors import BadInput
from pam_antagonist.recording import ESTIMATE_SHAPES, Arrival, RecordedEstimate, RecordedReference, Recording

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


def test_times() -> None:
    made = recording()
    assert made.duration_s == pytest.approx(4e-3, abs=1e-12)
    assert made.sample_period_s == pytest.approx(1e-3, abs=1e-12)
    np.testing.assert_allclose(made.time_s, np.arange(5) * 1e-3, atol=1e-12)
    assert np.isnan(recording(stamp_ns=STAMPS[:1], pressure=np.ones((1, 2)), voltage=np.ones((1, 2))).sample_period_s)


def test_slice_cuts_everything_at_the_same_times() -> None:
    reference = RecordedReference(STAMPS[[0, 2, 4]], [0, 1, 0], [0.1, 0.2, 0.3], [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    whole = recording(
        pressure=np.arange(10.0).reshape(5, 2),
        angle=np.arange(5.0),
        estimate=estimate(),
        reference=reference,
        received_ns={"pressure_1": Arrival(STAMPS + 9, STAMPS)},
    )
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
