"""The compared linear model: a state-space model from data, with its Kalman filter on the pressures.

A vector autoregression with input, y(t) = Σ A_i y(t−i) + Σ B_i u(t−i) + c + e(t), y = [ψ, P_1, P_2], by least
squares, which is a linear state-space model in innovation form (Ljung, *System Identification*, 1999, sections
4.3 and 7.3). Its filter is the stationary Kalman filter for the pressures alone; the angle follows by its
covariance with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import metrics

Floats = NDArray[np.float64]

STEP = 20
"""Samples that are averaged into one: from one to the next a pressure changes by less than its sensor's noise."""
_ORDERS = (1, 2, 3, 4)
_TRAINING = 2 / 3
_ANGLE, _PRESSURES = 0, slice(1, 3)
_RIDGE = 1e-9
_ROUNDS, _TOLERANCE = 20_000, 1e-9


@dataclass(frozen=True, eq=False)
class LinearModel:
    """x(k+1) = A x + B u + K e, y = C x + D u + e, in scaled deviations from the means; n states.

    ``gain`` and ``angle_gain`` are those of the stationary filter on the pressures; u is [u_1, u_2, 1].
    """

    order: int  # past samples in the regression; the state is that many outputs and inputs
    a: Floats  # (n, n)
    b: Floats  # (n, 3)
    c: Floats  # (3, n)
    d: Floats  # (3, 3)
    middle: Floats  # means of [ψ, P_1, P_2, u_1, u_2]
    scale: Floats  # their standard deviations
    gain: Floats  # (n, 2)
    angle_gain: Floats  # of the angle on the pressures' innovation (2,)


def averaged(values: Floats) -> Floats:
    """Means over ``STEP`` samples (N // STEP, ...)."""
    count = len(values) // STEP
    return np.asarray(values[: count * STEP].reshape(count, STEP, *values.shape[1:]).mean(axis=1))


def identify(angle: Floats, pressure: Floats, voltage: Floats) -> LinearModel:
    """A linear model from angles (N,), pressures (N, 2) and voltages (N, 2).

    The order is the one whose filter errs least in the angle on the last third, which the others are not fitted to; the
    model is then fitted to all of it.
    """
    y, u = averaged(np.column_stack([angle, pressure])), averaged(voltage)
    middle = np.concatenate([y.mean(axis=0), u.mean(axis=0)])
    scale = np.concatenate([y.std(axis=0), u.std(axis=0)])
    y, u = (y - middle[:3]) / scale[:3], (u - middle[3:]) / scale[3:]
    split = round(_TRAINING * len(y))

    def error(order: int) -> float:
        model = _realised(y[:split], u[:split], order, middle, scale)
        return metrics.rmse((_filter(model, y[:, _PRESSURES], u) - y[:, _ANGLE])[split:])

    return _realised(y, u, min(_ORDERS, key=error), middle, scale)


def _realised(y: Floats, u: Floats, order: int, middle: Floats, scale: Floats) -> LinearModel:
    """Least squares, then the state of past outputs and inputs, then the filter."""
    count, ones = len(y), np.ones((len(y), 1))
    u = np.hstack([u, ones])
    past = [
        part for lag in range(1, order + 1) for part in (y[order - lag : count - lag], u[order - lag : count - lag, :2])
    ]
    design = np.hstack([*past, u[order:]])
    square = design.T @ design
    ridge = _RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    theta = np.linalg.solve(square + ridge, design.T @ y[order:]).T
    left = y[order:] - design @ theta.T
    noise = left.T @ left / (len(left) - design.shape[1])
    n = 5 * order
    c, d = theta[:, :n], theta[:, n:]
    # State: [y(k−1), u(k−1), ..., y(k−p), u(k−p)]. Its first block becomes y(k) = C x + D u + e and u(k).
    a, b, k = np.zeros((n, n)), np.zeros((n, 3)), np.zeros((n, 3))
    a[:3], b[:3], k[:3] = c, d, np.eye(3)
    b[3:5, :2] = np.eye(2)
    a[5:, :-5] = np.eye(n - 5)
    return LinearModel(order, a, b, c, d, middle, scale, *_stationary(a, c, k, noise))


def _stationary(a: Floats, c: Floats, k: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """The filter of the pressures alone: gain (n, 2), and the angle's gain (2,)."""
    seen = c[_PRESSURES]
    q, r, s = k @ noise @ k.T, noise[_PRESSURES, _PRESSURES], k @ noise[:, _PRESSURES]
    # The recursion itself: the shift of old samples in A makes the usual solvers of its fixed point fail.
    p = q.copy()
    for _ in range(_ROUNDS):
        innovation = seen @ p @ seen.T + r
        with_state = a @ p @ seen.T + s
        gain = np.linalg.solve(innovation, with_state.T).T
        after = a @ p @ a.T + q - gain @ with_state.T
        after = 0.5 * (after + after.T)
        settled = float(np.max(np.abs(after - p))) < _TOLERANCE * float(np.max(np.abs(after)))
        p = after
        if settled:
            break
    with_angle = c[_ANGLE] @ p @ seen.T + noise[_ANGLE, _PRESSURES]
    return np.asarray(gain), np.asarray(np.linalg.solve(innovation, with_angle))


def _filter(model: LinearModel, pressure: Floats, voltage: Floats) -> Floats:
    """Scaled angle (M,)."""
    u = np.hstack([voltage, np.ones((len(voltage), 1))])
    angle = np.empty(len(u))
    # A joint that has stood at the first sample's values for long.
    rest = -model.middle[_ANGLE] / model.scale[_ANGLE]
    x = np.tile(np.concatenate([[rest], pressure[0], voltage[0]]), model.order)
    for t in range(len(u)):
        predicted = model.c @ x + model.d @ u[t]
        innovation = pressure[t] - predicted[_PRESSURES]
        angle[t] = predicted[_ANGLE] + model.angle_gain @ innovation
        x = model.a @ x + model.b @ u[t] + model.gain @ innovation
    return angle


def estimate(model: LinearModel, pressure: Floats, voltage: Floats) -> Floats:
    """The angle (N,) from pressures (N, 2) and voltages (N, 2) alone.

    It goes straight between the middles of the averages, which looks ahead by up to 20 ms: to the linear model's
    advantage.
    """
    y = (averaged(pressure) - model.middle[1:3]) / model.scale[1:3]
    u = (averaged(voltage) - model.middle[3:]) / model.scale[3:]
    value = _filter(model, y, u) * model.scale[_ANGLE] + model.middle[_ANGLE]
    middles = (np.arange(len(value)) + 0.5) * STEP - 0.5
    return np.asarray(np.interp(np.arange(len(pressure)), middles, value))
