"""Units and wiring: the fewest corrections with which all measurements agree with the model.

Each pressure follows its own valve or the other one. The ratio of the pressures to the model's gives the unit, their
difference shows gauge pressures. The signs of angle and torque then show whether pressure lines, valves or a sensor's
sign are exchanged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.checks.prediction import STEP_S, Prediction, correlation, in_steps, ratio_to
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.joint import range_of
from pam_antagonist.recording.plausible import UNITS
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
_NONE = Corrections()
Status = Literal["wrong", "doubtful", "good", "untested"]

# Thresholds. On the 30 recordings of rig A the correlation of the model's pressures is at least 0.996 with the measured
# ones and at most 0.65 with those of the other muscle; their ratio is 0.91 to 1.02. All are far from the bounds.
GOES_WITH = 0.9
"""Least correlation of a channel that agrees with the model."""
_LEAST_CONTRAST = 0.15
"""Least difference of the correlations of the two arrangements, to decide for one."""
_STEP_GOES_WITH = 0.6
"""Least correlation of the pressures' changes over short steps. On 16 recordings of two guessed rigs with closed-centre
valves it is 0.75 or more with the own valve and 0.1 or less with the other, on rig A 0.99 with the own."""
_SAME_UNIT = 1.6
"""A channel has the right unit if its ratio to the model is within this factor of 1, for a rig that is known."""
GAUGE_TOLERANCE = 25e3
"""[Pa] Tolerance of the offset of gauge pressures, one atmosphere, for errors of the rig file."""
NEAR, FAR_OFF = 20e3, 40e3
"""[Pa] Pressures within the first bound of the model's fit the rig file; beyond the second one they may be of another
rig. With effects that the rig file lacks, those of rig A differ by up to 43 kPa, most by less than 15 kPa."""
_ANY_PRESSURE = 250e3
"""[Pa] Largest difference from the model's pressures in the right unit, also for gauge pressures."""
STILL_ANGLE = math.radians(0.3)
"""[rad] A joint that moves less counts as still."""


@dataclass(frozen=True)
class Finding:
    """Result of one test.

    Attributes:
        status: ``wrong`` (certain), ``doubtful``, ``good`` or ``untested``.
        text: the observation, and how certain it is.
        options: command line options that correct it; empty where there are none.
        leave_out: command line options that were given and make it wrong.
    """

    status: Status
    text: str
    options: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()

    @property
    def todo(self) -> str:
        """What to change on the command line; empty where nothing is known."""
        parts = [f"{word} {' '.join(options)}" for word, options in
                 (("leave out", self.leave_out), ("type", self.options)) if options]  # fmt: skip
        return " and ".join(parts)


def guessed(rig: Rig) -> bool:
    """Whether a rig was never identified: its file has priors, standard deviations before that, of muscles or valves.

    Nothing is certain that follows from a comparison with the model of such a rig.
    """
    return not rig.identified and any(name.startswith(("muscle_", "valve_")) for name in rig.priors)


def unit_tolerance(rig: Rig, quantity: str) -> float:
    """Factor by which a channel may differ from the model although its unit is right.

    A rig file that was not identified says how well it knows its muscles and valves: by that much more.

    `quantity`: ``pressure``, ``angle`` or ``torque``.
    """
    stds = rig.uncertainty if rig.identified else {**rig.uncertainty, **rig.priors}
    names = ("inflow_area", "outflow_area") if quantity == "pressure" else ("force.v1", "force.c1")
    shares = [std / abs(rig.value(name)) for name, std in stds.items() if name.endswith(names) and rig.value(name)]
    return _SAME_UNIT * (1.0 + max(shares, default=0.0))


@dataclass(frozen=True)
class Arrangement:
    """Which pressure follows which valve."""

    findings: tuple[Finding, ...]
    exchanged: bool | None  # whether each pressure follows the other muscle's valve; None: it follows neither
    # whether only short steps from measured pressures show it, since the model drifts from the voltages.
    by_steps: bool = False


