"""Channels of a replay: quantities that the filter estimates and a validation sensor may measure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from pam_antagonist.estimation.metrics import ChannelErrors, ModelErrors
from pam_antagonist.replays.result import JointFacts, ReplayReport
from pam_antagonist.shown import number


class Channel(NamedTuple):
    """The angle or the torque."""

    name: str
    unit: str

    @property
    def title(self) -> str:
        """The name, capitalised."""
        return self.name.capitalize()

    def of(self, errors: ModelErrors) -> ChannelErrors | None:
        """Errors of the channel; None where it was not measured."""
        return errors.angle if self.name == "angle" else errors.torque

    def write(self, value: float) -> str:
        """A value with its unit."""
        return f"{number(value, 2)}{'' if self.unit == '°' else ' '}{self.unit}"


ANGLE, TORQUE = Channel("angle", "°"), Channel("torque", "N m")
CHANNELS = (ANGLE, TORQUE)
"""Channels that are estimated from the pressures."""
HIGH_COVERAGE = 0.98
"""Coverage of a 95 % interval above which the interval may be too wide."""
WIDE = 2.0 * 1.96
"""A 95 % interval is wide if its half width over the RMS error is larger: the claimed error is twice the real one."""


class Judged(NamedTuple):
    """A channel with its errors in one recording."""

    channel: Channel
    ukf: ChannelErrors
    model: ChannelErrors

    @property
    def coverage(self) -> float:
        """Share of the measured values in the filter's 95 % interval."""
        return math.nan if self.ukf.coverage95 is None else self.ukf.coverage95

    @property
    def wide(self) -> bool:
        """Whether the filter's 95 % interval is too wide for its errors."""
        return self.coverage > HIGH_COVERAGE and self.ukf.width is not None and self.ukf.width > WIDE


def judged(report: ReplayReport) -> list[Judged]:
    """Channels with a measurement, without a locked joint's angle, which is not estimated."""
    out = []
    for channel in CHANNELS:
        ukf, model = channel.of(report.ukf), channel.of(report.model_alone)
        if ukf is not None and model is not None and (channel is TORQUE or report.joint.condition == "free"):
            out.append(Judged(channel, ukf, model))
    return out


def joint_text(joint: JointFacts) -> str:
    """``free``, or ``locked at 5.7°``."""
    if joint.lock_angle_rad is None:
        return joint.condition
    return f"{joint.condition} at {math.degrees(joint.lock_angle_rad):.1f}°"


def joined(parts: Sequence[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"
