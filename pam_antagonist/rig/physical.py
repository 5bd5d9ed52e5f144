"""What follows from several values of a rig: whether they are physical, how far the joint may go, where it rests."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from pam_antagonist.model import dynamics, equilibrium, flow, muscle
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE, places
from pam_antagonist.model.effects.base import SIGNALS
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.rig import learned
from pam_antagonist.rig.schema import Rig, limits
from pam_antagonist.shown import few
from pam_antagonist.strict_yaml import unknown

_LEAST_EXPONENT = 0.2
"""Of the pressure's change by the volume's, where no regulator holds the pressure."""
_LEAST_VOLUME, _LARGEST_VOLUME = 1e-7, 1e-2
RANGE_WITHOUT_STOP = math.radians(25.0)
"""[rad] Range of the angle, to both sides, over which a joint without a stop is checked."""
_QUICKEST = 0.5 * par.LONGEST_STEP
"""[s] Least time constant, for any sample period: a Runge-Kutta step diverges beyond 2.8 time constants."""
_FAINT, _MORE = 1.0, 10.0
"""Noise in [Pa] that only low-passed readings have; largest ratio of the tuning's variance to the sensor's [-]."""
_LINEAR = 0.75
"""Share of a value by which a change lowers it as it is; larger ones bring it nearer to 0, but never there."""
_BEYOND = math.radians(1.0)
"""[rad] A correct estimate does not get so far beyond the mechanical stop."""
_REST_SHARE = (450.0 - 101.3) / (710.0 - 101.3)
"""[-] Pressure at rest as a share of the supply's gauge pressure: 450 of 710 kPa absolute, as in the paper."""


def is_positive(name: str) -> bool:
    """Whether a parameter is positive in any rig: all are, except those of volume, force map and effects."""
    return ".force." not in name and ".volume." not in name and not name.startswith("effects.")


def varied(name: str, value: float, change: float) -> float:
    """A value of a rig after a change by its uncertainty, as the sigma points of the filter have it.

    What cannot be negative stays above 0, however uncertain it is: v + c down to a quarter of v, and below it the
    curve v/(16 (−c/v − ½)), which continues it without a corner.
    """
    if value < 0.0 or value + change >= (1.0 - _LINEAR) * value or limits(name)[0] < 0.0:
        return value + change
    return (1.0 - _LINEAR) ** 2 * value * value / (-change - (2.0 * _LINEAR - 1.0) * value)


def unphysical(rig: Rig) -> str:
    """What is wrong with a rig, as far as single fields cannot show it, in one line; empty if nothing is."""
    checks = (
        _bad_limits, _bad_curves, _bad_effects, _bad_laws, _bad_regulators, _bad_muscles, _bad_spreads, _bad_bounds,
        _in_kilopascal, _bad_tunings,
    )  # fmt: skip
    return next((complaint for check in checks for complaint in check(rig)), "")


def _bad_limits(rig: Rig) -> Iterator[str]:
    if rig.supply.pressure <= rig.atmosphere.pressure * 1.2:
        yield (
            f"supply.pressure {rig.supply.pressure:g} Pa: expected an absolute pressure well above "
            f"atmosphere.pressure, {rig.atmosphere.pressure:g} Pa"
        )
    if len(rig.signals) > SIGNALS:
        yield f"signals: {len(rig.signals)} of them, expected at most {SIGNALS}"
    if rig.drive != "regulator" and rig.gas.polytropic_volume <= _LEAST_EXPONENT:
        yield f"gas.polytropic_volume {rig.gas.polytropic_volume:g}: expected above {_LEAST_EXPONENT:g}"
    low, high = rig.valves.voltage_min, rig.valves.voltage_max
    if low >= high:
        yield f"valves.voltage_min {low:g} V: expected below voltage_max, {high:g} V"


def _bad_tunings(rig: Rig) -> Iterator[str]:
    for name, tuning in rig.tunings.items():
        numbers = np.array([*tuning.initial, *tuning.process, *tuning.measurement])
        for state in tuning.states:
            if state not in par.SLOT_OF:
                yield f"tunings.{name}.states: unknown {state!r}, expected one of {', '.join(par.SLOT_OF)}"
        numbers = np.concatenate([numbers, *(np.array(pair) for pair in tuning.states.values())])
        if not (np.all(np.isfinite(numbers)) and np.all(numbers >= 0.0) and min(tuning.measurement) > 0.0):
            yield f"tunings.{name}: expected variances, finite and not negative, those of the measurement above 0"
    if "default" not in rig.tunings:
        yield "tunings: expected one that is called 'default'"
    if not np.all(np.isfinite(rig.parameters()[par.LOCKED :])):
        yield "gas: these constants give no finite flow"


def _bad_laws(rig: Rig) -> Iterator[str]:
    """Check that no learned law stands at valves that the rig does not have: it would do nothing."""
    if rig.drive == "valve" and not rig.valves.sealed:
        return
    for number, law in learned.laws_of(rig).items():
        if places.TABLE[law.place].part == places.VALVES:
            what = "is sealed" if rig.valves.sealed else "has pressure regulators"
            yield f"effects.learned.law{number}: place {law.place}, but the rig {what}; expected another one"


