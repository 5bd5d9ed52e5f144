"""What a rig leaves unknown, with priors and bounds.

A fit of several recordings moves single parameters (:func:`free_parameters`). A fit of one recording moves combinations
that the data can separate (:func:`base_directions`), and the parameters of its effects. An effect that may be added to
a model, with its free parameters, is a :class:`Candidate`.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.inference.expected import expected_sizes
from pam_antagonist.inference.unknown import Unknown, change_of, of_effect
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, Effect, EffectParameter, Form, parameter_path
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import is_positive
from pam_antagonist.rig.schema import limits

Floats = NDArray[np.float64]

RELATIVE_PRIOR = 0.05
"""Standard deviation before identification of a parameter for which the rig file gives none."""
_GAUGE_PRIOR = {"supply.pressure": 0.01}
"""Relative priors of values that a gauge shows: a regulator holds the supply pressure to about a per cent."""
_MEASURED = (
    ("geometry.radius",), ("joint.mass",), ("joint.shaft_radius",), ("joint.stiffness",),
    ("atmosphere.pressure",), ("gas.polytropic_flow",),
    *(tuple(f"muscle_{i}.volume.{name}" for name in ("d1", "d2", "d3")) for i in (1, 2)),
)  # fmt: skip
"""Parameters that no fit moves. The terms of a volume nearly cancel, so its coefficients change together. The length
at angle 0 is not included, because the force map belongs to the declared length."""
_MEASURED_STD = 0.01
"""Relative standard deviation of a value measured with a ruler, a scale or a gauge."""
_FLOW = (
    "valve_1.inflow_area", "valve_1.outflow_area", "valve_2.inflow_area", "valve_2.outflow_area",
    "gas.polytropic_flow", "gas.polytropic_volume", "supply.pressure",
)  # fmt: skip
STOP = "joint.stop"
_STOP_STD = math.radians(1.5)
"""[rad] How well a protractor shows the angle of a stop."""
EYE_STD = math.radians(3.0)
"""[rad] Of an encoder that was set by eye to the middle between two stops; so near them a joint may lean on one."""
_MOTION = ("joint.inertia", "joint.viscous_friction")
"""Coefficients of the paper's force map F = v(l) P + w(l)."""
_FRICTION = {
    "kikuuwe": ("friction.shaft", "friction.muscle"),
    "simple": ("friction.lever_force",),
    "tondu": ("friction.static", "friction.kinetic"),
    "none": (),
}
EFFECT_PARAMETERS = {
    parameter_path(effect.name, item.name): item for effect in CATALOGUE.values() for item in effect.parameters
}
"""Parameters of all effects, by dotted path."""


