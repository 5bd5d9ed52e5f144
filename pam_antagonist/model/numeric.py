"""What several equations need and numba has no quick version of."""

from __future__ import annotations

import math

from pam_antagonist._jit import inlined


@inlined
def power(base, exponent):
    """A power of what is not negative, faster than a general power and as exact here."""
    return math.exp(exponent * math.log(base))
