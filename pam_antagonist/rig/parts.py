"""Commercial muscles, valves and pressure regulators, with the values of their data sheets.

New rig files start from these values.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import cache
from typing import TypeVar

from pydantic import Field

from pam_antagonist.errors import BadInput
from pam_antagonist.paths import config_dir
from pam_antagonist.rig.schema import Curve
from pam_antagonist.strict_yaml import Strict, read_mapping, validated


class MusclePart(Strict):
    """A muscle of a data sheet."""

    diameter: float = Field(gt=1e-3, lt=0.2, description="inner diameter without pressure [m]")
    force: float = Field(gt=0.1, lt=1e5, description="contraction force without contraction [N]")
    pressure: float = Field(gt=1e4, lt=2e6, description="gauge pressure of it [Pa]")
    contraction: float = Field(gt=0.02, lt=0.5, description="largest contraction without load, at that pressure [-]")
    source: str = Field(description="where the numbers come from")


class ValvePart(Strict):
    """A proportional valve of a data sheet."""

    flow: float = Field(gt=1e-3, lt=1e5, description="standard nominal flow, from 7 to 6 bar absolute [l/min]")
    curve: Curve
    closed_centre: bool = Field(False, description="no air passes at the middle voltage")
    source: str = Field(description="where the numbers come from")


class RegulatorPart(Strict):
    """A pressure regulator."""

    lowest: float = Field(ge=0.0, lt=1e6, description="least gauge pressure that it can be set to [Pa]")
    highest: float = Field(gt=1e4, lt=2e6, description="largest one [Pa]")
    hysteresis: float = Field(0.0, ge=0.0, lt=1e5, description="between the way up and the way down; 0: not told [Pa]")
    source: str = Field(description="where the numbers come from")


Part = TypeVar("Part", bound=Strict)


def _parts(name: str, kind: type[Part], switches: Sequence[str] = ()) -> dict[str, Part]:
    """Parts by name, from a file of ``config/parts``."""
    path = config_dir() / "parts" / f"{name}.yaml"
    content = read_mapping(path, "parts", str(path))
    return {part: validated(kind, entries, f"{path}: {part}", switches) for part, entries in content.items()}


@cache
def muscle_parts() -> dict[str, MusclePart]:
    """Muscles by name."""
    return _parts("muscles", MusclePart)


@cache
def valve_parts() -> dict[str, ValvePart]:
    """Valves by name."""
    return _parts("valves", ValvePart, ("closed_centre",))


@cache
def regulator_parts() -> dict[str, RegulatorPart]:
    """Pressure regulators by name."""
    return _parts("regulators", RegulatorPart)


def named(what: str, name: str, parts: dict[str, Part]) -> Part:
    """The part of a name; upper and lower case do not matter. What it is is for the message."""
    bare = {known.lower(): part for known, part in parts.items()}
    if name.lower() in bare:
        return bare[name.lower()]
    close = _alike(name.lower(), list(bare))
    hint = f"; did you mean {' or '.join(known for known in parts if known.lower() in close)}?" if close else ""
    raise BadInput(f"{what} {name!r}: unknown, expected one of {', '.join(parts)}, or own{hint}")


def _alike(name: str, known: list[str]) -> list[str]:
    """Known names that a name may stand for: of which it is the beginning, else which begin it, else similar ones.

    The end of an order code is often left out, or has more than the size. One that is only similar is another size.
    """
    longer = [one for one in known if name and one.startswith(name)]
    shorter = [one for one in known if name.startswith(f"{one}-")]
    return longer or shorter or difflib.get_close_matches(name, known, 1)
