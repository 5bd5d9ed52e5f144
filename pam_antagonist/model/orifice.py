"""Mass flow through an ideal orifice: the two branches of equation (5)."""

from __future__ import annotations

import math

from pam_antagonist._jit import inlined
from pam_antagonist.model.parameters import CHOKED_FLOW, CRITICAL_RATIO, SUBSONIC, SUBSONIC_FLOW


@inlined
def orifice_flow(upstream, downstream, p):
    """Mass flow per orifice area [kg/(s m²)] of an ideal orifice, both branches of m_in and m_out.

    Choked where downstream ≤ upstream (2/(k+1))^(k/(k−1)), else subsonic. Where the ends are exchanged
    (a chamber above the tank's or below the atmosphere's pressure, which the paper leaves out) the flow
    reverses by the same law.

    `upstream`: absolute pressure before the orifice [Pa]. `downstream`: absolute pressure behind it [Pa].
    """
    sign = 1.0
    if downstream > upstream:
        upstream, downstream = downstream, upstream
        sign = -1.0
    if downstream <= upstream * p[CRITICAL_RATIO]:
        return sign * upstream * p[CHOKED_FLOW]
    gap = (upstream - downstream) / upstream
    return sign * upstream * p[SUBSONIC_FLOW] * math.sqrt(gap * _h(gap, p))


@inlined
def _h(s, p):
    """The polynomial of ``parameters.series``; pairs of terms need not wait for one another."""
    s2 = s * s
    s4 = s2 * s2
    first = (p[SUBSONIC] + s * p[SUBSONIC + 1]) + s2 * (p[SUBSONIC + 2] + s * p[SUBSONIC + 3])
    second = (p[SUBSONIC + 4] + s * p[SUBSONIC + 5]) + s2 * (p[SUBSONIC + 6] + s * p[SUBSONIC + 7])
    third = (p[SUBSONIC + 8] + s * p[SUBSONIC + 9]) + s2 * (p[SUBSONIC + 10] + s * p[SUBSONIC + 11])
    fourth = (p[SUBSONIC + 12] + s * p[SUBSONIC + 13]) + s2 * (p[SUBSONIC + 14] + s * p[SUBSONIC + 15])
    return (first + s4 * second) + (s4 * s4) * (third + s4 * fourth)
