"""Many short recordings of a joint that pressure regulators drive, each simulated from its own start.

Each input of the model has its class: measured pressures
(:class:`~pam_antagonist.inference.pressure_driven.PressureDriven`) or commands
(:class:`~pam_antagonist.inference.command_driven.CommandDriven`). Fits, sums by episode and their bootstrap are here.
An episode counts as one independent value, whatever its length.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.bootstrap import Interval, steps
from pam_antagonist.inference.driven import Driven
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.gauss_newton import effect_jacobian
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import converter_step
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.inference.weak_features import beside_signals, coefficients
from pam_antagonist.model.effects.base import SIGNALS
from pam_antagonist.recording import Recording, bag_name
from pam_antagonist.recording.csv_import import LEAST_ROWS
from pam_antagonist.recording.rows import resets
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
E = TypeVar("E", bound="Episodes")

LEAST_EPISODES = 20
"""Least number of episodes for a fit and a test of its result."""
STEPS = (4e-3, 2e-3, 1e-3)
"""[s] Longest steps of the integration. On 2,416 episodes of a real arm, a model has an error of 3°, and steps of 1 ms
change it by 0.002°. With an error of 0.05°, friction in steps of 4 ms causes 15 to 50 % of its square."""
_ACCURATE = 0.2
"""Steps are accurate enough if they change the simulation by less than this share of a model's error (RMS)."""
_ROUNDING = 1.0
"""[Pa] Largest difference of a logged "measured" pressure that is only a copy of the command."""
ROUNDS = 20
"""Most simulations with derivatives of a fit."""
_CONVERGED = 1e-4
"""Relative change of the squared error, or of the parameters, at which a fit ends."""


@dataclass(frozen=True, eq=False)
class EpisodeModel(Point):
    """A point in the space of models, with the parameters of its effects that a fit moves."""

    free: tuple[Unknown, ...] = ()

    def without(self, paths: Sequence[str]) -> EpisodeModel:
        """The model without some of its effects' parameters."""
        free = tuple(item for item in self.free if not set(item.paths) & set(paths))
        return EpisodeModel(self.theta, {k: v for k, v in self.effects.items() if k not in paths}, free)


class Squares(NamedTuple):
    """Squared errors by episode."""

    sums: Floats  # of each episode (E,), in the square of the unit
    counts: Floats  # number of values of each episode (E,)

    @property
    def rmse(self) -> float:
        """Root mean square error over all episodes together."""
        return float(np.sqrt(self.sums.sum() / self.counts.sum()))


