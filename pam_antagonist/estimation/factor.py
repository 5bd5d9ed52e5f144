"""A Cholesky factorisation that repairs a matrix which is not positive definite."""

from __future__ import annotations

import math

from pam_antagonist._jit import in_place

_TOLERANCE = 1e-12
"""A pivot below this share of its diagonal entry is a rounding error."""


@in_place
def factorise(matrix, lower):
    """Lower factor L with L Lᵀ = matrix; lost pivots are repaired.

    A state without variance (a locked joint's angle) gets a zero column. A pivot that rounding has made
    negative or nearly zero is lifted to ``_TOLERANCE`` of the diagonal entry, and the column below it is
    bounded so that the product stays positive definite.

    `matrix`: symmetric (n, n); the lower triangle is read. `lower`: result (n, n); the strict upper triangle is set to
    zero. Returns how many pivots were repaired; -1 where the matrix is not finite, and ``lower`` is of no use.
    """
    n = matrix.shape[0]
    repaired = 0
    for j in range(n):
        for i in range(j):
            lower[i, j] = 0.0
        diagonal = matrix[j, j]
        pivot = diagonal
        for k in range(j):
            pivot -= lower[j, k] * lower[j, k]
        if not math.isfinite(pivot):
            return -1
        least = _TOLERANCE * abs(diagonal)
        if diagonal == 0.0 and pivot == 0.0:
            for i in range(j, n):
                lower[i, j] = 0.0
            continue
        lost = pivot <= least
        if lost:
            repaired += 1
            pivot = max(least, 1e-300)
        root = math.sqrt(pivot)
        lower[j, j] = root
        for i in range(j + 1, n):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            # A repaired pivot holds no information, so neither does its column.
            lower[i, j] = 0.0 if lost else total / root
    return repaired
