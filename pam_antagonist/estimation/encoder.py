"""The measured angle as an input of the filter: one scalar update more, and what is wrong with an encoder.

A reading z = ψ + offset + e comes with a sample, or does not. Its noise is independent of the pressures', so that an
update after theirs (:func:`pam_antagonist.estimation.ukf.update_angle`) is exact. As for the pressures, a reading
beyond the gate is left out, and after ``PATIENCE`` of these in a row it is the filter that is wrong.

Three faults are no outliers. They are refused for good, and the filter goes on without the encoder:

* It **jumped**: from one reading to the next by more than a joint can move, and stayed there.
* It is **frozen**: it reads the same bits, although its declared noise or the pressures say that the joint moves.
* It has the **wrong sign**: the pressures say that the joint moves the other way.

What the pressures say of the motion is independent of any torque from outside. Equation (4) is linear in the velocity,
Ṗ_i = f_i(P, u) + g_i(ψ, P) ψ̇, and both come from the model. So over 50 ms

    M = Σ_k Σ_i g_i (ΔP_i − f_i Δt) / Σ_i g_i²

is the joint's way, with the variance V of the sensors' noise and of flows that are off by ``_FLOW_ERROR``. The slope of
M over the encoder's own way is 1; where it is below −½ and below 0 by four standard deviations, the sign is wrong.
"""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist._jit import in_place, merged
from pam_antagonist.estimation import push, ukf
from pam_antagonist.model import dynamics, sensor
from pam_antagonist.model.dynamics import ANGLE, FIRST, PRESSURE_1, SECOND, VELOCITY

FINE, JUMPED, FROZEN, WRONG_SIGN = range(4)
"""Verdicts on an encoder."""
(
    VERDICT, SIZE_OF_JUMP, REJECTED, WITHOUT, _LAST, _SAME_FOR, _WAITING, _BEFORE, _PRESSURE_1, _PRESSURE_2, _WINDOW,
    _WAY, _FLOW, _BEGAN, _STILL, _STILL_V, _WINDOWS, _EE, _EM, _EEV,
) = range(20)  # fmt: skip
MEMORY = 20
"""Numbers that are remembered of an encoder: the verdict, the jump [rad], refused readings in a row, the time without
a reading [s], and what it is judged by."""

PATIENCE = 20
"""Readings in a row, as of the pressures."""
_FASTEST = 30.0
"""[rad/s] A joint would cross its whole range in 30 ms."""
_NOISE = 8.0
"""Standard deviations of a reading that count as no jump."""
_SPAN = 0.05
"""[s] Over which a way is measured."""
_LOST = 0.1
"""[s] Further apart, readings are not compared."""
_FADING = 0.98
"""Of the sums, from one span to the next: about 2.5 s are remembered."""
_FLOW_ERROR = 0.05
"""Relative error of the modelled flows."""
_FEWEST = 10
"""Spans in which an encoder reads the same, before it is judged."""
_STANDSTILL = math.radians(0.2)
"""[rad] A joint that moves less in a span may as well stand."""
_SURE = 4.0
"""Mean square of the ways over their variance, from which on a joint moves; 1.0 on plants that are held, 2 % off."""
_EXACT = 0.2
"""[s] For which an encoder with declared noise cannot read the same bits."""

_pushed, _widen = push.jumped, push.widen
_update_angle, _derivative, _pressure_behind = ukf.update_angle, dynamics.derivative, sensor.pressure_behind


def new() -> np.ndarray:
    """What is remembered of an encoder that has not been read yet (MEMORY,)."""
    memory = np.zeros(MEMORY)
    memory[[_LAST, _PRESSURE_1, _PRESSURE_2]] = np.nan
    return memory


def was_read(memory: np.ndarray) -> bool:
    """Whether an encoder has been read.

    Args:
        memory: what is remembered of it (MEMORY,).
    """
    return not math.isnan(memory[_LAST])


def complaint(memory: np.ndarray) -> str:
    """Why an encoder is refused, and what to do; empty where it is not.

    Args:
        memory: what is remembered of it (MEMORY,).
    """
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
    return ""