@dataclass(frozen=True, eq=False)
class Episodes(Driven):
    """Episodes of a joint whose pressures regulators hold."""

    rig: Rig
    name: str
    first: Indices  # index of the first row of each episode, then the number of rows (E + 1,)
    time: Floats  # of the rows (N,) [s]
    angle: Floats  # measured (N,) [rad], NaN where missing
    pressure: Floats  # measured (N, 2) [Pa]
    signals: Floats  # further signals (N, S) [SI], in the order of ``rig.signals``, minus their values there
    command: Floats  # commanded pressures over the step that ends at each row (N, 2) [Pa], NaN where unknown
    jobs: int = 1
    left_out: int = 0  # number of episodes that are too short, or lack pressures, signals or the first angle
    # mean pressure of each muscle [Pa], at which the free directions of the force map leave the force unchanged; the
    # same for all parts of a recording.
    usual: tuple[float, float] = (0.0, 0.0)
    longest_step: float = STEPS[0]  # longest step of the integration [s]

    @classmethod
    def of(cls: type[E], recording: Recording, rig: Rig, also: Sequence[str] = (), jobs: int = 1) -> E:
        """Prepare a recording. `also`: names of further signals, beside those of the rig file."""
        name = bag_name(recording.path)
        if rig.drive != "regulator":
            raise BadInput(f"rig {rig.name} has valves (drive: valve); expected drive: regulator")
        if recording.angle is None:
            raise BadInput(f"{name}: no measured angle; expected measured/joint_states")
        names = list(dict.fromkeys([*rig.signals, *also]))
        if len(names) > SIGNALS:
            raise BadInput(f"{len(names)} further signals ({', '.join(names)}): expected at most {SIGNALS}")
        for signal in names:
            if signal not in recording.signals:
                known = ", ".join(recording.signals) or "none was recorded"
                raise BadInput(f"{name}: no signal {signal!r}; expected one of: {known}")
        _refuse_commands(recording, name)
        columns = [recording.signals[signal].values for signal in names]
        signals = np.column_stack(columns) if columns else np.empty((len(recording), 0))
        parts = whole_episodes(recording, names)
        if recording.episode_ns is None and (jumped := resets(recording)) is not None:
            raise BadInput(f"{name}: {jumped.sentence}")
        if len(parts) < LEAST_EPISODES:
            raise BadInput(
                f"{name}: {len(parts)} whole episodes of {len(recording.episodes)}; expected at least {LEAST_EPISODES} "
                f"with {LEAST_ROWS} rows, and pressures, angle and every signal throughout (import_csv: episode)"
            )
        means = {
            signal: rig.signals.get(signal, float(np.nanmean(c))) for signal, c in zip(names, columns, strict=True)
        }
        signals = signals - np.array(list(means.values()))
        command = recording.voltage if recording.drive == "regulator" else np.full((len(recording), 2), np.nan)
        made = cls(
            rig.replaced(signals=means), name, np.array([*(p.start for p in recording.episodes), len(recording)]),
            recording.time_s, recording.angle, recording.pressure, signals, command, jobs,
            len(recording.episodes) - len(parts),
            (float(np.nanmean(recording.pressure[:, 0])), float(np.nanmean(recording.pressure[:, 1]))),
        )  # fmt: skip
        kept = {part.start for part in parts}
        made = made.take(np.flatnonzero([part.start in kept for part in recording.episodes]))
        if made.rig.weak_laws is None:
            return made
        driven = coefficients(made.rig, made.pressure, made.signals, made.first, made.time)
        return replace(made, signals=beside_signals(made.signals, driven))

    def __len__(self) -> int:
        return len(self.first) - 1

    def take(self: E, episodes: Indices) -> E:
        """Some of the episodes. `episodes`: their numbers (K,), in order."""
        spans = [np.arange(self.first[e], self.first[e + 1]) for e in episodes]
        rows = np.concatenate(spans) if spans else np.empty(0, np.intp)
        first = np.concatenate([[0], np.cumsum([len(span) for span in spans])]).astype(np.intp)
        return replace(
            self, first=first, time=self.time[rows], angle=self.angle[rows], pressure=self.pressure[rows],
            signals=self.signals[rows], command=self.command[rows],
        )  # fmt: skip

    def followed_by(self: E, other: E) -> E:
        """These episodes, and then those of another recording."""
        names = ("time", "angle", "pressure", "signals", "command")
        time, angle, *columns = (np.concatenate([getattr(self, name), getattr(other, name)]) for name in names)
        pressure, signals, command = columns
        first = np.concatenate([self.first, self.first[-1] + other.first[1:]])
        return replace(
            self, first=first, time=time, angle=angle, pressure=pressure, signals=signals, command=command
        )  # fmt: skip

    @classmethod
    def like(cls: type[E], other: Episodes) -> E:
        """The same episodes, driven in this way."""
        return cls(**{item.name: getattr(other, item.name) for item in fields(other)})

    # Each subclass defines these.

    @property
    @abstractmethod
    def measured(self) -> Floats:
        """Compared measurements (N, C), NaN where missing."""

    @abstractmethod
    def simulated_each(self, points: Sequence[Point]) -> list[Floats]:
        """Simulated readings of the sensors (N, C), of several models."""

    @abstractmethod
    def candidates(self, taken: Mapping[str, float]) -> Mapping[str, tuple[Candidate, ...]]:
        """Effects that may be added to a model, by their names in a report; the simpler form of each first.

        `taken`: values of the model's effects' parameters, by dotted path.
        """

    @abstractmethod
    def as_if(self: E, model: Point) -> E:
        """These episodes as simulated by a model, with the noise of the readings added."""

    @abstractmethod
    def shown(self, model: Point) -> dict[str, float]:
        """Values of a model for a report, by dotted path; without coefficients that only change together."""

    @property
    @abstractmethod
    def runaway(self) -> float:
        """Bound of the residual, in its unit."""

    @property
    def share_of_steps(self) -> float:
        """Steps of effects' parameters for derivatives, as a share of the usual steps."""
        return 1.0

    # The rest is common to all subclasses.

    @property
    def as_configured(self) -> EpisodeModel:
        """The model of the rig file."""
        return EpisodeModel(self.origin.theta)

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First row of each episode, and the row after its last (E,)."""
        return list(zip(self.first[:-1].tolist(), self.first[1:].tolist(), strict=True))

    def values(self, model: Point) -> dict[str, float]:
        """Values of all parameters of a model that differ from the rig file's, by dotted path."""
        return {**self.changes(model), **model.effects}

    def simulated(self, point: Point) -> Floats:
        """:meth:`simulated_each` of one model."""
        return self.simulated_each([point])[0]

    @override
    def residual(self, point: Point) -> Floats:
        return self.residuals([point])[0]

    @override
    def residuals(self, points: Iterable[Point]) -> list[Floats]:
        return self.in_lanes(lambda group: [self.apart(shown) for shown in self.simulated_each(group)], points)

    def apart(self, shown: Floats) -> Floats:
        """Residual of what a model shows."""
        far = self.runaway
        return np.clip(np.nan_to_num(self.measured - shown, nan=0.0, posinf=far, neginf=-far), -far, far)

    def step_that_serves(self, model: Point) -> float:
        """The longest step [s], not above the present one, that is accurate enough for a model."""
        finest = replace(self, longest_step=STEPS[-1]).residual(model)
        for step in STEPS:
            apart = replace(self, longest_step=step).residual(model) - finest
            if step <= self.longest_step and np.sum(apart**2) <= _ACCURATE**2 * np.sum(finest**2):
                return step
        return STEPS[-1]

    def squares(self, left: Floats) -> Squares:
        """Squared errors by episode, without the first row of each, at which the model starts.

        `left`: a residual (N, C).
        """
        known = np.isfinite(self.measured)
        known[self.first[:-1]] = False
        return Squares(
            np.add.reduceat(np.where(known, left, 0.0) ** 2, self.first[:-1]).sum(axis=1),
            np.add.reduceat(known.astype(float), self.first[:-1]).sum(axis=1),
        )

    def coordinates(self, model: EpisodeModel) -> Floats:
        """Coordinates of the fitted parameters (K + F,)."""
        own = [item.coordinate(model.effects[item.path]) for item in model.free]
        return np.concatenate([model.theta, own])

    def moved(self, model: EpisodeModel, coordinates: Floats) -> EpisodeModel:
        """A model with other coordinates; all other values stay. `coordinates`: (K + F,)."""
        count = len(self.directions)
        values = dict(model.effects)
        # A step along a poorly determined direction may be very long: bounds limit it, and exp must not overflow.
        for item, coordinate in zip(model.free, np.clip(coordinates[count:], -600.0, 600.0), strict=True):
            values.update(dict.fromkeys(item.paths, item.bounded(item.value(float(coordinate)))))
        return EpisodeModel(np.asarray(coordinates[:count]), values, model.free)

    def slopes(self, model: EpisodeModel, left: Floats) -> Floats:
        """Derivatives of the residual by the coordinates (N C, K + F). `left`: residual of this model (N, C)."""
        effect = effect_jacobian(self, model, left, model.free, self.share_of_steps)
        return np.concatenate([self.jacobian(model, left), effect], axis=2).reshape(left.size, -1)

    def fit(self, model: EpisodeModel, rounds: int = ROUNDS) -> EpisodeModel:
        """The model with the least squared error. `rounds`: most simulations with derivatives."""
        each = [*self.directions, *model.free]
        low, high = np.array([(item.coordinate(item.low), item.coordinate(item.high)) for item in each]).T
        found = least_squares(
            lambda z: self.residual(self.moved(model, z)).ravel(),
            np.clip(self.coordinates(model), low + 1e-9, high - 1e-9),
            jac=lambda z: self.slopes(point := self.moved(model, z), self.residual(point)),
            bounds=(low, high), x_scale="jac", ftol=_CONVERGED, xtol=_CONVERGED, max_nfev=rounds,
        )  # fmt: skip
        return self.moved(model, found.x)

    def draws(self, model: EpisodeModel, seed: int = 0) -> dict[str, Floats]:
        """Values of :meth:`shown` in draws of a bootstrap by episode, each by one Gauss-Newton step (D,)."""
        left, channels = self.residual(model), self.measured.shape[1]
        spans = [(channels * begin, channels * end) for begin, end in self.spans]
        at = self.coordinates(model)
        moves = steps(spans, self.slopes(model, left), left.ravel(), seed)
        found = [self.shown(self.moved(model, at + move)) for move in moves]
        return {name: np.array([one[name] for one in found]) for name in found[0]}

    def intervals(self, model: EpisodeModel) -> dict[str, Interval]:
        """Values of :meth:`shown`, with 95 % intervals by episode."""
        best = self.shown(model)
        return {name: Interval.of(best[name], values) for name, values in self.draws(model).items()}


