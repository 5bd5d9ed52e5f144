"""Offsets of the pressure sensors, measured at rest."""

from __future__ import annotations

import math

import pytest

from pam_antagonist.hardware.calibration import Converter, ZeroPressureMeasurement, load_calibration


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
