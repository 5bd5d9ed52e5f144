"""Calibration from readings to SI units: a YAML file for each set of sensors, checked like a rig file.

A pressure is ``gain * reading + offset``, plus the atmosphere for gauge pressures. Or it is
``gain * (reading - at_rest)`` plus the atmosphere, where ``at_rest`` is the reading with the muscle open to the air.
"""

from __future__ import annotations

import difflib
import math
import statistics
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, NamedTuple, Optional  # (pydantic 1 evaluates annotations on Python 3.10)

from pydantic import Field

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.device import DeviceInfo
from pam_antagonist.paths import config_dir
from pam_antagonist.safety import SafeAction
from pam_antagonist.strict_yaml import Strict, read_mapping, validated

EXAMPLE = "example"
_HIGHEST_PRESSURE = 2.1e6  # no pneumatic muscle has a higher one [Pa]


class PressureChannel(Strict):
    """A pressure sensor."""

    gain: float = Field(description="of the sensor [Pa per V or code], not 0")
    offset: Optional[float] = Field(None, description="pressure at reading 0, gauge or absolute as in reference [Pa]")  # noqa: UP045
    at_rest: Optional[float] = Field(None, description="reading with the muscle open to the air [V or code]")  # noqa: UP045
    reference: Literal["gauge", "absolute"] = Field(description="whether offset counts from the atmosphere or vacuum")
    lowest: float = Field(description="least reading of a sensor that works [V or code]; below: wire broken")
    highest: float = Field(description="largest one [V or code]; above: short circuit")


class EncoderChannel(Strict):
    """An incremental encoder at the joint."""

    counts: float = Field(ge=4.0, lt=1e9, description="a turn of the joint, after quadrature [counts]")
    zero: int = Field(0, ge=-(2**31), lt=2**31, description="count at angle 0, where both muscles are equally long")
    sign: Literal[-1, 1] = Field(1, description="-1 where counts fall while muscle 1 gets shorter")


class TorqueChannel(Strict):
    """A torque meter: gain * reading + offset."""

    gain: float = Field(description="[N m per V or code], not 0")
    offset: float = Field(0.0, description="torque at reading 0 [N m]")
    lowest: float = Field(description="least reading of a meter that works [V or code]")
    highest: float = Field(description="largest one [V or code]")


class RegulatorChannel(Strict):
    """A pressure regulator whose command is a voltage of the device: pressure = gain * voltage + offset."""

    gain: float = Field(gt=1e3, lt=1e7, description="of the regulator's input [Pa per V]")
    offset: float = Field(description="pressure that 0 V ask for, gauge or absolute as in reference [Pa]")
    reference: Literal["gauge", "absolute"] = Field(description="whether offset counts from the atmosphere or vacuum")


class DeviceCalibration(Strict):
    """Sensors and regulators of a device. Read one with :func:`load_calibration`."""

    name: str
    unit: Literal["V", "code"] = Field(description="of the readings: V, or codes of the converter")
    atmosphere: float = Field(gt=50e3, lt=120e3, description="pressure of the surroundings, absolute [Pa]")
    pressure_sensors: Literal["measured", "none"] = Field(
        "measured", description="none: of a joint with pressure regulators, whose pressures nobody measures"
    )
    pressure_1: Optional[PressureChannel] = Field(None, description="or none, with pressure_sensors: none")  # noqa: UP045
    pressure_2: Optional[PressureChannel] = Field(None, description="the same of muscle 2")  # noqa: UP045
    regulator_1: Optional[RegulatorChannel] = Field(None, description="of a joint with pressure regulators")  # noqa: UP045
    regulator_2: Optional[RegulatorChannel] = Field(None, description="the same of muscle 2")  # noqa: UP045
    encoder: Optional[EncoderChannel] = Field(None, description="or none")  # noqa: UP045
    torque: Optional[TorqueChannel] = Field(None, description="or none")  # noqa: UP045


def calibration_names() -> list[str]:
    """Names of the calibrations that come with the package."""
    return sorted(path.stem for path in (config_dir() / "hardware").glob("*.yaml"))


def load_calibration(name_or_path: str | Path) -> DeviceCalibration:
    """Read and check a calibration.

    `name_or_path`: the path of a YAML file, or the name of one in ``config/hardware`` (``example``).
    """
    path = _locate(str(name_or_path))
    content = read_mapping(path, "hardware", "config/hardware/example.yaml")
    found = validated(DeviceCalibration, content, str(path))
    for complaint in _complaints(found):
        raise BadInput(f"{path}: {complaint}")
    return found


