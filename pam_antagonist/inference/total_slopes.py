"""How torque and friction of a joint go with what was measured, all of its model together.

Single weak laws may replace each other. What they do together is certain: how the whole torque, and the whole Coulomb
torque, go with each pressure and signal, with the angle and with the velocity, in the mean over what was seen. Each
part of the recording has its own drift.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.further import OWN, PLACES
from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.episodes import EpisodeModel
from pam_antagonist.inference.held_episodes import thinned
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.weak_laws import WeakFit, WeakModel
from pam_antagonist.model import dynamics
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, VELOCITY
from pam_antagonist.model.parameters import SIGNAL

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

PARTS = 3
"""Parts of the recording."""
_EPISODES, _STATES = 60, 200
"""Episodes of each part, and states of them, over which means are taken."""
_STEP = 0.02
"""Step of the differences: of an input in its range, of the angle [rad] and of the velocity [rad/s]."""
_OF_BASE = 1e-3
"""Step along a coordinate of the model without weak laws."""
_IN_95 = 1.96
FRICTION, LEVEL = PLACES.index("friction"), "level"


@dataclass(frozen=True)
class TotalSlope:
    """How one of both torques goes with something."""

    of: str  # ``torque`` or ``friction``
    by: str  # an input, ``angle`` or ``velocity``; ``level`` for the mean itself
    unit: str  # of the values
    parts: tuple[Interval, ...]  # in each part of the recording

    @property
    def agrees(self) -> bool:
        """Whether the intervals of all parts have a value in common."""
        return max(one.low for one in self.parts) <= min(one.high for one in self.parts)


def total_slopes(fit: WeakFit, found: WeakModel, episodes: Indices) -> tuple[TotalSlope, ...]:
    """How torque and friction go with all that was measured, in each third of some episodes."""
    inputs, rig = list(fit.laws.middle), fit.joint.rig
    by = [*inputs, "angle", "velocity", LEVEL]
    thirds = [_slopes(fit, found, part, by) for part in np.array_split(episodes, PARTS)]
    out = []
    for k, (of, name) in enumerate((of, name) for of in ("torque", "friction") for name in by):
        per = "SI" if name in rig.signals else {"angle": "rad", "velocity": "s/rad"}.get(name, "Pa")
        unit = {"s/rad": "N m s/rad"}.get(per, f"N m/{per}") if name != LEVEL else "N m"
        intervals = []
        for value, std in thirds:
            half = _IN_95 * float(std[k])
            intervals.append(Interval(float(value[k]), float(value[k]) - half, float(value[k]) + half))
        out.append(TotalSlope(of, name, unit, tuple(intervals)))
    return tuple(out)


def _slopes(fit: WeakFit, found: WeakModel, episodes: Indices, by: list[str]) -> tuple[Floats, Floats]:
    """Mean slopes (2 I,) of torque and friction, and their standard deviations."""
    episodes = thinned(episodes, _EPISODES)
    part, _ = fit.part(episodes, found.numbers)
    course = part.course(found.model)
    rows = np.linspace(0, len(course) - 1, min(_STATES, len(course))).astype(np.intp)
    base, by_base = _of_base(fit, found.model, course[rows], part.signals[rows], by)
    weak = _of_numbers(fit, part, episodes, course[rows], rows, by)
    value = base + weak @ found.numbers
    change = np.column_stack([by_base, weak * fit.stds])
    return value, np.sqrt(np.maximum(np.einsum("kq,qr,kr->k", change, found.covariance, change), 0.0))


def _of_numbers(
    fit: WeakFit, part: PressureDriven, episodes: Indices, states: Floats, rows: Indices, by: list[str]
) -> Floats:
    """Mean slopes (2 I, M) that each number makes."""
    known = fit.inputs(part)
    seen = {"angle": states[:, ANGLE], "velocity": states[:, VELOCITY]}

    def phi(name: str, step: float) -> Floats:
        # A lasting change: what fades does not count.
        moved = {**known, name: known[name] + step / fit.laws.range[name]} if name in known else known
        there = {**seen, name: seen[name] + step} if name in seen else seen
        return fit.phi(there, fit.columns(part, episodes, moved)[rows])

    slopes = _means(fit, by, phi)
    friction = np.array([term.place >= FRICTION for term in fit.terms])
    return np.concatenate([np.where(friction, 0.0, slopes), np.where(friction, slopes, 0.0)])


def _of_base(
    fit: WeakFit, model: EpisodeModel, states: Floats, signals: Floats, by: list[str]
) -> tuple[Floats, Floats]:
    """Mean slopes (2 I,) without weak laws, and how they go with the model's coordinates (2 I, K)."""
    joint, at = fit.joint, fit.joint.coordinates(model)
    here = _of_model(fit, joint.vector(model), states, signals, by)
    moves = _OF_BASE * np.eye(len(at))
    there = [_of_model(fit, joint.vector(joint.moved(model, at + move)), states, signals, by) for move in moves]
    return here, np.array([(one - here) / _OF_BASE for one in there]).T.reshape(len(here), len(at))


def _of_model(fit: WeakFit, p: Floats, states: Floats, signals: Floats, by: list[str]) -> Floats:
    names = list(fit.joint.rig.signals)
    columns = {"angle": ANGLE, "velocity": VELOCITY, **{name: PRESSURE_1 + k for k, name in enumerate(OWN)}}

    def torques(name: str, step: float) -> Floats:
        x, s = states.copy(), signals[:, : len(names)].copy()
        if name in columns:
            x[:, columns[name]] += step
        elif name in names:
            s[:, names.index(name)] += step
        return _torques(x, s, p)

    return _means(fit, by, torques).T.ravel()


def _means(fit: WeakFit, by: list[str], of: Callable[[str, float], Floats]) -> Floats:
    """Mean slopes (I, K) of what `of` gives (R, K) where one of some inputs is a step away; for a level its mean."""
    out = []
    for name in by:
        step = _STEP * fit.laws.range.get(name, 1.0)
        change = of(name, 0.0) if name == LEVEL else (of(name, step) - of(name, -step)) / (2.0 * step)
        out.append(np.mean(change, axis=0))
    return np.array(out)


def _torques(states: Floats, signals: Floats, p: Floats) -> Floats:
    """All torques but Coulomb friction, and its level (R, 2) [N m], at states (R, n) and signals (R, S)."""
    out, p = np.empty((len(states), 2)), p.copy()
    for k, (x, seen) in enumerate(zip(states, signals, strict=True)):
        p[SIGNAL : SIGNAL + len(seen)] = seen
        free = dynamics.torque_needed(x, 0.0, 0.0, p)
        out[k] = -free, dynamics.torque_needed(x, 0.0, 1.0, p) - free
    return out
