"""A calibration that recordings need: its value, its description in words, and the corrections that undo it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pam_antagonist.diagnosis.models import contradict
from pam_antagonist.recording.corrections import Corrections


@dataclass(frozen=True)
class FoundCalibration:
    """A calibration that recordings need."""

    name: str  # in :data:`~pam_antagonist.inference.calibration.CALIBRATIONS`
    value: float
    std: float  # its standard deviation, including the uncertainty of the rig's parameters
    unit: str
    delta_bic: float
    # value and standard deviation in each recording that shows it, by its name.
    by_recording: Mapping[str, tuple[float, float]]
    rivals: tuple[str, ...] = ()  # effects and calibrations that the recordings cannot distinguish from it


def differences(found: Sequence[FoundCalibration]) -> list[str]:
    """Calibrations in which recordings contradict each other."""
    out = []
    for item in found:
        if contradict(list(item.by_recording.values()), item.value):
            each = "; ".join(
                f"{name}: {in_words(replace(item, value=value, std=std))}"
                for name, (value, std) in item.by_recording.items()
            )
            out.append(f"the recordings differ in their calibration ({each}): correct each by itself")
    return out


def corrections(values: Mapping[str, float]) -> Corrections:
    """Corrections that undo calibrations, as a user enters them."""
    return Corrections(
        encoder_zero=values.get("encoder_zero", 0.0),
        torque_zero=values.get("torque_zero", 0.0),
        torque_scale=1.0 + values.get("torque_scale", 0.0),
        delay_voltage=values.get("delay_voltage", 0.0),
        delay_angle=values.get("delay_angle", 0.0),
        delay_torque=values.get("delay_torque", 0.0),
        delay_pressure=values.get("delay_pressure", 0.0),
    )


def in_words(found: FoundCalibration) -> str:
    """A calibration in words."""
    wording = _WORDS[found.name]
    size, std = abs(found.value) * wording.factor, found.std * wording.factor
    # A standard deviation has one digit, or two that begin with 1; the value has no more than these.
    magnitude = float(np.log10(max(std, 1e-6)))
    digits = max(0, -int(np.floor(magnitude)) + (magnitude % 1.0 < np.log10(2.0)))
    number = f"{size:.{digits}f} ± {std:.{digits}f} {wording.unit}".replace(" °", "°")
    return f"{wording.who} {number} too {wording.ways[int(found.value > 0.0)]}"


def experiment(name: str) -> str:
    """How to measure a calibration without a model."""
    return _EXPERIMENTS.get(name, _CLOCK)


def alternative(name: str) -> str:
    """What a report says of a calibration that does as well as what was found."""
    what = {"encoder_zero": "a zero of the encoder", "torque_zero": "a zero of the torque meter"}
    clock = f"stamps of the {name.removeprefix('delay_')} that are early or late"
    return what.get(name, "another scale of the torque meter" if name == "torque_scale" else clock)


class _Words(NamedTuple):
    """Words for a calibration: subject and verb, adjectives of a negative and a positive value, and unit."""

    who: str
    ways: tuple[str, str]
    unit: str
    factor: float


_STAMPED = ("late", "early")
_CLOCK = (
    "stamp everything by one clock, or record a step of a voltage at 1 kHz: late stamps shift the whole response, a "
    "slow valve or sensor rounds its beginning"
)
_EXPERIMENTS = {
    "encoder_zero": "hold the joint at an angle that is known without the encoder (a gauge block, a stop), and read it",
    "torque_zero": "read the torque meter with both muscles vented and nothing on the joint",
    "torque_scale": "hang a known weight on the joint and read the torque meter",
}
_WORDS = {
    "encoder_zero": _Words("the encoder reads", ("low", "high"), "°", 180.0 / np.pi),
    "torque_zero": _Words("the torque meter reads", ("low", "high"), "N m", 1.0),
    "torque_scale": _Words("the torque meter reads", ("little", "much"), "%", 100.0),
    "delay_voltage": _Words("the voltages are stamped", _STAMPED, "ms", 1e3),
    "delay_angle": _Words("the angle is stamped", _STAMPED, "ms", 1e3),
    "delay_torque": _Words("the torque is stamped", _STAMPED, "ms", 1e3),
    "delay_pressure": _Words("the pressures are stamped", _STAMPED, "ms", 1e3),
}
