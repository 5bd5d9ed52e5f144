"""A joint that pressure regulators drive, in many short recordings: its measured pressures are the input.

The pressures drive the joint's mechanics, and what the model makes of the angle is compared with what was measured,
from the first row of each episode to its last one. Free are the directions of the base parameters that pressures and
angle alone can tell: torque only shows by the inertia that it moves, so that torques are told per inertia.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import (
    Candidate,
    FreeDirection,
    FreeEffectParameter,
    start_values,
    values_along,
)
from pam_antagonist.inference.threads import side_by_side
from pam_antagonist.inference.trial import converter_step, white_std
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, Form
from pam_antagonist.model.effects.base import SIGNALS
from pam_antagonist.model.pressure_driven import angles
from pam_antagonist.recording import Recording, bag_name
from pam_antagonist.recording.resets import resets
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

LEAST_EPISODES = 20
"""Episodes with which something can be fitted, judged and told from chance."""
_STEPS = (4e-3, 2e-3, 1e-3)
"""[s] Longest steps of the integration. On 2,416 episodes of a real arm, of which a model leaves 3°, steps of 1 ms
change the error by 0.002°. Where a model leaves 0.05°, friction in steps of 4 ms makes a sixth to a half of its square."""
_SERVES = 0.2
"""Steps serve that change the angle by no more than this share of what a model leaves (RMS)."""
_FORCE = 1.0
"""[N] By so much the forces of two muscles of one make may differ."""
_STEP = 2e-3
_CLEAR = 5.0
"""Standard deviations of its noise from which on a velocity at an episode's start counts."""
_NO_REGULATORS = {
    f"effects.{name}.{item.name}": 0.0
    for name, effect in CATALOGUE.items()
    if name.startswith("regulator_")
    for item in effect.parameters
    if item.is_size
}
"""The pressures are measured: what the regulators make of their commands is in them."""
_ROUNDING = 1.0
"""[Pa] By so much a measured pressure may differ from a command that was logged in its place."""
_RUNAWAY = 10.0
"""[rad] Beyond it a model is wrong, however far it runs."""
_ROUNDS = 20
_ENOUGH = 1e-4
"""Relative change of the squared error, and of the parameters, that ends a fit."""


@dataclass(frozen=True, eq=False)
class PressureModel:
    """A model of such a joint.

    Attributes:
        amounts: of the free base directions (K,).
        free: effects' parameters that were fitted.
        effects: values of the effects' parameters, by dotted path.
    """

    amounts: Floats
    free: tuple[FreeEffectParameter, ...] = ()
    effects: Mapping[str, float] = field(default_factory=dict)

    def without(self, paths: Sequence[str]) -> PressureModel:
        """The model without some of its effects' parameters.

        Args:
            paths: of the parameters.
        """
        free = tuple(item for item in self.free if not set(item.paths) & set(paths))
        return PressureModel(self.amounts, free, {k: v for k, v in self.effects.items() if k not in paths})


class Squares(NamedTuple):
    """Squared errors of the angle by episode.

    Attributes:
        sums: of each episode (E,) [rad²].
        counts: how many values each has (E,).
    """

    sums: Floats
    counts: Floats

    @property
    def rmse(self) -> float:
        """Root mean square error over all episodes together [rad]."""
        return float(np.sqrt(self.sums.sum() / self.counts.sum()))