@merged
def _jumped(reading, noise, elapsed, encoder):
    """Whether a reading is not to be used, since it is further from the last one than a joint moves."""
    reach = _FASTEST * elapsed + _NOISE * math.sqrt(noise)
    if encoder[_WAITING] > 0.0:
        size = encoder[SIZE_OF_JUMP]
        if abs(reading - encoder[_BEFORE]) < 0.5 * abs(size):
            encoder[_WAITING] = 0.0  # a spike, and back
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
def _way(reading, elapsed, y, u, x, p, noise, encoder, work):
    """Add what the pressures say of the motion since the last sample [rad]."""
    state, still, moving = work.points[0], work.points[1], work.points[2]
    for i in range(x.shape[0]):
        state[i] = x[i]
    state[ANGLE] = reading
    state[PRESSURE_1], state[PRESSURE_1 + 1] = y
    state[VELOCITY] = 0.0
    _derivative(state, u, p, still)
    state[VELOCITY] = 1.0
    _derivative(state, u, p, moving)
    squares, way, flow = 0.0, 0.0, 0.0
    for i in range(2):
        slope = moving[PRESSURE_1 + i] - still[PRESSURE_1 + i]
        squares += slope * slope
        way += slope * (y[i] - encoder[_PRESSURE_1 + i] - still[PRESSURE_1 + i] * elapsed)
        flow += abs(slope * still[PRESSURE_1 + i]) * elapsed
    if squares <= 0.0:
        return
    encoder[_WAY] += way / squares
    encoder[_FLOW] += _FLOW_ERROR * flow / squares
    encoder[_WINDOW] += elapsed
    if encoder[_WINDOW] < _SPAN:
        return
    variance = 2.0 * max(noise[0], noise[1]) / squares + encoder[_FLOW] * encoder[_FLOW]
    own = reading - encoder[_BEGAN]
    encoder[_EE] = _FADING * encoder[_EE] + own * own
    encoder[_EM] = _FADING * encoder[_EM] + own * encoder[_WAY]
    encoder[_EEV] = _FADING * encoder[_EEV] + own * own * variance
    if encoder[_SAME_FOR] >= encoder[_WINDOW]:
        encoder[_STILL] += encoder[_WAY] * encoder[_WAY]
        encoder[_STILL_V] += variance
        encoder[_WINDOWS] += 1.0
    _begin_span(reading, encoder)


@merged
def _begin_span(reading, encoder):
    encoder[_WINDOW] = encoder[_WAY] = encoder[_FLOW] = 0.0
    encoder[_BEGAN] = reading


@merged
def _judge(noise, step, encoder):
    """Whether what was added up so far convicts the encoder."""
    windows = encoder[_WINDOWS]
    if step == 0.0 and noise > 0.0 and encoder[_SAME_FOR] >= _EXACT:
        encoder[VERDICT] = FROZEN
    elif windows >= _FEWEST and encoder[_STILL] > max(_SURE * encoder[_STILL_V], windows * _STANDSTILL * _STANDSTILL):
        encoder[VERDICT] = FROZEN
    elif encoder[_EE] > 0.0:
        slope, error = encoder[_EM] / encoder[_EE], math.sqrt(encoder[_EEV]) / encoder[_EE]
        if slope < -0.5 and slope + 4.0 * error < 0.0:
            encoder[VERDICT] = WRONG_SIGN


@in_place
def examine(reading, elapsed, y, usable, u, x, p, noise, angle_noise, angle_step, encoder, work):
    """Judge a reading by what came before, and by the pressures.

    Args:
        reading: ψ as measured, offset taken away [rad], finite.
        elapsed: since the last sample [s].
        y: pressures (2,) [Pa].
        usable: whether both are finite.
        u: voltages (2,) [V] over the step.
        x: estimate (n,), of which the added states count.
        p: parameter vector.
        noise: diagonal of R (2,) [Pa²].
        angle_noise: variance of a reading [rad²].
        angle_step: of the converter [rad]; 0: none.
        encoder: what is remembered (MEMORY,), changed in place.
        work: :class:`pam_antagonist.estimation.ukf.Work`, scratch.

    Returns:
        Whether the reading may be used.
    """
    elapsed += encoder[WITHOUT]
    encoder[WITHOUT] = 0.0
    behind = (_pressure_behind(FIRST, y[0], p), _pressure_behind(SECOND, y[1], p))
    if math.isnan(encoder[_LAST]):
        encoder[_LAST], encoder[_BEGAN] = reading, reading
        encoder[_PRESSURE_1], encoder[_PRESSURE_2] = behind
        return encoder[VERDICT] == FINE
    refused = _jumped(reading, angle_noise, elapsed, encoder)
    if reading == encoder[_LAST]:
        encoder[_SAME_FOR] += elapsed
    else:
        encoder[_SAME_FOR] = encoder[_STILL] = encoder[_STILL_V] = encoder[_WINDOWS] = 0.0
    if refused or not usable or elapsed > _LOST or math.isnan(encoder[_PRESSURE_1] + encoder[_PRESSURE_2]):
        _begin_span(reading, encoder)
    else:
        _way(reading, elapsed, behind, u, x, p, noise, encoder, work)
    if encoder[VERDICT] == FINE:
        _judge(angle_noise, angle_step, encoder)
    encoder[_LAST] = reading
    encoder[_PRESSURE_1], encoder[_PRESSURE_2] = behind
    return not refused and encoder[VERDICT] == FINE


@in_place
def correct(reading, memory, settings, work):
    """Update with a reading that lies within the gate.

    Args:
        reading: ψ as measured, offset taken away [rad], finite.
        memory: :class:`pam_antagonist.estimation.memory.Memory`, changed in place.
        settings: :class:`pam_antagonist.estimation.memory.Settings`.
        work: :class:`pam_antagonist.estimation.ukf.Work`, scratch.

    Returns:
        Whether it was used.
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
