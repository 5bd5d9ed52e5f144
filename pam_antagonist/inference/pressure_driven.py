"""A joint that pressure regulators drive, in many short recordings: its measured pressures are the input.

The pressures drive the joint's mechanics, and the simulated angle is compared with the measured one over each episode.
The free directions are those base parameters that pressures and angle alone can determine. Torques are determined only
relative to the inertia, which is fixed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.episodes import Episodes, noise_of
from pam_antagonist.inference.free_parameters import RELATIVE_PRIOR, Candidate, relative
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import converter_step, white_std
from pam_antagonist.inference.unknown import Unknown, change_of
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import Inputs
from pam_antagonist.model.effects import CATALOGUE, Form

Floats = NDArray[np.float64]

_FORCE = 1.0
"""[N] Unit of the force difference between two muscles of one kind."""
_CLEAR = 5.0
"""A start velocity below so many standard deviations of its noise is set to 0."""
NO_REGULATORS = {
    f"effects.{name}.{item.name}": 0.0
    for name, effect in CATALOGUE.items()
    if name.startswith("regulator_")
    for item in effect.parameters
    if item.is_size
}
"""Effects of the regulators are switched off, because the measured pressures already contain them."""


@dataclass(frozen=True, eq=False)
class PressureDriven(Episodes):
    """Episodes whose measured pressures are the input of the model, and whose angle [rad] is compared."""

    @cached_property
    @override
    def directions(self) -> tuple[Unknown, ...]:
        rig, middle = self.rig, self.rig.geometry.length
        forces = []
        for i in (1, 2):
            path = f"muscle_{i}.force."
            area = abs(rig.value(path + "v1") * middle + rig.value(path + "v2"))
            usual = self.usual[i - 1]
            # The force at the usual pressure does not change, so that rest angle and stiffness stay as they are.
            forces.append(change_of(f"{path}v, value", {path + "v2": area, path + "w2": -area * usual}, RELATIVE_PRIOR))
            turned = {path + "v1": area / middle, path + "v2": -area}
            turned |= {path + "w1": -area / middle * usual, path + "w2": area * usual}
            forces.append(change_of(f"{path}v, slope", turned, RELATIVE_PRIOR))
        apart = {"muscle_1.force.w2": _FORCE, "muscle_2.force.w2": -_FORCE}
        return (
            *forces,
            change_of("difference of the muscles' forces", apart, 1.0),
            relative(rig, "joint.stiffness", least=0.1),
            relative(rig, "joint.viscous_friction", least=1e-3),
        )

    @override
    def candidates(self, taken: Mapping[str, float]) -> dict[str, tuple[Candidate, ...]]:
        """Effects that may be added to a model, by their names in a report; the simpler form of each first.

        `taken`: values of the model's effects' parameters, by dotted path.
        """
        out: dict[str, tuple[Candidate, ...]] = {}
        for name, effect in CATALOGUE.items():
            if "regulator" not in effect.tested_with:
                continue
            by_signal = [item for item in effect.parameters if item.signal]
            if by_signal:
                for item, signal in zip(by_signal, self.rig.signals, strict=False):
                    others = tuple(other.name for other in by_signal if other is not item)
                    if f"effects.{name}.{item.name}" not in {**taken, **self._declared}:
                        out[f"{name}: {signal}"] = (Candidate(name, Form(without=others)),)
            elif not any(path.startswith(f"effects.{name}.") for path in {**taken, **self._declared}):
                # No lower bound: constant friction may be negative beside friction that grows with the pressures.
                forms = [replace(form, low={}) for form in effect.sealed.forms if effect.sealed.part]
                out[name] = tuple(Candidate(name, form) for form in forms) or (Candidate(name),)
        return out

    def vector(self, point: Point) -> Floats:
        """Parameter vector of a model."""
        return par.changed(self.rig.parameters(), {**self.values(point), **NO_REGULATORS})

    @cached_property
    def _declared(self) -> dict[str, float]:
        return {f"effects.{name}.{key}": at for name, values in self.rig.effects.items() for key, at in values.items()}

    @cached_property
    def start(self) -> Floats:
        """Angle [rad] and velocity [rad/s] with which each episode begins (E, 2)."""
        begin = self.first[:-1]
        first, second, third = (self.angle[begin + k] for k in (0, 1, 2))
        over = self.time[begin + 2] - self.time[begin]
        # One-sided difference of second order, which is 0 for a joint that starts from rest.
        moved = 4.0 * second - 3.0 * first - third
        # A start velocity that is only noise would move the simulated joint.
        bound = _CLEAR * np.hypot(converter_step(self.angle), 5.0 * white_std(self.angle, float(np.median(over)) / 2.0))
        velocity = np.where(np.abs(moved) > bound, moved / over, 0.0)
        return np.column_stack([self.angle[begin], velocity])

    @property
    @override
    def measured(self) -> Floats:
        return self.angle[:, None]

    @property
    @override
    def runaway(self) -> float:
        return 10.0

    def course(self, point: Point) -> Floats:
        """States of a model (N, n)."""
        return self._courses([point])[0]

    @override
    def simulated_each(self, points: Sequence[Point]) -> list[Floats]:
        return [states[:, :1] for states in self._courses(points)]

    def _courses(self, points: Sequence[Point]) -> list[Floats]:
        vectors, (angle, speed) = [self.vector(point) for point in points], self.start.T
        along = Inputs.at(self.time, self.longest_step, self.first, pressure=self.pressure, signals=self.signals)
        starts = [along.settled(angle, self.pressure[self.first[:-1]], p, speed) for p in vectors]
        return [states for states, _ in along.driven_each(starts, vectors)]

    @override
    def as_if(self, model: Point) -> PressureDriven:
        rng = np.random.default_rng(0)

        def noisier(readings: Floats, shown: Floats) -> Floats:
            return np.asarray(shown + noise_of(readings) * rng.standard_normal(len(shown)))

        pressure = np.column_stack([noisier(column, column) for column in self.pressure.T])
        angle = np.where(np.isfinite(self.angle), noisier(self.angle, self.simulated(model)[:, 0]), np.nan)
        return replace(self, pressure=pressure, angle=angle)

    @override
    def shown(self, model: Point) -> dict[str, float]:
        values = self.values(model)
        out = {name: values[name] for name in ("joint.stiffness", "joint.viscous_friction")}
        middle = self.rig.geometry.length
        for i in (1, 2):
            path = f"muscle_{i}.force."
            out[f"{path}v, at the middle length"] = values[f"{path}v1"] * middle + values[f"{path}v2"]
        codes = [path for path in model.effects if ".learned." in path and "_value" not in path]
        return out | {path: value for path, value in model.effects.items() if path not in codes}
