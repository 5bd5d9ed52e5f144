"""Units of CSV columns, and their values in SI units."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from types import MappingProxyType

from ..errors import BadInput

# psi: one pound-force (0.45359237 kg at 9.80665 m/s²) on a square inch (0.0254 m); exact by definition, like lbf.
_POUND_FORCE = 0.45359237 * 9.80665
_TABLE = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": _POUND_FORCE / 0.0254**2,
    },
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "torque": {
        "N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "mN m": 1e-3, "kgf cm": 9.80665e-2, "lbf in": _POUND_FORCE * 0.0254,
    },
    "temperature": {"degC": 1.0},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254},
    "volume": {"m3": 1.0, "dm3": 1e-3, "l": 1e-3, "cm3": 1e-6, "ml": 1e-6, "mm3": 1e-9},
    "mass": {"kg": 1.0, "g": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "kgf": 9.80665, "lbf": _POUND_FORCE},
}  # fmt: skip

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {quantity: MappingProxyType(units) for quantity, units in _TABLE.items()}
)
"""Quantity -> unit -> its value in SI units (s, Pa, rad, N m, V, m, m³, kg, N; degC for temperatures)."""

_ALIASES = {"µs": "us", "μs": "us", "°": "deg", "degrees": "deg", "degree": "deg",
            "m³": "m3", "dm³": "dm3", "cm³": "cm3", "mm³": "mm3", "L": "l", "mL": "ml"}  # fmt: skip


def canonical(where: str, quantity: str, unit: str) -> str:
    """A unit spelt as in ``UNITS``; spaces and dots between the parts of a product are ignored.

    Upper and lower case matter: MPa is not mPa.

    `quantity`: a key of ``UNITS``.
    """
    known = UNITS[quantity]
    bare = {_bare(name): name for name in known}
    text = _bare(_ALIASES.get(unit.strip(), unit))
    if text in bare:
        return bare[text]
    lower = {name.lower(): name for name in bare}
    close = difflib.get_close_matches(text.lower(), lower, 1, cutoff=0.6)
    hint = f"; did you mean {bare[lower[close[0]]]}?" if close else ""
    raise BadInput(f"{where}: unknown unit {unit[:40]!r} of {quantity}, expected one of {', '.join(known)}{hint}")


def _bare(unit: str) -> str:
    return "".join(letter for letter in unit if letter not in " ·*.-")
