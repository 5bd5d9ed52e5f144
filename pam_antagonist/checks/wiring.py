"""Units and wiring: the fewest corrections with which all measurements agree with the model.

Each pressure follows its own valve or the other one. The ratio of the pressures to the model's gives the unit, their
difference shows gauge pressures. The signs of angle and torque then show whether pressure lines, valves or a sensor's
sign are exchanged.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.checks.prediction import Prediction, correlation, range_of, ratio_to
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.units import UNITS
from pam_antagonist.recording.wrong_unit import STANDARD_ATMOSPHERE

Floats = NDArray[np.float64]
Status = Literal["wrong", "doubtful", "good", "untested"]

# Thresholds. On the 30 recordings of rig A the correlation of the model's pressures is at least 0.996 with the measured
# ones and at most 0.65 with those of the other muscle; their ratio is 0.91 to 1.02. All are far from the bounds.
GOES_WITH = 0.9
"""Least correlation of a channel that agrees with the model."""
_LEAST_CONTRAST = 0.15
"""Least difference of the correlations of the two arrangements, to decide for one."""
_SAME_UNIT = 1.6
"""A channel has the right unit if its ratio to the model is within this factor of 1."""
GAUGE_TOLERANCE = 25e3
"""[Pa] Tolerance of the offset of gauge pressures, one atmosphere, for errors of the rig file."""
FAR_OFF = 40e3
"""[Pa] Pressures that differ more from the model's do not fit the rig file."""
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
    """

    status: Status
    text: str
    options: tuple[str, ...] = ()


def arrangement(recording: Recording, model: Prediction) -> tuple[list[Finding], bool | None]:
    """Findings, and whether each pressure follows the other muscle's valve (None: it follows neither)."""
    straight, crossed = (
        min(correlation(recording.pressure[model.rows, (i + shift) % 2], model.pressure[:, i]) for i in (0, 1))
        for shift in (0, 1)
    )
    better, worse = max(straight, crossed), min(straight, crossed)
    if better < GOES_WITH:
        text = (
            f"the pressures do not follow the voltages as in this rig (correlation {better:.3f}, expected "
            f"{GOES_WITH:g} or more): the recording is of another rig, or its voltages are shifted in time"
        )
        return [Finding("doubtful", text)], None
    if better - worse < _LEAST_CONTRAST:
        text = "both valves had the same voltages, so exchanged valves or pressure lines are not tested"
        return [Finding("untested", text)], False
    if straight >= crossed:
        return [Finding("good", f"each pressure follows its own valve (correlation {straight:.3f})")], False
    return [], True


def pressure_unit_of(pressures: Floats, model: Prediction, now: Corrections) -> tuple[list[Finding], Corrections]:
    """Unit and reference of the pressures, by their ratio to the model's and the remaining offset.

    Args:
        pressures: as recorded, in an unknown unit, in the order of the valves (K, 2).
        model: the model's prediction.
        now: corrections so far.
    """
    ratio = float(np.sqrt(np.prod([ratio_to(pressures[:, i], model.pressure[:, i]) for i in (0, 1)])))
    unit, factor = min(UNITS["pressure"].items(), key=lambda item: abs(math.log(item[1] * ratio)))
    offset = np.nanmean(pressures * factor - model.pressure, axis=0)
    if max(factor * ratio, 1.0 / (factor * ratio)) > _SAME_UNIT or np.max(np.abs(offset)) > _ANY_PRESSURE:
        text = (
            f"the pressures change {ratio:.3g} times as much as the model's, and no unit has this factor: check the "
            "pressure sensors and supply.pressure"
        )
        return [Finding("doubtful", text)], now
    found = replace(now, pressure_unit=unit)
    gauge = bool(np.all(np.abs(offset + STANDARD_ATMOSPHERE) < GAUGE_TOLERANCE))
    out = []
    if unit != "Pa":
        options = tuple(replace(Corrections(), pressure_unit=unit).options())
        out.append(Finding("wrong", f"the pressures are in {unit}, not in Pa (sure)", options))
    if gauge:
        found = replace(found, gauge=True)
        left = float(np.sqrt(np.nanmean((pressures * factor + STANDARD_ATMOSPHERE - model.pressure) ** 2)))
        text = (
            f"both pressures are {-offset[0] / 1e3:.0f} and {-offset[1] / 1e3:.0f} kPa lower than the voltages make "
            f"them: these are gauge pressures. With 101.325 kPa added they differ by {left / 1e3:.1f} kPa (sure)"
        )
        out.append(Finding("wrong", text, ("--gauge",)))
    elif np.max(np.abs(offset)) > FAR_OFF:
        text = (
            f"pressures 1 and 2 differ by {offset[0] / 1e3:+.0f} and {offset[1] / 1e3:+.0f} kPa from what the "
            "voltages make them: check supply.pressure, the valve curves and the sensors' zeros"
        )
        out.append(Finding("doubtful", text))
    if not out:
        out.append(Finding("good", "the pressures are absolute, in Pa"))
    return out, found


@dataclass(frozen=True)
class Direction:
    """Sign and size of a measured channel relative to the model.

    Attributes:
        channel: ``angle`` or ``torque``.
        sign: 1 or -1, of the correlation with the model.
        ratio: standard deviation over the model's [-].
    """

    channel: str
    sign: int
    ratio: float


