"""A torque from outside that comes and goes: no law gives it, so it is estimated and judged by its course.

The model of a free joint is made to follow the measured angle by a torque; what that takes, beside the friction that
holds the joint anyway, is what pushes. A law that the model lacks asks for such a torque whenever the joint moves; a
push is there at some times and not at the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.diagnosis.experiment import Experiment, Point
from pam_antagonist.diagnosis.refit import Fitted, beyond, refit
from pam_antagonist.diagnosis.select import removed
from pam_antagonist.diagnosis.simulation import BLOCK, blocks
from pam_antagonist.identification.trial import ANGLE, PRESSURE_1
from pam_antagonist.model import dynamics, rest

Floats = NDArray[np.float64]

_STIFF = 30.0
"""[N m/rad] of the observer: a hundredth of a radian pulls the model with a muscle's torque."""
_DAMPING = 0.1
"""[N m s/rad] of the observer."""
_ROUNDS = 4
_LOOK = 12
"""[blocks] A quarter of a second: shorter than a push by hand."""
_MARGIN = 12
_STANDS_OUT = 3.0
_MOST_ACTIVE = 0.5
"""A torque that is there more than half of the time does not come and go."""
_LEAST_EPISODES = 2
"""What happened once may have been anything."""
_EXPLAINED = 0.75
"""Share of the excess, fitted and held out together, that must go with the pushes, told from the same angle: of either
part alone there may be little, where nothing pushed in it."""
_ALIKE = float(np.deg2rad(0.5))
"""[rad] Angles that are the same for a torque that depends on the angle."""
_APART = 50
"""[blocks] A second from a push is another time."""
_OFTEN = 5
"""[blocks] A torque at an angle is told from so many."""
_RECURRING = 0.5
"""A torque of which the same angle foretells more than this share is a law of the angle, and no push."""
_rk4_step = dynamics.rk4_step


@kernel
def _followed(x0, given, angle, p, dt, stiff, damping):  # type: ignore[no-untyped-def]
    """Torques (N,) [N m] that make the model follow an angle (N,) [rad]."""
    x = x0.copy()
    u = np.zeros(3)
    out = np.empty(len(angle))
    for k in range(len(angle)):
        u[0] = given[k, 0]
        u[1] = given[k, 1]
        u[2] = stiff * (angle[k] - x[0]) - damping * x[1]
        _rk4_step(x, u, p, dt, x)
        out[k] = u[2]
    return out


@dataclass(frozen=True, eq=False)
class Pushes:
    """An explanation by a torque that comes and goes.

    Attributes:
        experiment: the recording with that torque as its input.
        fitted: the base parameters beside it.
        torque: the torque (B,) [N m] in blocks over the whole recording, 0 between the pushes.
        active: share of the time with one.
        recurring: share of its square that the torque at the same angle at other times foretells.
        shares: share of the held-out excess, and of all of it, that goes with it, in hindsight; the latter twice where
            all of it was fitted.
        noise: size of the random walk that it looks like [N m/s^0.5].
    """

    experiment: Experiment
    fitted: Fitted
    torque: Floats
    active: float
    recurring: float
    shares: tuple[float, float]
    noise: float

    @property
    def episodes(self) -> int:
        """How often something pushes."""
        return int(np.sum(np.diff((self.torque != 0.0).astype(int)) == 1)) + int(self.torque[0] != 0.0)

    @property
    def explains(self) -> bool:
        """Whether pushes at some times, and nothing at the others, leave little of the residual."""
        comes_and_goes = self.episodes >= _LEAST_EPISODES and self.active <= _MOST_ACTIVE
        return comes_and_goes and self.recurring <= _RECURRING and self.shares[1] >= _EXPLAINED


