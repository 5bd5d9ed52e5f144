"""Numbers as people type them and as other programs write them."""

from __future__ import annotations

import re

_SPACE = "\u00a0"
_MARKS = str.maketrans(
    {
        **dict.fromkeys("\u2212\u2010\u2011\u2012\u2013\ufe63\uff0d", "-"),  # minus sign, hyphens, dashes
        "\uff0b": "+",
        **dict.fromkeys("\u2007\u2009\u202f", _SPACE),  # spaces that do not break a line
        "\u2019": "'",
    }
)
_GROUPED = re.compile(rf"[-+]?\d{{1,3}}([{_SPACE}'])\d{{3}}(?:\1\d{{3}})*(?!\d)")
_FORTRAN = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[dD][-+]?\d+")
_MICROSOFT = re.compile(r"([-+]?)1\.#(inf|ind|[qs]nan)\w*|[-+]?nan\(\w*\)", re.IGNORECASE)


def plain(text: str) -> str:
    """A text with the signs that a keyboard has."""
    return text if text.isascii() else text.translate(_MARKS)


def number_of(text: str, decimal: str = ".") -> float | None:
    """The number that a text is; None for any other text.

    Beside what Python reads: minus signs of typesetting, thousands parted by an apostrophe or by a space that does not
    break a line, exponents of Fortran (1.5D+03), and what programs of Microsoft's compiler print for no number
    (1.#QNAN). An underscore is no part of a number.

    `decimal`: what stands before the decimals, a point or a comma; the other one is no part of a number.
    """
    written = plain(text).strip()
    if found := _MICROSOFT.fullmatch(written):
        return float(f"{found[1] or ''}{'inf' if (found[2] or '').lower() == 'inf' else 'nan'}")
    if "_" in written or ("." if decimal == "," else ",") in written:
        return None
    if found := _GROUPED.match(written):
        written = found[0].replace(found[1], "") + written[found.end() :]
    written = written.replace(",", ".")
    if _FORTRAN.fullmatch(written):
        written = re.sub("[dD]", "e", written)
    try:
        return float(written)
    except ValueError:
        return None
