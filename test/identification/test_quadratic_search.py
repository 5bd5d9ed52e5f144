"""The search for the minimum of a costly, smooth function."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.identification.quadratic_search import minimum

WIDE = [(-12.0, 12.0), (-12.0, 12.0)]


def valley(x):
    """A likelihood's shape: steep on one side, flat on the other, the coordinates tied to each other."""
    a, b = x[0] - 1.3 + 0.4 * x[1], x[1] + 0.7
    return float(np.exp(a) - a + 2.0 * (np.log(np.cosh(b))))


@pytest.mark.parametrize(
    ("start", "most"),
    [((0.0, 0.0), 15), ((-3.0, 2.0), 25), pytest.param((3.0, 1.0), 40, id="from where it is e to the third as steep")],
)
def test_it_finds_the_minimum_with_few_values(start, most):
    found = minimum(valley, start, (1.0, -1.0), WIDE, enough=1e-4, most=40)
    assert found.value == pytest.approx(1.0, abs=2e-3)
    assert np.allclose(found.x, [1.3 + 0.28, -0.7], atol=0.05)
    assert found.evaluations <= most


def test_a_minimum_at_a_bound_is_found_and_no_value_is_worked_out_beyond_it():
    seen = []

    def function(x):
        seen.append(float(x[0]))
        return float((x[0] + 1.0) ** 2)

    found = minimum(function, (0.0,), (0.5,), [(0.0, 2.0)], enough=1e-4, most=12)
    assert found.x[0] == 0.0
    assert found.evaluations == len(seen) <= 4
    assert min(seen) >= 0.0


def test_the_number_of_values_is_bounded():
    rng = np.random.default_rng(1)
    found = minimum(lambda x: float(rng.normal()), (0.0, 0.0), (1.0, 1.0), WIDE, enough=1e-9, most=15)
    assert found.evaluations <= 15


def test_ragged_values_lead_neither_astray_nor_on_and_on():
    """A likelihood is ragged where a joint sticks in one simulation and slips in the next."""
    found = minimum(
        lambda x: valley(x) + 1e-3 * float(np.sin(300.0 * x.sum())), (0.0, 0.0), (1.0, -1.0), WIDE, 1e-3, 40
    )
    assert found.value < 1.01
    assert found.evaluations < 25


def test_a_flat_direction_does_no_harm():
    found = minimum(lambda x: float(x[1] ** 2), (1.0, 2.0), (1.0, 1.0), WIDE, enough=1e-6, most=30)
    assert abs(found.x[1]) < 1e-2
    assert found.evaluations < 20
