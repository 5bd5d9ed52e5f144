"""The model's Runge-Kutta step for several parameter vectors at once, against one after another."""

from __future__ import annotations

import numpy as np

from pam_antagonist.model import equilibrium, integration, lanes
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.lane_values import LANES
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.excitation import profile
from validation.benchmark.figure import Figure, pairwise

_CASES = (
    (),
    ("leak",),
    ("hysteresis",),
    ("creep", "valve_lag", "supply_droop"),
    ("line_resistance", "thermal", "pressure_sensor"),
)
"""Effects of a rig: none, one without a state, and more and more states."""
_DURATION = 20.0
_ROUNDS = 10


def measure(rig: Rig) -> list[Figure]:
    """Measure how much less a step costs by a model, where several run side by side.

    Args:
        rig: the rig, without effects of its own and with some of the catalogue.
    """
    return [_measured(rig, names) for names in _CASES]


def _measured(rig: Rig, names: tuple[str, ...]) -> Figure:
    effects = {
        name: {item.name: item.scale if item.is_size else item.neutral for item in CATALOGUE[name].parameters}
        for name in names
    }
    p = rig.replaced(effects=effects).parameters()
    voltage = profile("steps", _DURATION, rig.sample_period, seed=1)
    start = equilibrium.initial_state(0.0, 450e3, 450e3, voltage[0], p)
    substeps = integration.substeps_of(rig.sample_period)

    def alone() -> None:
        for _ in range(LANES):
            integration.course(start, voltage, p, rig.sample_period, substeps)

    def together() -> None:
        lanes.courses([start] * LANES, voltage, [p] * LANES, rig.sample_period, substeps)

    ratio, alone_s, together_s = pairwise(alone, together, rounds=_ROUNDS)
    steps = (len(voltage) - 1) * substeps
    words = " and ".join(name.replace("_", " ") for name in names) or "no effect"
    return Figure(
        f"lanes_{'_'.join(names) or 'plain'}",
        f"{LANES} models one by one against side by side, as fits run them ({words}; {np.size(start)} states)",
        ratio,
        "",
        None,
        "×",
        {"one_model_ns": alone_s / steps / LANES * 1e9, "side_by_side_ns": together_s / steps * 1e9},
    )