def free_parameters(rig: Rig, free: Sequence[str] = (), frozen: Sequence[str] = ()) -> list[Unknown]:
    """The parameters of a fit.

    By default these are all parameters that cannot be measured directly (Proposition 1): the force maps, the orifice
    areas, the polytropic indices, the friction, the sizes of the effects that the rig has or expects. The supply
    pressure, which a gauge shows to a per cent, is free as well. Priors and bounds come from the rig file (``priors``,
    ``bounds``). The default prior is 5 % of the value. The bounds are those of a rig file at most, and a factor of five
    either way; a number that may be negative changes by five times its value at most.

    `frozen`: names, or beginnings of names, to be kept at the start value.
    """
    for name in (*free, *frozen):
        if not any(_matches(known, name) for known in par.INDEX):
            close = difflib.get_close_matches(name, par.INDEX, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise BadInput(f"no parameter is called {name!r}: expected a dotted path such as friction.shaft{hint}")
    usual = _by_default(rig)
    chosen = []
    for name in par.INDEX:
        wanted = name in usual or any(_matches(name, word) for word in free)
        if not wanted or name == "friction.time_step" or any(_matches(name, word) for word in frozen):
            continue
        start = rig.value(name)
        std = rig.priors.get(name, _prior(name, start))
        if not (math.isfinite(start) and std > 0.0):
            raise BadInput(
                f"{name} is {start:g} in rig {rig.name}: to free it, give its prior in the rig file (priors)"
            )
        low, high = rig.bounds.get(name, _bounds(name, start))
        low, high = max(low, limits(name)[0]), min(high, limits(name)[1])
        positive = start > 0.0 and is_positive(name)
        chosen.append(Unknown(name, (name,), start, std / start if positive else std, positive, low, high))
    if not chosen:
        raise BadInput("every parameter is frozen: nothing is left to identify")
    return chosen


def sizes_of(rig: Rig) -> list[str]:
    """Sizes of the effects that a rig has, by dotted path."""
    return [name for name, item in EFFECT_PARAMETERS.items() if item.is_size and not item.fixed and rig.value(name)]


def _by_default(rig: Rig) -> set[str]:
    names = {
        f"muscle_{i}.force.{c}"
        for i in (1, 2)
        for c in FORMS[rig.model.force].moves
        if rig.value(f"muscle_{i}.force.{c}")
    }
    names |= set(_FRICTION[rig.model.friction])
    names |= set(_MOTION) | {name for name in _FLOW if not (rig.valves.sealed and name.startswith("valve_"))}
    present = set(sizes_of(rig))
    if rig.drive == "regulator":
        # No air passes a valve of the model. Range, dead zone and largest rate are fitted in a separate step.
        names -= {name for name in _FLOW if name != "gas.polytropic_volume"}
        names |= {"effects.regulator_lag.damping"}
        present -= {name for name in present if name.startswith("effects.regulator_") and name[-1] not in "12"}
    return {name for name in names if rig.value(name)} | present | set(expected_sizes(rig))


def _prior(name: str, start: float) -> float:
    if start == 0.0 and name in EFFECT_PARAMETERS:
        return EFFECT_PARAMETERS[name].scale
    return _relative_prior(name) * abs(start)


def _relative_prior(name: str) -> float:
    return _GAUGE_PRIOR.get(name, RELATIVE_PRIOR)


def _matches(name: str, word: str) -> bool:
    return name == word or name.startswith(word if word.endswith(".") else word + ".")


def _bounds(name: str, start: float) -> tuple[float, float]:
    """Usual bounds of a parameter: those of a rig file, and a factor of five; what may be 0 there may become 0."""
    low, high = limits(name)
    if name in EFFECT_PARAMETERS or start == 0.0:
        return low, high
    if is_positive(name):
        return max(low, start / 5.0 if low > 0.0 else 0.0), min(high, start * 5.0)
    return start - 5.0 * abs(start), start + 5.0 * abs(start)


def stop_std(rig: Rig) -> float:
    """Relative standard deviation of the angle of a rig's stops before a recording shows it."""
    assert rig.joint.stop is not None
    return rig.priors.get(STOP, _STOP_STD) / rig.joint.stop


def off_stop(rig: Rig, margin: float = EYE_STD) -> float:
    """Angle [rad] within which a joint does not lean on its stops. `margin`: [rad]."""
    return math.inf if rig.joint.stop is None else rig.joint.stop - margin


def shows_stop(rig: Rig, angle: Floats) -> bool:
    """Whether angles of a free joint (N,) [rad], NaN where missing, come near its stops."""
    return bool((np.abs(angle) >= off_stop(rig)).any())


def base_directions(rig: Rig, at_stop: bool = False) -> tuple[Unknown, ...]:
    """The directions of a rig; with the angle of its stops where a recording shows it (`at_stop`).

    Parameters that cannot be measured directly (Proposition 1 of Shin et al. 2022) are free. The linear force map
    F = v(l) P + w(l) is moved by its values at the middle length and its slopes, since its terms nearly
    cancel: one per cent of ``v2`` alone is seven per cent of the force. Volume and polytropic index k_1 only scale the
    flows and are represented by the orifice areas.

    `rig`: start values; its ``priors`` replace the 5 % of a direction that is a single parameter.
    """
    flow = [f"valve_{i}.{name}" for i in (1, 2) for name in ("inflow_area", "outflow_area")]
    if rig.drive == "regulator":
        flow = [f"effects.regulator_lag.{name}" for name in ("frequency_1", "frequency_2", "damping")]
    found = [_single(rig, path) for path in flow]
    for i in (1, 2):
        found += _force_map(rig, f"muscle_{i}.force.")
    found.append(_single(rig, "gas.polytropic_volume", free_only=True))
    if rig.drive == "valve":
        found.append(_single(rig, "supply.pressure"))
        sizes = expected_sizes(rig)
        found += [
            replace(change_of(path, {path: 1.0}, rig.priors[path]), shown_in=EFFECT_PARAMETERS[path].unit)
            for path in sizes
        ]
    for path in (*_MOTION, *_FRICTION[rig.model.friction]):
        found.append(_single(rig, path, free_only=True))
    if at_stop:
        found.append(replace(change_of(STOP, {STOP: rig.value(STOP)}, stop_std(rig)), free_only=True))
    return tuple(direction for direction in found if any(direction.adds.values()))


def measured_directions(rig: Rig) -> tuple[Unknown, ...]:
    """Directions that are measured directly, so that no fit of one recording moves them; changes of one std each.

    `rig`: the values; its ``priors`` and ``uncertainty`` replace the 1 % of a direction that is a single parameter.
    """
    found = []
    for names in _MEASURED:
        share = _MEASURED_STD
        if len(names) == 1 and (value := abs(rig.value(names[0]))):
            known = rig.uncertainty.get(names[0], rig.priors.get(names[0]))
            share = share if known is None else known / value
        found.append(change_of(names[0], {name: share * rig.value(name) for name in names}))
    return tuple(direction for direction in found if any(direction.adds.values()))


def _single(rig: Rig, path: str, free_only: bool = False) -> Unknown:
    value = rig.value(path)
    prior = rig.priors.get(path)
    std = prior / abs(value) if prior and value else _relative_prior(path)
    return replace(change_of(path, {path: value}, std), free_only=free_only)


def relative(rig: Rig, path: str, least: float) -> Unknown:
    """A change of one parameter, relative to its value or to a least size, within the bounds of a rig file."""
    now = rig.value(path)
    size = max(now, least)
    item = EFFECT_PARAMETERS.get(path)
    low, high = (item.low, item.high) if item else (0.0, math.inf)
    free = change_of(path, {path: size}, RELATIVE_PRIOR)
    return replace(free, low=(low - now) / size, high=(high - now) / size)


def _force_map(rig: Rig, path: str) -> list[Unknown]:
    if rig.model.force != "linear":
        return [_single(rig, f"{path}{name}") for name in FORMS[rig.model.force].moves]
    middle = rig.geometry.length
    directions = []
    for slope, intercept in (("v1", "v2"), ("w1", "w2")):
        steep = rig.value(path + slope)
        value = steep * middle + rig.value(path + intercept)
        name, std = f"{path}{slope[0]}", RELATIVE_PRIOR
        directions.append(change_of(f"{name}, value at the middle length", {path + intercept: value}, std))
        # The value at the middle length does not change with the slope.
        turned = {path + slope: steep, path + intercept: -steep * middle}
        directions.append(replace(change_of(f"{name}, slope", turned, std), free_only=True))
    return directions


def moved(rig: Rig, values: Mapping[str, float]) -> Rig:
    """A rig with other values."""
    result = rig
    for name, value in values.items():
        result = _put(result, name.split("."), float(value))
    return result


def _put(model: Any, path: list[str], value: float) -> Any:
    if isinstance(model, Mapping):
        key, *rest = path
        inner = _put(model.get(key, {}), rest, value) if rest else value
        return {**model, key: inner}
    if len(path) == 1:
        return model.unchecked(**{path[0]: value})
    return model.unchecked(**{path[0]: _put(getattr(model, path[0]), path[1:], value)})


_SPREAD = 4.0
"""Grid of the shapes: the neutral value, the scale, and the scale times and divided by this factor."""


@dataclass(frozen=True)
class Candidate:
    """An effect of the catalogue that a fit may add; its sizes show on which muscle it acts."""

    effect: str
    form: Form | None = None  # its free parameters; None for the form of the catalogue

    @property
    def catalogued(self) -> Effect:
        """Catalogue entry of the effect."""
        return CATALOGUE[self.effect]

    @property
    def _form(self) -> Form:
        return self.catalogued.form if self.form is None else self.form

    @property
    def free(self) -> tuple[Unknown, ...]:
        """Its free parameters, sizes first."""
        form = self._form
        items = [item for item in self.catalogued.parameters if item.name not in form.without]
        groups: dict[str, list[EffectParameter]] = {}
        for item in sorted(items, key=lambda item: not item.is_size):
            groups.setdefault(item.family if form.tied else item.name, []).append(item)
        return tuple(
            of_effect(tuple(parameter_path(self.effect, item.name) for item in group), _as_formed(group[0], form))
            for group in groups.values()
        )

    @property
    def constants(self) -> Mapping[str, float]:
        """Values that belong to it and stay, by dotted path."""
        return {}

    @property
    def sizes(self) -> tuple[Unknown, ...]:
        """Free sizes: the effect vanishes where they are 0."""
        return tuple(parameter for parameter in self.free if parameter.item.is_size)

    @property
    def shapes(self) -> tuple[Unknown, ...]:
        """Free shapes, such as times and widths."""
        return tuple(parameter for parameter in self.free if not parameter.item.is_size)

    def grid(self) -> list[dict[str, float]]:
        """Values of the shapes to try."""
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
    """A parameter with the scale and the least value of a form."""
    return replace(item, scale=form.scale.get(item.family, item.scale), low=form.low.get(item.family, item.low))


def candidates(taken: Mapping[str, float], drive: str = "valve") -> tuple[Candidate, ...]:
    """All candidates that a model does not have yet.

    `taken`: values of the effects' parameters of the model, by dotted path. `drive`: one of the ways of driving a joint
    that ``Effect.tested_with`` names.
    """
    present = {path.split(".")[1] for path in taken}
    return tuple(
        Candidate(name)
        for name, effect in CATALOGUE.items()
        if effect.deterministic and drive in effect.tested_with and name not in present
    )