def arrangement(
    recording: Recording, model: Prediction, rig: Rig, joint: str, lock_angle: float, typed: Corrections
) -> Arrangement:
    """Which pressure follows which valve, over the whole recording or, where the model drifts, over short steps.

    `lock_angle`: of a locked joint [rad]. `typed`: gives the unit of the pressures, from which the short steps begin.
    """
    free = [
        min(correlation(recording.pressure[model.rows, (i + shift) % 2], model.pressure[:, i]) for i in (0, 1))
        for shift in (0, 1)
    ]
    by_voltages = _decided(free, f"expected {GOES_WITH:g} or more")
    follows = max(free) >= GOES_WITH
    # Valves that are shut in the middle leave a pressure to an integrator, which sums up the errors of a guess.
    if follows and not (guessed(rig) and max(rig.valve_1.overlap, rig.valve_2.overlap) > 0.0):
        return by_voltages
    pascal = replace(recording, pressure=typed.pressure(recording.pressure))
    steps = []
    for crossed in (False, True):
        measured, simulated = in_steps(pascal, rig, joint, lock_angle, crossed)
        steps.append(min(correlation(measured[:, i], simulated[:, i]) for i in (0, 1)))
    if max(steps) >= _STEP_GOES_WITH and abs(steps[0] - steps[1]) >= _LEAST_CONTRAST:
        found = _decided(
            steps, f"{_STEP_GOES_WITH:g} or more, in steps of {STEP_S:g} s that begin at measured pressures"
        )
        text = (
            "valves that are closed in the middle let the model's pressures drift away from the measured ones, and "
            "this rig file was never identified"
            if follows
            else "from the voltages alone, the model's pressures drift away from the measured ones (correlation "
            f"{max(free):.3f}, expected {GOES_WITH:g} or more), as with valves that are closed in the middle, or "
            "with a guessed valve curve"
        )
        rest = "gauge pressures, delays and errors of the pressures are not tested, the rest by the measured pressures"
        return Arrangement((*found.findings, Finding("untested", f"{text}: {rest}")), found.exchanged, True)
    if follows:
        return by_voltages
    text = (
        f"the pressures do not follow the voltages as in this rig, neither over the whole recording (correlation "
        f"{max(free):.3f}, expected {GOES_WITH:g} or more) nor in steps of {STEP_S:g} s (correlation {max(steps):.3f}, "
        f"expected {_STEP_GOES_WITH:g} or more)"
    )
    why = "the recording is of another rig, or its voltages are shifted in time"
    if guessed(rig):
        why += ", or the guessed valves of this rig file are too far off, since it was never identified"
    return Arrangement((Finding("doubtful", f"{text}: {why}"),), None, True)


def _decided(correlations: Sequence[float], expected: str) -> Arrangement:
    straight, crossed = correlations
    if abs(straight - crossed) < _LEAST_CONTRAST:
        text = "both valves had the same voltages, so exchanged valves or pressure lines are not tested"
        return Arrangement((Finding("untested", text),), False)
    if crossed > straight:
        return Arrangement((), True)
    text = f"each pressure follows its own valve (correlation {straight:.3f}, {expected})"
    return Arrangement((Finding("good", text),), False)