def _bad_regulators(rig: Rig) -> Iterator[str]:
    """Check that a rig has the dynamics of its regulators, and only a rig with regulators."""
    given = [name for name in rig.effects if name.startswith("regulator_")]
    if rig.drive == "valve":
        if given:
            yield f"effects.{given[0]}: the rig has valves; expected drive: regulator with it"
        return
    if not all(rig.value(f"effects.regulator_lag.frequency_{i}") > 0.0 for i in (1, 2)):
        yield (
            "effects.regulator_lag is missing, which says how quickly the regulators follow; expected, for example "
            "for 9 Hz and a damping ratio of 0.33, regulator_lag: {frequency_1: 56.0, frequency_2: 56.0, damping: "
            "0.33}"
        )
    low, high = rig.command_limits
    if not low < high:
        yield f"effects.regulator_limits: {low:g} to {high:g} Pa, expected lowest below highest"


def _bad_muscles(rig: Rig) -> Iterator[str]:
    """Check volume and force map over the joint's range, with the functions of the model."""
    p = rig.parameters()
    bound = angle_range(rig)
    for i, name in enumerate(("muscle_1", "muscle_2")):
        force = getattr(rig, name).force
        for key in FORMS[rig.model.force].positive:
            if not (value := getattr(force, key)) > 0.0:
                yield f"{name}.force.{key}: {value:g}, expected above 0 with model.force: {rig.model.force}"
        for angle in (-bound, 0.0, bound):
            travel, _, _ = muscle.leverage(angle, p)
            length = muscle.length(i, travel, p)
            volume, _ = muscle.volume(i, length, p)
            if not _LEAST_VOLUME < volume < _LARGEST_VOLUME:
                yield (
                    f"{name}.volume gives {volume:.3g} m³ at a length of {length:g} m: expected {_LEAST_VOLUME:g} "
                    f"to {_LARGEST_VOLUME:g} m³ within the joint's range"
                )
        length, pressure = rig.geometry.length, 3.0 * rig.atmosphere.pressure
        rise = (muscle.force(i, length, pressure + 1e3, p) - muscle.force(i, length, pressure, p)) / 1e3
        if not 1e-7 < rise < 0.1:
            yield (
                f"{name}.force gives dF/dP = {rise:.3g} m² at geometry.length: expected 1e-7 to 0.1 m² "
                f"(force in N over absolute pressure in Pa; form {rig.model.force!r})"
            )


def _bad_effects(rig: Rig) -> Iterator[str]:
    for name, values in rig.effects.items():
        if name not in CATALOGUE:
            yield f"effects: {unknown(name, CATALOGUE)}; expected one of {', '.join(CATALOGUE)}"
        known = {item.name: item for item in CATALOGUE[name].parameters}
        for key, value in values.items():
            if key not in known:
                yield f"effects.{name}: {unknown(key, known)}; expected one of {few(list(known))}"
            item = known[key]
            if not item.low <= value <= item.high:
                yield (
                    f"effects.{name}.{key}: {value:g}, expected {item.low:g} to {item.high:g} {item.unit} "
                    f"({item.meaning})"
                )
        yield from _too_quick(name, values)
    if complaint := learned.complaint_about(rig.effects.get("learned", {}), list(rig.signals)):
        yield complaint
    pushes = rig.effects.get(DISTURBANCE, {})
    if "onset" in pushes and "prior" not in pushes:
        yield (
            f"effects.{DISTURBANCE}.onset is given without a prior: expected prior as well, the standard deviation of "
            "the pushes in N m"
        )


def _in_kilopascal(rig: Rig) -> Iterator[str]:
    """Check the unit of the pressure noise: below a pascal, but with a much larger variance in the tuning, is kPa."""
    std, tuning = rig.sensors.pressure_std, rig.tunings.get("default")
    if tuning is None or std >= _FAINT or max(tuning.measurement) <= _MORE * rig.sensors.error("pressure") ** 2:
        return
    yield (
        f"sensors.pressure_std: {std:g}, expected a standard deviation in [Pa]: tunings.default.measurement allows for "
        f"{math.sqrt(max(tuning.measurement)):.3g} Pa"
    )


def _bad_bounds(rig: Rig) -> Iterator[str]:
    for name, (low, high) in rig.bounds.items():
        if name not in par.INDEX:
            yield f"bounds: {unknown(name, par.INDEX)}"
        if not low <= rig.value(name) <= high or low == high:
            yield f"bounds of {name}: {low:g} to {high:g}, expected a range that holds its value, {rig.value(name):g}"
        if is_positive(name) and low < 0.0:
            yield f"bounds of {name}: {low:g}, expected 0 or more, since it cannot be negative"


