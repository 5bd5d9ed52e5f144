"""A joint that pressure regulators drive, in many short recordings: its measured pressures are the input.

The pressures drive the joint's mechanics, and the simulated angle is compared with the measured one over each episode.
The free directions are those base parameters that pressures and angle alone can determine. Torques are determined only
relative to the inertia, which is fixed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.episodes import EpisodeModel, Episodes, noise_of
from pam_antagonist.inference.free_parameters import Candidate, FreeDirection
from pam_antagonist.inference.law_candidates import LawCandidate, law_candidates, laws_in
from pam_antagonist.inference.law_responses import Responses
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import converter_step, white_std
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import Inputs
from pam_antagonist.model.effects import CATALOGUE, Form
from pam_antagonist.rig.learned import value_path

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
    def directions(self) -> tuple[FreeDirection, ...]:
        rig, middle = self.rig, self.rig.geometry.length
        forces = []
        for i in (1, 2):
            path = f"muscle_{i}.force."
            area = abs(rig.value(path + "v1") * middle + rig.value(path + "v2"))
            usual = self.usual[i - 1]
            # The force at the usual pressure does not change, so that rest angle and stiffness stay as they are.
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

    @override
    def candidates(self, taken: Mapping[str, float]) -> dict[str, tuple[Candidate, ...]]:
        """Effects that may be added to a model, by their names in a report; the simpler form of each first.

        `taken`: values of the model's effects' parameters, by dotted path.
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
                # No lower bound: constant friction may be negative beside friction that grows with the pressures.
                forms = [replace(form, low={}) for form in effect.sealed.forms if effect.sealed.part]
                out[name] = tuple(Candidate(name, form) for form in forms) or (Candidate(name),)
        return out

    @override
    def laws(self, model: EpisodeModel) -> list[LawCandidate]:
        """Learned laws that may be added to a model."""
        known, signals = {**self._declared, **model.effects}, tuple(self.rig.signals)
        return list(law_candidates(self._responses(model), self._torque, known, signals))

    @override
    def law_slopes(self, model: EpisodeModel, laws: Iterable[LawCandidate]) -> Iterator[Floats]:
        known, seen = np.isfinite(self.angle), self._responses(model)
        for one in laws:
            yield -one.scale * np.where(known[:, None], seen.columns(one.law)[:, one.moved], 0.0)

    @override
    def slopes(self, model: EpisodeModel, left: Floats) -> Floats:
        laws = laws_in(model.effects, tuple(self.rig.signals))
        if not laws:
            return super().slopes(model, left)
        known, seen = np.isfinite(self.angle)[:, None], self._responses(model)
        found = {}
        for number, law in laws.items():
            for k, column in enumerate(seen.columns(law).T, 1):
                found[value_path(number, k)] = column
        others = [item for item in model.free if item.path not in found]
        plain = super().slopes(EpisodeModel(model.theta, model.effects, tuple(others)), left)
        base, effect = np.split(plain, [len(self.directions)], axis=1)
        by_path = dict(zip((item.path for item in others), effect.T, strict=True))
        by_path |= {
            item.path: -item.item.scale * np.where(known[:, 0], found[item.path], 0.0)
            for item in model.free
            if item.path in found
        }
        return np.column_stack([base, *(by_path[item.path] for item in model.free)])

    def _responses(self, model: Point) -> Responses:
        p = self._vector(model)
        laws = laws_in({**self._declared, **model.effects}, tuple(self.rig.signals))
        return Responses(
            self.first, self._start, self.time, self.pressure, self.signals, p, self.longest_step,
            list(self.rig.signals), laws,
        )  # fmt: skip

    def _vector(self, point: Point) -> Floats:
        """Parameter vector of a model."""
        return par.changed(self.rig.parameters(), {**self.values(point), **NO_REGULATORS})

    @cached_property
    def _torque(self) -> float:
        """Typical torque of the pressures' changes [N m]."""
        middle, geometry = self.rig.geometry.length, self.rig.geometry
        areas = [
            self.rig.value(f"muscle_{i}.force.v1") * middle + self.rig.value(f"muscle_{i}.force.v2") for i in (1, 2)
        ]
        return float(geometry.radius * np.linalg.norm(areas * np.std(self.pressure, axis=0)))

    @cached_property
    def _declared(self) -> dict[str, float]:
        return {f"effects.{name}.{key}": at for name, values in self.rig.effects.items() for key, at in values.items()}

    @cached_property
    def _start(self) -> Floats:
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

    @override
    def simulated_each(self, points: Sequence[Point]) -> list[Floats]:
        vectors, (angle, speed) = [self._vector(point) for point in points], self._start.T
        along = Inputs.at(self.time, self.longest_step, self.first, pressure=self.pressure, signals=self.signals)
        starts = [along.settled(angle, self.pressure[self.first[:-1]], p, speed) for p in vectors]
        return [states[:, :1] for states, _ in along.driven_each(starts, vectors)]

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
