"""Corrections of a recording to the package's conventions: units, gauge pressure, exchanged lines, signs, late stamps.

A recording is corrected while it is read, so that every command sees the same corrected recording. The command line
options are made from the same table.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.recording.faults import without_faults
from pam_antagonist.recording.plausible import STANDARD_ATMOSPHERE, UNITS, canonical, unwrapped
from pam_antagonist.recording.recording import Recording
from pam_antagonist.recording.rows import curve, slow
from pam_antagonist.recording.stamps import LARGEST_DELAY

Floats = NDArray[np.float64]


class _Typed(NamedTuple):
    """How a number is given on the command line: name in the help, unit, factor to SI units, and bounds in SI units."""

    metavar: str
    unit: str
    factor: float
    low: float
    high: float


_DEGREES = _Typed("DEG", "deg", np.pi / 180.0, -np.pi, np.pi)
_MILLISECONDS = _Typed("MS", "ms", 1e-3, -LARGEST_DELAY, LARGEST_DELAY)


def _fix(default: Any, text: str, typed: _Typed | None = None) -> Any:
    """A field of :class:`Corrections`, with the help of its option."""
    return field(default=default, metadata={"help": text, "typed": typed})


@dataclass(frozen=True)
class Corrections:
    """Changes to a recording before it is used; numbers in SI units."""

    pressure_unit: str = _fix("Pa", "unit of the pressures in the bag (default: Pa)")
    gauge: bool = _fix(False, "the pressures are gauge pressures: add the atmosphere's of the rig file")
    swap_pressures: bool = _fix(False, "the pressure lines or sensors are exchanged")
    swap_valves: bool = _fix(False, "the valves or their voltages are exchanged")
    angle_unit: str = _fix("rad", "unit of the measured angle (default: rad)")
    flip_angle: bool = _fix(False, "the encoder counts in the other direction")
    unwrap_angle: bool = _fix(False, "the encoder is absolute and begins again after a turn: remove the jumps")
    torque_unit: str = _fix("N m", "unit of the measured torque (default: N m)")
    flip_torque: bool = _fix(False, "the torque meter counts in the other direction")
    encoder_zero: float = _fix(0.0, "degrees by which the encoder reads too high", _DEGREES)
    torque_zero: float = _fix(0.0, "N m by which the torque meter reads too high", _Typed("NM", "N m", 1.0, -1e3, 1e3))
    torque_scale: float = _fix(  # of the reading after its zero is subtracted
        1.0, "reading of the torque meter divided by the torque", _Typed("FACTOR", "", 1.0, 0.1, 10.0)
    )
    delay_voltage: float = _fix(0.0, "milliseconds by which the stamps of the voltages are too early", _MILLISECONDS)
    delay_angle: float = _fix(0.0, "milliseconds by which the stamps of the angle are too early", _MILLISECONDS)
    delay_torque: float = _fix(0.0, "milliseconds by which the stamps of the torque are too early", _MILLISECONDS)
    delay_pressure: float = _fix(0.0, "milliseconds by which the stamps of the pressures are too early", _MILLISECONDS)
    leave_out_faults: bool = _fix(
        False, "leave out readings that are no measurement: lost and held ones, and those at the end of a range"
    )
    align_clocks: bool = _fix(
        False, "shift the stamps of topics that another clock stamps than the pressures, by times of reception"
    )
    atmosphere: float = field(default=STANDARD_ATMOSPHERE, compare=False)
    """What gauge pressures count from [Pa]: no option, but a value of the rig file."""

    def __post_init__(self) -> None:
        for quantity in ("pressure", "angle", "torque"):
            name = f"{quantity}_unit"
            object.__setattr__(self, name, canonical(_option(name), quantity, getattr(self, name)))
        for name, typed in _TYPED.items():
            value = getattr(self, name)
            if not typed.low <= value <= typed.high:
                low, high = typed.low / typed.factor, typed.high / typed.factor
                raise BadInput(
                    f"{_option(name)} {value / typed.factor:g}: expected {low:g} to {high:g} {typed.unit}".rstrip()
                )

    def pressure(self, values: Floats) -> Floats:
        """Absolute pressure [Pa] of recorded values (N,)."""
        offset = self.atmosphere if self.gauge else 0.0
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
        recording = without_faults(recording) if self.leave_out_faults else recording
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
        return replace(recording, pressure=pressure, voltage=voltage, angle=angle, torque=torque, corrected=True)

    def replaced(self, **values: Any) -> Corrections:
        """These corrections with other values, by name."""
        return replace(self, **values)

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
        for item in _OPTIONS:
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


_OPTIONS = tuple(one for one in fields(Corrections) if one.metadata)
_TYPED: dict[str, _Typed] = {one.name: one.metadata["typed"] for one in _OPTIONS if one.metadata["typed"]}
"""Zeros, scale and delays."""


def _later(
    time: Floats, values: Floats, delay: float, again: NDArray[np.bool_] | None = None, hold: bool = False
) -> Floats:
    """Values (N,) that are delayed [s].

    `again`: rows that only repeat the last reading of a slow sensor (N,); None: none do. `hold`: whether the first and
    the last value are used outside the recording; else NaN.
    """
    known = slice(None) if again is None else ~again
    there = time - delay
    return curve(np.clip(there, time[0], time[-1]) if hold else there, time[known], values[known])


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of all corrections as one group."""
    group = parser.add_argument_group(
        "corrections of a recording (`check` and `close_loop` say which ones it needs)",
        "Zeros, scale and delays that are not given are those of the rig file (calibration).",
    )
    for item in _OPTIONS:
        option: dict[str, Any] = {"help": item.metadata["help"], "default": item.default}
        if isinstance(item.default, bool):
            option["action"] = "store_true"
        elif isinstance(item.default, float):
            option |= {"metavar": _TYPED[item.name].metavar, "type": float, "default": None}
        else:
            option["metavar"] = "UNIT"
        group.add_argument(_option(item.name), **option)


def from_options(arguments: argparse.Namespace, known: Corrections | None = None) -> Corrections:
    """The corrections of the command line, completed by those of the rig file.

    `arguments`: of a parser with :func:`add_options`. `known`: zeros, scale, delays and atmosphere of the rig file;
    default: none.
    """
    known = known or Corrections()
    values = {item.name: getattr(arguments, item.name) for item in _OPTIONS}
    for name, typed in _TYPED.items():
        given = values.pop(name)
        values[name] = getattr(known, name) if given is None else given * typed.factor
    return Corrections(**values, atmosphere=known.atmosphere)
