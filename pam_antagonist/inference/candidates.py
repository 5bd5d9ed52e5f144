"""What could be wrong: every effect of the catalogue, on each muscle and on both, with its free parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pam_antagonist.inference.free_parameters import FreeEffectParameter
from pam_antagonist.model.effects import CATALOGUE, Effect, EffectParameter, Form, parameter_path

_SPREAD = 4.0
"""Shapes are tried as in a rig that does not mention them, at their scale, and at so many times more and less."""


@dataclass(frozen=True)
class Candidate:
    """An effect of the catalogue as an explanation; on which muscle is left to its sizes.

    Attributes:
        effect: its name.
        form: the numbers that are free; None for those of the catalogue.
    """

    effect: str
    form: Form | None = None

    @property
    def catalogued(self) -> Effect:
        """Its entry in the catalogue."""
        return CATALOGUE[self.effect]

    @property
    def _form(self) -> Form:
        return self.catalogued.form if self.form is None else self.form

    @property
    def free(self) -> tuple[FreeEffectParameter, ...]:
        """Its numbers, sizes first."""
        form = self._form
        items = [item for item in self.catalogued.parameters if item.name not in form.without]
        groups: dict[str, list[EffectParameter]] = {}
        for item in sorted(items, key=lambda item: not item.is_size):
            groups.setdefault(item.family if form.tied else item.name, []).append(item)
        return tuple(
            FreeEffectParameter(
                tuple(parameter_path(self.effect, item.name) for item in group), _as_formed(group[0], form)
            )
            for group in groups.values()
        )

    @property
    def sizes(self) -> tuple[FreeEffectParameter, ...]:
        """Those with which it vanishes."""
        return tuple(parameter for parameter in self.free if parameter.item.is_size)

    @property
    def shapes(self) -> tuple[FreeEffectParameter, ...]:
        """Those that say how it acts."""
        return tuple(parameter for parameter in self.free if not parameter.item.is_size)

    def grid(self) -> list[dict[str, float]]:
        """Shapes to try."""
        if self._form.shapes:
            return [
                {parameter_path(self.effect, name): value for name, value in shapes.items()}
                for shapes in self._form.shapes
            ]
        points: list[dict[str, float]] = [{}]
        for shape in self.shapes:
            values = {shape.bounded(shape.item.scale * factor) for factor in (1.0 / _SPREAD, 1.0, _SPREAD)}
            values.add(shape.item.neutral)
            points = [{**point, shape.path: value} for point in points for value in sorted(values)]
        return points


def _as_formed(item: EffectParameter, form: Form) -> EffectParameter:
    """A number with the scale and the least value that it has in a form."""
    return replace(item, scale=form.scale.get(item.family, item.scale), low=form.low.get(item.family, item.low))


def candidates(taken: Mapping[str, float]) -> tuple[Candidate, ...]:
    """All candidates beside the effects that a model has already.

    Args:
        taken: values of the effects' parameters of the model, by dotted path.
    """
    present = {path.split(".")[1] for path in taken}
    return tuple(Candidate(name) for name, effect in CATALOGUE.items() if effect.deterministic and name not in present)
