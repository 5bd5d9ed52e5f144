"""Units, and the judge of plausibility: whether numbers can be pressures, voltages, angles or torques in their unit.

It judges bags, tables, arrays of Python and what ``check`` reads alike. A few implausible values are outliers. They are
counted and kept, because the estimator gates them. More than one in a thousand (and more than five) means that the
numbers are in another unit; they are refused with the unit that they look like.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..estimation.possible import MOST_VOLTS

Floats = NDArray[np.float64]

# psi: one pound-force (0.45359237 kg at 9.80665 m/s²) on a square inch (0.0254 m); exact by definition, like lbf.
_POUND_FORCE = 0.45359237 * 9.80665
_TABLE = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "pressure": {
        "Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "mbar": 1e2, "bar": 1e5, "psi": _POUND_FORCE / 0.0254**2,
    },
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0, "rev": 2.0 * math.pi},
    "torque": {
        "N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "mN m": 1e-3, "kgf cm": 9.80665e-2, "lbf in": _POUND_FORCE * 0.0254,
    },
    "temperature": {"degC": 1.0},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254},
    "volume": {"m3": 1.0, "dm3": 1e-3, "l": 1e-3, "cm3": 1e-6, "ml": 1e-6, "mm3": 1e-9},
    "mass": {"kg": 1.0, "g": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "kgf": 9.80665, "lbf": _POUND_FORCE},
    "inertia": {"kg m2": 1.0, "kg cm2": 1e-4, "kg mm2": 1e-6, "g m2": 1e-3, "g cm2": 1e-7, "g mm2": 1e-9},
    "flow": {"l/min": 1.0, "l/h": 1.0 / 60.0, "m3/h": 1e3 / 60.0},
    "rate": {"Hz": 1.0, "kHz": 1e3, "1/s": 1.0},
    "share": {"%": 1.0, "percent": 1.0},
    "bits": {"bits": 1.0, "bit": 1.0},
}  # fmt: skip

UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {quantity: MappingProxyType(units) for quantity, units in _TABLE.items()}
)
"""Quantity -> unit -> its value in SI units (s, Pa, rad, N m, V, m, m³, kg, N, kg m², Hz), else in the first unit."""

_ALIASES = {"°": "deg", "degrees": "deg", "degree": "deg", "L": "l", "mL": "ml", "L/min": "l/min"}
_SPELT = str.maketrans({"²": "2", "³": "3", "^": None, "µ": "u", "μ": "u", **dict.fromkeys(" ·⋅*.-\u00a0")})


def canonical(where: str, quantity: str, unit: str) -> str:
    """A unit spelt as in ``UNITS``; spaces and dots between the parts of a product are ignored.

    Upper and lower case matter: MPa is not mPa.

    `quantity`: a key of ``UNITS``.
    """
    known = UNITS[quantity]
    bare = {_bare(name): name for name in known}
    text = _bare(_ALIASES.get(unit.strip(), unit))
    if text in bare:
        return bare[text]
    lower = {name.lower(): name for name in bare}
    close = difflib.get_close_matches(text.lower(), lower, 1, cutoff=0.6)
    hint = f"; did you mean {bare[lower[close[0]]]}?" if close else ""
    raise BadInput(f"{where}: unknown unit {unit[:40]!r} of {quantity}, expected one of {', '.join(known)}{hint}")


def _bare(unit: str) -> str:
    return unit.translate(_SPELT)


class _Range(NamedTuple):
    """Plausible values of a quantity, in SI units."""

    low: float
    high: float
    usual: float  # a typical value: of several units that fit, the one is named that comes nearest to it
    odd: str  # where outliers lie
    expected: str  # what was expected, in words


MIN_PRESSURE, MAX_PRESSURE = 50e3, 2e6
"""[Pa] Absolute: a vented muscle holds the atmosphere's pressure, 54 kPa at 5,000 m; muscles work up to 0.9 MPa."""
_BELOW = 0.8
"""Least possible pressure of a muscle, by the atmosphere's where that is stated: a vented one, read with an error."""
STANDARD_ATMOSPHERE = 101_325.0
"""[Pa]"""
_RANGES = {
    "pressure": _Range(
        MIN_PRESSURE,
        MAX_PRESSURE,
        300e3,
        "outside {low:.3g} to 2000 kPa absolute",
        "the pressures of a filled muscle, {low:.3g} to 2000 kPa absolute",
    ),
    # Valves take 0 to 10 V, a bipolar amplifier before them -10 to 10 V; a measured voltage has an error.
    "voltage": _Range(-10.5, 10.5, 5.0, "outside -10 to 10 V", "-10 to 10 V"),
    "angle": _Range(
        -3.2,
        3.2,
        math.radians(20.0),
        "beyond half a turn",
        "within half a turn of 0, where the muscles are equally long",
    ),
    "torque": _Range(-1e3, 1e3, 2.0, "beyond 1000 N m", "up to 1000 N m"),
}
_PRESSURIZED = 15e3  # [Pa] above the atmosphere; a muscle that never exceeds this was not used
_STILL = math.radians(0.5)
_TINY = 0.05  # [V] a voltage in mV that stays below moves no valve
_JUMP = 0.75  # of a turn: a larger move between two rows is none of a joint
NO_VALUE = 1e30  # instruments write a larger number, such as 9.91e37, where there is no value


