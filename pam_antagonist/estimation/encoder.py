"""The measured angle as an input of the filter: a further scalar update, and the detection of encoder faults.

A sample may have a reading z = ψ + offset + e. Its noise is independent of that of the pressures, so that an update
after theirs (:func:`pam_antagonist.estimation.ukf.update_angle`) is exact. As for the pressures, a reading beyond the
gate is left out. After ``PATIENCE`` such readings in a row the filter is taken to be wrong: readings are used again.

Four faults are not outliers. The filter then goes on without the encoder:

* The encoder **jumped**: from one reading to the next by more than a joint can move, and stayed there.
* It is **frozen**: it reads the same bits, although its declared noise or the pressures say that the joint moves.
* It has the **wrong sign**: the pressures say that the joint moves in the other direction.
* It is **beyond** all angles of a joint, for more than ``PATIENCE`` readings: it counts degrees or steps.

The pressures show the motion whatever torque acts from outside. Equation (4) is linear in the velocity,
Ṗ_i = f_i(P, u) + g_i(ψ, P) ψ̇, and the model gives f_i and g_i. So over 50 ms

    M = Σ_k Σ_i g_i (ΔP_i − f_i Δt) / Σ_i g_i²

is the joint's displacement. Its variance V comes from the sensors' noise and from a relative error ``_FLOW_ERROR`` of
the flows. Over the encoder's own displacement E, M has the slope 1. The sign is wrong if this slope is below −½ and
below 0 by four standard deviations.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place, merged
from pam_antagonist.estimation import push, ukf
from pam_antagonist.estimation.possible import FURTHEST
from pam_antagonist.estimation.stamps import PATIENCE
from pam_antagonist.model import dynamics
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, SECOND, VELOCITY

FINE, JUMPED, FROZEN, WRONG_SIGN, BEYOND = range(5)
"""Verdicts on an encoder."""
(
    VERDICT, SIZE_OF_JUMP, REJECTED, WITHOUT, _LAST, _SAME_FOR, _WAITING, _BEFORE, _PRESSURE_1, _PRESSURE_2, _SPAN_TIME,
    _MOTION, _FLOW, _BEGAN, _STILL_MM, _STILL_V, _STILL_SPANS, _EE, _EM, _EEV,
) = range(20)  # fmt: skip
MEMORY = 20
"""Numbers in the memory of an encoder: the verdict, the jump or the reading beyond all angles [rad], rejected readings
in a row, the time without a reading [s], and the sums that the verdict needs (products of E, M and V; ``_STILL``: of
spans with equal readings)."""

_FASTEST = 30.0
"""[rad/s] At this velocity a joint would cross its whole range in 30 ms."""
_NOISE = 8.0
"""Standard deviations of a reading within which a change is no jump."""
_SPAN = 0.05
"""[s] Span over which a displacement is measured."""
_LOST = 0.1
"""[s] Readings that are further apart are not compared."""
_FORGETTING = 0.98
"""Forgetting factor of the sums, from one span to the next: they hold about 2.5 s."""
_FLOW_ERROR = 0.05
"""Relative error of the modelled flows."""
_FEWEST = 10
"""Spans with equal readings that are needed for a verdict."""
_STANDSTILL = math.radians(0.2)
"""[rad] A smaller displacement in a span does not count as motion."""
_MOVING = 4.0
"""A joint moves if the displacements' mean square exceeds so many variances. Held plants that are 2 % off have 1.0."""
_EXACT = 0.2
"""[s] An encoder with declared noise cannot read the same bits for so long."""

_pushed, _widen = push.jumped, push.widen
_update_angle, _derivative, _pressure_behind = ukf.update_angle, dynamics.derivative, dynamics.pressure_behind


def new() -> np.ndarray:
    """Memory of an encoder that has not been read yet (MEMORY,)."""
    memory = np.zeros(MEMORY)
    memory[[_LAST, _PRESSURE_1, _PRESSURE_2]] = np.nan
    return memory


def was_read(memory: np.ndarray) -> bool:
    """Whether an encoder has been read. `memory`: of the encoder (MEMORY,)."""
    return not math.isnan(memory[_LAST])


