"""Check the commands of a joint with pressure regulators."""

from __future__ import annotations

import numpy as np

from pam_antagonist.checks.wiring import Finding
from pam_antagonist.recording import Recording
from pam_antagonist.recording.plausible import MIN_PRESSURE
from pam_antagonist.recording.units import UNITS
from pam_antagonist.rig import Rig

_SATURATED = 0.02
"""Larger shares of samples beyond the range are reported: the regulators' output for them is not known."""
_SLACK = 1.0
"""[Pa] Rounding of a command at the end of the range."""


def commands(recording: Recording, rig: Rig) -> list[Finding]:
    """Unit, range and origin of the commands; nothing for a rig with valves."""
    if rig.drive == "valve":
        return []
    unit = _unit(recording)
    if unit:
        return [Finding("wrong", f"the commanded pressures are in {unit}, expected absolute pressures in Pa (sure)")]
    out = []
    for muscle in recording.logged_commands:
        number = muscle + 1
        text = (
            f"pressure_{number} is what regulator {number} was asked for, sample by sample: the command was logged in "
            "the place of the measured pressure (sure)"
        )
        out.append(Finding("wrong", text))
    low, high = rig.command_limits
    beyond = (recording.voltage < low - _SLACK) | (recording.voltage > high + _SLACK)
    share = float(np.mean(beyond.any(axis=1)))
    if share > _SATURATED:
        text = (
            f"commands lie beyond the regulators' range, {low / 1e3:.0f} to {high / 1e3:.0f} kPa absolute, in "
            f"{100 * share:.0f} % of the samples: are these gauge pressures, or is regulator_limits wrong?"
        )
        out.append(Finding("doubtful", text))
    text = (
        f"the commanded pressures lie within the regulators' range, {low / 1e3:.0f} to {high / 1e3:.0f} kPa absolute "
        f"(beyond it: {100.0 * share:.2g} % of the samples, {100.0 * _SATURATED:g} at most)"
    )
    return out or [Finding("good", text)]


def _unit(recording: Recording) -> str:
    """The apparent unit of the commands; empty for Pa."""
    top = float(np.nanquantile(np.abs(recording.voltage), 0.99))
    measured = float(np.nanquantile(np.abs(recording.pressure), 0.99))
    if top >= MIN_PRESSURE or not top > 0.0:
        return ""
    # The unit in which commands and measured pressures agree best.
    return min(UNITS["pressure"], key=lambda unit: abs(np.log(top * UNITS["pressure"][unit] / max(measured, 1.0))))