def _too_quick(name: str, values: Mapping[str, float]) -> Iterator[str]:
    """Check the time constants of a present effect, neutral ones included: an integration step must follow them."""
    items = CATALOGUE[name].parameters
    if not any(item.is_size and values.get(item.name, 0.0) != 0.0 for item in items):
        return
    for item in items:
        value = values.get(item.name, item.neutral)
        if item.unit == "s" and 0.0 < value < _QUICKEST:
            yield (
                f"effects.{name}.{item.name}: {value:g} s, expected at least {_QUICKEST:g} s"
                f"{', or 0 for none' if item.is_size else ''}: one step of the integration would not follow it"
            )


def _bad_spreads(rig: Rig) -> Iterator[str]:
    """Check standard deviations of parameters: known names, and sizes that a positive parameter may have."""
    sections = [("uncertainty", rig.uncertainty), ("priors", rig.priors)]
    sections += [(f"directions.{name}", changes) for name, changes in rig.directions.items()]
    for section, spreads in sections:
        for name, std in spreads.items():
            if name not in par.INDEX or name == "friction.time_step":
                yield f"{section}: {unknown(name, par.INDEX).replace('unknown', 'unknown parameter', 1)}"
            signed = section.startswith("directions")
            if not (math.isfinite(std) and (signed or std > 0.0)):
                yield f"{section} of {name}: {std:g}, expected a standard deviation above 0"
            if section == "uncertainty" and is_positive(name) and std > rig.value(name):
                yield (
                    f"{section} of {name}: {std:g}, expected at most its value, {rig.value(name):g}, since it cannot "
                    "be negative"
                )


def _bad_curves(rig: Rig) -> Iterator[str]:
    for where, curve in (("valve_1.curve", rig.valve_1.curve), ("valve_2.curve", rig.valve_2.curve)):
        voltage, rate = np.array(curve.voltage), np.array(curve.open_rate)
        if not 2 <= len(voltage) <= par.MAX_KNOTS:
            yield f"{where}: {len(voltage)} points, expected 2 to {par.MAX_KNOTS}"
        if len(voltage) != len(rate):
            yield f"{where}: {len(voltage)} voltages but {len(rate)} open rates"
        if not (np.all(np.isfinite(voltage)) and np.all(np.diff(voltage) > 0.0)):
            yield f"{where}.voltage: expected increasing values [V]"
        if not (np.all(np.diff(rate) >= 0.0) and rate[0] >= 0.0 and rate[-1] <= 1.0):
            yield f"{where}.open_rate: expected values from 0 to 1 that do not decrease"


def angle_range(rig: Rig) -> float:
    """Largest angle to either side [rad]: the mechanical stop; without one, the range that is checked."""
    return RANGE_WITHOUT_STOP if rig.joint.stop is None else rig.joint.stop


def stop_angle(rig: Rig) -> float:
    """Estimated angle to either side beyond which a controller stops the joint [rad]."""
    return angle_range(rig) + _BEYOND


def largest_torque(rig: Rig) -> float:
    """Torque at angle 0 with the supply's pressure in one muscle and none in the other, the larger of both [N m]."""
    p, (low, high) = rig.parameters("locked", 0.0), _pressures(rig)
    at_rest = np.array([*(flow.voltage_for(i, 0.5, p) for i in (0, 1)), 0.0])
    ways = [equilibrium.initial_state(0.0, *pair, at_rest, p) for pair in ((high, low), (low, high))]
    return max(abs(float(dynamics.torque(x, p))) for x in ways)


def rest_pressure(rig: Rig) -> float:
    """Absolute pressure of both muscles at rest [Pa]."""
    low, high = _pressures(rig)
    return float(round(low + _REST_SHARE * (high - low))) if rig.drive == "valve" else 0.5 * (low + high)


def vented(rig: Rig) -> tuple[float, tuple[float, float]]:
    """Least pressure that the muscles can have [Pa], and the commands (2,) that let the air out."""
    low = rig.command_limits[0]
    return _pressures(rig)[0], (low, low)


def rest_voltage(rig: Rig) -> tuple[float, float]:
    """Voltages (2,) at which the valves keep the pressure at rest [V], to a hundredth of a volt."""
    low, high = rig.valves.voltage_min, rig.valves.voltage_max
    first, second = (round(min(max(u, low), high), 2) for u in steady_voltage(rig, rest_pressure(rig)))
    return first, second


def steady_voltage(rig: Rig, pressure: float) -> tuple[float, float]:
    """Voltages (2,) [V] under which both muscles keep a pressure [Pa], by the valves' law (5).

    In the steady state as much flows in as out: the orifice areas play no part. A valve that is closed in the middle
    keeps any pressure there.
    """
    p = rig.parameters()
    supply = p[par.SUPPLY]
    first, second = (float(flow.voltage_for(i, flow.open_rate_for(i, 0.0, pressure, supply, p), p)) for i in (0, 1))
    return first, second


def _pressures(rig: Rig) -> tuple[float, float]:
    """Least and largest pressure that the muscles can have [Pa]."""
    return (rig.atmosphere.pressure, rig.supply.pressure) if rig.drive == "valve" else rig.command_limits
