"""Calibrations: what they say, and what is refused with a reason."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from pam_antagonist.errors import BadInput
from pam_antagonist.hardware.calibration import Converter, ZeroPressureMeasurement, load_calibration
from pam_antagonist.hardware.device import DeviceInfo
from pam_antagonist.paths import config_dir
from pam_antagonist.safety import SafeAction

EXAMPLE: dict[str, Any] = yaml.safe_load((config_dir() / "hardware" / "example.yaml").read_text(encoding="utf-8"))
REGULATORS = {f"regulator_{n}": {"gain": 60e3, "offset": 0.0, "reference": "gauge"} for n in (1, 2)}
INFO = DeviceInfo("bench", "V", True, True, 1_000_000, 20_000_000, 0.0, 10.0)


def write(folder: Path, **changes: Any) -> Path:
    """The example with some values replaced: ``pressure_1__gain=0``; None takes a key away."""
    content = copy.deepcopy(EXAMPLE)
    for name, value in changes.items():
        *groups, key = name.split("__")
        node = content
        for group in groups:
            node = node[group]
        if value is None:
            del node[key]
        else:
            node[key] = value
    path = folder / "hardware.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_example_is_in_si_units() -> None:
    converter = Converter(load_calibration("example"))
    assert converter.pressure((0.5, 2.5)) == pytest.approx((101.3e3, 601.3e3))
    assert converter.angle(4096) == pytest.approx(math.pi / 2)
    assert converter.angle(-4096) == pytest.approx(-math.pi / 2)
    assert converter.torque(3.0) == pytest.approx(1.0)
    assert converter.angle(None) is None and converter.torque(None) is None


def test_a_reading_at_rest_takes_the_place_of_the_offset(tmp_path: Path) -> None:
    path = write(tmp_path, pressure_1__offset=None, pressure_1__at_rest=0.52, pressure_2__reference="absolute")
    first, second = Converter(load_calibration(path)).pressure((0.52, 2.5))
    assert first == pytest.approx(101.3e3)
    assert second == pytest.approx(500e3)


def test_counts_with_a_leading_zero_are_read_as_written(tmp_path: Path) -> None:
    text = (config_dir() / "hardware" / "example.yaml").read_text(encoding="utf-8")
    assert text.count("zero: 0 ") == 1
    path = tmp_path / "hardware.yaml"
    path.write_text(text.replace("zero: 0 ", "zero: 0512 "), encoding="utf-8")
    encoder = load_calibration(path).encoder
    assert encoder is not None and encoder.zero == 512


@pytest.mark.parametrize("reading", [0.29, 4.71, 0.0, 1e9, math.nan, math.inf])
def test_readings_of_a_broken_sensor_are_no_pressure(reading: float) -> None:
    converter = Converter(load_calibration("example"))
    first, second = converter.pressure((reading, 1.0))
    assert math.isnan(first) and second == pytest.approx(226.3e3)
    torque = converter.torque(reading)
    assert torque is not None and math.isnan(torque) == (not 0.0 <= reading <= 5.0)


@pytest.mark.parametrize("count", [0, 1, -1, 100])
def test_counter_of_the_encoder_may_wrap(tmp_path: Path, count: int) -> None:
    converter = Converter(load_calibration(write(tmp_path, encoder__zero=2**31 - 1, encoder__sign=-1)))
    wrapped = (2**31 - 1 + count + 2**31) % 2**32 - 2**31
    assert converter.angle(wrapped) == pytest.approx(-count * 2 * math.pi / 16384)


def test_readings_are_the_way_back() -> None:
    converter = Converter(load_calibration("example"))
    first, second, counts, torque = converter.readings((450e3, 300e3), 0.2, 1.5)
    assert converter.pressure((first, second)) == pytest.approx((450e3, 300e3))
    assert converter.angle(counts) == pytest.approx(0.2, abs=2e-4)
    assert converter.torque(torque) == pytest.approx(1.5)


def test_channels_may_be_left_out(tmp_path: Path) -> None:
    converter = Converter(load_calibration(write(tmp_path, encoder=None, torque=None)))
    assert converter.angle(100) is None and converter.torque(1.0) is None
    assert converter.readings((450e3, 300e3), 0.2, 1.5)[2:] == (0, 0.0)
    converter.check(INFO)


def test_a_joint_with_regulators_does_without_pressure_sensors_and_one_with_valves_does_not(tmp_path: Path) -> None:
    none = {"pressure_sensors": "none", "pressure_1": None, "pressure_2": None}
    converter = Converter(load_calibration(write(tmp_path, **none, **REGULATORS)))
    assert not converter.measures_pressures and all(math.isnan(value) for value in converter.pressure((2.0, 2.0)))
    assert converter.readings((450e3, 300e3), 0.2, 1.5)[:2] == (0.0, 0.0)
    converter.adapt("regulator")
    with pytest.raises(BadInput, match="has no pressure sensors .*but the rig has valves"):
        converter.adapt("valve")
    with pytest.raises(BadInput, match="the calibration has no pressure sensors"):
        ZeroPressureMeasurement(converter).result()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"pressure_1__gain": 0.0}, "pressure_1.gain is 0"),
        ({"pressure_1__gain": None}, "pressure_1.gain is missing"),
        ({"pressure_1__gian": 1.0}, "unknown key 'pressure_1.gian'"),
        ({"pressure_1__offset": None}, "pressure_1: expected either offset or at_rest"),
        ({"pressure_1__at_rest": 0.5}, "pressure_1: expected either offset or at_rest"),
        ({"pressure_2__offset": None, "pressure_2__at_rest": 5.0}, "pressure_2.at_rest is 5"),
        ({"pressure_2__lowest": 5.0}, "pressure_2: lowest is 5 and highest 4.7"),
        ({"pressure_1__gain": 250.0}, "pressure_1: readings from lowest to highest mean"),  # kPa
        ({"pressure_1__gain": 2.5e6}, "ends below 2.1e+06 Pa"),
        ({"pressure_1__reference": "gage"}, "pressure_1.reference"),
        ({"unit": "mV"}, "unit"),
        ({"atmosphere": 1013.0}, "atmosphere"),
        ({"torque__gain": 0}, "torque.gain is 0"),
        ({"encoder__counts": 0}, "encoder.counts"),
        ({"encoder__sign": 0}, "encoder.sign"),
        ({"pressure_1__gain": math.nan}, "pressure_1.gain"),
        ({"pressure_1__gain": True}, "pressure_1.gain is yes or no"),
        ({"pressure_2": None}, "pressure_2 is missing: expected a sensor, or pressure_sensors: none"),
        (
            {"pressure_sensors": "none", "pressure_1": None, "pressure_2": None},
            "pressure_sensors is none: expected regul",
        ),
        ({"pressure_sensors": "none", **REGULATORS}, "pressure_1 is given, but pressure_sensors is none"),
    ],
)
def test_what_no_sensor_has_is_refused_in_one_line(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    path = write(tmp_path, **changes)
    with pytest.raises(BadInput) as caught:
        load_calibration(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and words in text and "\n" not in text


def test_names_are_checked() -> None:
    with pytest.raises(BadInput, match="unknown hardware 'exmaple': expected a .yaml file or .*did you mean 'example'"):
        load_calibration("exmaple")
    with pytest.raises(BadInput, match="no such hardware file"):
        load_calibration("/no/such.yaml")


@pytest.mark.parametrize(
    ("info", "words"),
    [
        (DeviceInfo("bench", "code", True, True, 1_000_000, None, 0.0, 10.0), "readings in V, not in code"),
        (DeviceInfo("bench", "V", False, True, 1_000_000, None, 0.0, 10.0), "has encoder, but bench has no"),
        (DeviceInfo("bench", "V", True, False, 1_000_000, None, 0.0, 10.0), "has torque, but bench has no"),
    ],
)
def test_a_device_that_the_calibration_is_not_for_is_refused(info: DeviceInfo, words: str) -> None:
    with pytest.raises(BadInput, match=words):
        Converter(load_calibration("example")).check(info)
    Converter(load_calibration("example")).check(INFO)


def test_offsets_at_rest_bring_the_pressures_to_the_atmospheres() -> None:
    converter = Converter(load_calibration("example"), (100.0, -50.0))
    rest = ZeroPressureMeasurement(converter)
    for k in range(1000):
        rest.add(converter.pressure((0.502 + 1e-4 * (-1) ** k, 0.497)))
    converter.rest = rest.result()
    assert converter.rest == pytest.approx((-500.0, 750.0), abs=1.0)
    assert converter.pressure((0.502, 0.497)) == pytest.approx((101.3e3, 101.3e3), abs=1.0)


@pytest.mark.parametrize(
    ("pressures", "words"),
    [
        ([(101.3e3, 101.3e3)] * 999, "999 samples so far"),
        ([(101.3e3, 140e3)] * 1000, "pressure 2 is .38700 Pa off the atmosphere"),
        ([(math.nan, 101.3e3)] * 1000, "pressure 1 is .nan Pa off"),
        ([(91.3e3, 101.3e3), (111.3e3, 101.3e3)] * 500, "pressure 1 still changes"),
    ],
)
def test_what_is_not_at_rest_is_not_measured(pressures: list[tuple[float, float]], words: str) -> None:
    rest = ZeroPressureMeasurement(Converter(load_calibration("example")))
    for pressure in pressures:
        rest.add(pressure)
    with pytest.raises(Exception, match=words):
        rest.result()


def test_a_device_puts_out_voltages_that_ask_for_the_pressures() -> None:
    converter = Converter(load_calibration("example_regulators"))
    assert converter.output((401.3e3, 101.3e3)) == pytest.approx((5.0, 0.0))
    assert converter.asked((5.0, 0.0)) == pytest.approx((401.3e3, 101.3e3))
    safe = converter.action(SafeAction((401.3e3, 341.3e3), (101.3e3, 101.3e3), 30e3))
    assert safe.hold == pytest.approx((5.0, 4.0)) and safe.vent == pytest.approx((0.0, 0.0))
    assert safe.rate == pytest.approx(0.5)
    with pytest.raises(BadInput, match="calibration example has no regulators, but the rig has"):
        Converter(load_calibration("example")).adapt("regulator")