@dataclass(frozen=True, eq=False)
class Signal:
    """Numbers of one quantity, from a topic of a bag, a column of a table or an array."""

    label: str
    quantity: str  # "pressure", "voltage", "angle", "torque", or another of ``UNITS`` that is only converted
    values: Floats  # (N,) or (N, 2) in the unit, NaN where missing
    unit: str
    reference: str = "absolute"  # of pressures: "absolute" or "gauge"
    atmosphere: float = STANDARD_ATMOSPHERE  # what gauge pressures count from [Pa]
    mapped: bool = False  # whether a map says the unit, which the user can change there
    stated: bool = False  # whether the atmosphere was stated

    def si(self, unit: str = "", reference: str = "") -> Floats:
        """The values in SI units, pressures absolute; as if they were in another unit, where one is given."""
        is_gauge = self.quantity == "pressure" and (reference or self.reference) == "gauge"
        factor = UNITS[self.quantity][unit or self.unit]
        return np.asarray(self.values * factor + (self.atmosphere if is_gauge else 0.0))

    @property
    def range(self) -> _Range:
        """Plausible values. No pressure is far below an atmosphere that was stated."""
        of = _RANGES[self.quantity]
        if self.quantity != "pressure":
            return of
        low = _BELOW * self.atmosphere if self.stated else of.low
        words = {name: getattr(of, name).format(low=low / 1e3) for name in ("odd", "expected")}
        return of._replace(low=low, **words)

    @property
    def finite(self) -> Floats:
        """The values without missing ones."""
        return np.asarray(self.values[np.isfinite(self.values)])

    @property
    def span(self) -> str:
        """Lowest and highest value, with the unit as declared."""
        finite, reference = self.finite, f" {self.reference}" if self.quantity == "pressure" else ""
        return f"{finite.min():.4g} to {finite.max():.4g} {self.unit}{reference}"


def finite_only(label: str, values: Floats, issues: list[str]) -> Floats:
    """Values with NaN for everything that is not finite. `values`: any numbers (N,) or (N, 2)."""
    bad = ~(np.abs(values) < NO_VALUE)
    if not np.any(bad):
        return values
    issues.append(f"{np.count_nonzero(bad)} of {values.size} values of {label} are not finite: left out")
    return np.where(bad, np.nan, values)


def few(count: int, size: int) -> bool:
    """Whether odd values are so rare that they say nothing of the rest."""
    return count <= max(5, 0.001 * size) and 2 * count <= size


def possible(quantity: str, values: Floats) -> bool:
    """Whether numbers in SI units are plausible but for a few; also where there are none."""
    return _possible(_RANGES[quantity], values)


