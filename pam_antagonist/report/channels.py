"""What is judged in a replay's report: which channels there are, and how their numbers are found and written."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from pam_antagonist.report.table import number

Report = dict[str, Any]
"""An entry of ``report.json``, see :mod:`pam_antagonist.report.replay`."""


class Channel(NamedTuple):
    """A quantity that the filter estimates and a validation sensor may measure.

    Attributes:
        name: key in the report, and what it is called.
        key: unit in the report's keys (``rmse_deg``).
        unit: unit as written in brackets.
    """

    name: str
    key: str
    unit: str

    @property
    def title(self) -> str:
        """Its name at the beginning of a sentence."""
        return self.name.capitalize()

    def value(self, report: Report, model: str = "ukf", what: str = "rmse") -> float:
        """An error of it: ``rmse`` or ``max``, of ``ukf`` or ``model_alone``."""
        return float(report[model][self.name][f"{what}_{self.key}"])

    def ratio(self, report: Report, model: str = "ukf") -> float:
        """The paper's ratio of the largest error to the range of the measured signal."""
        return float(report[model][self.name]["q"])

    def coverage(self, report: Report) -> float:
        """Share of the measured values in the filter's 95 % interval."""
        return float(report["ukf"][self.name]["coverage95"])

    def write(self, value: float) -> str:
        """A value with its unit."""
        return f"{number(value, 2)}{'' if self.unit == '°' else ' '}{self.unit}"


MODELS = ("ukf", "model_alone")
"""What is compared: the filter, and the model without any feedback."""
CHANNELS = (Channel("angle", "deg", "°"), Channel("torque", "nm", "N m"))
"""What is estimated from the pressures."""


def moves(report: Report) -> bool:
    """Whether the joint could move."""
    return bool(report["joint"]["condition"] == "free")


def lock_angle(report: Report) -> str:
    """Where a locked joint was held."""
    return f"{math.degrees(report['joint']['lock_angle_rad']):.1f}°"


def judged(report: Report) -> list[Channel]:
    """Channels with a measurement to compare with; a locked joint's angle is given, not estimated."""
    measured = [channel for channel in CHANNELS if report["ukf"][channel.name] is not None]
    return [channel for channel in measured if channel.name != "angle" or moves(report)]


def worst(channel: Channel, reports: Sequence[Report]) -> Report | None:
    """The recording in which the filter errs most; None where the channel was judged in none."""
    where = [report for report in reports if channel in judged(report)]
    return max(where, key=channel.value, default=None)
