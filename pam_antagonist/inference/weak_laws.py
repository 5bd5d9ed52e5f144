"""Many weak laws at once: what torque and friction of a joint go with, as sums of all that was measured.

Where no single law is certain, all of them together may be. So none is chosen: every number of a long list is fitted,
each with a prior that keeps it small (:data:`GROUPS`). Level and slopes of torque and friction may also drift over the
recording, along ramps that end at its last episode: a model of what comes next has none. The errors of an episode count
as one.

The model does the rest: the effect ``weak_laws`` acts with coefficients that go with the recording
(:mod:`~pam_antagonist.inference.weak_features`), and one simulation with its derivatives gives those of all numbers.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation.further import FADING, OWN, PLACES, fading
from pam_antagonist.inference.episodes import EpisodeModel, Squares
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.inference.weak_features import LASTING, beside_signals, features, inputs_of
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import Inputs
from pam_antagonist.model.effects.base import COEFFICIENTS
from pam_antagonist.model.effects.weak_laws import EFFECT, FARTHEST
from pam_antagonist.model.linearised import linearised, responses
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import WeakLaws

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

WEAK_LAWS = EFFECT.name
_VELOCITY = 0.5
"""[rad/s] Unit of the velocity."""
_ANGLES = 0.25
"""Unit of the angle, as a share of the range that was seen."""
_QUANTILES = (0.005, 0.995)
RAMPS = 4
"""Drift over the fitted episodes is this many ramps, one behind the other."""
_DRIFT, _DRIFT_OF_DRAG = 0.022, 0.067
"""Prior standard deviations of a ramp, as those of :data:`GROUPS`."""
_TOGETHER = 25
"""Neighbouring episodes that are worked out at once."""
_FEW = 300
"""A fit begins with so many of the episodes."""
_FIRST_ROUNDS, _ROUNDS = 4, 4
_DAMPING, _MORE, _LESS, _TRIES = 1e-3, 6.0, 0.2, 6
"""Levenberg's and Marquardt's damping: the first one, its factors after a step that failed and one that did not, and
the most steps that are tried in a round."""
_ENOUGH = 1.0
"""A step is the last one that gains less, in −2 log posterior."""
_MOVES = np.array([1e-4, 1e-2])
"""Steps of the difference quotients, in the angle [rad] and the velocity [rad/s]."""


@dataclass(frozen=True)
class Group:
    """Numbers of one kind, with the standard deviation of their priors."""

    places: tuple[str, ...]
    of: str  # which features: see :func:`_named`
    # share of the torque that one muscle's range of pressure makes; of ``drag`` of the viscous friction.
    std: float


GROUPS = (
    Group(("torque", "torque*angle"), "products", 0.12),
    Group(("torque", "torque*angle"), "signals", 0.12),
    Group(("torque",), "fading", 0.25),
    Group(("torque*angle",), "lasting", 0.06),
    Group(("torque*angle^2", "torque*angle^3"), "own", 0.12),
    Group(("drag",), "inputs", 0.5),
    Group(("drag*angle", "drag*angle^2"), "constant", 0.5),
    Group(("drag*speed",), "constant", 0.1),
    Group(("friction",), "level and slopes", 0.25),
    Group(("friction",), "squares", 0.12),
    Group(("friction",), "fading", 0.12),
    Group(("friction",), "lasting by input", 0.06),
    Group(("friction*angle", "friction*angle^2", "friction*slow"), "level and slopes", 0.12),
    Group(("friction*angle",), "lasting", 0.06),
    Group(("friction*slow*angle", "friction*fast"), "level and slopes", 0.06),
    Group(("friction*fast*angle",), "level and slopes", 0.03),
)
"""All weak laws. Their widths are those of a prototype on the measured arm (docs/evidence/measured.md): what is certain
there was less than half of them, and twice or half as wide changed little."""


@dataclass(frozen=True)
class Term:
    """A number: how much a coefficient goes with a feature."""

    place: int
    feature: str
    std: float  # of its prior, in N m, or N m s/rad of ``drag``
    ramp: int = -1  # of the drift, from the last one back; −1: it acts throughout


def _named(of: str, inputs: Sequence[str]) -> list[str]:
    """Names of the features of a kind."""
    pairs = [f"{a}*{b}" for a, b in itertools.combinations_with_replacement(inputs, 2)]
    lasting = [fading(name, time) for name in inputs for time in LASTING]
    return {
        "constant": ["constant"],
        "inputs": list(inputs),
        "level and slopes": ["constant", *inputs],
        "own": ["constant", *OWN],
        "signals": [name for name in inputs if name not in OWN],
        "squares": pairs,
        "products": [*pairs, *(f"{name}^3" for name in OWN)],
        "fading": [fading(name, time) for name in inputs for time in FADING],
        "lasting": lasting,
        "lasting by input": [f"{late}*{name}" for late in lasting for name in inputs],
    }[of]


@dataclass(frozen=True, eq=False)
class WeakModel:
    """A model with its numbers."""

    model: EpisodeModel
    numbers: Floats  # (M,), each in the unit of its term
    covariance: Floats  # of the coordinates of the model, then of the numbers in their priors' units (Q, Q)


@dataclass(frozen=True, eq=False)
class WeakFit:
    """Episodes with the weak laws that may explain what their model leaves.

    Attributes:
        joint: all episodes of the recording.
        laws: units of the inputs; its numbers do not count.
        torque: unit of the numbers [N m].
        drag: unit of those of the place ``drag`` [N m s/rad].
        begins: the first episode that is fitted, where the drift begins.
        ends: the one behind the last, where it ends.
    """

    joint: PressureDriven
    laws: WeakLaws
    torque: float
    drag: float
    begins: int
    ends: int

    @classmethod
    def of(cls, joint: PressureDriven, model: EpisodeModel, fitted: Indices) -> WeakFit:
        """Prepare episodes. `model`: without weak laws. `fitted`: episodes that may be fitted."""
        part, rig = joint.take(fitted), joint.rig
        names = (*OWN, *rig.signals)
        columns = np.column_stack([part.pressure, part.signals[:, : len(rig.signals)]])
        low, high = np.quantile(columns, _QUANTILES, axis=0)
        width = np.maximum(high - low, 1e-9 * np.maximum(np.abs(high), 1.0))
        laws = WeakLaws(
            middle=dict(zip(names, columns.mean(axis=0).tolist(), strict=True)),
            range=dict(zip(names, width.tolist(), strict=True)), numbers={},
        )  # fmt: skip
        values, length = joint.values(model), rig.geometry.length
        value = {path: values.get(path, rig.value(path)) for k in "12" for path in _areas(int(k))}
        areas = [abs(value[v1] * length + value[v2]) for v1, v2 in map(_areas, (1, 2))]
        angle = _ANGLES * float(np.ptp(np.quantile(part.angle[np.isfinite(part.angle)], _QUANTILES)))
        acting = {"amount": 1.0, "angle": min(max(angle, 1e-3), 10.0), "velocity": _VELOCITY}
        acts = rig.replaced(effects={**rig.effects, WEAK_LAWS: acting}, weak_laws=None)
        torque = rig.geometry.radius * float(np.mean(np.array(areas) * width[:2]))
        drag = abs(values.get("joint.viscous_friction", rig.joint.viscous_friction)) + 1e-3 * torque
        return cls(replace(joint, rig=acts, jobs=1), laws, torque, drag, int(fitted[0]), int(fitted[-1]) + 1)

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """All numbers, those of the drift last."""
        names = list(self.laws.middle)
        out = [
            Term(PLACES.index(place), feature, group.std * (self.drag if place.startswith("drag") else self.torque))
            for group in GROUPS
            for place in group.places
            for feature in _named(group.of, names)
        ]
        for ramp in range(len(self.ramps)):
            drifting = [(place, feature) for place in ("torque", "friction") for feature in ("constant", *names)]
            out += [Term(PLACES.index(place), feature, _DRIFT * self.torque, ramp)
                    for place, feature in (*drifting, ("torque*angle", "constant"))]  # fmt: skip
            out.append(Term(PLACES.index("drag"), "constant", _DRIFT_OF_DRAG * self.drag, ramp))
        return tuple(out)

    @cached_property
    def ramps(self) -> Floats:
        """How far each episode is before the end of each ramp, 0 to 1 (RAMPS, E); all are 0 behind the fitted ones."""
        every = max((self.ends - self.begins) / RAMPS, 1.0)
        ends = self.ends - every * np.arange(RAMPS)[:, None]
        return np.asarray(np.clip((ends - np.arange(len(self.joint))) / every, 0.0, 1.0))

    @cached_property
    def _places(self) -> Indices:
        return np.array([term.place for term in self.terms], dtype=np.intp)

    @cached_property
    def _columns(self) -> tuple[list[tuple[str, int]], Indices]:
        """The features that terms go with, each with its ramp, and of each term which (M,)."""
        every = [(term.feature, term.ramp) for term in self.terms]
        used = list(dict.fromkeys(every))
        return used, np.array([used.index(one) for one in every], dtype=np.intp)

    @cached_property
    def stds(self) -> Floats:
        """Standard deviations of the priors (M,)."""
        return np.array([term.std for term in self.terms])

    def inputs(self, part: PressureDriven) -> dict[str, Floats]:
        """Inputs of the features at the rows of some episodes, by name (N,)."""
        return inputs_of(self.laws, part.pressure, part.signals, list(part.rig.signals))

    def columns(self, part: PressureDriven, episodes: Indices, inputs: Mapping[str, Floats]) -> Floats:
        """What the numbers go with at the rows of some episodes (N, F), from their inputs."""
        known, late = (
            features(inputs, part.first, part.time),
            np.repeat(self.ramps[:, episodes], np.diff(part.first), 1),
        )
        return np.column_stack([
            known[name] if ramp < 0 else late[ramp] * known[name] for name, ramp in self._columns[0]
        ])  # fmt: skip

    def phi(self, seen: Mapping[str, Floats], columns: Floats) -> Floats:
        """How torque and Coulomb torque go with each number (N, M) at angles and velocities."""
        unit = self.joint.rig.effects[WEAK_LAWS]
        s, v = np.clip(seen["angle"] / unit["angle"], -FARTHEST, FARTHEST), seen["velocity"]
        fast = np.abs(v) / unit["velocity"]
        slow, one = np.exp(-fast), np.ones_like(s)
        hats = (one, s, s**2, s**3, -v, -s * v, -(s**2) * v, -np.abs(v) * v,
                one, s, s**2, slow, slow * s, fast, fast * s)  # fmt: skip
        return np.column_stack(hats)[:, self._places] * columns[:, self._columns[1]]

    def part(self, episodes: Indices, numbers: Floats) -> tuple[PressureDriven, Floats]:
        """Some of the episodes as the model with such numbers sees them, and their features (N, F)."""
        part = self.joint.take(episodes)
        columns = self.columns(part, episodes, self.inputs(part))
        table = np.zeros((columns.shape[1], COEFFICIENTS))
        np.add.at(table, (self._columns[1], self._places), numbers)
        return replace(part, signals=beside_signals(part.signals, columns @ table)), columns

    def squares(self, episodes: Indices, found: WeakModel, jobs: int) -> Squares:
        """Squared errors of episodes."""

        def one(some: Indices) -> Squares:
            part, _ = self.part(some, found.numbers)
            return part.squares(part.residual(found.model))

        sums, counts = zip(*side_by_side(one, _groups(episodes, 4 * _TOGETHER), jobs), strict=True)
        return Squares(np.concatenate(sums), np.concatenate(counts))

    def products(self, episodes: Indices, found: WeakModel) -> tuple[Floats, Floats]:
        """Of the residual's derivatives: with each other (Q, Q), and with the residual (Q,)."""
        part, columns = self.part(episodes, found.numbers)
        left = part.residual(found.model)
        base = part.slopes(found.model, left)
        slopes = np.column_stack([base, self.slopes(part, columns, found.model)])
        known = np.isfinite(part.angle)
        known[part.first[:-1]] = False
        slopes = slopes[known]
        return slopes.T @ slopes, slopes.T @ left[known, 0]

    def slopes(self, part: PressureDriven, columns: Floats, model: EpisodeModel) -> Floats:
        """Derivatives of the residual by the numbers in units of their priors (N, M)."""
        p = part.vector(model)
        held = Inputs.at(part.time, part.longest_step, part.first, pressure=part.pressure).vector(p)
        row, seen, passed = linearised(
            part.first, part.start, part.time, part.pressure, part.signals, held, part.longest_step,
            np.array([0, 1]), _MOVES,
        )  # fmt: skip
        length, slides = seen[:, 1], seen[:, 8]
        begin = np.flatnonzero(np.diff(row, prepend=-1) != 0)
        count = np.diff(np.append(begin, len(row)))
        share = ((np.arange(len(row)) - np.repeat(begin, count) + 0.5) / np.repeat(count, count))[:, None]
        between = (1.0 - share) * columns[row - 1] + share * columns[row]
        torques = self.phi({"angle": seen[:, 2], "velocity": seen[:, 3]}, between)
        torques[:, self._places >= PLACES.index("friction")] *= -slides[:, None]
        torques *= (length / p[par.INERTIA])[:, None] * self.stds
        return np.asarray(-responses(part.first, row, passed, np.ascontiguousarray(torques), len(part.time)))

    def fitted(self, start: EpisodeModel, episodes: Indices, jobs: int, progress: Callable[[str], None]) -> WeakModel:
        """The most probable numbers, with all others of the model, from some episodes."""
        size = len(self.joint.coordinates(start))
        found = WeakModel(start, np.zeros(len(self.terms)), np.zeros((size + len(self.terms),) * 2))
        some = episodes[:: max(len(episodes) // _FEW, 1)]
        for part, rounds in ((some, _FIRST_ROUNDS), (episodes, _ROUNDS)):
            for number, one in enumerate(self._rounds(found, part, rounds, jobs), 1):
                progress(f"weak laws of {len(part)} episodes, round {number} of at most {rounds}")
                found = one
        return found

    def _rounds(self, found: WeakModel, episodes: Indices, rounds: int, jobs: int) -> Iterator[WeakModel]:
        """Steps of Levenberg and Marquardt."""
        size, damping = len(self.joint.coordinates(found.model)), _DAMPING
        prior = np.concatenate([np.zeros(size), np.ones(len(self.terms))])
        squares = self.squares(episodes, found, jobs)
        for _ in range(rounds):
            # An episode's errors count as one, of the size that all have now.
            unit = squares.sums.sum() / len(episodes)
            each = side_by_side(partial(self.products, found=found), _groups(episodes), jobs)
            gram = sum(one for one, _ in each) / unit + np.diag(prior)
            now = np.concatenate([np.zeros(size), found.numbers / self.stds])
            pull = sum(one for _, one in each) / unit + prior * now
            cost, covariance = squares.sums.sum() / unit + float(now @ now), np.linalg.pinv(gram, hermitian=True)
            for _ in range(_TRIES):
                step = np.linalg.solve(gram + damping * np.diag(np.diag(gram) + 1e-12), -pull)
                moved = self._moved(found, step, covariance)
                after = self.squares(episodes, moved, jobs)
                weighed = moved.numbers / self.stds
                gained = cost - after.sums.sum() / unit - float(weighed @ weighed)
                if gained > 0.0:
                    break
                damping *= _MORE
            else:
                return
            damping *= _LESS
            found, squares = moved, after
            yield found
            if gained < _ENOUGH:
                return

    def _moved(self, found: WeakModel, step: Floats, covariance: Floats) -> WeakModel:
        at = self.joint.coordinates(found.model)
        model = self.joint.moved(found.model, at + step[: len(at)])
        return WeakModel(model, found.numbers + step[len(at) :] * self.stds, covariance)

    def in_rig(self, rig: Rig, found: WeakModel) -> Rig:
        """A rig with the weak laws as they are at the end of the fitted episodes: without drift."""
        numbers: dict[str, dict[str, float]] = {}
        for term, value in zip(self.terms, found.numbers, strict=True):
            if term.ramp < 0:
                numbers.setdefault(PLACES[term.place], {})[term.feature] = float(value)
        acting = self.joint.rig.effects[WEAK_LAWS]
        return rig.replaced(
            effects={**rig.effects, WEAK_LAWS: dict(acting)}, weak_laws=self.laws.replaced(numbers=numbers)
        )


def _areas(muscle: int) -> tuple[str, str]:
    return f"muscle_{muscle}.force.v1", f"muscle_{muscle}.force.v2"


def _groups(episodes: Indices, size: int = _TOGETHER) -> list[Indices]:
    return [episodes[k : k + size] for k in range(0, len(episodes), size)]
