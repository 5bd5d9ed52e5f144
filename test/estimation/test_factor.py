"""The factorisation that always has an answer."""

from __future__ import annotations

import numpy as np
import pytest

from pam_antagonist.estimation.factor import factorise


def test_equals_numpy_on_definite_matrices() -> None:
    rng = np.random.default_rng(2)
    for n in (1, 2, 4, 9):
        root = rng.normal(size=(n, n)) * np.exp(rng.uniform(-6, 6, n))[:, None]
        matrix = root @ root.T
        lower = np.full((n, n), np.nan)
        assert factorise(matrix, lower) == 0
        assert np.allclose(lower, np.linalg.cholesky(matrix), rtol=1e-8, atol=0.0)


def test_a_state_without_variance_gets_a_zero_column() -> None:
    matrix = np.diag([0.0, 2.0, 0.0, 9.0])
    matrix[1, 3] = matrix[3, 1] = 3.0
    lower = np.empty((4, 4))
    assert factorise(matrix, lower) == 0
    assert np.allclose(lower @ lower.T, matrix)


@pytest.mark.parametrize(
    "matrix", [[[1.0, 1.0], [1.0, 1.0 - 1e-15]], [[1.0, 2.0], [2.0, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]]
)
def test_lost_pivots_are_repaired_to_a_definite_product(matrix: list[list[float]]) -> None:
    given = np.array(matrix)
    lower = np.empty((2, 2))
    assert factorise(given, lower) > 0
    product = lower @ lower.T
    assert np.all(np.isfinite(product))
    assert np.all(np.linalg.eigvalsh(product) > 0.0)


def test_says_where_nothing_is_finite() -> None:
    assert factorise(np.array([[1.0, np.nan], [np.nan, 1.0]]), np.empty((2, 2))) == -1
    assert factorise(np.array([[np.inf, 0.0], [0.0, 1.0]]), np.empty((2, 2))) == -1
