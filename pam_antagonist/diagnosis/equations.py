"""Equation errors: what each equation of the model lacks where it starts from the measurements again and again.

A simulation carries every error along; an equation that is given the measured state shows its own error only. From
each fifth of a second the model runs for as long, from the measured angle and pressures on (states that nobody measures
are the simulation's). How much more the pressures and the joint have moved than it says is the error of the flows and
of the motion; measurement and model are averaged alike, so that smoothing cannot look like a lag. The torque's error is
taken at the measured state.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.trial import ANGLE, BLOCK, PRESSURE_1, TORQUE
from pam_antagonist.model import dynamics, flow, muscle, sensor

Floats = NDArray[np.float64]

NAMES = ("mass flow 1", "mass flow 2", "contraction torque", "joint motion")
UNITS = ("mg/s", "mg/s", "N m", "deg/s")
SPAN = 10
"""[blocks] How long the model runs from a measurement."""
_NEAR = 2
"""[blocks] To either side, from which the velocity is told."""
_PROBES = 12


@dataclass(frozen=True, eq=False)
class EquationErrors:
    """Errors of the equations over all of a recording.

    Attributes:
        begin: the block from which each was taken (W,).
        values: (W, 4) in the order and units of ``NAMES`` and ``UNITS``; 0 where something is missing.
        noise: what the sensors alone give (4,).
        known: which of them could be worked out.
    """

    begin: NDArray[np.int64]
    values: Floats
    noise: Floats
    known: tuple[int, ...]


def equation_errors(experiment: Experiment, point: Point) -> EquationErrors:
    """Errors of each equation of a model.

    Args:
        experiment: the recording.
        point: the model.
    """
    trial, p = experiment.trial, experiment.parameters(point)
    states, _ = experiment.states(point)
    shown = np.full((len(experiment.measured), 4), np.nan)
    shown[:, list(experiment.channels)] = experiment.measured
    noise = np.zeros(4)
    noise[list(experiment.channels)] = experiment.noise
    known = [0, 1]
    moves = ANGLE in experiment.channels
    if TORQUE in experiment.channels and (moves or trial.joint == "locked"):
        known.append(2)
    if moves:
        known.append(3)
    begin = np.arange(_NEAR, len(shown) - SPAN - 1, SPAN)
    start = np.array(
        [_measured_state(states, shown, block, trial.dt if moves else None, p) for block in range(len(shown))]
    )
    factors = np.array([[_flow_of_rate(i, start[b], p) for i in (0, 1)] for b in begin])
    seconds = SPAN * BLOCK * trial.dt

    def said(block: int, x: Floats) -> Floats:
        """Pressures' readings and angle at the end of a window (3,)."""
        first = block * BLOCK + BLOCK // 2
        run, _ = dynamics.course(x, trial.given[first : first + (SPAN + 1) * BLOCK], p, trial.dt, 1)
        end = run[SPAN * BLOCK - BLOCK // 2 : SPAN * BLOCK + BLOCK // 2].mean(axis=0)
        return np.array([sensor.reading(0, end[2], p), sensor.reading(1, end[3], p), end[0]])

    values = np.full((len(begin), 4), np.nan)
    ends = np.array([said(int(b), start[b]) for b in begin])
    rates = (shown[begin + SPAN][:, [PRESSURE_1, PRESSURE_1 + 1, ANGLE]] - ends) / seconds
    values[:, :2] = rates[:, :2] * factors * 1e6
    torque = np.array([dynamics.torque(x, p) for x in start])
    lacking = shown[:, TORQUE] - torque
    values[:, 2] = [lacking[b : b + SPAN].mean() for b in begin]
    values[:, 3] = np.degrees(rates[:, 2])
    # What the sensors' noise does at the start and at the end of a window, for some of them.
    errors = np.zeros(4)
    velocity = noise[ANGLE] * np.sqrt(2.0) / (2 * _NEAR * BLOCK * trial.dt)
    of_state = ((0, noise[ANGLE]), (1, velocity if moves else 0.0), (2, noise[PRESSURE_1]), (3, noise[PRESSURE_1 + 1]))
    probes = np.linspace(0, len(begin) - 1, min(_PROBES, len(begin))).astype(int)
    for w in probes:
        for state, std in of_state:
            if std == 0.0 or (state < 2 and not moves):
                continue
            x = start[begin[w]].copy()
            x[state] += std
            change = (said(int(begin[w]), x) - ends[w]) / seconds
            turned = dynamics.torque(x, p) - torque[begin[w]] if state != 1 else 0.0
            errors[:2] += (change[:2] * factors[w] * 1e6) ** 2
            errors[2] += turned**2 / SPAN
            errors[3] += np.degrees(change[2]) ** 2
    errors /= len(probes)
    errors[:2] += (noise[PRESSURE_1:] / seconds * np.mean(factors, axis=0) * 1e6) ** 2
    errors[2] += noise[TORQUE] ** 2 / SPAN
    errors[3] += np.degrees(noise[ANGLE] / seconds) ** 2
    return EquationErrors(begin, np.nan_to_num(values), np.sqrt(errors), tuple(known))


def _measured_state(states: Floats, shown: Floats, block: int, dt: float | None, p: Floats) -> Floats:
    """The simulation's state in the middle of a block, with what was measured in place of what was simulated.

    The angle stays the simulation's where `dt` is None.
    """
    x = states[block * BLOCK + BLOCK // 2].copy()
    if dt is not None:
        low, high = max(block - _NEAR, 0), min(block + _NEAR, len(shown) - 1)
        x[0] = shown[block, ANGLE]
        x[1] = (shown[high, ANGLE] - shown[low, ANGLE]) / ((high - low) * BLOCK * dt)
    for i in (0, 1):
        x[2 + i] = sensor.pressure_behind(i, shown[block, PRESSURE_1 + i], p)
    return x


def _flow_of_rate(i: int, x: Floats, p: Floats) -> float:
    """Mass flow [kg/s] that moves a pressure by 1 Pa/s, by equation (4)."""
    sine, _, _ = muscle.leverage(x[0], p)
    chamber, _ = muscle.volume(i, muscle.length(i, sine, p), p)
    still, moved = (flow.pressure_rate(x[2 + i], chamber, 0.0, m, p) for m in (0.0, 1.0))
    return float(1.0 / (moved - still))
