"""Many models on the same inputs at once, four or eight in a step of the integration.

A fit simulates the same recording with many parameter vectors, and a filter takes its sigma points over the same step.
Four of them run side by side, with AVX-512 eight (:mod:`pam_antagonist.model.lane_values`), by the same equations
(:mod:`pam_antagonist.model.lane_form`). Each has the same bits as alone, so results do not depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numba.core import errors, types

from pam_antagonist._jit import by_types, form_by_types
from pam_antagonist.model import composition, integration, lane_form
from pam_antagonist.model import parameters as par
from pam_antagonist.model.lane_values import FEWEST, LANES, array_of_lanes, in_lane, in_lanes, lanes

form_by_types(lane_form.lane_form)


@lru_cache(maxsize=1)
def possible() -> bool:
    """Whether the equations can be compiled for lanes; an effect of another package may not."""

    def tried() -> str:
        x, stages = array_of_lanes(1), array_of_lanes(2)
        try:
            integration.rk4_step_within.compile((x, types.float64[::1], x, types.float64, x, stages))
        except errors.NumbaError:
            return "no"
        return "yes"

    return composition.remembered("lanes", tried) == "yes"


def beside(vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Parameters of several models that run side by side (P, LANES). All take the branches that any of them needs.

    `vectors`: parameter vector (P,) of each.
    """
    p = np.stack(vectors, axis=1)
    p[par.PLAIN], p[par.STATELESS_EFFECTS] = p[par.PLAIN].min(), p[par.STATELESS_EFFECTS].max()
    return p


def groups(models: Sequence[Sequence[np.ndarray]]) -> list[list[int]]:
    """Groups of models that can run side by side, as indices; at most LANES in a group.

    `models`: parameter vectors (P,) of each model, one for each of its phases.
    """
    by_structure: dict[tuple[bytes, ...], list[int]] = {}
    for k, vectors in enumerate(models):
        by_structure.setdefault(tuple(map(_structure, vectors)), []).append(k)
    return [same[begin : begin + LANES] for same in by_structure.values() for begin in range(0, len(same), LANES)]


def _structure(p: np.ndarray) -> bytes:
    """What models must have in common to run side by side: options of the rig, added states, signals, valve curves."""
    shared = p[par.LOCKED :].copy()
    shared[[place - par.LOCKED for place in (*par.FLOW_CONSTANTS, par.PLAIN, par.STATELESS_EFFECTS)]] = 0.0
    return shared.tobytes()


def sigma_points_beside(parameter_sets: np.ndarray, points: int) -> np.ndarray:
    """Parameters of the sigma points, side by side in groups.

    `parameter_sets`: sets of the first points (1 + 2 m, SIZE); the others have the first set. Returns (G, SIZE, LANES),
    G groups; unused places of the last group have the first set.
    """
    steps = range(0, points, LANES)
    each = [parameter_sets[k if k < len(parameter_sets) else 0] for k in range(len(steps) * LANES)]
    return np.stack([beside(each[first : first + LANES]) for first in steps])


def advance(points, u, parameter_sets, dt, effects, work):
    """Propagate each sigma point over a step, in place; in compiled code only.

    `points`: (K, n). `u`: input (2,) held over the step. `parameter_sets`: sets of the first points (1 + 2 m, SIZE);
    the others have the first set. `dt`: step [s].
    """
    raise NotImplementedError("in compiled code only")


@by_types(advance)
def _advance(points, u, parameter_sets, dt, effects, work):
    plain = isinstance(effects, types.NoneType)
    step = integration.plain_step if plain else integration.rk4_step_within
    return _in_groups(step) if FEWEST <= LANES and (plain or possible()) else _one_by_one(step)


def _one_by_one(step: Any) -> Callable[..., None]:
    def advance(points, u, parameter_sets, dt, effects, work):
        sets = parameter_sets.shape[0]
        for k in range(points.shape[0]):
            step(points[k], u, parameter_sets[k if k < sets else 0], dt, points[k], work.stages)

    return advance


def _in_groups(step: Any) -> Callable[..., None]:
    def advance(points, u, parameter_sets, dt, effects, work):
        states = work.lane_states
        for group in range(work.lane_sets.shape[0]):
            first = group * LANES
            count = min(LANES, points.shape[0] - first)
            for lane in range(count):
                for i in range(points.shape[1]):
                    states[i, lane] = points[first + lane, i]
            x = in_lanes(states)
            step(x, u, in_lanes(work.lane_sets[group]), dt, x, in_lanes(work.lane_stages))
            for lane in range(count):
                for i in range(points.shape[1]):
                    points[first + lane, i] = states[i, lane]

    return advance


def keep(into, row, column, value):
    """Keep a value in an array, ``into[row, column]``; of lanes, in the array of each model. In compiled code only."""
    raise NotImplementedError("in compiled code only")


@by_types(keep)
def _keep(into, row, column, value):
    def one(into, row, column, value):
        into[row, column] = value

    def each(into, row, column, value):
        for k in range(LANES):
            into[k, row, column] = in_lane(value, k)

    return each if value is lanes else one
