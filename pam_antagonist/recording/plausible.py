"""Refuse recorded values that are implausible in their unit: gauge pressure, other units, degrees.

A few implausible values are outliers. They are counted and kept, because the estimator gates them. More than one in a
thousand (and more than five) means that the recording is in another unit; it is refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput

Floats = NDArray[np.float64]

MIN_PRESSURE = 80e3
"""Lowest plausible absolute pressure [Pa]; a vented muscle holds atmospheric pressure, 79 kPa at 2,000 m."""
MAX_PRESSURE = 2e6
"""Highest plausible absolute pressure [Pa]; pneumatic muscles work up to about 0.9 MPa."""
MIN_VOLTAGE, MAX_VOLTAGE = -0.5, 10.5
"""Plausible voltages [V]: the range of 0 to 10 V, widened by measurement error."""
MAX_ANGLE = 3.2
"""Largest plausible joint angle [rad]: half a turn."""
_JUMP = 0.75  # of a turn: a larger move between two rows is none of a joint
MAX_TORQUE = 1e3
"""Largest plausible joint torque [N m]."""


NO_VALUE = 1e30
"""Instruments write a larger number, such as 9.91e37, where there is no value."""


def finite_only(topic: str, what: str, values: Floats, issues: list[str]) -> Floats:
    """Values with NaN for everything that is not finite.

    Args:
        values: any numbers (N,) or (N, 2).
    """
    bad = ~(np.abs(values) < NO_VALUE)
    if not np.any(bad):
        return values
    issues.append(f"{np.count_nonzero(bad)} of {values.size} values of {what} on {topic} are not finite: left out")
    return np.where(bad, np.nan, values)


def few(count: int, size: int) -> bool:
    """Whether odd values are so rare that they say nothing of the rest."""
    return count <= max(5, 0.001 * size) and 2 * count <= size


def _implausible(topic: str, values: Floats, odd: NDArray[np.bool_], what: str, issues: list[str]) -> bool:
    """Whether too many values are implausible; a few are only reported as an issue."""
    count = int(np.count_nonzero(odd))
    if not few(count, values.size):
        return True
    if count:
        issues.append(f"{count} of {values.size} values on {topic} {what}: kept, for the estimator to judge")
    return False


def check_pressure(where: str, topic: str, pressure: Floats, issues: list[str]) -> None:
    """Refuse values that are no absolute pressures in Pa.

    Args:
        pressure: (N, 2) [Pa].
    """
    values = _finite(where, topic, "pressure", pressure)
    expected = "expected absolute pressure in Pa"
    low = values < MIN_PRESSURE
    if _implausible(topic, values, low, f"lie below {MIN_PRESSURE / 1e3:g} kPa absolute", issues):
        top = float(np.quantile(np.abs(values), 0.99))
        if top == 0.0:
            raise BadInput(f"{where}: {topic} is 0 throughout, {expected}; is the sensor connected?")
        for unit, bound in (("MPa", 2.0), ("bar", 20.0), ("kPa or psi", 2e3), ("hPa", MIN_PRESSURE / 4)):
            if top <= bound:
                raise BadInput(f"{where}: {topic} looks like {unit} (values up to {top:.4g}), {expected}")
        raise BadInput(
            f"{where}: {topic} looks like gauge pressure ({np.count_nonzero(low)} of {len(values)} values lie below "
            f"{MIN_PRESSURE / 1e3:g} kPa, the lowest at {values.min() / 1e3:.4g} kPa), {expected}; "
            "a vented muscle holds about 101 kPa absolute"
        )
    if _implausible(topic, values, values > MAX_PRESSURE, f"lie above {MAX_PRESSURE / 1e6:g} MPa", issues):
        raise BadInput(f"{where}: {topic} has values up to {values.max():.4g}, {expected}, {MAX_PRESSURE:g} at most")


def check_voltage(where: str, topic: str, voltage: Floats, issues: list[str]) -> None:
    """Refuse voltages outside the valves' range.

    Args:
        voltage: (N, 2) [V].
    """
    values = _finite(where, topic, "voltage", voltage)
    odd = (values < MIN_VOLTAGE) | (values > MAX_VOLTAGE)
    if _implausible(topic, values, odd, "lie outside 0 to 10 V", issues):
        top = float(np.quantile(np.abs(values), 0.99))
        unit = "" if top <= 24.0 else ", which looks like percent" if top <= 100.0 else ", which looks like mV"
        raise BadInput(
            f"{where}: {topic} has values from {values.min():.4g} to {values.max():.4g}{unit}, expected 0 to 10 V"
        )


def unwrapped(angle: Floats, turn: float) -> Floats:
    """Readings of an absolute encoder without jumps, moved by whole turns to lie around 0.

    Args:
        angle: readings (N,), NaN where missing [any unit].
        turn: after how much the encoder begins again, in the same unit.
    """
    known = np.isfinite(angle)
    out = angle.copy()
    if np.any(known):
        steady = np.unwrap(angle[known], period=turn)
        out[known] = steady - turn * np.rint(np.median(steady) / turn)
    return out


def turns(angle: Floats, turn: float) -> int:
    """Number of places at which an absolute encoder begins again; 0 where the readings are not those of one.

    Args:
        angle: readings (N,), NaN where missing [any unit].
        turn: after how much the encoder begins again, in the same unit.
    """
    values = angle[np.isfinite(angle)]
    jumps = np.abs(np.diff(values)) > _JUMP * turn
    return int(np.count_nonzero(jumps)) if len(values) and np.ptp(values) <= turn * (1.0 + 1e-3) else 0


def check_angle(where: str, topic: str, angle: Floats, issues: list[str]) -> None:
    """Refuse an angle in degrees, and one that jumps by a turn.

    Args:
        angle: (N,) [rad].
    """
    values = angle[np.isfinite(angle)]
    if turns(values, 2.0 * np.pi):
        raise BadInput(
            f"{where}: the position on {topic} goes from {values.min():.4g} to {values.max():.4g} rad and jumps by a "
            "turn, as of an absolute encoder, expected an angle without jumps; type --unwrap-angle"
        )
    if _implausible(topic, values, np.abs(values) > MAX_ANGLE, f"lie beyond {MAX_ANGLE:g} rad", issues):
        raise BadInput(
            f"{where}: the position on {topic} goes from {values.min():.4g} to {values.max():.4g}, which looks like "
            "degrees, expected rad"
        )


def check_torque(where: str, topic: str, torque: Floats, issues: list[str]) -> None:
    """Refuse a torque in N mm.

    Args:
        torque: (N,) [N m].
    """
    values = torque[np.isfinite(torque)]
    if _implausible(topic, values, np.abs(values) > MAX_TORQUE, f"lie beyond {MAX_TORQUE:g} N m", issues):
        raise BadInput(
            f"{where}: the torque on {topic} goes from {values.min():.4g} to {values.max():.4g}, which looks like "
            "N mm, expected N m"
        )


def _finite(where: str, topic: str, what: str, values: Floats) -> Floats:
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        raise BadInput(f"{where}: {topic} holds no finite {what} in {len(values)} messages")
    return np.asarray(finite)