def directions_of(recording: Recording, model: Prediction, now: Corrections, joint: str) -> list[Direction]:
    """Sign and size of angle and torque relative to the model, where they correlate with it.

    Args:
        recording: without corrections.
        model: the model's prediction for it.
        now: the corrections so far.
        joint: ``free`` or ``locked``.
    """
    out = []
    if joint == "free" and recording.angle is not None and range_of(model.angle) > STILL_ANGLE:
        out.append(("angle", now.angle(recording.angle[model.rows]), model.angle))
    if recording.torque is not None:
        out.append(("torque", now.torque(recording.torque[model.rows]), model.torque))
    found = []
    for channel, values, expected in out:
        rho = correlation(values, expected)
        if abs(rho) >= GOES_WITH:
            found.append(Direction(channel, 1 if rho > 0.0 else -1, ratio_to(values, expected)))
    return found


def which_is_exchanged(
    exchanged: bool, directions: Sequence[Direction], now: Corrections
) -> tuple[list[Finding], Corrections]:
    """The fewest corrections with which pressures, angle and torque agree with the model.

    Exchanged pressure lines do not change the signs of angle and torque; exchanged valves reverse both.

    Args:
        exchanged: whether each pressure follows the other muscle's valve.
        directions: of the measured channels.
        now: corrections so far.
    """
    fitting = []
    for lines, valves, *flips in itertools.product((False, True), repeat=2 + len(directions)):
        signs = [(-1 if valves else 1) * (-1 if flip else 1) for flip in flips]
        if lines != valves if exchanged else lines == valves:
            if all(direction.sign == sign for direction, sign in zip(directions, signs, strict=True)):
                flipped: dict[str, Any] = {
                    f"flip_{d.channel}": True for d, flip in zip(directions, flips, strict=True) if flip
                }
                fitting.append(replace(now, swap_pressures=lines, swap_valves=valves, **flipped))
    fewest = min(len(option.options()) for option in fitting)
    best = [option for option in fitting if len(option.options()) == fewest]
    findings = []
    for direction in directions:
        findings += _unit_of(direction)
    units: dict[str, Any] = {f"{d.channel}_unit": _nearest_unit(d)[0] for d in directions if _nearest_unit(d)[1]}
    chosen = replace(best[0], **{name: unit for name, unit in units.items() if unit})
    changed = [[o for o in option.options() if o not in now.options()] for option in best]
    if not any(changed):
        seen = " and ".join(d.channel for d in directions)
        if seen:
            findings.append(Finding("good", f"{seen} turn{'s' if len(directions) == 1 else ''} as the voltages say"))
        return findings, chosen
    what = "; or ".join(_in_words(options) for options in changed)
    seen = "each pressure follows the other muscle's valve" if exchanged else "each pressure follows its own valve"
    turns = ", ".join(f"{d.channel} {'as' if d.sign > 0 else 'against'} the voltages" for d in directions)
    sure = " (sure)" if len(best) == 1 else " (these recordings cannot tell which)"
    text = f"{what}: {seen}{f'; {turns}' if turns else ''}{sure}"
    options = tuple(changed[0]) if len(best) == 1 else ()
    if len(best) > 1:
        text += f"; type {' or '.join(' '.join(options) for options in changed)}"
        chosen = replace(now, **{name: unit for name, unit in units.items() if unit})
    return [*findings, Finding("wrong", text, options)], chosen


_WORDS = {
    "--swap-pressures": "the pressure lines are exchanged",
    "--swap-valves": "the valves are exchanged",
    "--flip-angle": "the encoder counts the wrong way round",
    "--flip-torque": "the torque meter counts the wrong way round",
}


def _in_words(options: Sequence[str]) -> str:
    return " and ".join(_WORDS[option] for option in options if option in _WORDS)


def _nearest_unit(direction: Direction) -> tuple[str, bool]:
    """The nearest unit of a channel, and whether the channel is in it and not in rad or N m."""
    unit, factor = min(UNITS[direction.channel].items(), key=lambda item: abs(math.log(item[1] * direction.ratio)))
    off = factor * direction.ratio
    base = "rad" if direction.channel == "angle" else "N m"
    # Within a factor of 1.6 the unit is rad or N m: the rig file may have such an error.
    if max(direction.ratio, 1.0 / direction.ratio) <= _SAME_UNIT:
        return base, False
    return unit, max(off, 1.0 / off) <= _SAME_UNIT


def _unit_of(direction: Direction) -> list[Finding]:
    unit, other = _nearest_unit(direction)
    if other:
        text = (
            f"the measured {direction.channel} is in {unit} ({direction.ratio:.3g} times as large as the model's; sure)"
        )
        return [Finding("wrong", text, (f"--{direction.channel}-unit {unit!r}",))]
    if max(direction.ratio, 1.0 / direction.ratio) > _SAME_UNIT:
        text = (
            f"the measured {direction.channel} is {direction.ratio:.3g} times as large as the model's, and no unit "
            "has this factor: check geometry.radius and the force map"
        )
        return [Finding("doubtful", text)]
    return []


def fits(corrected: Recording, model: Prediction) -> list[Finding]:
    """RMS difference of the corrected pressures from the model's; a large one means another rig."""
    left = np.sqrt(np.nanmean((corrected.pressure[model.rows] - model.pressure) ** 2, axis=0))
    text = f"the model, driven by the voltages, is {left[0] / 1e3:.1f} and {left[1] / 1e3:.1f} kPa off (RMS)"
    if np.max(left) > FAR_OFF:
        return [Finding("doubtful", f"{text}: is this a recording of this rig?")]
    return [Finding("good", text)]
