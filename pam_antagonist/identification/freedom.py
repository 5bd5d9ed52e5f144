"""Which parameters may move in a fit, by how much they are expected to, and within what bounds."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import is_positive

_RELATIVE_PRIOR = 0.05
_FIXED = ("geometry.", "joint.shaft_radius", "joint.mass", "joint.gravity", "joint.stop", "joint.stiffness",
          "friction.pressure_floor", "friction.time_step", "gas.heat_ratio", "gas.constant", "gas.temperature",
          "atmosphere.pressure", "supply.pressure", "volume.", "valves.", "effects.", "friction.lever_force",
          "friction.static", "friction.kinetic", "friction.velocity")  # fmt: skip
"""What Proposition 1 calls directly measurable, and the volume, which a graduated cylinder gives."""


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
    polytropic indices, the friction. The prior of each is that of the rig file (``priors``), else 5 %; so are its
    bounds (``bounds``), else a factor of five either way.

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
    chosen = []
    for name in par.INDEX:
        by_default = not any(part in name if part == "volume." else name.startswith(part) for part in _FIXED)
        by_default = by_default and _in_form(name, rig)
        wanted = by_default or any(_matches(name, word) for word in free)
        if not wanted or any(_matches(name, word) for word in frozen):
            continue
        start = rig.value(name)
        std = rig.priors.get(name, _RELATIVE_PRIOR * abs(start))
        if not (math.isfinite(start) and std > 0.0):
            raise BadInput(
                f"{name} is {start:g} in rig {rig.name}: to free it, give its prior in the rig file (priors)"
            )
        low, high = rig.bounds.get(name, _bounds(name, start))
        chosen.append(FreeParameter(name, start, std, low, high))
    if not chosen:
        raise BadInput("every parameter is frozen: nothing is left to identify")
    return chosen


def _in_form(name: str, rig: Rig) -> bool:
    """Whether the rig's form of the force map has this coefficient; true of what is none."""
    _, found, coefficient = name.partition(".force.")
    if not found:
        return True
    if rig.model.force == "linear":
        return not coefficient.startswith("c")
    return coefficient.startswith("c") and rig.value(name) != 0.0


def _matches(name: str, word: str) -> bool:
    return name == word or name.startswith(word if word.endswith(".") else word + ".")


def _bounds(name: str, start: float) -> tuple[float, float]:
    if is_positive(name):
        return start / 5.0, start * 5.0
    width = 5.0 * abs(start) if start else np.inf
    return start - width, start + width
