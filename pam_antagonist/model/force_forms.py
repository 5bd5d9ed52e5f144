"""Forms of the static force map: one row for each, with what the rest of the package has to know of it.

The equations are in :mod:`~pam_antagonist.model.muscle`. To add a form, add a row and its equation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class ForceForm:
    """A form of the static force map; coefficients are named as under ``muscle_i.force`` in a rig file."""

    units: Mapping[str, str]  # of the coefficients, by name
    gains: tuple[str, ...]  # coefficients to which, together, the force is in proportion, or nearly so
    offset: str  # coefficient that is an offset of the force, at all contractions but the least
    moves: tuple[str, ...]  # coefficients that recordings of a joint can determine
    bent: tuple[str, ...] = ()  # coefficients in which the force is not linear
    positive: tuple[str, ...] = ()  # coefficients that have to be above 0
    # coefficient that is the muscle's length without pressure and load; none: contractions count from L_0.
    nominal: str = ""
    fewest_lengths: int = 0  # of a measured table


def _newtons(count: int, **other: str) -> dict[str, str]:
    return {name: other.get(name, "N") for name in (f"c{k}" for k in range(1, count + 1))}


_LINEAR = {"v1": "m", "v2": "m²", "w1": "N/m", "w2": "N"}
_BRAIDED = _newtons(7, c2="-", c4="-", c5="-", c6="m")
_ANY = tuple(f"c{k}" for k in range(1, 8))
FORMS: Mapping[str, ForceForm] = {
    "linear": ForceForm(_LINEAR, tuple(_LINEAR), "w2", tuple(_LINEAR)),
    "hildebrandt": ForceForm(_newtons(7), _ANY, "c4", _ANY),
    "sarosi": ForceForm(_newtons(6, c3="-"), ("c1", "c2", "c4", "c5", "c6"), "c6", _ANY, ("c3",)),
    "polynomial": ForceForm(_newtons(6), _ANY[:6], "c1", _ANY),
    # At two lengths a force has two slopes and two offsets: fewer numbers than this form.
    "braided": ForceForm(
        _BRAIDED, ("c1",), "c3", ("c1", "c2", "c3"), tuple(_BRAIDED), ("c1", "c2", "c3", "c4", "c6", "c7"), "c6", 3
    ),
}
"""All forms, in the order of their codes in the parameter vector."""