def _possible(of: _Range, values: Floats) -> bool:
    return few(*_odd(of, values))


def _odd(of: _Range, values: Floats) -> tuple[int, int]:
    """Number of implausible values, and of all that are there."""
    known = values[np.isfinite(values)]
    return int(np.count_nonzero((known < of.low) | (known > of.high))), known.size


def judge(where: str, signal: Signal, issues: list[str]) -> None:
    """Refuse numbers that are implausible in their unit; say the few that are outliers.

    Pressures and voltages are needed, so that a signal without any value is refused as well.
    """
    quantity, finite = signal.quantity, signal.finite
    if not finite.size:
        if quantity in ("pressure", "voltage"):
            what = f"value in {len(signal.values)} rows" if signal.mapped else f"finite {quantity}"
            raise BadInput(f"{where}: {signal.label} holds no {what}")
        return
    count, size = _odd(signal.range, signal.si())
    tiny = quantity == "voltage" and signal.unit != "V" and 0.0 < np.nanmax(np.abs(signal.si())) < _TINY
    turning = quantity == "angle" and _turns(signal)
    if not few(count, size) or tiny or turning or _upside_down(signal):
        raise refusal(where, signal)
    if count:
        text = f"{count} of {size} values on {signal.label} lie {signal.range.odd}"
        issues.append(f"{text}: kept, for the estimator to judge")
    if quantity == "angle" and signal.unit == "deg":
        moved = float(np.ptp(finite))
        if math.radians(moved) < _STILL < moved:
            issues.append(f"{signal.label} goes from {signal.span}: a locked joint? {moved:.3g} could be rad")


def _upside_down(signal: Signal) -> bool:
    """Whether voltages are nearly all below 0: an amplifier that gives such ones gives positive ones as well."""
    return signal.quantity == "voltage" and _top(signal.si()) < 0.0


def judge_muscles(where: str, first: Signal, second: Signal, issues: list[str]) -> None:
    """Refuse pressures of two muscles that no muscle can have, or that leave both slack."""
    slack = []
    for signal in (first, second):
        judge(where, signal, issues)
        if _top(signal.si()) - signal.atmosphere < _PRESSURIZED:
            slack.append(signal)
    # One vented muscle is possible, unless its unit differs from the other muscle's and another unit fits. Two are not.
    own_unit = (first.unit, first.reference) != (second.unit, second.reference)
    if len(slack) == 2 or (slack and own_unit and _other_pressure(slack[0])):
        raise refusal(where, slack[0])
    for signal in slack:
        issues.append(f"{signal.label} stays at the atmosphere's pressure, {signal.span}: was it never filled?")


def refusal(where: str, signal: Signal) -> BadInput:
    """What is wrong with implausible numbers, what was expected, and what they look like."""
    quantity, finite, si = signal.quantity, signal.finite, signal.si()[np.isfinite(signal.values)]
    text = f"{where}: {signal.label} goes from {signal.span}"
    if quantity == "pressure":
        text += f", which makes {si.min() / 1e3:.4g} to {si.max() / 1e3:.4g} kPa absolute"
        other = _other_pressure(signal)
        hint = f"; {_top(signal.values):.3g} looks like {other}" if other else ""
        if not hint and np.all(finite == finite[0]):
            hint = "; it is the same throughout: is the sensor connected?"
    elif quantity == "voltage":
        # What is a little beyond the range is a voltage of another valve, and no other unit.
        hint = "" if signal.unit == "V" and _top(np.abs(si)) <= MOST_VOLTS else _looks_like(signal)
        if _upside_down(signal):
            hint = "; none is above 0: is the sign right?"
        if signal.unit == "V" and MOST_VOLTS < _top(np.abs(si)) <= 100.0:
            hint = f"; {_top(np.abs(si)):.3g} looks like percent" + (": give scale: 0.1" if signal.mapped else "")
        if not hint and signal.mapped:
            hint = "; give scale and offset where a column holds something else, such as percent"
    elif quantity == "angle":
        hint = _absolute_encoder(signal) or _looks_like(signal)
        if signal.mapped and not hint.startswith("; it jumps") and (not hint or signal.unit == "deg"):
            hint += "; give offset if the sensor counts from elsewhere"  # many encoders count degrees from another zero
    else:
        hint = _looks_like(signal)
    return BadInput(f"{text}, expected {signal.range.expected}{hint}")


