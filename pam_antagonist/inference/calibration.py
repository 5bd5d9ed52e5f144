"""Calibrations of a recording: zeros and a scale of its sensors, and stamps that are too early. They are not effects.

A calibration changes the readings of the sensors and not the joint. It is applied to the model's readings: a zero is
added, a scale multiplies, and a channel with late or early stamps is read at another time. A fit moves calibrations
like the parameters of effects, so that both are compared by the same evidence.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.inference.unknown import Unknown, of_effect
from pam_antagonist.model.effects import EffectParameter
from pam_antagonist.recording.rows import curve

Floats = NDArray[np.float64]

_PREFIX = "calibration."
_CLOCKS = ("voltage", "pressure", "angle", "torque")
_CHANNELS = MappingProxyType({"angle": (ANGLE,), "torque": (TORQUE,), "pressure": (PRESSURE_1, PRESSURE_1 + 1)})


def _item(name: str, unit: str, largest: float, scale: float, meaning: str) -> EffectParameter:
    return EffectParameter(name, unit, 0.0, -largest, largest, scale, meaning)


CALIBRATIONS: Mapping[str, EffectParameter] = MappingProxyType(
    {
        item.name: item
        for item in (
            _item("encoder_zero", "rad", 0.35, 5e-3, "by how much the encoder reads too high"),
            _item("torque_zero", "N m", 20.0, 0.05, "by how much the torque meter reads too high"),
            _item("torque_scale", "-", 0.9, 0.03, "share by which the torque meter reads too high"),
            _item("delay_voltage", "s", 1.0, 4e-3, "by how much the stamps of the voltages are too early"),
            _item("delay_angle", "s", 1.0, 4e-3, "by how much the stamps of the angle are too early"),
            _item("delay_torque", "s", 1.0, 4e-3, "by how much the stamps of the torque are too early"),
            _item("delay_pressure", "s", 1.0, 4e-3, "by how much the stamps of the pressures are too early"),
        )
    }
)
"""All calibrations by name, with units, bounds and scales."""


def path(name: str) -> str:
    """Dotted path of a calibration in a :class:`~pam_antagonist.inference.point.Point`."""
    return _PREFIX + name


def is_calibration(dotted: str) -> bool:
    """Whether a dotted path is a calibration, and not a parameter of an effect."""
    return dotted.startswith(_PREFIX)


def values_of(effects: Mapping[str, float]) -> dict[str, float]:
    """The calibrations of a point, by name."""
    return {dotted[len(_PREFIX) :]: value for dotted, value in effects.items() if is_calibration(dotted)}


def without(effects: Mapping[str, float]) -> dict[str, float]:
    """The values of a point that belong to effects."""
    return {dotted: value for dotted, value in effects.items() if not is_calibration(dotted)}


@dataclass(frozen=True)
class CalibrationCandidate(Candidate):
    """A calibration as a candidate beside the effects; ``effect`` holds its name."""

    @property
    @override
    def free(self) -> tuple[Unknown, ...]:
        return (of_effect((path(self.effect),), CALIBRATIONS[self.effect]),)

    @override
    def grid(self) -> list[dict[str, float]]:
        return [{}]


def candidates(trial: Trial, channels: Iterable[int], taken: Mapping[str, float]) -> tuple[CalibrationCandidate, ...]:
    """Calibrations that a recording can show and that the model does not have yet."""
    compared = set(channels)
    # One of all clocks is the reference and has no delay.
    clocks = sum(name.startswith("delay_") for name in values_of(taken))
    late = clocks < sum(name == "voltage" or not compared.isdisjoint(_CHANNELS[name]) for name in _CLOCKS) - 1
    shown = {
        "encoder_zero": ANGLE in compared or is_lock_measured(trial),
        "torque_zero": TORQUE in compared,
        "torque_scale": TORQUE in compared,
        "delay_voltage": late,
        "delay_angle": late and ANGLE in compared,
        "delay_torque": late and TORQUE in compared,
        "delay_pressure": late and len(compared) > 2,
    }
    return tuple(CalibrationCandidate(name) for name, can in shown.items() if can and path(name) not in taken)


def is_lock_measured(trial: Trial) -> bool:
    """Whether the lock angle of a joint was read from its encoder."""
    angle = trial.measured[:, ANGLE]
    known = angle[np.isfinite(angle)]
    return trial.joint == "locked" and len(known) > 0 and abs(float(np.median(known)) - trial.lock_angle) < _AS_READ


_AS_READ = 2e-3
"""[rad] Tolerance for a lock angle that was read from the encoder, since it is rounded to 0.1°."""


def readings(simulated: Floats, dt: float, values: Mapping[str, float]) -> Floats:
    """Simulated readings of sensors with calibrations.

    Args:
        simulated: readings of exact sensors (N, 4), in the order of ``CHANNELS``.
        dt: sample period [s].

    Returns:
        (N, 4), NaN where a late or early channel would need times before the first sample or after the last.
    """
    if not values:
        return simulated
    out = simulated.copy()
    out[:, ANGLE] += values.get("encoder_zero", 0.0)
    out[:, TORQUE] = values.get("torque_zero", 0.0) + (1.0 + values.get("torque_scale", 0.0)) * out[:, TORQUE]
    time = np.arange(len(out), dtype=np.float64) * dt
    for name, columns in _CHANNELS.items():
        early = values.get(f"delay_{name}", 0.0) - values.get("delay_voltage", 0.0)
        if early:
            for column in columns:
                out[:, column] = curve(time + early, time, out[:, column])
    return out


def corrected(trial: Trial, values: Mapping[str, float]) -> Trial:
    """A recording with these calibrations removed from its readings."""
    if not values:
        return trial
    measured, time = trial.measured.copy(), trial.time
    zero = values.get("encoder_zero", 0.0)
    measured[:, ANGLE] -= zero
    measured[:, TORQUE] = (measured[:, TORQUE] - values.get("torque_zero", 0.0)) / (
        1.0 + values.get("torque_scale", 0.0)
    )
    for name, columns in _CHANNELS.items():
        # By whole samples: interpolation would average the noise, which would then look too small.
        late = round(values.get(f"delay_{name}", 0.0) / trial.dt)
        source = np.clip(np.arange(len(time)) - late, 0, len(time) - 1)
        measured[:, columns] = measured[source][:, columns]
    voltage = trial.voltage
    if values.get("delay_voltage"):
        voltage = np.column_stack([np.interp(time - values["delay_voltage"], time, u) for u in voltage.T])
    lock = trial.lock_angle - (zero if is_lock_measured(trial) else 0.0)
    return replace(trial, measured=measured, voltage=voltage, lock_angle=lock)
