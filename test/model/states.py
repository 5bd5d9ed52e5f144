"""States and inputs to try the physics on, and the physics with one thing taken away."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from pam_antagonist.model import integration
from pam_antagonist.rig import Rig

ATMOSPHERE, TANK = 101.3e3, 710e3
CHOKED_BELOW = TANK * (2 / 2.4) ** 3.5
"""[Pa] The inflow is choked up to here, 375 kPa."""
CHOKED_ABOVE = ATMOSPHERE / (2 / 2.4) ** 3.5
"""[Pa] The outflow is choked from here on, 192 kPa."""

EDGE_PRESSURES = (
    60e3,  # below the atmosphere: air comes in through the outlet
    ATMOSPHERE,
    ATMOSPHERE + 20e3,  # T_p is bounded below this
    CHOKED_ABOVE * (1 - 1e-9),
    CHOKED_ABOVE * (1 + 1e-9),
    CHOKED_BELOW * (1 - 1e-9),
    CHOKED_BELOW * (1 + 1e-9),
    TANK,
    760e3,  # above the tank: air goes back through the inlet
)
EDGE_VOLTAGES = (-1.0, 0.0, 1e-6, 4.0, 5.0, 5.5, 7.5, 10.0 - 1e-6, 10.0, 12.0)


def random_states(number: int, seed: int) -> Iterator[tuple[list[float], list[float]]]:
    """State and voltages, over the whole range and a little beyond, at rest, creeping and fast."""
    rng = np.random.default_rng(seed)
    for k in range(number):
        angle = rng.uniform(-0.5, 0.5)
        velocity = (0.0, rng.normal(0.0, 1e-3), rng.normal(0.0, 0.1), rng.normal(0.0, 5.0))[k % 4]
        pressures = rng.uniform(80e3, 750e3, 2)
        voltages = rng.uniform(-0.5, 10.5, 2)
        yield [angle, velocity, *map(float, pressures)], [float(u) for u in voltages]


def sealed(rig: Rig, **changes: float) -> np.ndarray:
    """A free joint without a stop, both chambers closed: no air goes in or out."""
    areas = {f"valve_{i}.{way}_area": 0.0 for i in (1, 2) for way in ("inflow", "outflow")}
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return rig.parameters(changes={"joint.stop": math.inf, **areas, **named})


def held(rig: Rig, **changes: float) -> np.ndarray:
    """Like :func:`sealed`, but the pressures do not follow the volume either: they stay what they are."""
    return sealed(rig, gas__polytropic_volume=0.0, **changes)


def steps(x: list[float], p: np.ndarray, number: int, dt: float = 1e-3, u=(5.5, 5.5)) -> np.ndarray:
    """States (number + 1, 4) from ``x`` on at constant voltages, one Runge-Kutta step each."""
    out = np.empty((number + 1, 4))
    out[0] = x
    for k in range(number):
        integration.rk4_step(out[k], np.array(u), p, dt, out[k + 1])
    return out
