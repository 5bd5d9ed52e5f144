r"""What the valves did while samples were missing.

Over a gap the commands are unknown. If they were held, the pressures after it agree with the prediction: the innovation
ν has the covariance S. Otherwise the command u of each muscle over each half of the gap may be anything in its range,
with the variance σ², and ν has the covariance S + G, with G = σ² Σ (∂p/∂u)(∂p/∂u)ᵀ. The more likely of the two counts.
Held commands would make the filter sure of pressures that it cannot know: the new ones then seem impossible, or pull
the angle with them. So unless they were held,

1. the constant commands ū are found that explain the pressures after the gap, by bisection, since a pressure rises with
   its command;
2. the sigma points take ū over the gap;
3. the covariance gains σ² Σ (∂x/∂u)(∂x/∂u)ᵀ at ū. The update with the pressures after the gap then leaves what these
   do not show: other courses of the commands to the same pressures.
"""

from __future__ import annotations

import math

from pam_antagonist._jit import in_place
from pam_antagonist.estimation import ukf
from pam_antagonist.model import dynamics, integration
from pam_antagonist.model.dynamics import PRESSURE_1

_plain_step, _step = integration.plain_step, integration.rk4_step_within
_predict, _innovate, _pressure_behind = ukf.predict, ukf.innovate, dynamics.pressure_behind
_ROUNDS = 12
"""Bisections: ū to 1/4096 of the range."""
_UNIFORM = math.sqrt(1.0 / 12.0)
"""Standard deviation of a command that may be anything in its range, as a share of the range."""


