"""How large an effect is: by how many noises of a sample it moves the channel that it moves most."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.design.information import Information
from pam_antagonist.rig import Rig
from validation.battery.plants import staircase

Floats = NDArray[np.float64]
_MINUTE, _STEP, _ROUNDS, _CLOSE = 60.0, 5e-4, 8, 1.1
"""A size is that over a minute of the battery's voltages, worked out in these steps [s], right to a tenth."""


class Sizes:
    """Sizes of effects in one rig: root mean square over a minute of the free joint, without noise.

    Args:
        rig: without the effect.
        rng: of the voltages, which are the battery's.
    """

    def __init__(self, rig: Rig, rng: np.random.Generator) -> None:
        self._rig = rig
        self._voltage = staircase(np.asarray(np.arange(1, round(_MINUTE / _STEP) + 1) * _STEP), rng)
        self._without = self._shown(rig)

    def _shown(self, rig: Rig) -> Floats:
        work = Information(rig, (), step=_STEP)
        middle = 0.5 * (rig.atmosphere.pressure + rig.supply.pressure)
        return work.along(work.start((middle, middle), self._voltage[0]), self._voltage).shown

    def of(self, joint: Rig) -> float:
        """The size that an effect has.

        Args:
            joint: the rig with it.
        """
        sensors = self._rig.sensors
        noise = [sensors.angle_std, sensors.torque_std, sensors.pressure_std, sensors.pressure_std]
        return float(np.max(np.sqrt(np.mean(((self._shown(joint) - self._without) / noise) ** 2, axis=0))))

    def reached(self, joint_with: Callable[[float], Rig], wanted: float) -> tuple[Rig, float]:
        """The joint whose effect has a size, or comes closest to it.

        Args:
            joint_with: makes the rig with so many times the usual effect.
            wanted: size.

        Returns:
            The rig, and the size that its effect has.
        """
        factor, tried = 1.0, []
        for _ in range(_ROUNDS):
            joint = joint_with(factor)
            size = self.of(joint)
            tried.append((abs(math.log(max(size, 1e-9) / wanted)), size, joint))
            if tried[-1][0] < math.log(_CLOSE):
                break
            # What sticks jumps: no leap further than a factor of three.
            factor *= float(np.clip(wanted / max(size, 1e-9), 1.0 / 3.0, 3.0))
        _, size, joint = min(tried, key=lambda item: item[0])
        return joint, size
