"""Many models on the same inputs at once, four or eight in a step of the integration.

A fit simulates the same recording with many parameter vectors, and a filter takes its sigma points over the same step.
Four of them run side by side, with AVX-512 eight (:mod:`pam_antagonist.model.lane_values`), by the same equations
(:mod:`pam_antagonist.model.lane_form`). Each has the same bits as alone, so results do not depend on the machine.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numba.core import types

from pam_antagonist._jit import by_types
from pam_antagonist.model import composition, integration, lane_form
from pam_antagonist.model import parameters as par
from pam_antagonist.model.lane_values import CHUNK, FEWEST, LANES


def driver() -> Any:
    """The driver of several models, compiled; None where an effect of another package has no lane form."""
    together = _side_by_side()
    return None if together is None else together.drive


def beside(vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Parameters of several models that run side by side (P, LANES). All take the branches that any of them needs.

    `vectors`: parameter vector (P,) of each.
    """
    p = np.stack(vectors, axis=1)
    p[par.PLAIN], p[par.STATELESS_EFFECTS] = p[par.PLAIN].min(), p[par.STATELESS_EFFECTS].max()
    return p


def step(plain: bool) -> Any:
    """The Runge-Kutta step of several models, compiled; None where single steps are faster or lanes cannot be compiled.

    `plain`: whether all models are known to be plain: much less is compiled then. Returns
    :func:`~pam_antagonist.model.integration.plain_step` or :func:`~pam_antagonist.model.integration.rk4_step_within`,
    for states (n, LANES), parameters (P, LANES) and scratch (STAGES + 1, n, LANES).
    """
    if FEWEST > LANES:
        return None
    if plain:
        text = composition.remembered("plain_lanes", lambda: lane_form.lane_module((integration.plain_step,)))
        return composition.imported(text, "plain_lanes").plain_step
    together = _side_by_side()
    return None if together is None else together.rk4_step


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


@lru_cache(maxsize=1)
def _side_by_side() -> Any:
    """Module of the compiled driver of several models; None where an effect of another package has no lane form."""
    try:
        return importlib.import_module("pam_antagonist.model.lane_drive")
    except lane_form.NoLaneForm:
        return None


def scratch(n: int, inputs: int) -> tuple[np.ndarray, ...]:
    """Scratch of the driver: for a step, for the state, for the input, for states and torques of the last rows."""
    stages, recent = np.empty((integration.STAGES + 1, n, LANES)), np.empty((CHUNK, n, LANES))
    return stages, np.empty((n, LANES)), np.zeros(inputs), recent, np.zeros((CHUNK, 2, LANES))


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
    together = step(plain)
    if together is None:
        return _one_by_one(integration.plain_step if plain else integration.rk4_step_within)
    return _in_groups(together)


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
            step(states, u, work.lane_sets[group], dt, states, work.lane_stages)
            for lane in range(count):
                for i in range(points.shape[1]):
                    points[first + lane, i] = states[i, lane]

    return advance
