"""Propagation of sigma points over a step of the model: several at once on processors with wide instructions.

Each point has the same bits either way (:mod:`pam_antagonist.model.lanes`), so the estimate does not depend on the
machine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import types

from pam_antagonist._jit import by_types
from pam_antagonist.model import integration, lanes
from pam_antagonist.model.lane_values import LANES


def beside(parameter_sets: np.ndarray, points: int) -> np.ndarray:
    """Parameters of the sigma points, side by side in groups.

    `parameter_sets`: sets of the first points (1 + 2 m, SIZE); the others have the first set. Returns (G, SIZE, LANES),
    G groups; unused places of the last group have the first set.
    """
    steps = range(0, points, LANES)
    each = [parameter_sets[k if k < len(parameter_sets) else 0] for k in range(len(steps) * LANES)]
    return np.stack([lanes.beside(each[first : first + LANES]) for first in steps])


def advance(points, u, parameter_sets, dt, effects, work):
    """Propagate each sigma point over a step, in place; in compiled code only.

    `points`: (K, n). `u`: input (2,) held over the step. `parameter_sets`: sets of the first points (1 + 2 m, SIZE);
    the others have the first set. `dt`: step [s].
    """
    raise NotImplementedError("in compiled code only")


@by_types(advance)
def _advance(points, u, parameter_sets, dt, effects, work):
    plain = isinstance(effects, types.NoneType)
    together = lanes.step(plain)
    if together is None:
        return _one_by_one(integration.plain_step if plain else integration.rk4_step_within)
    return _side_by_side(together)


def _one_by_one(step: Any) -> Callable[..., None]:
    def advance(points, u, parameter_sets, dt, effects, work):
        sets = parameter_sets.shape[0]
        for k in range(points.shape[0]):
            step(points[k], u, parameter_sets[k if k < sets else 0], dt, points[k], work.stages)

    return advance


def _side_by_side(step: Any) -> Callable[..., None]:
    def advance(points, u, parameter_sets, dt, effects, work):
        states = work.lane_states
        for group in range(work.lane_sets.shape[0]):
            first = group * LANES
            count = min(LANES, points.shape[0] - first)
            for lane in range(count):
                for i in range(points.shape[1]):
                    states[i, lane] = points[first + lane, i]
            step(states, u, work.lane_sets[group], dt, states, work.lane_stages)
            for lane in range(count):
                for i in range(points.shape[1]):
                    points[first + lane, i] = states[i, lane]

    return advance