@dataclass(frozen=True, eq=False)
class PressureDriven:
    """Episodes of a joint whose measured pressures are the input of the model.

    Attributes:
        rig: as configured, with the further signals that may count.
        name: of the recording.
        first: index of the first row of each episode, and behind the last one (E + 1,).
        time: of the rows (N,) [s].
        angle: measured (N,) [rad], NaN where missing.
        pressure: measured (N, 2) [Pa].
        signals: further ones (N, S) [SI], in the order of ``rig.signals``, less their values there.
        command: what the regulators were asked for over the step that ends at each row (N, 2) [Pa], NaN where that is
            not known.
        jobs: threads.
        left_out: episodes that lack pressures, signals or the first angle.
        usual: pressure of each muscle [Pa] about which the directions turn; the same for all parts of a recording.
        longest_step: a model takes no longer steps than this [s].
    """

    rig: Rig
    name: str
    first: Indices
    time: Floats
    angle: Floats
    pressure: Floats
    signals: Floats
    command: Floats
    jobs: int = 1
    left_out: int = 0
    usual: tuple[float, float] = (0.0, 0.0)
    longest_step: float = _STEPS[0]

    @classmethod
    def of(cls, recording: Recording, rig: Rig, also: Sequence[str] = (), jobs: int = 1) -> PressureDriven:
        """Make a recording ready.

        Args:
            recording: with measured angle and episodes.
            rig: whose pressures regulators hold.
            also: names of further signals that are offered, beside those of the rig file.
            jobs: threads.

        Raises:
            BadInput: a rig with valves, no angle, a signal that was not recorded, or too few episodes.
        """
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
        whole: NDArray[np.bool_] = np.asarray(np.isfinite(np.column_stack([recording.pressure, signals])).all(axis=1))
        parts = [part for part in recording.episodes if whole[part].all() and np.isfinite(recording.angle[part.start])]
        if recording.episode_ns is None and (jumped := resets(recording)) is not None:
            raise BadInput(f"{name}: {jumped.sentence}")
        if len(parts) < LEAST_EPISODES:
            raise BadInput(
                f"{name}: {len(parts)} whole episodes of {len(recording.episodes)}; expected at least {LEAST_EPISODES} "
                "with pressures, angle and every signal throughout (import_csv: episode)"
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
        return made.take(np.flatnonzero([part.start in kept for part in recording.episodes]))

    def __len__(self) -> int:
        return len(self.first) - 1

    def take(self, episodes: Indices) -> PressureDriven:
        """Some of the episodes.

        Args:
            episodes: their numbers (K,), in order.
        """
        spans = [np.arange(self.first[e], self.first[e + 1]) for e in episodes]
        rows = np.concatenate(spans) if spans else np.empty(0, np.intp)
        first = np.concatenate([[0], np.cumsum([len(span) for span in spans])]).astype(np.intp)
        return replace(
            self, first=first, time=self.time[rows], angle=self.angle[rows], pressure=self.pressure[rows],
            signals=self.signals[rows], command=self.command[rows],
        )  # fmt: skip

    @cached_property
    def directions(self) -> tuple[FreeDirection, ...]:
        """Free base directions: what pressures and angle tell of forces, stiffness and viscous friction."""
        rig, middle = self.rig, self.rig.geometry.length
        forces = []
        for i in (1, 2):
            path = f"muscle_{i}.force."
            area = abs(rig.value(path + "v1") * middle + rig.value(path + "v2"))
            usual = self.usual[i - 1]
            # About the usual pressure, so that neither the rest angle nor the stiffness moves with them.
            forces.append(FreeDirection(f"{path}v, value", {path + "v2": area, path + "w2": -area * usual}))
            turned = {path + "v1": area / middle, path + "v2": -area}
            turned |= {path + "w1": -area / middle * usual, path + "w2": area * usual}
            forces.append(FreeDirection(f"{path}v, slope", turned))
        apart = {"muscle_1.force.w2": _FORCE, "muscle_2.force.w2": -_FORCE}
        return (
            *forces,
            FreeDirection("difference of the muscles' forces", apart, 1.0),
            FreeDirection("joint.stiffness", {"joint.stiffness": max(rig.joint.stiffness, 0.1)}),
            FreeDirection("joint.viscous_friction", {"joint.viscous_friction": max(rig.joint.viscous_friction, 1e-3)}),
        )

    @property
    def as_configured(self) -> PressureModel:
        """The model of the rig file."""
        return PressureModel(np.zeros(len(self.directions)))

    def candidates(self, taken: Mapping[str, float]) -> dict[str, tuple[Candidate, ...]]:
        """Effects that may be added to a model, by their names in a report; the simpler form of each first.

        Args:
            taken: values of the model's effects' parameters, by dotted path.
        """
        out: dict[str, tuple[Candidate, ...]] = {}
        for name, effect in CATALOGUE.items():
            if "regulator" not in effect.tested_with:
                continue
            by_signal = [item for item in effect.parameters if item.unit.endswith("/SI")]
            if by_signal:
                for item, signal in zip(by_signal, self.rig.signals, strict=False):
                    others = tuple(other.name for other in by_signal if other is not item)
                    if f"effects.{name}.{item.name}" not in {**taken, **self._declared}:
                        out[f"{name}: {signal}"] = (Candidate(name, Form(without=others)),)
            elif not any(path.startswith(f"effects.{name}.") for path in {**taken, **self._declared}):
                # Constant friction may be less than none where the rest of it grows with pressures from far below.
                forms = [replace(form, low={}) for form in effect.sealed.forms if effect.sealed.part]
                out[name] = tuple(Candidate(name, form) for form in forms) or (Candidate(name),)
        return out

    @cached_property
    def _declared(self) -> dict[str, float]:
        return {f"effects.{name}.{key}": 0.0 for name, values in self.rig.effects.items() for key in values}

    def values(self, model: PressureModel) -> dict[str, float]:
        """Values of all parameters of a model that differ from the rig file's, by dotted path."""
        return {
            **values_along(start_values(self.rig, self.directions), self.directions, model.amounts),
            **model.effects,
        }

    @cached_property
    def _start(self) -> Floats:
        """Angle [rad] and velocity [rad/s] with which each episode begins (E, 2)."""
        begin = self.first[:-1]
        first, second, third = (self.angle[begin + k] for k in (0, 1, 2))
        over = self.time[begin + 2] - self.time[begin]
        # Of second order, so that a joint that starts from rest has none.
        moved = 4.0 * second - 3.0 * first - third
        # A velocity from noise would throw the joint before anything moves it.
        doubt = _CLEAR * np.hypot(converter_step(self.angle), 5.0 * white_std(self.angle, float(np.median(over)) / 2.0))
        velocity = np.where(np.abs(moved) > doubt, moved / over, 0.0)
        return np.column_stack([self.angle[begin], velocity])

    def simulated(self, model: PressureModel) -> Floats:
        """What the encoder would show (N,) [rad]."""
        p = par.changed(self.rig.parameters(), {**self.values(model), **_NO_REGULATORS})
        return np.asarray(angles(self.first, self._start, self.time, self.pressure, self.signals, p, self.longest_step))

    def step_that_serves(self, model: PressureModel) -> float:
        """The longest step [s], no longer than now, that changes the angle by little beside what a model leaves.

        Args:
            model: the model.
        """
        finest = replace(self, longest_step=_STEPS[-1]).residual(model)
        for step in _STEPS:
            apart = replace(self, longest_step=step).residual(model) - finest
            if step <= self.longest_step and apart @ apart <= _SERVES**2 * (finest @ finest):
                return step
        return _STEPS[-1]

    def residual(self, model: PressureModel) -> Floats:
        """Measured minus simulated angle (N,) [rad], 0 where nothing was measured."""
        left = np.nan_to_num(self.angle - self.simulated(model), nan=0.0, posinf=_RUNAWAY, neginf=-_RUNAWAY)
        return np.asarray(np.clip(left, -_RUNAWAY, _RUNAWAY))

    def squares(self, left: Floats) -> Squares:
        """Squared errors by episode; the first row of each, where the model starts, does not count.

        Args:
            left: a residual (N,) [rad].
        """
        known = np.isfinite(self.angle)
        known[self.first[:-1]] = False
        return Squares(
            np.add.reduceat(np.where(known, left, 0.0) ** 2, self.first[:-1]),
            np.add.reduceat(known.astype(float), self.first[:-1]),
        )

    def as_if(self, model: PressureModel) -> PressureDriven:
        """These episodes as if a model were right: what it does, with the noise of the readings once more.

        Args:
            model: the model.
        """
        rng = np.random.default_rng(0)

        def noisier(readings: Floats, shown: Floats) -> Floats:
            return np.asarray(shown + _noise(readings) * rng.standard_normal(len(shown)))

        pressure = np.column_stack([noisier(column, column) for column in self.pressure.T])
        angle = np.where(np.isfinite(self.angle), noisier(self.angle, self.simulated(model)), np.nan)
        return replace(self, pressure=pressure, angle=angle)

    def coordinates(self, model: PressureModel) -> Floats:
        """The numbers that a fit moves (K + F,)."""
        own = [item.coordinate(model.effects[item.path]) for item in model.free]
        return np.concatenate([model.amounts, own])

    def moved(self, model: PressureModel, coordinates: Floats) -> PressureModel:
        """A model with other numbers; further shapes and effects stay.

        Args:
            model: the model.
            coordinates: (K + F,).
        """
        count = len(self.directions)
        values = dict(model.effects)
        # A step along a direction that hardly shows may lead anywhere: the bounds hold it, and exp must not overflow.
        for item, coordinate in zip(model.free, np.clip(coordinates[count:], -600.0, 600.0), strict=True):
            values.update(dict.fromkeys(item.paths, item.bounded(item.value(float(coordinate)))))
        return PressureModel(np.asarray(coordinates[:count]), model.free, values)

    def jacobian(self, model: PressureModel, left: Floats) -> Floats:
        """Derivatives of the residual by the coordinates (N, K + F).

        Args:
            model: where.
            left: residual there (N,).
        """
        at = self.coordinates(model)
        count = len(self.directions)
        steps = np.full(len(at), _STEP)
        steps[count:] = [item.step(model.effects[item.path]) for item in model.free]
        points = [self.moved(model, at + step * row) for step, row in zip(steps, np.eye(len(at)), strict=True)]
        columns = side_by_side(lambda point: self.residual(point) - left, points, self.jobs)
        return np.column_stack(columns) / steps

    def fit(self, model: PressureModel, rounds: int = _ROUNDS) -> PressureModel:
        """The model with the least squared error of the angle.

        Args:
            model: where to start.
            rounds: simulations of the whole, at most.
        """
        count = len(self.directions)
        low = np.full(count + len(model.free), -np.inf)
        high = np.full(len(low), np.inf)
        for k, direction in enumerate(self.directions):
            if direction.name in ("joint.stiffness", "joint.viscous_friction"):
                low[k] = -self.rig.value(direction.name) / direction.changes[direction.name]
        for k, item in enumerate(model.free, count):
            low[k], high[k] = item.coordinate(item.item.low), item.coordinate(item.item.high)
        start = np.clip(self.coordinates(model), low + 1e-9, high - 1e-9)
        found = least_squares(
            lambda z: self.residual(self.moved(model, z)), start,
            jac=lambda z: self.jacobian(point := self.moved(model, z), self.residual(point)),
            bounds=(low, high), x_scale="jac", ftol=_ENOUGH, xtol=_ENOUGH, max_nfev=rounds,
        )  # fmt: skip
        return self.moved(model, found.x)


def _noise(readings: Floats) -> float:
    """Standard deviation of the noise of a signal, from its fourth differences.

    What a joint or a regulator does within rows of 10 ms counts for little in these; half of them may be between two
    episodes.
    """
    differences = np.diff(readings[np.isfinite(readings)], 4)
    spread = float(np.median(np.abs(differences))) / (0.6745 * math.sqrt(70.0)) if len(differences) else 0.0
    return max(spread, converter_step(readings) / math.sqrt(12.0))


def _refuse_commands(recording: Recording, name: str) -> None:
    """Refuse what was asked for in the place of what was measured."""
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
