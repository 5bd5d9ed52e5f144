"""The columns of a table of static measurements, with their quantities and units.

Nothing is guessed: a column without a unit, and a pressure that is not said to be gauge or absolute, are refused.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pam_antagonist.errors import BadInput
from pam_antagonist.recording.units import UNITS, canonical

_WORDS = {
    "length": ("length", "l", "len"),
    "pressure": ("pressure", "p"),
    "force": ("force", "f"),
    "volume": ("volume", "v", "vol"),
}
QUANTITIES = tuple(_WORDS)
"""Quantities that a column may hold; ``_std`` behind a quantity means its standard deviation."""
_DEVIATION = ("std", "sigma", "sd")
_REFERENCES = {"gauge": "gauge", "g": "gauge", "rel": "gauge", "relative": "gauge",
               "absolute": "absolute", "abs": "absolute", "a": "absolute"}  # fmt: skip


@dataclass(frozen=True)
class Choice:
    """A column as the user named it.

    Attributes:
        column: its name in the file's first line.
        unit: its unit, empty where the name contains it.
        reference: of a pressure: gauge, absolute or empty.
    """

    column: str
    unit: str = ""
    reference: str = ""


def column_of(path: Path, header: Sequence[str], quantity: str, given: Choice | None, reference: str) -> Choice:
    """Column, unit and reference of a quantity, complete.

    Args:
        path: the file, for messages.
        header: names of its columns.
        quantity: one of ``QUANTITIES``, or with ``_std`` behind it.
        given: what the user said about the column; the rest has to be in the column's name.
        reference: gauge or absolute, for a pressure whose column does not say it.

    Raises:
        BadInput: no such column or several, no unit, or no reference of a pressure.
    """
    base = quantity.removesuffix("_std")
    where = f"{path}: {quantity}"
    if given is None:
        found = candidates(header, quantity)
        if len(found) != 1:
            listed = ", ".join(header)
            what = f"{len(found)} columns are called so" if found else "no column is called so"
            raise BadInput(
                f"{where}: {what} among {listed}, expected one such as {_example(quantity)}; else give "
                f'--column "{quantity}=NAME:UNIT"'
            )
        given = Choice(found[0])
    tokens = _tokens(given.column)
    unit, stated = given.unit, given.reference
    if not unit:
        in_name = [pair for token in tokens if (pair := _unit(base, token))]
        if len(in_name) != 1:
            raise BadInput(
                f"{where}: column {given.column!r} does not tell its unit, expected one of {', '.join(UNITS[base])} in "
                f'its name ({_example(quantity)}); else give --column "{quantity}={given.column}:UNIT"'
            )
        unit = in_name[0][0]
        stated = stated or in_name[0][1]
    unit = canonical(f"{where}: column {given.column!r}", base, unit)
    if quantity != "pressure":
        return Choice(given.column, unit)
    references = {_REFERENCES[token.lower()] for token in tokens if token.lower() in _REFERENCES} | (
        {stated} if stated else set()
    )
    references |= {reference} if reference else set()
    if len(references) != 1:
        what = (
            "is said to be gauge and absolute"
            if references
            else "does not tell whether it is gauge or absolute pressure"
        )
        raise BadInput(
            f"{where}: column {given.column!r} {what}, expected one of them, in its name (pressure_{unit}_gauge) or by "
            "--pressure gauge|absolute"
        )
    return Choice(given.column, unit, references.pop())


def _example(quantity: str) -> str:
    return {"length": "length_mm", "pressure": "pressure_kPa_gauge", "force": "force_N", "volume": "volume_cm3",
            "force_std": "force_std_N", "volume_std": "volume_std_cm3"}[quantity]  # fmt: skip


def _tokens(name: str) -> list[str]:
    return [token for token in re.split(r"[\s_\[\](){},/;:]+", name) if token]


def candidates(header: Sequence[str], quantity: str) -> list[str]:
    """Columns whose first word is a name of the quantity, or of its standard deviation (``force_std``)."""
    base, _, deviation = quantity.partition("_")
    out = []
    for name in header:
        words = [token.lower() for token in _tokens(name)]
        if words and words[0] in _WORDS[base] and any(word in _DEVIATION for word in words[1:]) == bool(deviation):
            out.append(name)
    return out


def _unit(quantity: str, token: str) -> tuple[str, str] | None:
    """The unit that a word of a column's name states, with the reference of barg or psia; None if it is no unit."""
    for text, reference in ((token, ""), (token[:-1], {"g": "gauge", "a": "absolute"}.get(token[-1:], "-"))):
        if reference == "-" or (reference and quantity != "pressure"):
            continue
        try:
            return canonical("", quantity, text.replace("^", "")), reference
        except BadInput:
            continue
    return None