def pressure_unit_of(
    pressures: Floats,
    model: Prediction,
    now: Corrections,
    typed: Corrections,
    tolerance: float,
    exchanged: bool,
    in_steps: Callable[[float, float], float],
) -> tuple[list[Finding], Corrections]:
    """Unit and reference of the pressures, by their ratio to the model's and the remaining offset.

    The offset alone decides nothing: a valve that is closed in its middle lets the model's pressures drift. So short
    steps have to agree.

    `pressures`: as recorded, in an unknown unit, in the order of the valves (K, 2). `exchanged`: whether that is the
    other order than the sensors'. `in_steps`: error of the model [Pa] over short steps that begin at the measured
    pressures, by the factor of their unit and by what is added to them [Pa].
    """
    names = ("pressure_2", "pressure_1") if exchanged else ("pressure_1", "pressure_2")
    ratios = [ratio_to(pressures[:, i], model.pressure[:, i]) for i in (0, 1)]
    each = [_unit_by_ratio("pressure", ratio, typed.pressure_unit, tolerance)[0] for ratio in ratios]
    if all(each) and UNITS["pressure"][each[0]] != UNITS["pressure"][each[1]]:
        pairs = zip(names, each, ratios, strict=True)
        seen = " and ".join(
            f"{name} in {unit} ({ratio:.3g} times as large as the model's)" for name, unit, ratio in pairs
        )
        text = f"{seen}: the two have different units, so no option corrects them; correct the driver of one (sure)"
        return [Finding("wrong", text)], replace(now, pressure_unit=typed.pressure_unit, gauge=typed.gauge)
    ratio = float(np.sqrt(np.prod(ratios)))
    unit, _ = _unit_by_ratio("pressure", ratio, typed.pressure_unit, tolerance)
    offset = np.nanmean(pressures * UNITS["pressure"].get(unit, 1.0) - model.pressure, axis=0)
    if not unit or np.max(np.abs(offset)) > _ANY_PRESSURE:
        sizes = " and ".join(f"{name} changes {one:.3g} times" for name, one in zip(names, ratios, strict=True))
        text = f"{sizes} as much as the model's, and no unit has this factor: check the sensors and supply.pressure"
        return [Finding("doubtful", text)], replace(now, pressure_unit=typed.pressure_unit, gauge=typed.gauge)
    factor = UNITS["pressure"][unit]
    out = _unit_findings("pressure", "the pressures are", unit, typed.pressure_unit)
    air = now.atmosphere
    gauge = bool(np.all(np.abs(offset + air) < GAUGE_TOLERANCE))
    absolute = bool(np.max(np.abs(offset)) <= FAR_OFF)
    if gauge != typed.gauge and (gauge or absolute):
        with_air, as_recorded = in_steps(factor, air), in_steps(factor, 0.0)
        gauge, absolute = gauge and not with_air > as_recorded, absolute and not as_recorded > with_air
    found = replace(now, pressure_unit=unit, gauge=gauge or (typed.gauge and not absolute))
    lower = np.abs(offset + air) < GAUGE_TOLERANCE
    if not typed.gauge and lower.sum() == 1 and np.max(np.abs(offset[~lower])) < GAUGE_TOLERANCE:
        one, other = (names[int(np.flatnonzero(which)[0])] for which in (lower, ~lower))
        text = (
            f"{one} is {abs(float(offset[lower][0])) / 1e3:.0f} kPa lower than the voltages make it, and {other} "
            f"agrees: {one} seems to be gauge pressure and {other} absolute, so no option corrects them; correct one "
            "driver"
        )
        return [*out, Finding("doubtful", text)], found
    off = offset + (air if found.gauge else 0.0)
    differ = f"{off[0] / 1e3:+.0f} and {off[1] / 1e3:+.0f} kPa"
    if gauge and not typed.gauge:
        left = float(np.sqrt(np.nanmean((pressures * factor + air - model.pressure) ** 2)))
        text = (
            f"both pressures are {-offset[0] / 1e3:.0f} and {-offset[1] / 1e3:.0f} kPa lower than the voltages make "
            f"them: these are gauge pressures. With {air / 1e3:.6g} kPa added they differ by {left / 1e3:.1f} kPa "
            "(sure)"
        )
        out.append(Finding("wrong", text, ("--gauge",)))
    elif typed.gauge and absolute:
        text = (
            f"the pressures are absolute as recorded: they differ by {differ} from what the voltages make them (sure)"
        )
        out.append(Finding("wrong", text, (), ("--gauge",)))
    elif np.max(np.abs(off)) > FAR_OFF:
        text = (
            f"pressures 1 and 2 differ by {differ} from what the "
            "voltages make them: check supply.pressure, the valve curves and the sensors' zeros"
            + (" (short steps show that these are no gauge pressures)" if lower.all() and not found.gauge else "")
        )
        out.append(Finding("doubtful", text))
    if not out:
        kind = "gauge pressures" if found.gauge else "absolute"
        text = f"the pressures are {kind}, in {unit}: they differ by {differ} from the model's on average"
        status: Status = "good" if np.max(np.abs(off)) <= NEAR else "untested"
        out.append(Finding(status, f"{text} ({NEAR / 1e3:.0f} at most)"))
    return out, found


def _unit_by_ratio(quantity: str, ratio: float, typed: str, tolerance: float) -> tuple[str, list[str]]:
    """The unit of values that are ``ratio`` times as large as the model's in SI units, and the others that fit.

    The given unit is kept where it fits; without one that fits, the unit is "". The others are those that a model with
    twice the error would have.
    """
    off = {unit: abs(math.log(max(factor * ratio, 1e-300))) for unit, factor in UNITS[quantity].items()}
    fit = sorted((unit for unit in off if off[unit] <= math.log(tolerance)), key=lambda unit: off[unit])
    if typed in fit:
        return typed, []
    base = next(iter(UNITS[quantity]))
    unit = base if base in fit else fit[0] if fit else ""
    factor = UNITS[quantity].get(unit, 1.0)
    return unit, [one for one in off if off[one] <= 2.0 * math.log(tolerance) and UNITS[quantity][one] != factor]


