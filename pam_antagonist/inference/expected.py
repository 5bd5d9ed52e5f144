"""Expected effects of a rig file: sizes of effects that are 0 in the file and have a prior there.

A guessed valve curve is the common case. The prior of ``effects.valve_offset.voltage_1`` is the expected shift of the
curve. A fit finds the shift like an orifice area, and a diagnosis does not report it as an effect.
"""

from __future__ import annotations

from typing import Any

from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig import Rig

_SIZES = {
    parameter_path(effect.name, item.name)
    for effect in CATALOGUE.values()
    for item in effect.parameters
    if item.is_size
}
_CURVE_SHIFT = parameter_path("valve_offset", "voltage_")


def expected_sizes(rig: Rig) -> tuple[str, ...]:
    """Sizes of effects that are 0 in the rig file and have a prior there, by dotted path.

    The file expects them: they are values of the rig that have not been measured yet.
    """
    return tuple(name for name in rig.priors if name in _SIZES and not rig.value(name))


def guesses_curves(rig: Rig) -> bool:
    """Whether a rig file expects the curve of a valve to be shifted."""
    return any(path.startswith(_CURVE_SHIFT) for path in expected_sizes(rig))


def with_known_curves(rig: Rig, start: Rig) -> Rig:
    """A rig with expected shifts moved from the effect into the curves of its valves.

    An expected shift that is known now is part of the curve, and a rig without effects runs faster.
    """
    changes: dict[str, Any] = {}
    known = set()
    offset = dict(rig.effects.get("valve_offset", {}))
    for path in expected_sizes(start):
        name = path.rsplit(".", 1)[1]
        if path.startswith(_CURVE_SHIFT) and (shift := offset.pop(name, 0.0)):
            valve = getattr(rig, f"valve_{name[-1]}")
            # κ(u − δ); both curves are constant beyond their ends.
            curve = valve.curve.replaced(voltage=tuple(voltage + shift for voltage in valve.curve.voltage))
            known.add(path)
            changes[f"valve_{name[-1]}"] = valve.replaced(curve=curve)
    if not changes:
        return rig
    effects = {name: values for name, values in rig.effects.items() if name != "valve_offset"}
    effects |= {"valve_offset": offset} if offset else {}
    for section, spreads in (("priors", rig.priors), ("uncertainty", rig.uncertainty)):
        changes[section] = {name: std for name, std in spreads.items() if name not in known}
    return rig.replaced(**changes, effects=effects)
