"""Normal equations of several trials, and the minimum within bounds that is found from normal equations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from pam_antagonist.inference.normal_equations import Arrow, Local
from pam_antagonist.inference.trust_region import Evaluated, minimise

COMMON, WAYS, STARTS, TRIALS = 4, 2, 3, 5


def drawn(deviations: np.ndarray | None) -> tuple[list[Local], np.ndarray, np.ndarray]:
    """Trials, and the information and right-hand side that a matrix from the fitted vector to all residuals gives."""
    rng = np.random.default_rng(7)
    ways = 0 if deviations is None else WAYS
    size = COMMON + TRIALS * (ways + STARTS)
    trials, information, pull = [], np.eye(size), np.zeros(size)
    for index in range(TRIALS):
        slope, residual = rng.standard_normal((30, COMMON + STARTS)), rng.standard_normal(30)
        trials.append(Local(slope.T @ slope, slope.T @ residual))
        first = COMMON + index * (ways + STARTS)
        moves = np.zeros((COMMON + STARTS, size))
        moves[:COMMON, :COMMON] = np.eye(COMMON)
        if deviations is not None:
            moves[:COMMON, first : first + ways] = deviations
        moves[COMMON:, first + ways : first + ways + STARTS] = np.eye(STARTS)
        whole = slope @ moves
        information += whole.T @ whole
        pull += whole.T @ residual
    return trials, information, pull


@pytest.mark.parametrize("deviate", [True, False])
def test_an_arrow_is_the_sum_over_all_residuals(deviate: bool) -> None:
    deviations = np.random.default_rng(3).standard_normal((COMMON, WAYS)) if deviate else None
    trials, information, pull = drawn(deviations)
    arrow = Arrow.of(trials, deviations, COMMON)
    found, right = arrow.whole()
    assert np.allclose(found, information, rtol=1e-12)
    assert np.allclose(right, pull, rtol=1e-12)
    gain = 0.5 * pull @ np.linalg.solve(information, pull) - 0.5 * np.linalg.slogdet(information)[1]
    assert arrow.log_evidence() == pytest.approx(gain, rel=1e-10)


def curve(point: np.ndarray) -> np.ndarray:
    """Residuals of an exponential with an offset, and a prior's."""
    time = np.linspace(0.0, 3.0, 40)
    shown = 2.0 * np.exp(-1.3 * time) + 0.4 + 0.02 * np.sin(40.0 * time)
    return np.concatenate([point[0] * np.exp(-point[1] * time) + point[2] - shown, 0.01 * point])


def evaluated(point: np.ndarray) -> Evaluated:
    residual = curve(point)

    def equations(_: bool) -> tuple[np.ndarray, np.ndarray]:
        slope = np.stack([(curve(point + step) - curve(point - step)) / 2e-6 for step in 1e-6 * np.eye(3)], axis=1)
        return slope.T @ slope, -slope.T @ residual

    return Evaluated(0.5 * float(residual @ residual), equations)


@pytest.mark.parametrize(
    ("low", "high"),
    [([-9.0] * 3, [9.0] * 3), ([-9.0, 0.0, 0.5], [9.0, 9.0, 9.0]), ([0.0] * 3, [1.5, 9.0, 9.0])],
    ids=["free", "at a lower bound", "at an upper bound"],
)
def test_the_minimum_is_that_of_scipy(low: list[float], high: list[float]) -> None:
    start = np.array([1.0, 0.2, 0.6])
    found, cost = minimise(evaluated, start, np.array(low), np.array(high), np.ones(3), evaluations=60)
    known = least_squares(curve, start, bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert cost == pytest.approx(float(known.cost), rel=1e-4)
    assert found == pytest.approx(known.x, abs=3e-3)
    assert np.all(found >= low) and np.all(found <= high)


def test_a_step_to_where_the_cost_is_no_number_is_not_taken() -> None:
    def walled(point: np.ndarray) -> Evaluated:
        return evaluated(point) if point[1] < 1.0 else Evaluated(float("nan"), evaluated(point).equations)

    found, cost = minimise(
        walled, np.array([1.0, 0.2, 0.6]), np.full(3, -9.0), np.full(3, 9.0), np.ones(3), evaluations=60
    )
    assert found[1] < 1.0
    assert cost < evaluated(np.array([1.0, 0.2, 0.6])).cost
    assert np.isfinite(cost)
