"""A fit finds the best values within bounds, says how well, and never leaves them."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from pam_antagonist.identification.unknowns import Unknown, fitted, parameters

TIME = np.linspace(0.0, 3.0, 200)
GAIN = Unknown("gain", ("a.gain", "b.gain"), 2.0, 0.5, positive=True)
SHIFT = Unknown("shift", ("shift",), 0.0, 0.3, low=-0.2, high=0.2)


def residual(true: tuple[float, float], noise: float = 0.0, unit: float = 0.01):
    wanted = true[0] * np.exp(-TIME) + true[1] + noise * np.random.default_rng(1).standard_normal(len(TIME))

    def of(values: Mapping[str, float]) -> np.ndarray:
        return (values["gain"] * np.exp(-TIME) + values["shift"] - wanted) / unit

    return of


def test_values_are_found_and_given_to_all_their_parameters() -> None:
    found = fitted([GAIN, SHIFT], residual((3.1, 0.1)))
    assert found.values == pytest.approx({"gain": 3.1, "shift": 0.1}, rel=1e-3)
    assert found.parameters["a.gain"] == found.parameters["b.gain"] == found.values["gain"]
    assert not found.at_bounds


def test_standard_errors_are_those_of_the_noise() -> None:
    off = []
    found = fitted([GAIN, SHIFT], residual((3.1, 0.1), noise=0.01))
    for name, true in (("gain", 3.1), ("shift", 0.1)):
        off.append(abs(found.values[name] - true) / found.stds[name])
    assert max(off) < 4.0
    assert found.stds["gain"] < 0.01


def test_a_value_beyond_its_bounds_stops_at_them_and_is_named() -> None:
    found = fitted([GAIN, SHIFT], residual((3.1, 0.9)))
    assert found.values["shift"] == pytest.approx(0.2, abs=1e-3)
    assert found.at_bounds == ("shift",)


def test_a_positive_value_stays_positive_whatever_the_data_say() -> None:
    assert fitted([GAIN, SHIFT], residual((-5.0, 0.0))).values["gain"] > 0.0


@pytest.mark.parametrize("begin", [(-4.0, -0.5), (4.0, 0.5), (50.0, -50.0)])
def test_every_start_ends_at_the_same_values(begin: tuple[float, float]) -> None:
    found = fitted([GAIN, SHIFT], residual((3.1, 0.1)), np.array(begin), evaluations=40)
    assert found.values == pytest.approx({"gain": 3.1, "shift": 0.1}, rel=1e-2)


def test_simulations_that_diverge_are_left() -> None:
    whole = residual((3.1, 0.1))
    found = fitted(
        [GAIN, SHIFT], lambda v: whole(v) if v["gain"] < 6.0 else np.full(len(TIME), np.nan), np.array([0.5, 0.0])
    )
    assert found.values["gain"] == pytest.approx(3.1, rel=1e-3)


def test_without_data_the_prior_stays() -> None:
    found = fitted([GAIN, SHIFT], lambda values: np.zeros(3))
    assert found.values == {"gain": 2.0, "shift": 0.0}
    assert found.stds == pytest.approx({"gain": 1.0, "shift": 0.3})


def test_amount_is_the_inverse_of_value() -> None:
    for item in (GAIN, SHIFT):
        assert item.amount(item.value(0.7)) == pytest.approx(0.7)
    assert parameters([GAIN], {"gain": GAIN.value(1.0)})["b.gain"] == pytest.approx(2.0 * math.exp(0.5))