@in_place
def _end(x, inputs, steps, since, dt, p, effects, scratch, out):
    """State (n,) at the end of a gap under inputs (3, 2) over its halves and over the last period."""
    for i in range(x.shape[0]):
        out[i] = x[i]
    for step in range(steps):
        held = inputs[2 if step >= since else (0 if step < since // 2 else 1)]
        if effects is None:
            _plain_step(out, held, p, dt, out, scratch)
        else:
            _step(out, held, p, dt, out, scratch)


@in_place
def _vary(x, held, limits, steps, since, dt, p, effects, work):
    """σ ∂x/∂u around held commands, in ``work.halves`` (4, n); ``work.inputs`` ends with the last period's."""
    inputs, halves, ends = work.inputs, work.halves, work.points
    for i in range(2):
        deviation = _UNIFORM * (limits[i, 1] - limits[i, 0])
        below, above = max(held[i] - deviation, limits[i, 0]), min(held[i] + deviation, limits[i, 1])
        for half in range(2):
            for end in range(2):
                for j in range(2):
                    inputs[0, j] = inputs[1, j] = held[j]
                inputs[half, i] = above if end == 1 else below
                _end(x, inputs, steps, since, dt, p, effects, work.stages, ends[end])
            for k in range(x.shape[0]):
                slope = (ends[1, k] - ends[0, k]) * deviation / (above - below)
                halves[2 * i + half, k] = slope if math.isfinite(slope) else 0.0


@in_place
def _explain(x, held, pressure, usable_1, usable_2, limits, steps, since, dt, p, effects, work):
    """Replace the held commands (2,) by those that explain the pressures after the gap (2,), where these are known."""
    inputs, brackets, end = work.inputs, work.brackets, work.points[0]
    for i in range(2):
        known = usable_1 if i == 0 else usable_2
        for side in range(2):
            brackets[i, side] = limits[i, side] if known else held[i]
    for _ in range(_ROUNDS):
        for i in range(2):
            inputs[0, i] = inputs[1, i] = 0.5 * (brackets[i, 0] + brackets[i, 1])
        _end(x, inputs, steps, since, dt, p, effects, work.stages, end)
        for i in range(2):
            brackets[i, 1 if end[PRESSURE_1 + i] > pressure[i] else 0] = inputs[0, i]
    for i in range(2):
        held[i] = 0.5 * (brackets[i, 0] + brackets[i, 1])


@in_place
def _improbability(v1, v2, s11, s12, s22):
    """Minus twice the logarithm of a likelihood, but for a constant; infinite for a covariance that is not definite."""
    determinant = s11 * s22 - s12 * s12
    if not determinant > 0.0:
        return math.inf
    return math.log(determinant) + (v1 * v1 * s22 - 2.0 * v1 * v2 * s12 + v2 * v2 * s11) / determinant


@in_place
def _held_on(innovation, covariance, usable_1, usable_2, halves):
    """Whether the pressures after a gap are more likely if the commands were held than if they may be anything."""
    if not (usable_1 or usable_2):
        return False
    g11, g12, g22 = 0.0, 0.0, 0.0
    for k in range(halves.shape[0]):
        a, b = halves[k, PRESSURE_1], halves[k, PRESSURE_1 + 1]
        g11, g12, g22 = g11 + a * a, g12 + a * b, g22 + b * b
    v1, v2, s11, s12, s22 = innovation[0], innovation[1], covariance[0, 0], covariance[0, 1], covariance[1, 1]
    if not usable_1:
        v1, s11, s12, g11, g12 = 0.0, 1.0, 0.0, 0.0, 0.0
    if not usable_2:
        v2, s22, s12, g22, g12 = 0.0, 1.0, 0.0, 0.0, 0.0
    return _improbability(v1, v2, s11, s12, s22) <= _improbability(v1, v2, s11 + g11, s12 + g12, s22 + g22)


@in_place
def _widen(covariance, halves):
    """Add the variance by unknown commands to a covariance (n, n), in place."""
    for k in range(halves.shape[0]):
        for i in range(covariance.shape[0]):
            for j in range(covariance.shape[0]):
                covariance[i, j] += halves[k, i] * halves[k, j]


@in_place
def propagate(steps, since, dt, u, known_u, effects, memory, settings, work):
    """Predict over steps of the model. Returns how many pivots were repaired.

    `dt`: step [s]. `u`: new commands (2,).
    """
    repaired = 0
    for step in range(steps):
        if step == since and known_u:
            memory.held[0], memory.held[1] = u
        outcome = _predict(
            memory.x,
            memory.covariance,
            memory.cross,
            memory.held,
            settings.parameter_sets,
            dt,
            memory.noise,
            # Errors of the steps within a period add up, as one error would.
            settings.change_noise * (settings.period / dt),
            settings.kappa,
            effects,
            work,
        )
        if outcome < 0:
            break
        repaired += outcome
    return repaired


@in_place
def _copy(x, covariance, cross, own_x, own_covariance, own_cross):
    """Copy state and covariances into arrays of the same shapes."""
    for i in range(x.shape[0]):
        own_x[i] = x[i]
        for j in range(x.shape[0]):
            own_covariance[i, j] = covariance[i, j]
        for j in range(cross.shape[1]):
            own_cross[i, j] = cross[i, j]


@in_place
def over_gap(steps, since, dt, y, usable_1, usable_2, u, known_u, effects, memory, settings, work):
    """Predict over missing samples, whose commands are unknown. Returns how many pivots were repaired.

    `steps`: as for :func:`propagate`. `y`: pressures after the gap (2,) [Pa]. `u`: as for :func:`propagate`.
    """
    x, covariance, cross, held = memory.x, memory.covariance, memory.cross, memory.held
    p, limits, pressure = settings.parameter_sets[0], settings.commands, work.brackets[0]
    first, second = held[0], held[1]
    _copy(x, covariance, cross, work.before_x, work.before_covariance, work.before_cross)
    for i in range(2):
        work.inputs[2, i] = u[i] if known_u else held[i]
        memory.innovation[i] = _pressure_behind(i, y[i], p)
        pressure[i] = memory.innovation[i]
    _vary(x, held, limits, steps, since, dt, p, effects, work)
    repaired = propagate(steps, since, dt, u, known_u, effects, memory, settings, work)
    _innovate(x, covariance, pressure, settings.measurement_noise, pressure, memory.innovation_covariance)
    if _held_on(pressure, memory.innovation_covariance, usable_1, usable_2, work.halves):
        return repaired
    _copy(work.before_x, work.before_covariance, work.before_cross, x, covariance, cross)
    held[0], held[1] = first, second
    _explain(x, held, memory.innovation, usable_1, usable_2, limits, steps, since, dt, p, effects, work)
    _vary(x, held, limits, steps, since, dt, p, effects, work)
    repaired = propagate(steps, since, dt, u, known_u, effects, memory, settings, work)
    _widen(covariance, work.halves)
    return repaired
