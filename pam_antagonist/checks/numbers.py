"""Zeros, scale and delays that were given, or are in the rig file: does the recording agree better without them?"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pam_antagonist.checks.prediction import (
    Prediction,
    correlation,
    from_pressures,
    in_steps,
    predicted,
    ratio_to,
    remainder,
    with_other_areas,
)
from pam_antagonist.checks.wiring import GOES_WITH, Finding, guessed
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.plausible import MAX_PRESSURE, MIN_PRESSURE
from pam_antagonist.rig import Rig

_BETTER = 0.5
"""A number makes it wrong if the difference from the model is at most this share without it."""
_ZERO_ANGLE, _ZERO_TORQUE, _SCALE = math.radians(3.0), 0.1, 1.25
"""[rad], [range of the model's torque], [-]: smaller differences from the model may be errors of the rig file."""
_CHANNEL = {"delay_angle": "angle", "delay_torque": "torque"}


def without_delays(
    recording: Recording, rig: Rig, joint: str, lock_angle: float, now: Corrections
) -> tuple[list[Finding], Corrections]:
    """Delays that make it worse, and the corrections without them. `lock_angle`: of a locked joint [rad]."""
    out = []
    for name in ("delay_voltage", "delay_pressure", "delay_angle", "delay_torque"):
        value = getattr(now, name)
        channel = _CHANNEL.get(name)
        if not value or (channel is not None and getattr(recording, channel) is None):
            continue
        other = now.replaced(**{name: 0.0})
        for by_steps in (False, True):
            given, left = (
                _agreement(each, recording, rig, joint, lock_angle, channel, by_steps) for each in (now, other)
            )
            if max(given, left) >= GOES_WITH:
                break
        if 1.0 - left**2 < _BETTER * (1.0 - given**2):
            what = f"the {channel or 'pressures'} agree{'s' * (channel is not None)} better with the model"
            text = f"{what} without the delay of {1e3 * value:.3g} ms (correlation {left:.3f}, with it {given:.3f})"
            out.append(finding(name, now, rig, text))
            now = other
    return out, now


def without_zeros(
    recording: Recording, model: Prediction, rig: Rig, joint: str, now: Corrections
) -> tuple[list[Finding], Corrections]:
    """Zeros and a scale that make it worse, and the corrections without them."""
    out = []
    for name, neutral in (("torque_scale", 1.0), ("encoder_zero", 0.0), ("torque_zero", 0.0)):
        value = getattr(now, name)
        channel = "angle" if name == "encoder_zero" else "torque"
        recorded, expected = getattr(recording, channel), getattr(model, channel)
        if value == neutral or recorded is None or (channel == "angle" and joint == "locked"):
            continue
        other = now.replaced(**{name: neutral})
        given, left = (getattr(each, channel)(recorded[model.rows]) for each in (now, other))
        if not np.isfinite(given - expected).any():
            continue
        if name == "torque_scale":
            sizes = [ratio_to(values, expected) for values in (given, left)]
            wrong = [abs(math.log(max(size, 1e-300))) for size in sizes]
            bound, shown = math.log(_SCALE), [f"{size:.3g} times the model's" for size in sizes]
        else:
            sizes = [float(np.nanmean(values - expected)) for values in (given, left)]
            wrong = [abs(size) for size in sizes]
            bound = (
                _ZERO_ANGLE if channel == "angle" else _ZERO_TORQUE * float(np.nanmax(expected) - np.nanmin(expected))
            )
            shown = [f"{np.degrees(s):+.1f} deg off" if channel == "angle" else f"{s:+.3g} N m off" for s in sizes]
        if wrong[0] > bound and wrong[1] <= _BETTER * wrong[0]:
            text = f"the {channel} is {shown[0]} on average, and {shown[1]} without the {name.replace('_', ' ')} of "
            size = math.degrees(value) if channel == "angle" else value
            out.append(finding(name, now, rig, f"{text}{size:.3g}{' deg' * (channel == 'angle')}"))
            now = other
    return out, now


_CONSTANT = 6.0
"""A difference from the model is constant if its mean is so many times as large as its standard deviation. That of an
encoder with a wrong zero has 80, that of muscles which are counted the other way round 4."""


def constant_error(
    timed: Recording, model: Prediction, rig: Rig, joint: str, now: Corrections
) -> tuple[list[Finding], Corrections]:
    """A zero that is missing: angle or torque differ from the model by the same at each sample."""
    for name, channel in (("encoder_zero", "angle"), ("torque_zero", "torque")):
        recorded, expected = getattr(timed, channel), getattr(model, channel)
        if recorded is None or (channel == "angle" and joint == "locked"):
            continue
        apart = getattr(now, channel)(recorded[model.rows]) - expected
        if not np.isfinite(apart).any():
            continue
        mean, std = float(np.nanmean(apart)), float(np.nanstd(apart))
        least = _ZERO_ANGLE if channel == "angle" else _ZERO_TORQUE * float(np.nanmax(expected) - np.nanmin(expected))
        if abs(mean) <= max(least, _CONSTANT * std):
            continue
        scale, unit = (math.degrees(1.0), "°") if channel == "angle" else (now.torque_scale, " N m")
        found = now.replaced(**{name: getattr(now, name) + mean * (1.0 if channel == "angle" else now.torque_scale)})
        sensor = "encoder reads" if channel == "angle" else "torque meter reads"
        text = (
            f"the measured {channel} differs from the model's by the same at each sample, "
            f"{mean * scale:+.3g}{unit} (± {std * scale:.2g}{unit}): the {sensor} {abs(mean) * scale:.3g}{unit} too "
            f"{'high' if mean > 0.0 else 'low'} (sure)"
        )
        if channel == "angle" and rig.joint.stop is not None and abs(mean) > rig.joint.stop:
            text = text.replace(" (sure)", f", beyond the rig's stop of {math.degrees(rig.joint.stop):.3g}° (sure)")
        option = Corrections().replaced(**{name: getattr(found, name)}).options()
        # The model's torque is that at the measured angle: one zero at a time.
        return [Finding("wrong", text, tuple(option))], found
    return [], now


def finding(name: str, now: Corrections, rig: Rig, text: str) -> Finding:
    """That a number makes it worse, and where it comes from: the command line, or the rig file.

    `name`: of the number, a field of ``Corrections``.
    """
    value = getattr(now, name)
    if value == dict(rig.calibration).get(name):
        return Finding("doubtful", f"{text}: it is calibration.{name} of the rig file")
    return Finding("doubtful", text, (), tuple(Corrections().replaced(**{name: value}).options()))


def delays_of(now: Corrections) -> Corrections:
    """Only the delays of corrections."""
    delays = {name: value for name, value in now.calibration().items() if name.startswith("delay_")}
    return Corrections().replaced(**delays)


def without_calibration(now: Corrections, rig: Rig) -> Corrections:
    """Corrections without those that the rig file has anyway, for the command line."""
    known, default = dict(rig.calibration), Corrections()
    return now.replaced(**{name: getattr(default, name) for name in known if getattr(now, name) == known[name]})


def _agreement(
    now: Corrections, recording: Recording, rig: Rig, joint: str, lock_angle: float, channel: str | None, by_steps: bool
) -> float:
    """Best correlation of the pressures, or magnitude of that of another channel, with the model.

    By steps, the model of the pressures begins anew at measured ones, and that of angle and torque rests under them.
    """
    delayed = delays_of(now).arranged(recording)
    pascal = replace(delayed, pressure=now.pressure(delayed.pressure))
    if by_steps and channel is None:
        steps = [in_steps(pascal, rig, joint, lock_angle, crossed) for crossed in (False, True)]
        return max(min(correlation(one[:, i], other[:, i]) for i in (0, 1)) for one, other in steps)
    if by_steps:
        model = from_pressures(pascal, rig, joint, lock_angle)
    else:
        known_start = MIN_PRESSURE <= float(np.nanmedian(pascal.pressure)) <= MAX_PRESSURE
        model = predicted(pascal, rig, joint, lock_angle, known_start)
    if channel is None:
        return max(
            min(correlation(delayed.pressure[model.rows, (i + shift) % 2], model.pressure[:, i]) for i in (0, 1))
            for shift in (0, 1)
        )
    return abs(correlation(getattr(delayed, channel)[model.rows], getattr(model, channel)))


_LATE = 0.010
"""[s] Smaller delays may be errors of the valve model."""
_LATE_SHARE = 0.3
"""Least share of the pressures' difference from the model that a delay must explain. On rig A a delay of 22 ms
explained 0.42 to 0.62, effects of other kinds at most 0.20."""


def delay_of_voltages(
    corrected: Recording, rig: Rig, model: Prediction, joint: str, lock_angle: float, now: Corrections
) -> tuple[list[Finding], Corrections]:
    """Delay of the pressures against the voltages, separated from the effect of wrong orifice areas.

    The pressures' difference from the model is regressed on the rate of the model's pressures, the effect of each
    orifice area, the pressure itself and a constant. The coefficient of the rate is the delay.

    `lock_angle`: of a locked joint [rad].
    """
    moved = [
        predicted(corrected, other, joint, lock_angle, known_start=True).pressure - model.pressure
        for other in with_other_areas(rig)
    ]
    delays, weights, shares = [], [], []
    for i in (0, 1):
        residual = corrected.pressure[model.rows, i] - model.pressure[:, i]
        other = np.column_stack([*(m[:, i] for m in moved[2 * i : 2 * i + 2]), model.pressure[:, i],
                                 np.ones(len(residual))])  # fmt: skip
        known = np.isfinite(residual)
        rate = -model.pressure_rate[:, i]
        base = remainder(other[known], residual[known])
        alone = remainder(other[known], rate[known])
        if not np.any(alone):
            continue
        delay = float(alone @ base / (alone @ alone))
        left = base - delay * alone
        delays.append(delay)
        weights.append(float(alone @ alone) / max(float(left @ left), 1e-12))
        shares.append(1.0 - float(left @ left) / max(float(base @ base), 1e-12))
    if not delays:
        return [Finding("untested", "delays are not tested, since the pressures do not move")], now
    delay = float(np.average(delays, weights=weights))
    apart = float(np.ptp(delays)) / 2.0
    size = f"{1e3 * delay:.1f} ± {1e3 * max(apart, 0.0005):.1f} ms"
    if abs(delay) + 2.0 * apart < _LATE and not guessed(rig):
        text = (
            f"no delay between the stamps of voltages and pressures ({size}; less than {1e3 * _LATE:.0f} ms expected)"
        )
        return [Finding("good", text)], now
    told = abs(delay) >= max(_LATE, 2.0 * apart) and min(shares) >= _LATE_SHARE
    if guessed(rig):
        text = (
            f"the pressures come {size} later than the model's: stamps cannot be told from the speed of the valves in "
        )
        text += "the rig file, which was never identified"
        return [Finding("doubtful" if told else "untested", text)], now
    if not told:
        text = f"a delay of the pressures cannot be told from other errors of the model: {size} would explain "
        text += (
            f"{100.0 * max(min(shares), 0.0):.0f} % of their difference, expected {100.0 * _LATE_SHARE:.0f} % or more"
        )
        return [Finding("untested", text)], now
    found = replace(now, delay_voltage=round(now.delay_voltage + delay, 3))
    options = tuple(replace(Corrections(), delay_voltage=found.delay_voltage).options())
    remaining = found.delay_voltage - now.delay_pressure
    # A large delay is measured only roughly: it is left out where less than half of it remains without.
    given = replace(Corrections(), delay_voltage=now.delay_voltage, delay_pressure=now.delay_pressure).options()
    if given and abs(remaining) < max(_LATE, 0.5 * abs(now.delay_voltage - now.delay_pressure)):
        text = f"the pressures come {1e3 * abs(delay):.0f} ms {'later' if delay > 0.0 else 'earlier'} than the model's "
        text += f"with the given delays, and about {1e3 * abs(remaining):.0f} ms without them"
        return [Finding("doubtful", text, (), tuple(given))], replace(now, delay_voltage=0.0, delay_pressure=0.0)
    if delay > 0.0:
        text = (
            f"the pressures come {1e3 * delay:.0f} ± {1e3 * max(apart, 0.0005):.0f} ms later than the model's: the "
            "voltages are stamped too early, or the valves are slow. If the stamps are wrong, type the correction; "
            "`close_loop` compares both explanations"
        )
    else:
        text = (
            f"the pressures come {-1e3 * delay:.0f} ms before the voltages that cause them: the voltages are stamped "
            "too late"
        )
    # A positive delay is not applied automatically, because a slow valve looks the same.
    return [Finding("doubtful", text, options)], now if delay > 0.0 else found