def complaint(memory: np.ndarray) -> str:
    """Why an encoder is refused, and what to do; empty where it is not. `memory`: of the encoder (MEMORY,)."""
    verdict = int(memory[VERDICT])
    if verdict == JUMPED:
        return (
            f"the encoder jumped by {math.degrees(memory[SIZE_OF_JUMP]):+.1f}° from one sample to the next: "
            "look for lost steps or a loose shaft, find its zero again, then call ~/reset"
        )
    if verdict == FROZEN:
        return (
            f"the encoder is frozen at {math.degrees(memory[_LAST]):.2f}° while the joint moves: "
            "look at its cable and its driver, then call ~/reset"
        )
    if verdict == WRONG_SIGN:
        return (
            "the encoder has the wrong sign, by the motion that the pressures show: "
            "let the driver publish the negative angle (positive where muscle 1 shortens), then call ~/reset"
        )
    if verdict == BEYOND:
        return (
            f"the encoder reads {memory[SIZE_OF_JUMP]:.4g} rad, expected within ±{FURTHEST:.4g} rad: "
            "let the driver publish rad (degrees times 0.0174533), then call ~/reset"
        )
    return ""


@merged
def _jumped(reading, noise, elapsed, encoder):
    """Whether a reading must not be used, because it differs from the last one by more than a joint can move."""
    reach = _FASTEST * elapsed + _NOISE * math.sqrt(noise)
    if encoder[_WAITING] > 0.0:
        size = encoder[SIZE_OF_JUMP]
        if abs(reading - encoder[_BEFORE]) < 0.5 * abs(size):
            encoder[_WAITING] = 0.0  # it was a spike
            return False
        encoder[_WAITING] += 1.0
        if encoder[_WAITING] > PATIENCE:
            encoder[VERDICT] = JUMPED
        return True
    if elapsed < _LOST and abs(reading - encoder[_LAST]) > reach:
        encoder[_WAITING] = 1.0
        encoder[_BEFORE] = encoder[_LAST]
        encoder[SIZE_OF_JUMP] = reading - encoder[_LAST]
        return True
    return False


@merged
def _add_motion(reading, elapsed, y, u, x, p, noise, encoder, work):
    """Add the displacement [rad] since the last sample that the pressures show, and close a span that is over."""
    state, still, moving = work.points[0], work.points[1], work.points[2]
    for i in range(x.shape[0]):
        state[i] = x[i]
    state[ANGLE] = reading
    state[PRESSURE_1], state[PRESSURE_1 + 1] = y
    state[VELOCITY] = 0.0
    _derivative(state, u, p, still)
    state[VELOCITY] = 1.0
    _derivative(state, u, p, moving)
    squares, motion, flow = 0.0, 0.0, 0.0
    for i in range(2):
        slope = moving[PRESSURE_1 + i] - still[PRESSURE_1 + i]
        squares += slope * slope
        motion += slope * (y[i] - encoder[_PRESSURE_1 + i] - still[PRESSURE_1 + i] * elapsed)
        flow += abs(slope * still[PRESSURE_1 + i]) * elapsed
    if squares <= 0.0:
        return
    encoder[_MOTION] += motion / squares
    encoder[_FLOW] += _FLOW_ERROR * flow / squares
    encoder[_SPAN_TIME] += elapsed
    if encoder[_SPAN_TIME] < _SPAN:
        return
    variance = 2.0 * max(noise[0], noise[1]) / squares + encoder[_FLOW] * encoder[_FLOW]
    own = reading - encoder[_BEGAN]
    encoder[_EE] = _FORGETTING * encoder[_EE] + own * own
    encoder[_EM] = _FORGETTING * encoder[_EM] + own * encoder[_MOTION]
    encoder[_EEV] = _FORGETTING * encoder[_EEV] + own * own * variance
    if encoder[_SAME_FOR] >= encoder[_SPAN_TIME]:
        encoder[_STILL_MM] += encoder[_MOTION] * encoder[_MOTION]
        encoder[_STILL_V] += variance
        encoder[_STILL_SPANS] += 1.0
    _begin_span(reading, encoder)


@merged
def _begin_span(reading, encoder):
    encoder[_SPAN_TIME] = encoder[_MOTION] = encoder[_FLOW] = 0.0
    encoder[_BEGAN] = reading


