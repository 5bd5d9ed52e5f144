"""What could be wrong: every effect of the catalogue, on each muscle and on both, with its unknowns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.model.effects import CATALOGUE, Effect, EffectParameter, parameter_path

_SPREAD = 4.0
"""Shapes are tried as in a rig that does not mention them, at their scale, and at so many times more and less."""

UNKNOWN_INPUT = "external_torque"
"""The effect that no deterministic model has: judged by what all others leave (:mod:`pushes`)."""


_TIED = ("hysteresis",)
"""Effects whose share of each muscle does not show: both lengths move as one, and so do their loops."""


@dataclass(frozen=True)
class Candidate:
    """An effect of the catalogue as an explanation; on which muscle is left to its sizes.

    Attributes:
        effect: its name.
    """

    effect: str

    @property
    def catalogued(self) -> Effect:
        """Its entry in the catalogue."""
        return CATALOGUE[self.effect]

    @property
    def free(self) -> tuple[FreeEffectParameter, ...]:
        """Its numbers, sizes first."""
        items = sorted(self.catalogued.parameters, key=lambda item: not item.is_size)
        if self.effect not in _TIED:
            return tuple(FreeEffectParameter((parameter_path(self.effect, item.name),), item) for item in items)
        groups: dict[str, list[EffectParameter]] = {}
        for item in items:
            groups.setdefault(item.name[:-2] if item.muscle else item.name, []).append(item)
        return tuple(
            FreeEffectParameter(tuple(parameter_path(self.effect, item.name) for item in group), group[0])
            for group in groups.values()
        )

    @property
    def sizes(self) -> tuple[FreeEffectParameter, ...]:
        """Those with which it vanishes."""
        return tuple(unknown for unknown in self.free if unknown.item.is_size)

    @property
    def shapes(self) -> tuple[FreeEffectParameter, ...]:
        """Those that say how it acts."""
        return tuple(unknown for unknown in self.free if not unknown.item.is_size)

    def grid(self) -> list[dict[str, float]]:
        """Shapes to try."""
        points: list[dict[str, float]] = [{}]
        for shape in self.shapes:
            values = {shape.bounded(shape.item.scale * factor) for factor in (1.0 / _SPREAD, 1.0, _SPREAD)}
            values.add(shape.item.neutral)
            points = [{**point, shape.path: value} for point in points for value in sorted(values)]
        return points


def candidates(taken: Mapping[str, float]) -> tuple[Candidate, ...]:
    """All candidates beside the effects that a model has already.

    Args:
        taken: values of the effects' parameters of the model, by dotted path.
    """
    present = {path.split(".")[1] for path in taken}
    return tuple(Candidate(name) for name in CATALOGUE if name != UNKNOWN_INPUT and name not in present)