def _unit_findings(quantity: str, what: str, unit: str, typed: str, why: str = "sure") -> list[Finding]:
    """A unit that is not the given one."""
    if unit == typed:
        return []
    given, needed = (tuple(_NONE.replaced(**{f"{quantity}_unit": one}).options()) for one in (typed, unit))
    return [Finding("wrong", f"{what} in {unit}, not in {typed} ({why})", needed, () if needed else given)]


@dataclass(frozen=True)
class SignAndSize:
    """Sign and size of a measured channel relative to the model."""

    channel: str  # ``angle`` or ``torque``
    sign: int  # 1 or -1, of the correlation with the model
    ratio: float  # standard deviation over the model's [-], without a correction of its unit
    correlation: float = 1.0


def directions_of(recording: Recording, model: Prediction, joint: str) -> list[SignAndSize]:
    """Sign and size of angle and torque relative to the model, where they correlate with it."""
    out = []
    if joint == "free" and recording.angle is not None and range_of(model.angle) > STILL_ANGLE:
        out.append(("angle", recording.angle[model.rows], model.angle))
    if recording.torque is not None:
        out.append(("torque", recording.torque[model.rows], model.torque))
    found = []
    for channel, values, expected in out:
        rho = correlation(values, expected)
        if abs(rho) >= GOES_WITH:
            found.append(SignAndSize(channel, 1 if rho > 0.0 else -1, ratio_to(values, expected), abs(rho)))
    return found


_SWITCHES = ("swap_pressures", "swap_valves", "flip_angle", "flip_torque")
_WORDS = {
    "swap_pressures": ("the pressure lines are exchanged", "the pressure lines are not exchanged"),
    "swap_valves": ("the valves are exchanged", "the valves are not exchanged"),
    "flip_angle": ("the encoder counts the wrong way round", "the encoder counts the right way round"),
    "flip_torque": ("the torque meter counts the wrong way round", "the torque meter counts the right way round"),
}
"""What is so where an option is missing, and where it was given in vain."""


def which_is_exchanged(
    arranged: Arrangement, directions: Sequence[SignAndSize], now: Corrections, typed: Corrections
) -> tuple[list[Finding], Corrections]:
    """The corrections with which pressures, angle and torque agree with the model, with the fewest options to type.

    Exchanged pressure lines do not change the signs of angle and torque; exchanged valves reverse both.

    `arranged`: which pressure follows which valve, and whether the measured pressures show the rest. `typed`:
    corrections that the user gave; what they say of channels without a direction is kept.
    """
    exchanged, drive = arranged.exchanged, "measured pressures" if arranged.by_steps else "voltages"
    seen = [f"flip_{direction.channel}" for direction in directions]
    given = {name: getattr(typed, name) for name in _SWITCHES}
    fitting = []
    for lines, valves, *flips in itertools.product((False, True), repeat=2 + len(directions)):
        signs = [(-1 if valves else 1) * (-1 if flip else 1) for flip in flips]
        if (lines != valves) == exchanged and signs == [direction.sign for direction in directions]:
            choice = {"swap_pressures": lines, "swap_valves": valves, **dict(zip(seen, flips, strict=True))}
            fitting.append({**given, **choice})

    def effort(choice: dict[str, bool]) -> tuple[int, int, int]:
        """Options to type, then options to change, then options; nothing where the given ones are right."""
        changes = sum(choice[name] != given[name] for name in _SWITCHES)
        return (
            (sum(choice[name] > given[name] for name in _SWITCHES), changes, sum(choice.values()))
            if changes
            else (-1, 0, 0)
        )

    least = min(effort(choice) for choice in fitting)
    best = [choice for choice in fitting if effort(choice) == least]
    if least[0] < 0:
        names = " and ".join(d.channel for d in directions)
        text = f"{names} turn{'s' if len(directions) == 1 else ''} as the {drive} say (correlation "
        text += f"{', '.join(f'{d.correlation:.3f}' for d in directions)}, expected {GOES_WITH:g} or more)"
        return ([Finding("good", text)] if names else []), replace(now, **best[0])
    changed = [[name for name in _SWITCHES if choice[name] != given[name]] for choice in best]
    what = "; or ".join(" and ".join(_WORDS[name][given[name]] for name in names) for names in changed)
    follows = "each pressure follows the other muscle's valve" if exchanged else "each pressure follows its own valve"
    turns = ", ".join(f"{d.channel} {'as' if d.sign > 0 else 'against'} the {drive}" for d in directions)
    recorded = f"as recorded, {follows}" if any(given.values()) else follows
    text = f"{what}: {recorded}{f'; {turns}' if turns else ''}"
    if len(best) > 1:
        ways = " or ".join(_changes(names, given).todo for names in changed)
        return [Finding("wrong", f"{text} (these recordings cannot tell which); {ways}")], replace(now, **given)
    return [replace(_changes(changed[0], given), text=f"{text} (sure)")], replace(now, **best[0])


