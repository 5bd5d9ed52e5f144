"""A simulated joint with wiring faults, to test that they are detected."""

from __future__ import annotations

import numpy as np

from pam_antagonist.hardware.line_faults import FaultPlan
from pam_antagonist.simulation.plant import Plant, PlantSample

_LEAK = 2.5e-8
"""[m²] Area of a leaking fitting: half of a valve's inflow area."""
_OFF = 1.001
"""Pressure of a supply that is off, relative to the atmosphere [-]."""


class Miswired:
    """A simulated joint behind faulty wiring."""

    def __init__(self, plant: Plant, faults: FaultPlan) -> None:
        self._plant, self._faults = plant, faults
        self._held: dict[int, float] = {}
        self._changed: dict[str, float] = {}
        self._right = plant.named(("supply.pressure", "effects.leak.area_1", "effects.leak.area_2"))
        self._off = _OFF * plant.named(("atmosphere.pressure",))["atmosphere.pressure"]

    def step(self, voltage: tuple[float, float]) -> PlantSample:
        """Advance one sample period.

        Args:
            voltage: outputs of the device (2,) [V].
        """
        faults = self._faults
        if (wanted := self._wanted()) != self._changed:
            self._plant.change({**self._right, **wanted})
            self._changed = wanted
        given = list(reversed(voltage)) if faults.has("swap_valves") else list(voltage)
        for i in (1, 2):
            if faults.hits("stuck", i):
                given[i - 1] = self._held.setdefault(i, given[i - 1])
            else:
                self._held.pop(i, None)
        sample = self._plant.step((given[0], given[1]))
        if faults.has("swap_sensors"):
            sample = sample._replace(pressure=np.asarray(sample.pressure[::-1].copy()))
        if faults.has("flip_encoder"):
            sample = sample._replace(angle=-sample.angle)
        return sample

    def _wanted(self) -> dict[str, float]:
        """Parameters of the joint that faults change, by dotted path."""
        out = {f"effects.leak.area_{i}": _LEAK for i in (1, 2) if self._faults.hits("leak", i)}
        if self._faults.has("no_supply"):
            out["supply.pressure"] = self._off
        return out