@merged
def _judge(noise, step, encoder):
    """Set the verdict if the sums show a fault."""
    spans = encoder[_STILL_SPANS]
    if step == 0.0 and noise > 0.0 and encoder[_SAME_FOR] >= _EXACT:
        encoder[VERDICT] = FROZEN
    elif spans >= _FEWEST and encoder[_STILL_MM] > max(_MOVING * encoder[_STILL_V], spans * _STANDSTILL * _STANDSTILL):
        encoder[VERDICT] = FROZEN
    elif encoder[_EE] > 0.0:
        slope, error = encoder[_EM] / encoder[_EE], math.sqrt(encoder[_EEV]) / encoder[_EE]
        if slope < -0.5 and slope + 4.0 * error < 0.0:
            encoder[VERDICT] = WRONG_SIGN


@in_place
def examine(reading, elapsed, y, usable, u, x, p, noise, angle_noise, angle_step, encoder, work):
    """Check a reading against earlier readings and against the pressures.

    `reading`: ψ as measured, offset subtracted [rad], finite. `elapsed`: since the last sample [s]. `y`: pressures (2,)
    [Pa]. `u`: voltages (2,) [V] over the step. `x`: estimate (n,), of which the added states count. `noise`: diagonal
    of R (2,) [Pa²]. `angle_noise`: variance of a reading [rad²]. `angle_step`: of the converter [rad]; 0: none.
    `encoder`: its memory (MEMORY,), changed in place.
    """
    elapsed += encoder[WITHOUT]
    encoder[WITHOUT] = 0.0
    if abs(reading) > FURTHEST:
        encoder[WITHOUT] = elapsed
        encoder[REJECTED] += 1.0
        if encoder[REJECTED] > PATIENCE and encoder[VERDICT] == FINE:
            encoder[VERDICT], encoder[SIZE_OF_JUMP] = BEYOND, reading
        return False
    behind = (_pressure_behind(FIRST, y[0], p), _pressure_behind(SECOND, y[1], p))
    if math.isnan(encoder[_LAST]):
        encoder[_LAST], encoder[_BEGAN] = reading, reading
        encoder[_PRESSURE_1], encoder[_PRESSURE_2] = behind
        return encoder[VERDICT] == FINE
    refused = _jumped(reading, angle_noise, elapsed, encoder)
    if reading == encoder[_LAST]:
        encoder[_SAME_FOR] += elapsed
    else:
        encoder[_SAME_FOR] = encoder[_STILL_MM] = encoder[_STILL_V] = encoder[_STILL_SPANS] = 0.0
    if refused or not usable or elapsed > _LOST or math.isnan(encoder[_PRESSURE_1] + encoder[_PRESSURE_2]):
        _begin_span(reading, encoder)
    else:
        _add_motion(reading, elapsed, behind, u, x, p, noise, encoder, work)
    if encoder[VERDICT] == FINE:
        _judge(angle_noise, angle_step, encoder)
    encoder[_LAST] = reading
    encoder[_PRESSURE_1], encoder[_PRESSURE_2] = behind
    return not refused and encoder[VERDICT] == FINE


@in_place
def correct(reading, memory, settings, work):
    """Update with a reading, unless the gate rejects it.

    `reading`: ψ as measured, offset subtracted [rad], finite. `memory`:
    :class:`pam_antagonist.estimation.memory.Memory`, changed in place. `settings`:
    :class:`pam_antagonist.estimation.memory.FilterSettings`.
    """
    innovation = reading - memory.x[ANGLE]
    variance = memory.covariance[ANGLE, ANGLE] + settings.angle_noise
    if innovation * innovation > settings.gate * settings.gate * variance:
        memory.encoder[REJECTED] += 1.0
        if memory.encoder[REJECTED] <= PATIENCE:
            return False
    else:
        memory.encoder[REJECTED] = 0.0
    if _pushed(innovation * innovation / variance, settings.parameter_sets[0]):
        _widen(memory.covariance, settings.parameter_sets[0])
    _update_angle(memory.x, memory.covariance, memory.cross, innovation, settings.angle_noise, work)
    return True
