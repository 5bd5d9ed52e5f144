"""Zero of the pressure sensors, measured while the muscles are open to the air."""

from __future__ import annotations

import statistics
from collections import deque

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter

_SAMPLES = 1000
_FARTHEST = 30e3  # [Pa] largest error; with more, the sensor is broken or the muscle is not open
_LOUDEST = 3e3  # [Pa] largest standard deviation; with more, air still moves


class ZeroPressureMeasurement:
    """The last thousand samples of both pressures."""

    def __init__(self, converter: Converter) -> None:
        self._converter = converter
        self._pressures: deque[tuple[float, float]] = deque(maxlen=_SAMPLES)

    def add(self, pressure: tuple[float, float]) -> None:
        """Take one sample (2,) absolute [Pa]."""
        self._pressures.append(pressure)

    def clear(self) -> None:
        """Forget all samples, because the conversion changes."""
        self._pressures.clear()

    def result(self) -> tuple[float, float]:
        """Correction to add to both pressures (2,) [Pa], so that they equal the atmosphere."""
        if not self._converter.measures_pressures:
            raise BadInput("sensors at rest: the calibration has no pressure sensors (pressure_sensors: none)")
        if len(self._pressures) < _SAMPLES:
            raise BadInput(f"sensors at rest: {len(self._pressures)} samples so far, expected {_SAMPLES}")
        first, second = (self._one(muscle) for muscle in (0, 1))
        return first, second

    def _one(self, muscle: int) -> float:
        values = [pressure[muscle] - self._converter.rest[muscle] for pressure in self._pressures]
        off = statistics.fmean(values) - self._converter.calibration.atmosphere
        if not abs(off) <= _FARTHEST:  # also true for NaN
            raise BadInput(
                f"sensors at rest: pressure {muscle + 1} is {off:+.0f} Pa off the atmosphere's, expected at most "
                f"{_FARTHEST:g}: is the muscle open to the air?"
            )
        if statistics.pstdev(values) > _LOUDEST:
            raise BadInput(f"sensors at rest: pressure {muscle + 1} still changes: wait until it is constant")
        return -off
