"""Values that are implausible in their declared unit, and the unit that they look like.

:mod:`~pam_antagonist.recording.plausible` defines the plausible ranges. This module searches other units in which the
same numbers would be plausible.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from . import plausible
from .units import UNITS

Floats = NDArray[np.float64]

STANDARD_ATMOSPHERE = 101_325.0
"""[Pa]"""
_PRESSURIZED = 15e3  # [Pa] above the atmosphere; a muscle that never exceeds this was not used
_USUAL_PRESSURE = 300e3  # [Pa] above the atmosphere
_USUAL_ANGLE = math.radians(20.0)
_STILL = math.radians(0.5)


@dataclass(frozen=True, eq=False)
class Signal:
    """Numbers of a CSV column.

    Attributes:
        values: (N,) in the unit, NaN where missing.
    """

    label: str
    values: Floats
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


def check_pressures(where: str, first: Signal, second: Signal, atmosphere: float, issues: list[str]) -> None:
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
            plausible.check_pressure(where, signal.label, values, issues)
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
        f"{plausible.MIN_PRESSURE / 1e3:g} to {plausible.MAX_PRESSURE / 1e3:g} kPa absolute"
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
            if gauge >= _PRESSURIZED and _passes(plausible.check_pressure, values):
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


def check_angle(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse an angle beyond half a turn, and one that jumps by a turn."""
    factor = UNITS["angle"][signal.unit]
    try:
        plausible.check_angle(where, signal.label, signal.values * factor, issues)
        if plausible.turns(signal.values * factor, math.pi):
            raise BadInput("half turns")
    except BadInput:
        hint = _absolute_encoder(signal)
        if not hint:
            hint = _looks_like(signal, "angle", plausible.check_angle, _USUAL_ANGLE)
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
            if plausible.turns(finite, part) and np.ptp(plausible.unwrapped(finite, part)) <= 0.5 * turn:
                other = "" if unit == signal.unit else f"unit: {unit}, "
                return f"; it jumps as an absolute encoder that begins again: give {other}wraps: {part:.7g}"
    if len(finite) and plausible.turns(finite, float(np.ptp(finite))):
        return (
            f"; it jumps by {np.abs(np.diff(finite)).max():.4g} {signal.unit} from one row to the next: of an absolute "
            "encoder give scale and wraps, after how much it begins again"
        )
    return ""


def check_torque(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse a torque beyond ``plausible.MAX_TORQUE``."""
    try:
        plausible.check_torque(where, signal.label, signal.values * UNITS["torque"][signal.unit], issues)
    except BadInput:
        hint = _looks_like(signal, "torque", plausible.check_torque, 2.0)
        raise BadInput(
            f"{where}: {signal.label} goes from {signal.span}, expected up to {plausible.MAX_TORQUE:g} N m{hint}"
        ) from None


def check_voltage(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse voltages outside 0 to 10 V, and millivolts that are too small to move a valve."""
    volt = signal.values * UNITS["voltage"][signal.unit]
    finite = volt[np.isfinite(volt)]
    if not len(finite):
        raise BadInput(f"{where}: {signal.label} holds no value in {len(volt)} rows")
    try:
        plausible.check_voltage(where, signal.label, volt, issues)
        tiny = signal.unit != "V" and 0.0 < np.abs(finite).max() < 0.05
    except BadInput:
        tiny = True
    if tiny:
        hint = _looks_like(signal, "voltage", plausible.check_voltage, 5.0)
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