def whole_episodes(recording: Recording, signals: Iterable[str] = ()) -> list[slice]:
    """Rows of the episodes that are long enough and have pressures, such signals and the first angle."""
    known = np.isfinite(np.column_stack([recording.pressure, *(recording.signals[name].values for name in signals)]))
    whole: NDArray[np.bool_] = np.asarray(known.all(axis=1))
    assert recording.angle is not None
    return [
        part for part in recording.episodes
        if part.stop - part.start >= LEAST_ROWS and whole[part].all() and np.isfinite(recording.angle[part.start])
    ]  # fmt: skip


def noise_of(readings: Floats) -> float:
    """Standard deviation of the noise of a signal (N,), from its fourth differences.

    Motion of a joint or a regulator changes these little at rows of 10 ms. The median ignores the differences across
    two episodes.
    """
    differences = np.diff(readings[np.isfinite(readings)], 4)
    spread = float(np.median(np.abs(differences))) / (0.6745 * math.sqrt(70.0)) if len(differences) else 0.0
    return max(spread, converter_step(readings) / math.sqrt(12.0))


def _refuse_commands(recording: Recording, name: str) -> None:
    """Refuse a recording whose measured pressures are a copy of the commands or of another signal."""
    asked = {signal: values for signal, (values, _) in recording.signals.items()}
    if recording.drive == "regulator":
        asked |= {f"the command of regulator {k + 1}": recording.voltage[:, k] for k in (0, 1)}
    for signal, values in asked.items():
        for number in (1, 2):
            apart = np.abs(values - recording.pressure[:, number - 1])
            if np.isfinite(apart).any() and np.nanmax(apart) <= _ROUNDING and np.nanmax(values) > np.nanmin(values):
                raise BadInput(
                    f"{name}: pressure_{number} is {signal}, row by row; expected the measured pressure, not what "
                    "the regulator was asked for"
                )
