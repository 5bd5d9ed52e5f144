"""The judge of plausibility: values in SI units, and numbers in a declared unit with the unit that they look like.

A few implausible values are outliers. They are counted and kept, because the estimator gates them. More than one in a
thousand (and more than five) means that the recording is in another unit; it is refused. ``check_`` takes values of a
bag in SI units. ``judge_`` takes numbers of a table in their declared unit, and looks for another unit that fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from .units import UNITS

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
    """Values with NaN for everything that is not finite. `values`: any numbers (N,) or (N, 2)."""
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
    """Refuse values that are no absolute pressures in Pa. `pressure`: (N, 2) [Pa]."""
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
    """Refuse voltages outside the valves' range. `voltage`: (N, 2) [V]."""
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

    `angle`: readings (N,), NaN where missing [any unit]. `turn`: after how much the encoder begins again, in the same
    unit.
    """
    known = np.isfinite(angle)
    out = angle.copy()
    if np.any(known):
        steady = np.unwrap(angle[known], period=turn)
        out[known] = steady - turn * np.rint(np.median(steady) / turn)
    return out


def turns(angle: Floats, turn: float) -> int:
    """Number of places at which an absolute encoder begins again; 0 where the readings are not those of one.

    `angle`: readings (N,), NaN where missing [any unit]. `turn`: after how much the encoder begins again, in the same
    unit.
    """
    values = angle[np.isfinite(angle)]
    jumps = np.abs(np.diff(values)) > _JUMP * turn
    return int(np.count_nonzero(jumps)) if len(values) and np.ptp(values) <= turn * (1.0 + 1e-3) else 0


def check_angle(where: str, topic: str, angle: Floats, issues: list[str]) -> None:
    """Refuse an angle in degrees, and one that jumps by a turn. `angle`: (N,) [rad]."""
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
    """Refuse a torque in N mm. `torque`: (N,) [N m]."""
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


STANDARD_ATMOSPHERE = 101_325.0
"""[Pa]"""
_PRESSURIZED = 15e3  # [Pa] above the atmosphere; a muscle that never exceeds this was not used
_USUAL_PRESSURE = 300e3  # [Pa] above the atmosphere
_USUAL_ANGLE = math.radians(20.0)
_STILL = math.radians(0.5)


@dataclass(frozen=True, eq=False)
class Signal:
    """Numbers of a CSV column."""

    label: str
    values: Floats  # (N,) in the unit, NaN where missing
    unit: str
    reference: str = ""

    @property
    def span(self) -> str:
        """Lowest and highest value, with the unit as declared."""
        finite = self.values[np.isfinite(self.values)]
        return f"{finite.min():.4g} to {finite.max():.4g} {self.unit}" + (
            f" {self.reference}" if self.reference else ""
        )


def pascal(values: Floats, unit: str, reference: str, atmosphere: float) -> Floats:
    """Absolute pressure [Pa] of values in a unit.

    Args:
        values: (N,) in the unit.
        reference: ``absolute`` or ``gauge``.
        atmosphere: absolute pressure of the surroundings [Pa].
    """
    return np.asarray(values * UNITS["pressure"][unit] + (atmosphere if reference == "gauge" else 0.0))


def judge_pressures(where: str, first: Signal, second: Signal, atmosphere: float, issues: list[str]) -> None:
    """Refuse pressures that no muscle can have, or that leave both muscles slack.

    Args:
        first: Pressure of muscle 1 as declared.
        second: Pressure of muscle 2.
        atmosphere: Absolute pressure of the surroundings [Pa].
        issues: Gets sentences about single odd values and a muscle that is never pressurised.
    """
    slack = []
    for signal in (first, second):
        values = pascal(signal.values, signal.unit, signal.reference, atmosphere)
        try:
            check_pressure(where, signal.label, values, issues)
        except BadInput:
            raise BadInput(_pressure_message(where, signal, values, atmosphere)) from None
        if _top(values) - atmosphere < _PRESSURIZED:
            slack.append((signal, values))
    # One vented muscle is possible, unless its unit differs from the other muscle's and another unit fits. Two are not.
    own_unit = (first.unit, first.reference) != (second.unit, second.reference)
    if len(slack) == 2 or (slack and own_unit and _other_pressure(slack[0][0], atmosphere)):
        raise BadInput(_pressure_message(where, *slack[0], atmosphere))
    for signal, _ in slack:
        issues.append(f"{signal.label} stays at the atmosphere's pressure, {signal.span}: was it never filled?")


def _pressure_message(where: str, signal: Signal, values: Floats, atmosphere: float) -> str:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return f"{where}: {signal.label} holds no value in {len(values)} rows"
    text = (
        f"{where}: {signal.label} goes from {signal.span}, which makes {finite.min() / 1e3:.4g} to "
        f"{finite.max() / 1e3:.4g} kPa absolute, expected the pressures of a filled muscle, "
        f"{MIN_PRESSURE / 1e3:g} to {MAX_PRESSURE / 1e3:g} kPa absolute"
    )
    other = _other_pressure(signal, atmosphere)
    if other:
        return f"{text}; {_top(signal.values):.3g} looks like {other}"
    return text + ("" if np.any(finite != finite[0]) else "; it is the same throughout: is the sensor connected?")


def _other_pressure(signal: Signal, atmosphere: float) -> str:
    """Another unit or reference in which the numbers are pressures of a filled muscle; "" for none."""
    fits: dict[tuple[str, str], float] = {}
    for unit in UNITS["pressure"]:
        for reference in ("gauge", "absolute"):
            values = pascal(signal.values, unit, reference, atmosphere)
            gauge = _top(values) - atmosphere
            if gauge >= _PRESSURIZED and _passes(check_pressure, values):
                fits[unit, reference] = abs(math.log(gauge / _USUAL_PRESSURE))
    # The most likely mistake first: the other reference, then another unit, then both.
    for chosen in (
        [fit for fit in fits if fit[0] == signal.unit and fit[1] != signal.reference],
        [fit for fit in fits if fit[0] != signal.unit and fit[1] == signal.reference],
        [fit for fit in fits if fit[0] != signal.unit],
    ):
        if chosen:
            unit, reference = min(chosen, key=lambda fit: fits[fit])
            return f"{reference} pressure" if unit == signal.unit else unit
    return ""


def judge_angle(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse an angle beyond half a turn, and one that jumps by a turn."""
    factor = UNITS["angle"][signal.unit]
    try:
        check_angle(where, signal.label, signal.values * factor, issues)
        if turns(signal.values * factor, math.pi):
            raise BadInput("half turns")
    except BadInput:
        hint = _absolute_encoder(signal)
        if not hint:
            hint = _looks_like(signal, "angle", check_angle, _USUAL_ANGLE)
            if not hint or signal.unit == "deg":  # many encoders count degrees from another zero
                hint += "; give offset if the sensor counts from elsewhere"
        raise BadInput(
            f"{where}: {signal.label} goes from {signal.span}, expected within half a turn of 0, where the muscles are "
            f"equally long{hint}"
        ) from None
    finite = signal.values[np.isfinite(signal.values)]
    if signal.unit == "deg" and len(finite) and np.ptp(finite) * factor < _STILL and np.ptp(finite) > _STILL:
        issues.append(f"{signal.label} goes from {signal.span}: a locked joint? {np.ptp(finite):.3g} could be rad")