def _locate(name: str) -> Path:
    path = Path(name)
    if path.suffix in (".yaml", ".yml"):
        return path
    names = calibration_names()
    if name not in names:
        close = difflib.get_close_matches(name, names, 1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        raise BadInput(f"unknown hardware {name!r}: expected a .yaml file or one of {', '.join(names)}{hint}")
    return config_dir() / "hardware" / f"{name}.yaml"


def _complaints(calibration: DeviceCalibration) -> Iterator[str]:
    """Contradictions between entries, which the schema cannot check."""
    sensors = {"pressure_1": calibration.pressure_1, "pressure_2": calibration.pressure_2}
    for name, channel in {**sensors, "torque": calibration.torque}.items():
        if channel is None:
            continue
        if channel.gain == 0.0:
            yield f"{name}.gain is 0: expected the sensor's gain"
        if not channel.lowest < channel.highest:
            yield f"{name}: lowest is {channel.lowest:g} and highest {channel.highest:g}: expected lowest < highest"
    if (calibration.regulator_1 is None) != (calibration.regulator_2 is None):
        yield "regulator_1 and regulator_2: expected both, or neither"
    measured = calibration.pressure_sensors == "measured"
    if not measured and calibration.regulator_1 is None:
        yield (
            "pressure_sensors is none: expected regulator_1 and regulator_2 as well, since valve voltages do not "
            "determine the pressures"
        )
    for name, channel in sensors.items():
        if measured and channel is None:
            yield f"{name} is missing: expected a sensor, or pressure_sensors: none with pressure regulators"
        if not measured and channel is not None:
            yield f"{name} is given, but pressure_sensors is none: expected only one of them"
        if channel is not None:
            yield from _pressure_complaints(name, channel, calibration.atmosphere)


def _pressure_complaints(name: str, channel: PressureChannel, atmosphere: float) -> Iterator[str]:
    if (channel.offset is None) == (channel.at_rest is None):
        yield f"{name}: expected either offset or at_rest"
    if channel.at_rest is not None and not channel.lowest <= channel.at_rest <= channel.highest:
        yield (
            f"{name}.at_rest is {channel.at_rest:g}: expected a reading of a sensor that works, "
            f"{channel.lowest:g} to {channel.highest:g}"
        )
    low, high = sorted(_absolute(channel, atmosphere, end) for end in (channel.lowest, channel.highest))
    if high > _HIGHEST_PRESSURE or high < atmosphere or low < -atmosphere:
        yield (
            f"{name}: readings from lowest to highest mean {low:g} to {high:g} Pa absolute: expected a range that "
            f"includes the atmosphere's pressure and ends below {_HIGHEST_PRESSURE:g} Pa; is gain in Pa?"
        )


def _absolute(channel: PressureChannel, atmosphere: float, reading: float) -> float:
    if channel.at_rest is not None:
        return channel.gain * (reading - channel.at_rest) + atmosphere
    offset = channel.offset or 0.0
    return channel.gain * reading + offset + (atmosphere if channel.reference == "gauge" else 0.0)


class _Straight(NamedTuple):
    gain: float
    offset: float
    lowest: float = -math.inf
    highest: float = math.inf

    def value(self, reading: float) -> float:
        """Value in SI units; NaN for a reading outside the sensor's range."""
        if not self.lowest <= reading <= self.highest:  # also true for NaN
            return math.nan
        return self.gain * reading + self.offset

    def reading(self, value: float) -> float:
        """The reading for a value."""
        return (value - self.offset) / self.gain


Pair = tuple[float, float]


class Converter:
    """Readings to SI units, and back.

    `rest`: correction that is added to both pressures (2,) [Pa], as measured at rest.
    """

    def __init__(self, calibration: DeviceCalibration, rest: Pair = (0.0, 0.0)) -> None:
        self.calibration = calibration
        self.rest = rest
        atmosphere = calibration.atmosphere
        self._pressures = tuple(
            _Straight(channel.gain, _absolute(channel, atmosphere, 0.0), channel.lowest, channel.highest)
            for channel in (calibration.pressure_1, calibration.pressure_2)
            if channel is not None
        )
        self._regulators = tuple(
            _Straight(channel.gain, channel.offset + (atmosphere if channel.reference == "gauge" else 0.0))
            for channel in (calibration.regulator_1, calibration.regulator_2)
            if channel is not None
        )
        torque, encoder = calibration.torque, calibration.encoder
        self._torque = None if torque is None else _Straight(torque.gain, torque.offset, torque.lowest, torque.highest)
        self._step = math.nan if encoder is None else encoder.sign * 2.0 * math.pi / encoder.counts
        self._zero = 0 if encoder is None else encoder.zero

    def check(self, info: DeviceInfo) -> None:
        """Make sure that the device has the channels of the calibration."""
        name = self.calibration.name
        if info.unit != self.calibration.unit:
            raise BadInput(f"calibration {name} is for readings in {self.calibration.unit}, not in {info.unit}")
        for channel, there in (("encoder", info.encoder), ("torque", info.torque)):
            if getattr(self.calibration, channel) is not None and not there:
                raise BadInput(f"calibration {name} has {channel}, but {info.name} has no such channel")

    @property
    def measures_pressures(self) -> bool:
        """Whether there are pressure sensors."""
        return bool(self._pressures)

    def pressure(self, readings: Pair) -> Pair:
        """Both pressures, absolute [Pa]; NaN where the sensor is faulty or missing."""
        if not self._pressures:
            return math.nan, math.nan
        first, second = self._pressures
        return first.value(readings[0]) + self.rest[0], second.value(readings[1]) + self.rest[1]

    def adapt(self, drive: str) -> None:
        """Use regulators, or none, as a rig has them; `drive`: of the rig, ``valve`` or ``regulator``."""
        name = self.calibration.name
        if drive == "regulator" and not self._regulators:
            raise BadInput(
                f"calibration {name} has no regulators, but the rig has; expected regulator_1 and regulator_2, such as "
                "{gain: 60.0e+3, offset: 0.0, reference: gauge}; with the device emulator: hardware example_regulators"
            )
        if drive == "valve" and not self._pressures:
            raise BadInput(
                f"calibration {name} has no pressure sensors (pressure_sensors: none), but the rig has valves, whose "
                "voltages do not determine the pressures; expected pressure_1 and pressure_2"
            )
        if drive == "valve":
            self._regulators = ()

    def asked(self, command: Pair) -> Pair:
        """Pressure commands (2,) [Pa absolute] of the device's voltages (2,) [V]; the voltages without regulators."""
        if not self._regulators:
            return command
        first, second = self._regulators
        return first.value(command[0]), second.value(command[1])

    def output(self, command: Pair) -> Pair:
        """Voltages of the device (2,) [V] for pressure commands [Pa]; the command itself without regulators."""
        if not self._regulators:
            return command
        first, second = self._regulators
        return first.reading(command[0]), second.reading(command[1])

    def action(self, action: SafeAction) -> SafeAction:
        """A safe action in voltages of the device; neither muscle vents faster than the action's rate.

        `action`: in voltages, or in pressures for a joint with regulators.
        """
        if not self._regulators:
            return action
        vent = None if action.vent is None else self.output(action.vent)
        return SafeAction(self.output(action.hold), vent, action.rate / max(line.gain for line in self._regulators))

    def angle(self, encoder: int | None) -> float | None:
        """Angle [rad], None without an encoder."""
        if encoder is None or self.calibration.encoder is None:
            return None
        # 32-bit counters wrap around
        return ((encoder - self._zero + 2**31) % 2**32 - 2**31) * self._step

    def torque(self, reading: float | None) -> float | None:
        """Torque [N m], None without a torque meter, NaN where it is faulty."""
        return None if reading is None or self._torque is None else self._torque.value(reading)

    def readings(self, pressure: Pair, angle: float, torque: float) -> tuple[float, float, int, float]:
        """Readings for the emulator, not limited to ``lowest`` and ``highest``; 0 for missing sensors.

        Args:
            pressure: of both muscles, absolute [Pa].
            angle: of the joint [rad].
            torque: of the muscles [N m].

        Returns:
            Readings of both pressures, counts of the encoder, reading of the torque meter.
        """
        shown = [channel.reading(value) for channel, value in zip(self._pressures, pressure, strict=False)]
        first, second = shown or (0.0, 0.0)
        counts = 0 if self.calibration.encoder is None else round(angle / self._step) + self._zero
        return first, second, counts, 0.0 if self._torque is None else self._torque.reading(torque)


_SAMPLES = 1000
_FARTHEST = 30e3  # [Pa] largest error; with more, the sensor is broken or the muscle is not open
_LOUDEST = 3e3  # [Pa] largest standard deviation; with more, air still moves


class ZeroPressureMeasurement:
    """The last thousand samples of both pressures."""

    def __init__(self, converter: Converter) -> None:
        self._converter = converter
        self._pressures: deque[tuple[float, float]] = deque(maxlen=_SAMPLES)

    def add(self, pressure: tuple[float, float]) -> None:
        """Take one sample (2,) absolute [Pa]."""
        self._pressures.append(pressure)

    def clear(self) -> None:
        """Forget all samples, because the conversion changes."""
        self._pressures.clear()

    def result(self) -> tuple[float, float]:
        """Correction to add to both pressures (2,) [Pa], so that they equal the atmosphere."""
        if not self._converter.measures_pressures:
            raise BadInput("sensors at rest: the calibration has no pressure sensors (pressure_sensors: none)")
        if len(self._pressures) < _SAMPLES:
            raise BadInput(f"sensors at rest: {len(self._pressures)} samples so far, expected {_SAMPLES}")
        first, second = (self._one(muscle) for muscle in (0, 1))
        return first, second

    def _one(self, muscle: int) -> float:
        values = [pressure[muscle] - self._converter.rest[muscle] for pressure in self._pressures]
        off = statistics.fmean(values) - self._converter.calibration.atmosphere
        if not abs(off) <= _FARTHEST:  # also true for NaN
            raise BadInput(
                f"sensors at rest: pressure {muscle + 1} is {off:+.0f} Pa off the atmosphere's, expected at most "
                f"{_FARTHEST:g}: is the muscle open to the air?"
            )
        if statistics.pstdev(values) > _LOUDEST:
            raise BadInput(f"sensors at rest: pressure {muscle + 1} still changes: wait until it is constant")
        return -off
