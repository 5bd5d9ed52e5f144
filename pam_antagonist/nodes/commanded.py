"""Commands of a rig's drive: voltages of valves, or pressures of regulators.

Both drives share the limits, slew, time-out and safe commands of :mod:`pam_antagonist.safety`, and the layout of the
messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from pam_antagonist.control import VoltageLimits
from pam_antagonist.recording.topics import COMMAND_TOPICS, STATE_TOPICS, TOPICS
from pam_antagonist.rig import Rig
from pam_antagonist.safety import SafeAction, safe_action
from pam_antagonist_msgs.msg import PressureCommand, ValveCommand

_ASTRAY_VOLTAGE, _ASTRAY_PRESSURE = 0.25, 25e3
"""[V], [Pa] Largest normal difference between command and output; commands of consecutive samples differ by less."""


class Topics(NamedTuple):
    """Topics of the commands and of the outputs.

    Attributes:
        state: topic of the voltages or pressures that valves or regulators got, relative.
    """

    message: type
    command: str
    state: str
    frame_id: str


class Drive(NamedTuple):
    """Limits of the commands, in V for valves or Pa for regulators.

    Attributes:
        slew: largest change of each command [V/s] or [Pa/s].
        astray: largest normal difference between command and output [V] or [Pa].
    """

    topics: Topics
    limits: VoltageLimits
    action: SafeAction
    slew: float
    astray: float


def topics_of(rig: Rig) -> Topics:
    """Topics of a rig's commands."""
    message, frame_id = (ValveCommand, "valves") if rig.drive == "valve" else (PressureCommand, "regulators")
    command, state = (TOPICS[names[rig.drive]].relative for names in (COMMAND_TOPICS, STATE_TOPICS))
    return Topics(message, command, state, frame_id)


def drive_of(rig: Rig, values: Mapping[str, Any]) -> Drive:
    """Limits of the commands of a rig.

    Args:
        values: the node's parameters by name, including ``SAFETY``.
    """
    topics = topics_of(rig)
    low, high = rig.command_limits
    if rig.drive == "valve":
        limits = VoltageLimits(low, high)
        action = safe_action(
            values["safe_action"], limits, values["safe_voltage"], values["vent_voltage"], values["vent_rate"]
        )
        return Drive(topics, limits, action, values.get("max_slew", 0.0), _ASTRAY_VOLTAGE)
    limits = VoltageLimits(low, high, "Pa")
    hold = tuple(value or 0.5 * (low + high) for value in values["safe_pressure"])
    vent = tuple(value or low for value in values["vent_pressure"])
    action = safe_action(values["safe_action"], limits, hold, vent, values["vent_pressure_rate"])
    return Drive(topics, limits, action, values.get("max_pressure_slew", 0.0), _ASTRAY_PRESSURE)