def _absolute_encoder(signal: Signal) -> str:
    """The hint to give ``wraps``, where the readings jump as those of an encoder that begins again."""
    finite = signal.values[np.isfinite(signal.values)]
    for unit in (signal.unit, *UNITS["angle"]):
        turn = 2.0 * math.pi / UNITS["angle"][unit]
        for part in (turn, 0.5 * turn):
            if turns(finite, part) and np.ptp(unwrapped(finite, part)) <= 0.5 * turn:
                other = "" if unit == signal.unit else f"unit: {unit}, "
                return f"; it jumps as an absolute encoder that begins again: give {other}wraps: {part:.7g}"
    if len(finite) and turns(finite, float(np.ptp(finite))):
        return (
            f"; it jumps by {np.abs(np.diff(finite)).max():.4g} {signal.unit} from one row to the next: of an absolute "
            "encoder give scale and wraps, after how much it begins again"
        )
    return ""


def judge_torque(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse a torque beyond ``MAX_TORQUE``."""
    try:
        check_torque(where, signal.label, signal.values * UNITS["torque"][signal.unit], issues)
    except BadInput:
        hint = _looks_like(signal, "torque", check_torque, 2.0)
        raise BadInput(
            f"{where}: {signal.label} goes from {signal.span}, expected up to {MAX_TORQUE:g} N m{hint}"
        ) from None


def judge_voltage(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse voltages outside 0 to 10 V, and millivolts that are too small to move a valve."""
    volt = signal.values * UNITS["voltage"][signal.unit]
    finite = volt[np.isfinite(volt)]
    if not len(finite):
        raise BadInput(f"{where}: {signal.label} holds no value in {len(volt)} rows")
    try:
        check_voltage(where, signal.label, volt, issues)
        tiny = signal.unit != "V" and 0.0 < np.abs(finite).max() < 0.05
    except BadInput:
        tiny = True
    if tiny:
        hint = _looks_like(signal, "voltage", check_voltage, 5.0)
        if signal.unit == "V" and 24.0 < _top(np.abs(volt)) <= 100.0:
            hint = f"; {_top(np.abs(volt)):.3g} looks like percent: give scale: 0.1"
        raise BadInput(
            f"{where}: {signal.label} goes from {signal.span}, expected 0 to 10 V"
            f"{hint or '; give scale and offset where a column holds something else, such as percent'}"
        )


def _looks_like(signal: Signal, quantity: str, check: Callable[..., None], usual: float) -> str:
    """The hint "; 366 looks like kPa", or "" where the numbers are implausible in every unit."""
    top = _top(np.abs(signal.values))
    fits = {
        unit: abs(math.log(top * factor / usual))
        for unit, factor in UNITS[quantity].items()
        if unit != signal.unit and top > 0.0 and _passes(check, signal.values * factor)
    }
    return f"; {top:.3g} looks like {min(fits, key=lambda unit: fits[unit])}" if fits else ""


def _passes(check: Callable[..., None], values: Floats) -> bool:
    try:
        check("", "", values, [])
    except BadInput:
        return False
    return True


def _top(values: Floats) -> float:
    """99 % quantile of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, 0.99)) if len(finite) else math.nan
