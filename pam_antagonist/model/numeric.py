"""Elementary functions of numbers and of lanes, with the same bits: sums of their power series.

The functions of the libraries work on one number. With the functions here, a kernel on lanes
(:mod:`pam_antagonist.model.lane_values`) gives the bits of the kernel on numbers, on any processor. The terms are
summed in pairs, which the processor computes in parallel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from numba.core import types
from numba.core.typing import signature
from numba.extending import intrinsic

from pam_antagonist._jit import inlined
from pam_antagonist.model.lane_values import LANES, ir, lanes, where

_WHOLE = 1.5 * 2.0**52
"""Adding this to a number rounds it to an integer, if its absolute value is below 2^51."""
_LOG2_E = 1.0 / math.log(2.0)
# ln 2 and π/2 in two parts. The first part ends with zero bits, so that its product with a small integer is exact.
_LN2, _LN2_REST = float.fromhex("0x1.62E42FEEp-1"), 1.9082149292705877e-10
_QUARTER, _QUARTER_REST = float.fromhex("0x1.921FB544p0"), 6.077100506506192e-11
_FIRST_OF_UPPER_HALF = math.sqrt(2.0)


def _of_bits(doc: str, build: Callable[..., Any]) -> Any:
    """Define a function of the bits of a number, or of those of each lane."""

    def typer(typingctx: Any, value: Any) -> Any:
        if value is not lanes and value != types.float64:
            return None

        def code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = ir.VectorType(ir.IntType(64), LANES) if value is lanes else ir.IntType(64)

            def constant(number: int) -> Any:
                return ir.Constant(kind, [number] * LANES if value is lanes else number)

            return builder.bitcast(build(builder, builder.bitcast(args[0], kind), constant), args[0].type)

        return signature(value, value), code

    typer.__doc__ = doc
    return intrinsic(typer)


_power_of_two = _of_bits(
    "2 to the whole number n, −1022 to 1023, that was added to 1.5 · 2^52.",
    lambda b, bits, c: b.shl(b.add(bits, c(1023)), c(52)),
)
_fraction = _of_bits(
    "The number with another exponent: from 1 to 2.",
    lambda b, bits, c: b.or_(b.and_(bits, c(0x000F_FFFF_FFFF_FFFF)), c(0x3FF0_0000_0000_0000)),
)
_exponent = _of_bits(
    "2^52 and the exponent of a number, with the bias of 1023.",
    lambda b, bits, c: b.or_(b.lshr(bits, c(52)), c(0x4330_0000_0000_0000)),
)


@inlined
def exp(x):
    """The power e^x with a relative error of 1e-15; x is limited to −708 and 709.

    With x = n ln 2 + r and |r| ≤ 0.35, it is 2^n e^r: fourteen terms of the series.
    """
    bounded = min(max(x, -708.0), 709.0)
    shifted = bounded * _LOG2_E + _WHOLE
    n = shifted - _WHOLE
    r = (bounded - n * _LN2) - n * _LN2_REST
    r2 = r * r
    r4 = r2 * r2
    low = (1.0 / 2.0 + r * (1.0 / 6.0)) + r2 * (1.0 / 24.0 + r * (1.0 / 120.0))
    middle = (1.0 / 720.0 + r * (1.0 / 5040.0)) + r2 * (1.0 / 40320.0 + r * (1.0 / 362880.0))
    high = (1.0 / 3628800.0 + r * (1.0 / 39916800.0)) + r2 * (1.0 / 479001600.0 + r * (1.0 / 6227020800.0))
    return (1.0 + (r + r2 * (low + r4 * (middle + r4 * high)))) * _power_of_two(shifted)


@inlined
def log(x):
    """Natural logarithm, to 1e-15 of its value or of 1e-15; −inf for 0 to 2e-308, NaN for negative numbers.

    With x = 2^n m and m from √½ to √2, it is n ln 2 + 2 artanh s, s = (m − 1)/(m + 1): eleven terms of the series.
    """
    part = _fraction(x)
    above = part > _FIRST_OF_UPPER_HALF
    m = where(above, 0.5 * part, part)
    n = (_exponent(x) - (2.0**52 + 1023.0)) + where(above, 1.0, 0.0)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    z2 = z * z
    z4 = z2 * z2
    low = (1.0 / 3.0 + z * (1.0 / 5.0)) + z2 * (1.0 / 7.0 + z * (1.0 / 9.0))
    high = (1.0 / 11.0 + z * (1.0 / 13.0)) + z2 * (1.0 / 15.0 + z * (1.0 / 17.0))
    tail = low + z4 * (high + z4 * (1.0 / 19.0 + z * (1.0 / 21.0)))
    # 2 artanh s = f − s f + 2 z s (1/3 + ...): the rounding errors of the first two terms are negligible.
    value = n * _LN2 + (f + ((2.0 * s * z * tail - s * f) + n * _LN2_REST))
    usual = where(x < math.inf, value, x)
    return where(x >= 2.3e-308, usual, where(x >= 0.0, -math.inf, math.nan))


@inlined
def power(base, exponent):
    """A power of a base that is not negative; faster than a general power, and as exact for the model's values."""
    return exp(exponent * log(base))


@inlined
def sine_and_cosine(x):
    """The sine and the cosine of x, to 1e-15 for |x| up to some thousands.

    With x = n π/2 + r and |r| ≤ π/4, they are sine and cosine of r up to order and sign: nine terms of each series.
    """
    n = (x * (2.0 / math.pi) + _WHOLE) - _WHOLE
    r = (x - n * _QUARTER) - n * _QUARTER_REST
    z = r * r
    z2 = z * z
    z4 = z2 * z2
    odd = (-1.0 / 6.0 + z * (1.0 / 120.0)) + z2 * (-1.0 / 5040.0 + z * (1.0 / 362880.0))
    odd += z4 * ((-1.0 / 39916800.0 + z * (1.0 / 6227020800.0)) + z2 * (-1.0 / 1307674368000.0))
    even = (1.0 / 24.0 + z * (-1.0 / 720.0)) + z2 * (1.0 / 40320.0 + z * (-1.0 / 3628800.0))
    even += z4 * ((1.0 / 479001600.0 + z * (-1.0 / 87178291200.0)) + z2 * (1.0 / 20922789888000.0))
    sine = r + r * z * odd
    cosine = 1.0 - (0.5 * z - z2 * even)
    # n = 4 k + quarter, quarter from −2 to 2.
    quarter = n - 4.0 * ((0.25 * n + _WHOLE) - _WHOLE)
    swapped = abs(quarter) == 1.0
    first, second = where(swapped, cosine, sine), where(swapped, sine, cosine)
    # sin(r + π/2) = cos r and cos(r + π/2) = −sin r. After half a turn, both change their signs.
    back = abs(quarter) == 2.0
    return (
        where(back, -first, where(quarter == -1.0, -first, first)),
        where(back, -second, where(quarter == 1.0, -second, second)),
    )
