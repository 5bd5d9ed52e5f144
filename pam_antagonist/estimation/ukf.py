"""The unscented Kalman filter as compiled kernels: the paper's equations (13) to (24), and one extension.

The extension is consider (Schmidt-Kalman) parameters: m uncertain parameters of the model that are not
estimated. They enter as normalised θ ~ N(0, I). The filter never reduces their covariance, and propagates
their cross covariance C = cov(x, θ) with the state. With m = 0 every formula below is the paper's.

Sigma points of the joint vector [θ, x] come from its lower Cholesky factor

    [ I  0 ]        c = √(m + n + κ),  L Lᵀ = P − C Cᵀ,
    [ C  L ],

so that a column of θ changes parameters *and* state, and a column of x the state alone. The perturbed
parameter vectors are therefore the same at every step and are made once. The gain acts on the state only.

Two points differ from the printed equations. The gain is P_xy/P_yy, since P_yy already contains R (the printed
gain is an option of a tuning). Rows of the matrix square root in (14), (15) are columns of the lower factor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model import dynamics, integration, lanes
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1
from pam_antagonist.model.lane_values import LANES

_advance, _torque = lanes.advance, dynamics.torque
OUTPUTS = 2
_TOLERANCE = 1e-12
"""A pivot below this share of its diagonal entry is a rounding error."""


class FilterScratch(NamedTuple):
    """Scratch arrays of the kernels, so that no step allocates."""

    points: np.ndarray  # sigma points (1 + 2 m + 2 n, n)
    lower: np.ndarray  # lower factor (n, n)
    scratch: np.ndarray  # (n, n)
    gain: np.ndarray  # K (n, 2)
    torques: np.ndarray  # torque of each sigma point (1 + 2 m + 2 n,) [N m]
    stages: np.ndarray  # of a Runge-Kutta step (STAGES + 1, n)
    lane_sets: np.ndarray  # parameters of the sigma points, side by side (G, SIZE, LANES)
    lane_states: np.ndarray  # states of a group of sigma points (n, LANES)
    lane_stages: np.ndarray  # of a Runge-Kutta step of such a group (STAGES + 1, n, LANES)
    inputs: np.ndarray  # commands over the halves of a gap and over the period after it (3, 2)
    brackets: np.ndarray  # bounds of the commands that are searched (2, 2)
    halves: np.ndarray  # effects of unknown commands over the halves of a gap on the state (4, n)
    before_x: np.ndarray  # state before a gap (n,)
    before_covariance: np.ndarray  # P there (n, n)
    before_cross: np.ndarray  # C there (n, m)


def make_work(states: int, parameter_sets: np.ndarray) -> FilterScratch:
    """Scratch arrays for a number of states and parameters. `parameter_sets`: of the sigma points (1 + 2 m, SIZE)."""
    n, points = states, 2 * states + len(parameter_sets)
    return FilterScratch(
        points=np.zeros((points, n)),
        lower=np.zeros((n, n)),
        scratch=np.zeros((n, n)),
        gain=np.zeros((n, 2)),
        torques=np.zeros(points),
        stages=np.zeros((integration.STAGES + 1, n)),
        lane_sets=lanes.sigma_points_beside(parameter_sets, points),
        lane_states=np.zeros((n, LANES)),
        lane_stages=np.zeros((integration.STAGES + 1, n, LANES)),
        inputs=np.zeros((3, 2)),
        brackets=np.zeros((2, 2)),
        halves=np.zeros((4, n)),
        before_x=np.zeros(n),
        before_covariance=np.zeros((n, n)),
        before_cross=np.zeros((n, (len(parameter_sets) - 1) // 2)),
    )


@in_place
def factorise(matrix, lower):
    """Lower Cholesky factor L with L Lᵀ = matrix; lost pivots are repaired.

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


@in_place
def spread_points(x, cross, lower, reach, points):
    """Sigma points of the state, equations (13) to (15).

    `x`: mean (n,). `cross`: C (n, m). `lower`: L (n, n). `points`: result (1 + 2 m + 2 n, n): the mean, then a pair for
    each θ, then one for each state.
    """
    n = x.shape[0]
    m = cross.shape[1]
    for i in range(n):
        points[0, i] = x[i]
        for j in range(m):
            step = reach * cross[i, j]
            points[1 + 2 * j, i] = x[i] + step
            points[2 + 2 * j, i] = x[i] - step
        for j in range(n):
            step = reach * lower[i, j]
            points[1 + 2 * (m + j), i] = x[i] + step
            points[2 + 2 * (m + j), i] = x[i] - step