def _changes(names: Sequence[str], given: dict[str, bool]) -> Finding:
    """Options to type, and options to leave out, for switches that change."""
    options, leave_out = (
        tuple(_NONE.replaced(**{name: True for name in names if given[name] is was}).options()) for was in (False, True)
    )
    return Finding("wrong", "", options, leave_out)


def unit_of(
    direction: SignAndSize, now: Corrections, typed: Corrections, tolerance: float
) -> tuple[list[Finding], str]:
    """Findings about the unit of angle or torque, and the unit.

    `now`: corrections so far; a unit in them that is not the given one was found by the values alone.
    """
    channel, ratio = direction.channel, direction.ratio
    given, before = getattr(typed, f"{channel}_unit"), getattr(now, f"{channel}_unit")
    if before != given:
        return [], before
    unit, others = _unit_by_ratio(channel, ratio, given, tolerance)
    what = f"the measured {channel} is"
    large = f"{ratio:.3g} times as large as the model's"
    within = f"{1.0 / tolerance:.2g} to {tolerance:.2g} expected"
    if unit == given:
        size = ratio * UNITS[channel][unit]
        return [Finding("good", f"{what} in {unit}, {size:.3g} times as large as the model's ({within})")], unit
    if unit and (not others or unit == next(iter(UNITS[channel]))):
        return _unit_findings(channel, what, unit, given, f"{large}; sure"), unit
    if unit:
        text = f"{what} {large} ({within}): it may be in {' or '.join([unit, *others])}, or the rig file is far off"
        return [Finding("doubtful", text)], given
    base = next(iter(UNITS[channel]))
    twice = min(UNITS[channel], key=lambda name: abs(math.log(ratio / UNITS[channel][name])))
    if twice != base and abs(math.log(ratio / UNITS[channel][twice])) <= math.log(tolerance):
        text = (
            f"{what} {large} ({within}): values in {base} were converted from {twice}, a factor of "
            f"{UNITS[channel][twice]:.3g} (correct its unit in the map of import_csv), or this is a recording of "
            "another rig"
        )
        return [Finding("doubtful", text)], given
    text = f"{what} {large} ({within}), and no unit has this factor: check geometry.radius and the force map"
    return [Finding("doubtful", text)], given


def fits(corrected: Recording, model: Prediction, rig: Rig) -> list[Finding]:
    """RMS difference of the corrected pressures from the model's; a large one means another rig."""
    left = np.sqrt(np.nanmean((corrected.pressure[model.rows] - model.pressure) ** 2, axis=0))
    text = f"the model, driven by the voltages, is {left[0] / 1e3:.1f} and {left[1] / 1e3:.1f} kPa off (RMS"
    if np.max(left) <= NEAR:
        return [Finding("good", f"{text}; {NEAR / 1e3:.0f} at most)")]
    text += f"), expected {NEAR / 1e3:.0f} at most"
    if guessed(rig):
        return [
            Finding("doubtful", f"{text}: the rig file was never identified, or this is a recording of another rig")
        ]
    if np.max(left) > FAR_OFF:
        return [Finding("doubtful", f"{text}: is this a recording of this rig?")]
    return [Finding("doubtful", f"{text}: something acts that the rig file lacks; `close_loop` looks for it")]