def _other_pressure(signal: Signal) -> str:
    """Another unit or reference in which the numbers are pressures of a filled muscle; "" for none."""
    fits: dict[tuple[str, str], float] = {}
    for unit in UNITS["pressure"]:
        for reference in ("gauge", "absolute"):
            values = signal.si(unit, reference)
            gauge = _top(values) - signal.atmosphere
            if gauge >= _PRESSURIZED and _possible(signal.range, values):
                fits[unit, reference] = abs(math.log(gauge / _RANGES["pressure"].usual))
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


def _looks_like(signal: Signal) -> str:
    """The hint "; 366 looks like kPa", or "" where the numbers are implausible in every unit."""
    top, of = _top(np.abs(signal.values)), _RANGES[signal.quantity]
    fits = {
        unit: abs(math.log(top * factor / of.usual))
        for unit, factor in UNITS[signal.quantity].items()
        if unit != signal.unit and top > 0.0 and possible(signal.quantity, signal.values * factor)
    }
    if not fits:
        return ""
    # Most encoders count degrees.
    usual = "deg" if signal.unit == "rad" and "deg" in fits else min(fits, key=lambda unit: fits[unit])
    return f"; {top:.3g} looks like {usual}"


def _top(values: Floats) -> float:
    """99 % quantile of the finite values; NaN without any."""
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, 0.99)) if len(finite) else math.nan


def unwrapped(angle: Floats, turn: float) -> Floats:
    """Readings of an absolute encoder without jumps, moved by whole turns to lie around 0.

    `angle`: readings (N,), NaN where missing [any unit]. `turn`: after how much the encoder begins again, in that unit.
    """
    known = np.isfinite(angle)
    out = angle.copy()
    if np.any(known):
        steady = np.unwrap(angle[known], period=turn)
        out[known] = steady - turn * np.rint(np.median(steady) / turn)
    return out


def turns(angle: Floats, turn: float) -> int:
    """Number of places at which an absolute encoder begins again; 0 where the readings are not those of one.

    `angle`: readings (N,), NaN where missing [any unit]. `turn`: after how much the encoder begins again, in that unit.
    """
    values = angle[np.isfinite(angle)]
    jumps = np.abs(np.diff(values)) > _JUMP * turn
    return int(np.count_nonzero(jumps)) if len(values) and np.ptp(values) <= turn * (1.0 + 1e-3) else 0


def _turns(signal: Signal) -> bool:
    """Whether an angle jumps by a turn, or by half of one, which only a map can mend."""
    return any(turns(signal.si(), part * math.pi) for part in ((2.0, 1.0) if signal.mapped else (2.0,)))


def _absolute_encoder(signal: Signal) -> str:
    """What to type or to give, where the readings jump as those of an encoder that begins again."""
    finite = signal.finite
    if not signal.mapped:
        jumps = turns(finite, 2.0 * math.pi)
        return "; it jumps by a turn, as an absolute encoder that begins again: type --unwrap-angle" if jumps else ""
    for unit in (signal.unit, *UNITS["angle"]):
        turn = 2.0 * math.pi / UNITS["angle"][unit]
        for part in (turn, 0.5 * turn):
            if turns(finite, part) and np.ptp(unwrapped(finite, part)) <= 0.5 * turn:
                other = "" if unit == signal.unit else f"unit: {unit}, "
                return f"; it jumps as an absolute encoder that begins again: give {other}wraps: {part:.7g}"
    if turns(finite, float(np.ptp(finite))):
        return (
            f"; it jumps by {np.abs(np.diff(finite)).max():.4g} {signal.unit} from one row to the next: of an absolute "
            "encoder give scale and wraps, after how much it begins again"
        )
    return ""
