"""The catalogue of effects: the built-in ones, and those that installed packages add.

A package adds an effect by an entry point of the group ``pam_antagonist.effects``, whose value names the module or the
:class:`~pam_antagonist.model.effects.base.Effect`. The catalogue has the built-in effects first, then those of packages
by their names. In this order, added states follow P_2, and contributions of effects are summed.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib import import_module
from importlib.metadata import entry_points

from pam_antagonist._jit import EFFECTS_GROUP
from pam_antagonist.errors import BadInput
from pam_antagonist.model.effects.base import AddedState, Effect

BUILT_IN = (
    "hysteresis",
    "leak",
    "supply_droop",
    "valve_lag",
    "valve_offset",
    "line_resistance",
    "pressure_sensor",
    "load_torque",
    "friction",
    "creep",
    "thermal",
    "external_torque",
    "valve_play",
    "warm_up",
    "slack",
    "friction_by_pressure",
    "friction_by_signal",
    "load_by_signal",
    "strength_by_signal",
    "regulator_limits",
    "regulator_threshold",
    "regulator_dead_time",
    "regulator_lag",
    "limb_weight",
    "weak_laws",
    "learned",
)
"""Files of this folder, in the catalogue's order."""


def parameter_path(effect: str, name: str) -> str:
    """Dotted path of an effect's parameter, as in a rig file."""
    return f"effects.{effect}.{name}"


def effect_in(module: str, name: str = "EFFECT") -> Effect:
    """The effect that a module holds."""
    try:
        written = import_module(module)
        found = getattr(written, name)
    except Exception as error:
        raise BadInput(f"effect {module}:{name}: {type(error).__name__}: {error}") from error
    if not isinstance(found, Effect):
        raise BadInput(f"effect {module}:{name}: {type(found).__name__}, expected an Effect")
    _, _, notes = inspect.cleandoc(written.__doc__ or "").partition("\n")
    if not notes.strip():
        raise BadInput(f"effect {module}: no docstring; expected a title line and what the documentation says of it")
    return replace(found, module=module, notes=notes.strip())


def catalogue(effects: Iterable[Effect]) -> dict[str, Effect]:
    """Effects by name."""
    result: dict[str, Effect] = {}
    states: dict[str, str] = {}
    for effect in effects:
        complaint = _incomplete(effect)
        if effect.name in result:
            complaint = "this name is taken by another effect"
        for state in effect.states:
            if state.name in states:
                complaint = f"the state {state.name!r} is taken by effect {states[state.name]!r}"
            states[state.name] = effect.name
        if not effect.deterministic and any(not other.deterministic for other in result.values()):
            complaint = "a second effect that is not deterministic: a diagnosis could not tell it from the first"
        if complaint:
            raise BadInput(f"effect {effect.name!r}: {complaint}")
        result[effect.name] = effect
    return result


def _incomplete(effect: Effect) -> str:
    """What is wrong with an effect, in one line; empty if nothing is."""
    if not effect.name.isidentifier():
        return "expected a name of letters, digits and underscores"
    for what in ("meaning", "law", "source", "signature", "sentence", "experiment"):
        if not getattr(effect, what).strip():
            return f"{what} is empty: expected what Effect's documentation says of it"
    names = [item.name for item in effect.parameters]
    if len(set(names)) != len(names):
        return f"parameters {', '.join(names)}: expected different names"
    if not any(item.is_size for item in effect.parameters):
        return "no parameter is neutral at 0: expected a size with which the effect vanishes"
    return _wrong_parameter(effect) or _wrong_state(effect, names) or _wrong_words(effect)


def _wrong_parameter(effect: Effect) -> str:
    for item in effect.parameters:
        if not item.low <= item.neutral <= item.high or not item.low <= item.scale <= item.high or item.scale <= 0.0:
            return (
                f"{item.name}: bounds {item.low:g} to {item.high:g}, expected ones that hold the neutral value, "
                f"{item.neutral:g}, and the scale, {item.scale:g}, which is above 0"
            )
        if not item.meaning or not item.unit:
            return f"{item.name}: expected a meaning and a unit ('-' for none)"
    return ""


def _wrong_state(effect: Effect, names: list[str]) -> str:
    for state in effect.states:
        for name in (
            state.switch,
            *state.further,
            *([state.noise] if isinstance(state.noise, str) else []),
            *filter(None, [state.prior]),
        ):
            if name not in names:
                close = difflib.get_close_matches(name, names, 1)
                return f"state {state.name}: unknown parameter {name!r}" + (f", {close[0]!r}?" if close else "")
    return ""


def _wrong_words(effect: Effect) -> str:
    if effect.sealed.part is None and not effect.sealed.reason:
        return "sealed: expected the part of a sealed joint that shows it, or the reason why none does"
    if effect.sealed.loop is not None:
        known, loop = [item.name for item in effect.parameters], effect.sealed.loop
        if not loop.sizes or not {*loop.sizes, *filter(None, [loop.width])} <= set(known):
            return f"sealed.loop: expected names of its parameters, which are {', '.join(known)}"
    try:
        effect.in_words(None, {})
        effect.in_words(1, {}, sealed=True)
    except (KeyError, ValueError, IndexError) as error:
        return f"sentence: {error} is no parameter of it, nor muscle, valve or s"
    return ""


def _all() -> Iterable[Effect]:
    for name in BUILT_IN:
        yield effect_in(f"{__package__}.{name}")
    for point in sorted(entry_points(group=EFFECTS_GROUP), key=lambda point: point.name):
        yield effect_in(point.module, point.attr or "EFFECT")


CATALOGUE: Mapping[str, Effect] = catalogue(_all())
"""All effects by name."""

ADDED_STATES: tuple[tuple[str, AddedState], ...] = tuple(
    (effect.name, state) for effect in CATALOGUE.values() for state in effect.states
)
"""Every state that effects can add, with the effect's name, in the order in which they follow P_2."""

DISTURBANCE = next(effect.name for effect in CATALOGUE.values() if not effect.deterministic)
"""The effect that follows no law: the disturbance torque, which a filter estimates."""


def experiment_between(effect: str, other: str) -> str | None:
    """Which recording distinguishes two effects, given by name; None if neither entry names one."""
    return CATALOGUE[effect].distinguished_by.get(other) or CATALOGUE[other].distinguished_by.get(effect)


def random_part(effects: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """The part of a rig's effects that follows no law: a filter estimates it, and the model alone leaves it out.

    It consists of the parameters that drive a state by noise, and of the shapes of the same effect.

    Args:
        effects: of a rig, as in its file.
    """
    out = {}
    for name, values in effects.items():
        noises = {state.noise for state in CATALOGUE[name].states if isinstance(state.noise, str)}
        shapes = {item.name for item in CATALOGUE[name].parameters if not item.is_size}
        if any(values.get(noise) for noise in noises):
            out[name] = {key: value for key, value in values.items() if key in noises | shapes}
    return out
