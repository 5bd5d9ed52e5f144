"""Corrections of a recording to the package's conventions: units, gauge pressure, exchanged lines, signs, late stamps.

A recording is corrected while it is read, so that every command sees the same corrected recording. The command line
options are made from the same table.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.recording.plausible import STANDARD_ATMOSPHERE, unwrapped
from pam_antagonist.recording.recording import Recording
from pam_antagonist.recording.rows import slow
from pam_antagonist.recording.stamps import LARGEST_DELAY
from pam_antagonist.recording.units import UNITS, canonical

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Corrections:
    """Changes to a recording before it is used."""

    pressure_unit: str = "Pa"
    gauge: bool = False  # the pressures are gauge pressures; the standard atmosphere is added
    swap_pressures: bool = False  # ``pressure_1`` belongs to muscle 2, and the other way round
    swap_valves: bool = False  # the first voltage belongs to muscle 2's valve, and the other way round
    angle_unit: str = "rad"
    flip_angle: bool = False
    unwrap_angle: bool = False  # the encoder is absolute and begins again after a turn; its jumps are removed
    torque_unit: str = "N m"
    flip_torque: bool = False
    encoder_zero: float = 0.0  # by how much the encoder reads too high [rad]
    torque_zero: float = 0.0  # by how much the torque meter reads too high [N m]
    torque_scale: float = 1.0  # reading of the torque meter over the torque, after its zero is subtracted
    delay_voltage: float = 0.0  # by how much the voltages are stamped too early relative to all other signals [s]
    delay_angle: float = 0.0  # by how much the angle is stamped too early [s]
    delay_torque: float = 0.0  # by how much the torque is stamped too early [s]
    delay_pressure: float = 0.0  # by how much both pressures are stamped too early [s]
    # topics with a clock of their own get the stamps of the pressures' clock, by times of reception.
    align_clocks: bool = False

    def __post_init__(self) -> None:
        for quantity in ("pressure", "angle", "torque"):
            name = f"{quantity}_unit"
            object.__setattr__(self, name, canonical(_option(name), quantity, getattr(self, name)))
        for name, (low, high) in _BOUNDS.items():
            value, typed = getattr(self, name), _TYPED[name]
            if not low <= value <= high:
                raise BadInput(
                    f"{_option(name)} {value / typed.factor:g}: expected {low / typed.factor:g} to "
                    f"{high / typed.factor:g} {typed.unit}".rstrip()
                )

    def pressure(self, values: Floats) -> Floats:
        """Absolute pressure [Pa] of recorded values (N,)."""
        offset = STANDARD_ATMOSPHERE if self.gauge else 0.0
        return np.asarray(values * UNITS["pressure"][self.pressure_unit] + offset)

    def angle(self, values: Floats) -> Floats:
        """Angle [rad] of recorded values (N,)."""
        turned = values * (UNITS["angle"][self.angle_unit] * (-1.0 if self.flip_angle else 1.0))
        turned = unwrapped(turned, 2.0 * np.pi) if self.unwrap_angle else turned
        return np.asarray(turned - self.encoder_zero)

    def torque(self, values: Floats) -> Floats:
        """Torque [N m] of recorded values (N,)."""
        turned = values * (UNITS["torque"][self.torque_unit] * (-1.0 if self.flip_torque else 1.0))
        return np.asarray((turned - self.torque_zero) / self.torque_scale)

    def arranged(self, recording: Recording) -> Recording:
        """A recording with its columns exchanged and its channels delayed as asked; values keep their units.

        Angle and torque are NaN where a delay leaves them without a value; voltages and pressures keep their first one.
        """
        pressure, voltage = recording.pressure, recording.voltage
        if self.swap_pressures:
            pressure = pressure[:, ::-1]
        if self.swap_valves:
            voltage = voltage[:, ::-1]
        if self.delay_voltage:
            # A sample's voltage holds over the step that ends there, so nothing is interpolated.
            late = recording.stamp_ns - round(self.delay_voltage * 1e9)
            source = np.searchsorted(recording.stamp_ns, late, side="left")
            voltage = voltage[np.clip(source, 0, len(recording) - 1)]
        angle, torque, time = recording.angle, recording.torque, recording.time_s
        again = slow(recording) if self.delay_pressure or self.delay_angle or self.delay_torque else {}
        if self.delay_pressure and "pressures" in again:
            # A reading that is shown too early is shown later, in whole rows: the filter uses it once.
            late = recording.stamp_ns - round(self.delay_pressure * 1e9)
            source = np.searchsorted(recording.stamp_ns, late, side="right") - 1
            pressure = pressure[np.clip(source, 0, len(recording) - 1)]
        elif self.delay_pressure:
            held = (_later(time, column, self.delay_pressure, hold=True) for column in pressure.T)
            pressure = np.column_stack(list(held))
        if self.delay_angle and angle is not None:
            angle = _later(time, angle, self.delay_angle, again.get("angle"))
        if self.delay_torque and torque is not None:
            torque = _later(time, torque, self.delay_torque, again.get("torque"))
        return replace(recording, pressure=pressure, voltage=voltage, angle=angle, torque=torque)

    def applied(self, recording: Recording) -> Recording:
        """All corrections of a recording that was read without any."""
        return self.arranged(
            replace(
                recording,
                pressure=self.pressure(recording.pressure),
                angle=None if recording.angle is None else self.angle(recording.angle),
                torque=None if recording.torque is None else self.torque(recording.torque),
            )
        )

    def followed_by(self, further: Corrections) -> Corrections:
        """These corrections, combined with zeros, a scale and delays that were found in the corrected recording.

        `further`: the corrections that were found; all but zeros, scale and delays are ignored.
        """
        delays = {name: getattr(self, name) + getattr(further, name) for name in _TYPED if name.startswith("delay_")}
        return replace(
            self,
            encoder_zero=self.encoder_zero + further.encoder_zero,
            torque_zero=self.torque_zero + self.torque_scale * further.torque_zero,
            torque_scale=self.torque_scale * further.torque_scale,
            **delays,
        )

    def calibration(self) -> dict[str, float]:
        """Only zeros, scale and delays, by name, as in the ``calibration`` of a rig file."""
        return {name: getattr(self, name) for name in _TYPED}

    def options(self) -> list[str]:
        """Command line options for these corrections."""
        out = []
        for item in fields(self):
            value = getattr(self, item.name)
            if value == item.default:
                continue
            if isinstance(value, bool):
                out.append(_option(item.name))
            elif isinstance(value, float):
                out.append(f"{_option(item.name)} {value / _TYPED[item.name].factor:.4g}")
            else:
                out.append(f"{_option(item.name)} {value!r}" if " " in value else f"{_option(item.name)} {value}")
        return out


class _Typed(NamedTuple):
    """How a number is given on the command line: name in the help, unit, and factor to SI units."""

    metavar: str
    unit: str
    factor: float


_MILLISECONDS = _Typed("MS", "ms", 1e-3)
_TYPED = {
    "encoder_zero": _Typed("DEG", "deg", np.pi / 180.0),
    "torque_zero": _Typed("NM", "N m", 1.0),
    "torque_scale": _Typed("FACTOR", "", 1.0),
    "delay_voltage": _MILLISECONDS,
    "delay_angle": _MILLISECONDS,
    "delay_torque": _MILLISECONDS,
    "delay_pressure": _MILLISECONDS,
}
_BOUNDS = {
    "encoder_zero": (-np.pi, np.pi),
    "torque_zero": (-1e3, 1e3),
    "torque_scale": (0.1, 10.0),
    **{name: (-LARGEST_DELAY, LARGEST_DELAY) for name in _TYPED if name.startswith("delay_")},
}


def _later(
    time: Floats, values: Floats, delay: float, again: NDArray[np.bool_] | None = None, hold: bool = False
) -> Floats:
    """Values (N,) that are delayed by linear interpolation.

    Args:
        time: of the values (N,) [s].
        values: to be delayed (N,).
        delay: [s].
        again: rows that only repeat the last reading of a slow sensor (N,); None: none do.
        hold: whether the first and the last value are used outside the recording; else NaN.
    """
    ends = {} if hold else {"left": np.nan, "right": np.nan}
    known = slice(None) if again is None else ~again
    return np.interp(time - delay, time[known], values[known], **ends)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


_HELP = {
    "pressure_unit": "unit of the pressures in the bag (default: Pa)",
    "gauge": "the pressures are gauge pressures: add 101.325 kPa",
    "swap_pressures": "the pressure lines or sensors are exchanged",
    "swap_valves": "the valves or their voltages are exchanged",
    "angle_unit": "unit of the measured angle (default: rad)",
    "flip_angle": "the encoder counts in the other direction",
    "unwrap_angle": "the encoder is absolute and begins again after a turn: remove the jumps",
    "torque_unit": "unit of the measured torque (default: N m)",
    "flip_torque": "the torque meter counts in the other direction",
    "encoder_zero": "degrees by which the encoder reads too high",
    "torque_zero": "N m by which the torque meter reads too high",
    "torque_scale": "reading of the torque meter divided by the torque",
    "delay_voltage": "milliseconds by which the stamps of the voltages are too early",
    "delay_angle": "milliseconds by which the stamps of the angle are too early",
    "delay_torque": "milliseconds by which the stamps of the torque are too early",
    "delay_pressure": "milliseconds by which the stamps of the pressures are too early",
    "align_clocks": "shift the stamps of topics that another clock stamps than the pressures, by times of reception",
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of all corrections as one group."""
    group = parser.add_argument_group(
        "corrections of a recording (`check` and `close_loop` say which ones it needs)",
        "Zeros, scale and delays that are not given are those of the rig file (calibration).",
    )
    for item in fields(Corrections):
        option: dict[str, Any] = {"help": _HELP[item.name], "default": item.default}
        if isinstance(item.default, bool):
            option["action"] = "store_true"
        elif isinstance(item.default, float):
            option |= {"metavar": _TYPED[item.name].metavar, "type": float, "default": None}
        else:
            option["metavar"] = "UNIT"
        group.add_argument(_option(item.name), **option)


def from_options(arguments: argparse.Namespace, known: Mapping[str, float] = MappingProxyType({})) -> Corrections:
    """The corrections of the command line, completed by the rig file's calibration.

    `arguments`: of a parser with :func:`add_options`. `known`: zeros, scale and delays of the rig file, by name;
    default: none.
    """
    values = {item.name: getattr(arguments, item.name) for item in fields(Corrections)}
    for name, typed in _TYPED.items():
        given = values.pop(name)
        if given is not None:
            values[name] = given * typed.factor
        elif name in known:
            values[name] = known[name]
    return Corrections(**values)
