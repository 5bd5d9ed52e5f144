"""Mass flow through an ideal orifice: the two branches of equation (5)."""

from __future__ import annotations

import math

from pam_antagonist._jit import inlined
from pam_antagonist.model.numeric import power
from pam_antagonist.model.parameters import CHOKED_FLOW, CRITICAL_RATIO, FLOW_EXPONENT, SUBSONIC_FLOW


@inlined
def orifice_flow(upstream, downstream, p):
    """Mass flow per orifice area [kg/(s m²)] of an ideal orifice, both branches of m_in and m_out.

    Choked where downstream ≤ upstream (2/(k+1))^(k/(k−1)), else subsonic. Where the ends are exchanged
    (a chamber above the tank's or below the atmosphere's pressure, which the paper leaves out) the flow
    reverses by the same law.

    Args:
        upstream: absolute pressure before the orifice [Pa].
        downstream: absolute pressure behind it [Pa].
        p: parameter vector.
    """
    sign = 1.0
    if downstream > upstream:
        upstream, downstream = downstream, upstream
        sign = -1.0
    if downstream <= upstream * p[CRITICAL_RATIO]:
        return sign * upstream * p[CHOKED_FLOW]
    # With w = r^((1−k)/k), r^(2/k) − r^((k+1)/k) = r² w (w − 1): one power instead of two, and upstream r = downstream.
    w = power(upstream / downstream, p[FLOW_EXPONENT])
    return sign * downstream * p[SUBSONIC_FLOW] * math.sqrt(max(w * (w - 1.0), 0.0))
