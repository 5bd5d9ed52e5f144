"""Which parameters may move in a fit, by how much they are expected to, and within what bounds."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import is_positive

RELATIVE_PRIOR = 0.05
"""Standard deviation before identification of a parameter for which the rig file gives none."""
_GAUGE_PRIOR = {"supply.pressure": 0.01}
"""What a gauge shows is known better than what is not measured; a regulator holds it to about a per cent."""

_FLOW = (
    "valve_1.inflow_area", "valve_1.outflow_area", "valve_2.inflow_area", "valve_2.outflow_area",
    "gas.polytropic_flow", "gas.polytropic_volume", "supply.pressure",
)  # fmt: skip
_MOTION = ("joint.inertia", "joint.viscous_friction")
_FORCE = {"linear": ("v1", "v2", "w1", "w2")}
_FRICTION = {
    "kikuuwe": ("shaft", "muscle"),
    "simple": ("lever_force",),
    "tondu": ("static", "kinetic"),
    "none": (),
}
_EFFECTS = {parameter_path(effect.name, item.name): item for effect in CATALOGUE.values() for item in effect.parameters}


@dataclass(frozen=True)
class FreeParameter:
    """A parameter that a fit may move.

    Attributes:
        name: its dotted path.
        start: value in the rig file.
        prior_std: standard deviation of the prior around it, in the parameter's unit.
        low: least value that makes sense.
        high: largest value.
    """

    name: str
    start: float
    prior_std: float
    low: float
    high: float


def free_parameters(rig: Rig, free: Sequence[str] = (), frozen: Sequence[str] = ()) -> list[FreeParameter]:
    """The parameters of a fit.

    By default all that cannot be measured directly (Proposition 1): the force maps, the orifice areas, the
    polytropic indices, the friction, the sizes of the effects that the rig has; and the supply pressure, which a
    gauge shows to a per cent. The prior of each is that of the rig file (``priors``), else 5 % of the value; so are
    its bounds (``bounds``), else a factor of five either way.

    Args:
        rig: start values and priors.
        free: names, or beginnings of names, to be freed as well.
        frozen: names, or beginnings of names, to be kept at the start value.

    Raises:
        BadInput: a name that matches no parameter, or a freed parameter without a scale.
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
        low, high = rig.bounds.get(name, _bounds(name, start, std))
        chosen.append(FreeParameter(name, start, std, low, high))
    if not chosen:
        raise BadInput("every parameter is frozen: nothing is left to identify")
    return chosen


def _by_default(rig: Rig) -> set[str]:
    coefficients = _FORCE.get(rig.model.force, tuple(f"c{k}" for k in range(1, par.COEFFICIENTS + 1)))
    names = {f"muscle_{i}.force.{c}" for i in (1, 2) for c in coefficients if rig.value(f"muscle_{i}.force.{c}")}
    names |= {f"friction.{name}" for name in _FRICTION[rig.model.friction]}
    names |= set(_MOTION) | {name for name in _FLOW if not (rig.valves.sealed and name.startswith("valve_"))}
    present = {name for name, item in _EFFECTS.items() if item.is_size and rig.value(name)}
    return {name for name in names if rig.value(name)} | present


def _prior(name: str, start: float) -> float:
    if start == 0.0 and name in _EFFECTS:
        return _EFFECTS[name].scale
    return _GAUGE_PRIOR.get(name, RELATIVE_PRIOR) * abs(start)


def _matches(name: str, word: str) -> bool:
    return name == word or name.startswith(word if word.endswith(".") else word + ".")


def _bounds(name: str, start: float, std: float) -> tuple[float, float]:
    if name in _EFFECTS:
        return min(_EFFECTS[name].low, start - std), max(_EFFECTS[name].high, start + std)
    if is_positive(name):
        return (start / 5.0, start * 5.0) if start > 0.0 else (0.0, 10.0 * std)
    width = 5.0 * abs(start) if start else np.inf
    return start - width, start + width