@in_place
def conditional_factor(covariance, cross, scratch, lower):
    """L with L Lᵀ = P − C Cᵀ; if a pivot had to be repaired, P is set to C Cᵀ + L Lᵀ, which is definite.

    `covariance`: P (n, n). `cross`: C (n, m). `scratch`: (n, n), overwritten. `lower`: result (n, n). Returns repaired
    pivots, -1 for a covariance that is not finite.
    """
    n = covariance.shape[0]
    m = cross.shape[1]
    for i in range(n):
        for j in range(i + 1):
            total = covariance[i, j]
            for k in range(m):
                total -= cross[i, k] * cross[j, k]
            scratch[i, j] = total
            if i == j and m > 0 and total < 1e-12 * covariance[i, i]:
                scratch[i, j] = 1e-12 * covariance[i, i]
    repaired = factorise(scratch, lower)
    if repaired > 0:
        for i in range(n):
            for j in range(i + 1):
                total = 0.0
                for k in range(m):
                    total += cross[i, k] * cross[j, k]
                for k in range(j + 1):
                    total += lower[i, k] * lower[j, k]
                covariance[i, j] = total
                covariance[j, i] = total
    return repaired


@in_place
def predict(x, covariance, cross, u, parameter_sets, dt, noise, change, kappa, effects, work):
    """Prediction step, equations (13) to (18), in place.

    `x`: estimate (n,). `covariance`: P (n, n). `cross`: C (n, m). `u`: input (2,) held over the step. `parameter_sets`:
    (1 + 2 m, SIZE): nominal, then a pair for each θ at ±c. `dt`: step [s]. `noise`: diagonal of Q (n,) for this step.
    `change`: variance of the error of a predicted change of pressure in this step, relative to its square. Returns
    repaired pivots, -1 where the covariance is not finite.
    """
    points, lower = work.points, work.lower
    n = x.shape[0]
    m = cross.shape[1]
    spread = m + n + kappa
    reach = spread**0.5
    repaired = conditional_factor(covariance, cross, work.scratch, lower)
    if repaired < 0:
        return repaired
    spread_points(x, cross, lower, reach, points)
    _advance(points, u, parameter_sets, dt, effects, work)
    centre_weight = kappa / spread
    weight = 0.5 / spread
    p1, p2 = x[PRESSURE_1], x[PRESSURE_1 + 1]
    for i in range(n):
        total = 0.0
        for k in range(1, 1 + 2 * m + 2 * n):
            total += points[k, i]
        x[i] = centre_weight * points[0, i] + weight * total
        for j in range(m):
            cross[i, j] = weight * reach * (points[1 + 2 * j, i] - points[2 + 2 * j, i])
    for k in range(1 + 2 * m + 2 * n):
        for i in range(n):
            points[k, i] -= x[i]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(1, 1 + 2 * m + 2 * n):
                total += points[k, i] * points[k, j]
            total = centre_weight * points[0, i] * points[0, j] + weight * total
            if i == j:
                total += noise[i]
            covariance[i, j] = total
            covariance[j, i] = total
    if change > 0.0:
        covariance[PRESSURE_1, PRESSURE_1] += change * (x[PRESSURE_1] - p1) ** 2
        covariance[PRESSURE_1 + 1, PRESSURE_1 + 1] += change * (x[PRESSURE_1 + 1] - p2) ** 2
    return repaired


@in_place
def innovate(x, covariance, y, noise, innovation, innovation_covariance):
    """Innovation and its covariance, equations (19) to (21).

    g selects the pressures from the state. For this linear g, the redrawn sigma points of (19) have
    exactly the moments ŷ = g(x̂), P_yy = g P gᵀ + R and P_xy = P gᵀ (22), which are used directly.

    `x`: prediction (n,). `covariance`: P⁻ (n, n). `y`: measured pressures (2,) [Pa]. `noise`: diagonal of R (2,).
    `innovation`: result (2,). `innovation_covariance`: result (2, 2).
    """
    for a in range(OUTPUTS):
        innovation[a] = y[a] - x[PRESSURE_1 + a]
        for b in range(OUTPUTS):
            innovation_covariance[a, b] = covariance[PRESSURE_1 + a, PRESSURE_1 + b]
        innovation_covariance[a, a] += noise[a]


@inlined
def _inverse(covariance, noise, use_1, use_2):
    """Inverse of P_yy = g P gᵀ + R over the pressures that are used; zero for the others."""
    s11 = covariance[PRESSURE_1, PRESSURE_1] + noise[0]
    s22 = covariance[PRESSURE_1 + 1, PRESSURE_1 + 1] + noise[1]
    if use_1 and use_2:
        s12 = covariance[PRESSURE_1, PRESSURE_1 + 1]
        determinant = s11 * s22 - s12 * s12
        return s22 / determinant, -s12 / determinant, s11 / determinant
    return (1.0 / s11 if use_1 else 0.0), 0.0, (1.0 / s22 if use_2 else 0.0)


