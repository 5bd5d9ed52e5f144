"""When an identified value is called determined."""

from __future__ import annotations

import math

import pytest

from pam_antagonist.inference.determined import Evidence


@pytest.mark.parametrize(
    ("known", "reason"),
    [
        (Evidence(5.3e-8, 5.2e-8, 2.6e-9, 1e-10), ""),
        (Evidence(0.20, 0.20, 0.01, 0.0099), "stays near its prior"),
        # A curvature that is ever so certain: fewer data lead elsewhere.
        (Evidence(701.34e3, 701.3e3, 7e3, 70.0, moves=3.7e3), "depends on the part that is fitted"),
        (Evidence(701.34e3, 701.3e3, 7e3, 70.0, misfit=3.7e3), "errors of the model may have moved it"),
        (Evidence(-8.8, 2000.0, 5000.0, 301.0), "uncertain by more than its value"),
        (Evidence(0.31, 0.20, 0.06, 0.045), "moved, but uncertain"),
        (Evidence(0.31, 0.20, 0.06, 1e-4, rise=-0.3), "flat profile"),
        (Evidence(0.31, 0.20, 0.06, 0.02, rise=0.2), "moved, but uncertain"),
        (Evidence(0.2, 0.5, 0.1, 0.001, bound=0.2), "met a bound"),
        (Evidence(1.84, 0.0, 0.5, 0.09), "contradicts its prior"),
        (Evidence(0.01, 0.0, 0.5, 0.02), ""),
    ],
)
def test_a_value_is_determined_by_more_than_its_curvature(known: Evidence, reason: str) -> None:
    assert known.reason == reason and known.determined == (not reason)
    assert known.error >= known.std or math.isinf(known.error)
