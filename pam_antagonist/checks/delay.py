"""Delay between the stamps of the voltages and of the pressures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pam_antagonist.checks.prediction import Prediction, predicted, remainder, with_other_areas
from pam_antagonist.checks.wiring import Finding, guessed
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import Rig

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

    Args:
        joint: ``free`` or ``locked``.
        lock_angle: of a locked joint [rad].
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
