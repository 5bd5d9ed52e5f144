"""A number that a fit may find: what it moves, where it begins, its prior and its bounds.

A fit moves the number's coordinate, which is 0 at the start. A positive number is unknown by its logarithm, so that no
fit makes it negative. All fits have the same numbers: parameters of a rig, combinations of parameters that a recording
can separate, sizes and shapes of effects, zeros and clocks of sensors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pam_antagonist.model.effects import EffectParameter
from pam_antagonist.rig import Rig

WIDEST = 5.0
"""A fit moves a number by at most so many units; an unknown may have its own reach."""


@dataclass(frozen=True)
class Unknown:
    """A number that a fit may find."""

    name: str  # what it is; a dotted path where it is a single parameter
    paths: tuple[str, ...] = ()  # dotted paths of the parameters that have its value
    start: float = 0.0
    std: float = math.inf  # of the prior; of the logarithm where ``positive``; inf: it has none
    positive: bool = False  # whether it stays above 0
    low: float = -math.inf
    high: float = math.inf
    # parameters to which it adds: factor of this one in each, by dotted path.
    adds: Mapping[str, float] = field(default_factory=dict, hash=False)
    recording: str = ""  # the only one that it belongs to; empty: to all
    reach: float = WIDEST  # how far a fit may move its coordinate
    may_vanish: bool = False  # whether its least value is none at all, such as of a friction
    # change of the value (of its logarithm where ``positive``) by a coordinate of 1; 0: the prior's standard deviation.
    unit: float = 0.0
    shown_in: str = "in SI units"  # unit of a change in words; "%" for one that is relative
    free_only: bool = False  # whether nothing of a joint that is locked at angle 0 depends on it
    catalogued: EffectParameter | None = field(default=None, repr=False)  # the parameter of an effect or calibration

    @property
    def path(self) -> str:
        """Dotted path of the first parameter."""
        return self.paths[0]

    @property
    def item(self) -> EffectParameter:
        """The catalogue's entry of an effect's parameter."""
        assert self.catalogued is not None, self.name
        return self.catalogued

    @property
    def muscle(self) -> int | None:
        """Muscle of an effect's parameter; None if it does not belong to a single muscle."""
        return self.item.muscle if len(self.paths) == 1 else None

    @property
    def scale(self) -> float:
        """Change of the value (of its logarithm where it is positive) by a coordinate of 1."""
        return self.unit or self.std

    @property
    def prior(self) -> float:
        """Standard deviation of the prior, of the coordinate."""
        return self.std / self.scale

    @property
    def prior_std(self) -> float:
        """Standard deviation of the prior, in the unknown's unit."""
        return self.std * self.start if self.positive else self.std

    def value(self, coordinate: float) -> float:
        """Value at a coordinate."""
        if self.positive:
            return self.start * math.exp(self.scale * coordinate)
        return self.start + self.scale * coordinate

    def coordinate(self, value: float) -> float:
        """The inverse of :meth:`value`."""
        return (math.log(value / self.start) if self.positive else value - self.start) / self.scale

    def slope(self, value: float) -> float:
        """Derivative of the value by its coordinate."""
        return self.scale * value if self.positive else self.scale

    def bounded(self, value: float) -> float:
        """The nearest value within the bounds."""
        return min(max(value, self.low), self.high)

    def step(self, value: float) -> float:
        """Step of a difference quotient at a value, in coordinates; sizes that cannot shrink step upwards."""
        if self.positive:
            return -0.1 if value * 1.1 > self.high else 0.1
        return 0.1 * max(1.0, abs(value / self.scale))

    def is_none(self, coordinate: float) -> bool:
        """Whether a bound that was met at a coordinate means that there is none of it."""
        return self.may_vanish and coordinate < 0.0

    def in_words(self, coordinate: float) -> str:
        """A coordinate as a change of the value, with its unit or in per cent."""
        if self.positive:
            return f"{100.0 * (self.value(coordinate) / self.start - 1.0):+.0f} %"
        change = self.scale * coordinate
        return f"{100 * change:+.0f} %" if self.shown_in == "%" else f"{change:+.2g} {self.shown_in}"

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and largest coordinate."""
        low = -self.reach if self.positive and self.low <= 0.0 else max(-self.reach, self._limited(self.low))
        return min(low, 0.0), max(min(self.reach, self._limited(self.high)), 0.0)

    def _limited(self, value: float) -> float:
        return self.coordinate(value) if math.isfinite(value) else math.copysign(self.reach, value)


def change_of(name: str, adds: Mapping[str, float], std: float = math.inf) -> Unknown:
    """A change of parameters that move together. `adds`: change of each for a coordinate of 1, by dotted path."""
    return Unknown(name, (), 0.0, std, adds=adds, reach=math.inf, unit=1.0, shown_in="%")


def of_effect(paths: tuple[str, ...], item: EffectParameter) -> Unknown:
    """A parameter of an effect or calibration, without a prior: sizes in units of their scale, shapes by logarithm.

    `paths`: of the parameters with this value: several if only their sum is observable.
    """
    start, unit = (0.0, item.scale) if item.is_size else (1.0, 1.0)
    return Unknown(
        paths[0], paths, start, positive=not item.is_size, low=item.low, high=item.high, unit=unit, catalogued=item
    )


def parameters(
    unknowns: Sequence[Unknown],
    values: Mapping[str, float],
    recording: str = "",
    start: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """Value of each parameter, by dotted path.

    `values`: of the unknowns, by name. `start`: of parameters to which unknowns only add; default: 0.
    """
    begin = start or {}
    out = {path: values[item.name] for item in unknowns for path in item.paths}
    for item in unknowns:
        if item.recording in ("", recording):
            for path, factor in item.adds.items():
                out[path] = out.get(path, begin.get(path, 0.0)) + factor * values[item.name]
    return out


def start_values(rig: Rig, unknowns: Sequence[Unknown]) -> dict[str, float]:
    """A rig's values of the parameters to which unknowns add, by dotted path."""
    return {name: rig.value(name) for item in unknowns for name in item.adds}
