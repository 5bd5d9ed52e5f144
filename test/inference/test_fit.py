"""A fit finds the best values within bounds, says how well, and never leaves them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pam_antagonist.inference import fit as fits
from pam_antagonist.inference import fit_errors
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.fit_errors import Rows
from pam_antagonist.inference.unknown import Unknown

TIME = np.linspace(0.0, 3.0, 200)
GAIN = Unknown("gain", ("a.gain", "b.gain"), 2.0, 0.5, positive=True)
SHIFT = Unknown("shift", ("shift",), 0.0, 0.3, low=-0.2, high=0.2)


def each(of: Callable[[Mapping[str, float]], Any]):
    """What a fit takes: a function of several values at once."""
    return lambda points: [of(values) for values in points]


def fitted(items: Sequence[Unknown], of: Callable[[Mapping[str, float]], np.ndarray], *rest: Any, **more: Any) -> Fit:
    return fits.fitted(items, each(of), *rest, **more)


def with_errors(
    fit: Fit, of: Callable[[Mapping[str, float]], np.ndarray], elsewhere: Sequence[Any] = (), **more: Any
) -> Fit:
    return fit_errors.with_errors(fit, each(of), elsewhere=[each(one) for one in elsewhere], **more)


def within_bounds(fit: Fit, of: Callable[[Mapping[str, float]], np.ndarray]) -> Fit:
    return fits.within_bounds(fit, each(of))


def residual(true: tuple[float, float], noise: float = 0.0, unit: float = 0.01):
    wanted = true[0] * np.exp(-TIME) + true[1] + noise * np.random.default_rng(1).standard_normal(len(TIME))

    def of(values: Mapping[str, float]) -> np.ndarray:
        return (values["gain"] * np.exp(-TIME) + values["shift"] - wanted) / unit

    return of


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


def _lasting(rng: np.random.Generator, count: int, last: float) -> np.ndarray:
    """Errors that last for some rows, with a standard deviation of 1."""
    keep = math.exp(-1.0 / last)
    out = rng.standard_normal(count)
    for k in range(1, count):
        out[k] = keep * out[k - 1] + math.sqrt(1.0 - keep**2) * out[k]
    return out


@pytest.mark.parametrize("size", [0.2, 3.0])
def test_true_values_lie_in_their_intervals_although_errors_last_and_their_size_was_guessed(size: float) -> None:
    time = np.linspace(0.0, 30.0, 1200)
    shapes = np.column_stack([np.sin(time), np.sin(2.3 * time), np.cos(0.9 * time) ** 2])
    unknown = [Unknown(name, (name,), 0.0, 1.0) for name in "abc"]
    rng = np.random.default_rng(0)
    inside, narrow = [], []
    for _ in range(60):
        true = rng.standard_normal(3)
        wanted = shapes @ true + size * _lasting(rng, len(time), 6.0)

        def of(values: Mapping[str, float], wanted: np.ndarray = wanted) -> np.ndarray:
            return math.sqrt(0.1) * (shapes @ np.array(list(values.values())) - wanted)

        first = fitted(unknown, of)
        off = np.abs(with_errors(first, of).amounts - true)
        inside += list(off < 1.96 * np.sqrt(np.diag(with_errors(first, of).covariance)))
        narrow += list(off < 1.96 * np.sqrt(np.diag(first.covariance)))
    assert 0.9 <= np.mean(inside) <= 0.99
    assert not 0.9 <= np.mean(narrow) <= 0.99


def test_a_fit_that_a_rough_cost_holds_up_is_not_certain() -> None:
    whole = residual((3.1, 0.1), unit=0.3)

    def rough(values: Mapping[str, float]) -> np.ndarray:
        return whole(values) + 0.3 * np.sin(60.0 * values["gain"] + 40.0 * TIME)

    stuck = fitted([GAIN, SHIFT], rough)
    assert abs(stuck.values["gain"] - 3.1) > 10.0 * stuck.stds["gain"]
    assert abs(stuck.values["gain"] - 3.1) < 1.96 * with_errors(stuck, rough).stds["gain"]


def test_errors_of_another_stage_widen_the_intervals() -> None:
    whole = residual((3.1, 0.1), noise=0.01)
    first = fitted([GAIN, SHIFT], whole)

    def elsewhere(values: Mapping[str, float]) -> np.ndarray:
        return whole({**values, "shift": values["shift"] + 0.02})

    alone, both = with_errors(first, whole), with_errors(first, whole, elsewhere=[elsewhere])
    assert both.values == alone.values
    assert both.stds["shift"] == pytest.approx(math.hypot(alone.stds["shift"], 0.02), rel=0.05)


def test_a_value_at_a_bound_is_not_determined() -> None:
    whole = residual((3.1, 0.9))
    found = with_errors(fitted([GAIN, SHIFT], whole), whole)
    assert found.reasons["shift"] == "met a bound"
    assert found.values["shift"] == pytest.approx(0.2, abs=1e-3)
    assert found.stds["gain"] > 0.0


def test_a_value_that_meets_a_bound_is_put_back_and_the_others_are_fitted_with_it() -> None:
    """The bound was written into the rig file, and the others had adapted to it."""
    whole = residual((3.1, 0.9))
    met = fitted([GAIN, SHIFT], whole)
    found = within_bounds(met, whole)
    assert met.values["shift"] == pytest.approx(0.2, abs=1e-3)
    assert found.values["shift"] == 0.0 and found.kept == {"shift": pytest.approx(0.2, abs=1e-3)}
    assert found.values["gain"] > met.values["gain"] + 0.1
    assert with_errors(found, whole).reasons["shift"].startswith("met a bound")
    assert list(found.moved.values) == ["gain"]


def test_a_friction_may_vanish_and_what_no_file_has_stays_at_its_bound() -> None:
    for unknown, true in (
        ([replace(GAIN, may_vanish=True), SHIFT], (1e-9, 0.0)),
        ([GAIN, replace(SHIFT, paths=())], (3.1, 0.9)),
    ):
        met = fitted(unknown, residual(true))
        assert len(met.at_bounds) == 1 and within_bounds(met, residual(true)) is met


SHAPES = np.column_stack([np.sin(TIME), np.cos(2.0 * TIME)])
LACKS = 0.1 * np.sign(np.sin(3.5 * TIME))


def lacking(repeats: int, lacks: float) -> tuple[Callable[[Mapping[str, float]], np.ndarray], Rows]:
    """A model that lacks something, of which a recording is so many times as long; its noise is 0.01."""
    noise = 0.01 * np.random.default_rng(0).standard_normal((repeats, len(TIME)))

    def of(values: Mapping[str, float]) -> np.ndarray:
        return (SHAPES @ [values["a"] - 0.5, values["b"] + 0.2] - lacks * LACKS - noise).ravel() / 0.1

    return of, Rows.of([("one", repeats * len(TIME), 0.1)])


def test_what_a_model_lacks_does_not_average_out_and_noise_does() -> None:
    unknown = [Unknown(name, (name,), 0.0, 1.0) for name in "ab"]

    def std(repeats: int, lacks: float) -> float:
        of, rows = lacking(repeats, lacks)
        return with_errors(fitted(unknown, of), of, rows=rows).stds["a"]

    assert std(16, 1.0) > 0.75 * std(4, 1.0)
    assert std(16, 0.0) < 0.75 * std(4, 0.0)
    assert std(16, 1.0) > 5.0 * std(16, 0.0)
    of, rows = lacking(16, 1.0)
    found = with_errors(fitted(unknown, of), of, rows=rows)
    assert abs(found.values["a"] - 0.5) < 3.0 * found.stds["a"]
    assert abs(found.values["a"] - 0.5) > 3.0 * with_errors(fitted(unknown, of), of).stds["a"]


def test_recordings_that_pull_a_value_apart_are_named_and_widen_its_error() -> None:
    unknown = [Unknown("a", ("a",), 0.0, 1.0), Unknown("b", ("b",), 0.0, 1.0)]
    noise = 0.01 * np.random.default_rng(0).standard_normal((3, len(TIME)))

    def of(values: Mapping[str, float], true: Sequence[float] = (0.5, 0.5, 0.8)) -> np.ndarray:
        parts = [SHAPES[:, 0] * (values["a"] - one) - noise[k] for k, one in enumerate(true)]
        # Only the last one shows b: without it there is the prior, and no contradiction.
        return np.concatenate([*parts, SHAPES[:, 1] * (values["b"] - 0.9) - noise[0]]) / 0.1

    names = [(name, len(TIME) * (1 + (name == "third")), 0.1) for name in ("first", "second", "third")]
    found = with_errors(fitted(unknown, of), of, rows=Rows.of(names))
    (pulled,) = found.pulled
    assert (pulled.name, pulled.recording) == ("a", "third")
    assert found.stds["b"] < 0.1
    assert pulled.without == pytest.approx(0.5, abs=0.05)
    assert found.stds["a"] > 0.9 * abs(found.values["a"] - 0.5)

    def alike(values: Mapping[str, float]) -> np.ndarray:
        return of(values, (0.5, 0.5, 0.5))

    assert with_errors(fitted(unknown, alike), alike, rows=Rows.of(names)).pulled == ()


def test_values_that_are_all_at_bounds_stay_as_they_are() -> None:
    narrow = Unknown("gain", ("gain",), 2.0, 0.5, low=1.999, high=2.001)
    found = fitted([narrow], lambda values: np.full(5, 100.0 * (values["gain"] - 3.0)))
    errors = {"angle": np.ones(20)}
    assert with_errors(found, lambda values: np.ones(5)).reasons == {"gain": "met a bound"}
    assert fits.refined(found, [], each(lambda values: errors), {"angle": 1.0}, 2).unknowns == found.unknowns


def test_what_the_other_recordings_hardly_tell_contradicts_none_of_them() -> None:
    """Without its only free recording a rig had a hysteresis of 60 N: a step of the linear model, told as an error."""
    noise = 0.01 * np.random.default_rng(0).standard_normal((2, len(TIME)))
    unknown = [Unknown(name, (name,), 0.0, 1.0) for name in "ab"]

    def pulled(weight: float) -> dict[str, str]:
        shapes = np.stack([SHAPES, SHAPES * [weight, 1.0]])

        def of(values: Mapping[str, float]) -> np.ndarray:
            # The second recording has another a.
            made = np.stack([SHAPES @ [0.5, -0.2], shapes[1] @ [1.5, -0.2]]) + noise
            return (shapes @ [values["a"], values["b"]] - made).ravel() / 0.1

        rows = Rows.of([("one", len(TIME), 0.1), ("two", len(TIME), 0.1)])
        found = with_errors(fitted(unknown, of), of, rows=rows)
        return {item.name: item.recording for item in found.pulled}

    assert "a" in pulled(1.0)
    assert "a" not in pulled(1e-3)