@in_place
def update(x, covariance, cross, innovation, noise, gain_noise, use_1, use_2, work):
    """Update step, equations (23) and (24), for the pressures that are to be used, in place.

    The gain K = P_xy/P_yy of the whole P⁻ acts on the state; C ← C − K g C. The covariance is updated in
    Joseph's form, (I − K g) P⁻ (I − K g)ᵀ + K R Kᵀ. This equals (24) for this gain, stays symmetric and
    non-negative under rounding, and is the true covariance for any other gain as well.

    `x`: prediction (n,), becomes the estimate. `covariance`: P⁻ (n, n), becomes P. `cross`: C (n, m). `innovation`:
    (2,) [Pa]. `noise`: diagonal of R (2,). `gain_noise`: value of R in the gain: R itself, or 2 R for the gain as
    printed.
    """
    factor, scratch, gain = work.lower, work.scratch, work.gain
    n = x.shape[0]
    m = cross.shape[1]
    v1 = innovation[0] if use_1 else 0.0
    v2 = innovation[1] if use_2 else 0.0
    i11, i12, i22 = _inverse(covariance, noise, use_1, use_2)
    nis = v1 * v1 * i11 + 2.0 * v1 * v2 * i12 + v2 * v2 * i22
    i11, i12, i22 = _inverse(covariance, gain_noise, use_1, use_2)
    for i in range(n):
        a = covariance[i, PRESSURE_1]
        b = covariance[i, PRESSURE_1 + 1]
        gain[i, 0] = a * i11 + b * i12
        gain[i, 1] = a * i12 + b * i22
        x[i] += gain[i, 0] * v1 + gain[i, 1] * v2
    for j in range(m):
        c1 = cross[PRESSURE_1, j]
        c2 = cross[PRESSURE_1 + 1, j]
        for i in range(n):
            cross[i, j] -= gain[i, 0] * c1 + gain[i, 1] * c2
    # (I − K g) P⁻: K g takes two rows of P⁻.
    for i in range(n):
        for j in range(n):
            scratch[i, j] = (
                covariance[i, j] - gain[i, 0] * covariance[PRESSURE_1, j] - gain[i, 1] * covariance[PRESSURE_1 + 1, j]
            )
    for i in range(n):
        for j in range(i + 1):
            value = (
                scratch[i, j]
                - scratch[i, PRESSURE_1] * gain[j, 0]
                - scratch[i, PRESSURE_1 + 1] * gain[j, 1]
                + gain[i, 0] * noise[0] * gain[j, 0]
                + gain[i, 1] * noise[1] * gain[j, 1]
            )
            factor[i, j] = value
    for i in range(n):
        for j in range(i + 1):
            covariance[i, j] = factor[i, j]
            covariance[j, i] = factor[i, j]
    return nis


@in_place
def update_angle(x, covariance, cross, innovation, noise, work):
    """Update step for a measured angle, whose noise is independent of the pressures', in place.

    The gain K = P_xψ/(P_ψψ + R) acts on the state, as in :func:`update`: C ← C − K C_ψ, and P in Joseph's form.

    `x`: estimate (n,). `covariance`: P (n, n). `cross`: C (n, m). `innovation`: measured less estimated angle [rad].
    `noise`: variance R of the measurement [rad²].
    """
    gain, factor = work.gain, work.lower
    n, m = x.shape[0], cross.shape[1]
    total = covariance[ANGLE, ANGLE] + noise
    for i in range(n):
        gain[i, 0] = covariance[i, ANGLE] / total
        x[i] += gain[i, 0] * innovation
    for j in range(m):
        c = cross[ANGLE, j]
        for i in range(n):
            cross[i, j] -= gain[i, 0] * c
    for i in range(n):
        for j in range(i + 1):
            # (I − K g) P (I − K g)ᵀ + K R Kᵀ for the one row g that picks the angle.
            factor[i, j] = (
                covariance[i, j]
                - gain[i, 0] * covariance[ANGLE, j]
                - covariance[i, ANGLE] * gain[j, 0]
                + gain[i, 0] * total * gain[j, 0]
            )
    for i in range(n):
        for j in range(i + 1):
            covariance[i, j] = factor[i, j]
            covariance[j, i] = factor[i, j]


@in_place
def torque_moments(x, covariance, cross, parameter_sets, kappa, effects, work, moments):
    """Torque and its covariances by the unscented transform of equation (9).

    `x`: estimate (n,). `covariance`: P (n, n). `cross`: C (n, m). `parameter_sets`: (1 + 2 m, SIZE), as for
    :func:`predict`. `moments`: result (1 + 1 + n,): mean of τ [N m], its variance, its covariance with each state.
    Returns repaired pivots, -1 where the covariance is not finite.
    """
    points, lower, torques = work.points, work.lower, work.torques
    n = x.shape[0]
    m = cross.shape[1]
    spread = m + n + kappa
    repaired = conditional_factor(covariance, cross, work.scratch, lower)
    if repaired < 0:
        return repaired
    spread_points(x, cross, lower, spread**0.5, points)
    mean = 0.0
    for k in range(1 + 2 * m + 2 * n):
        weight = kappa / spread if k == 0 else 0.5 / spread
        torques[k] = _torque(points[k], parameter_sets[k if k <= 2 * m else 0], effects)
        mean += weight * torques[k]
    moments[:] = 0.0
    moments[0] = mean
    for k in range(1 + 2 * m + 2 * n):
        weight = kappa / spread if k == 0 else 0.5 / spread
        moments[1] += weight * (torques[k] - mean) ** 2
        for i in range(n):
            moments[2 + i] += weight * (torques[k] - mean) * (points[k, i] - x[i])
    return repaired