def find(experiment: Experiment, fitted: Fitted) -> Pushes | None:
    """Look for pushes in a recording of a free joint; None where the joint was locked or its angle not measured.

    What the observer asks for beyond friction's reach is taken for a push, the base parameters are fitted beside it,
    and both are repeated, since pushes that were taken for the model's error had bent its parameters.

    Args:
        experiment: the recording.
        fitted: its model without pushes.
    """
    trial = experiment.trial
    if trial.joint == "locked" or ANGLE not in experiment.channels:
        return None
    known = np.zeros(len(trial)) if trial.external is None else np.nan_to_num(trial.external)
    # Another recording has pushes of its own; they are not known there.
    experiment = replace(experiment, judged=())
    best, point = None, fitted.point
    for _ in range(_ROUNDS):
        seen = _observed(experiment, point)
        torque = np.where(_episodes(seen), seen, 0.0)
        samples = np.repeat(torque, BLOCK)
        samples = np.concatenate([samples, np.zeros(len(trial) - len(samples))])
        pushed = replace(experiment, trial=replace(trial, external=known + samples))
        point = refit(_between(pushed, torque), point, fitted.unknowns, renewals=2).point
        before = (experiment.held(experiment.residual(fitted.point, whole=True)), fitted.residual)
        after = (pushed.held(pushed.residual(point, whole=True)), pushed.residual(point))
        pairs = [pair for pair in zip(before, after, strict=True) if len(pair[0])]
        over = np.array([[beyond(experiment, part) for part in pair] for pair in pairs])
        shares = removed(*over[0]), removed(over[:, 0], over[:, 1])
        steps = np.diff(torque[::_LOOK])
        noise = float(np.sqrt(np.mean(steps**2) / (_LOOK * BLOCK * trial.dt)))
        if best is None or shares[1] > best[2][1]:
            best = pushed, point, shares, torque, noise, seen
    assert best is not None
    pushed, point, shares, torque, noise, seen = best
    beside = refit(pushed, point, fitted.unknowns, rounds=0)
    active = torque != 0.0
    recurring = _recurring(seen, active, _angle(experiment))
    return Pushes(pushed, beside, torque, float(np.mean(active)), recurring, shares, noise)


def _between(experiment: Experiment, torque: Floats) -> Experiment:
    """The recording with its angle unknown during pushes: where the model was made to follow, it always fits."""
    measured = experiment.trial.measured.copy()
    pushed = np.repeat(torque != 0.0, BLOCK)
    measured[: len(pushed)][pushed, ANGLE] = np.nan
    return replace(experiment, trial=replace(experiment.trial, measured=measured))


def _observed(experiment: Experiment, point: Point) -> Floats:
    """Torque (B,) [N m] that makes the model follow the measured angle."""
    trial = experiment.trial
    angle = _angle(experiment)
    measured = np.interp(np.arange(len(trial)), (np.arange(len(angle)) + 0.5) * BLOCK, angle)
    p = experiment.parameters(point)
    start = experiment.simulated(point)[0]
    x0 = rest.initial_state(measured[0], start[PRESSURE_1], start[PRESSURE_1 + 1], trial.given[0], p)
    return blocks(_followed(x0, trial.given, measured, p, trial.dt, _STIFF, _DAMPING)[:, None])[:, 0]


def _angle(experiment: Experiment) -> Floats:
    """Measured angle (B,) [rad], interpolated where it is missing."""
    angle = experiment.measured[:, experiment.channels.index(ANGLE)]
    known = np.isfinite(angle)
    return np.interp(np.arange(len(angle)), np.flatnonzero(known), angle[known])


def _recurring(seen: Floats, active: NDArray[np.bool_], angle: Floats) -> float:
    """Share of the pushes' squares that the mean torque at the same angle at other times foretells.

    Args:
        seen: torque (B,) [N m] that makes the model follow the measured angle.
        active: when there is a push (B,).
        angle: measured (B,) [rad].
    """
    places = np.rint(angle / _ALIKE).astype(int)
    places -= places.min()

    def sums(part: slice) -> tuple[Floats, Floats]:
        count = places.max() + 1
        torque, times = np.bincount(places[part], seen[part], count), np.bincount(places[part], minlength=count)
        return np.asarray(torque), np.asarray(times, dtype=float)

    total, often = sums(slice(None))
    edges = np.flatnonzero(np.diff(active, prepend=False, append=False))
    left = 0.0
    for begin, end in edges.reshape(-1, 2):
        near, times = sums(slice(max(begin - _APART, 0), end + _APART))
        elsewhere = often - times
        foretold = np.where(elsewhere >= _OFTEN, (total - near) / np.maximum(elsewhere, 1), 0.0)
        left += float(np.sum((seen[begin:end] - foretold[places[begin:end]]) ** 2))
    squares = float(np.sum(seen[active] ** 2))
    return 1.0 - left / squares if squares > 0.0 else 0.0


def _episodes(torque: Floats) -> NDArray[np.bool_]:
    """When there is a push (B,): the torque stands out from its median size, with what is just before and after."""
    smooth = np.convolve(torque, np.ones(_LOOK) / _LOOK, mode="same")
    out = np.abs(smooth) > max(_STANDS_OUT * float(np.median(np.abs(smooth))), 0.1 * float(np.max(np.abs(smooth))))
    return np.convolve(out, np.ones(2 * _MARGIN + 1), mode="same") > 0.0
