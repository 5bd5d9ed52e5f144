"""Parameters of the nodes: one table for each node, for declaration, checks and ``--help``."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import angle_range, largest_torque, rest_pressure, rest_voltage, stop_angle
from pam_antagonist.strict_yaml import leading_zeros

if TYPE_CHECKING:
    from rclpy.node import Node

Value = bool | int | float | str | list[float] | list[str]

_PATIENCE, _SAMPLES = 0.02, 3
"""[s], [-] Time, and samples of the rig, for which a command or an estimate may fail to come; the longer one counts."""
_TYPES = {bool: "true or false", int: "an integer", float: "a number", str: "a text"}

# Parameters that ROS itself, or a parameter file for a whole pipeline, may set on any node.
_ROS_OWN = ("use_sim_time", "start_type_description_service")
_ROS_PREFIXES = ("qos_overrides.", "diagnostic_updater.")


@dataclass(frozen=True)
class Parameter:
    """One parameter; a list of numbers has two, one for each muscle."""

    name: str  # as in ``-p name:=value``
    default: Value
    low: float | None = None  # lowest value, also of each element of a list; None: no bound
    high: float | None = None
    choices: tuple[str, ...] = ()
    solid: bool = False
    read_only: bool = True
    # value by which a parameter is left to the rig file (:func:`by_rig`), beside the range; None: none.
    left: float | None = None
    description: str = ""

    def about(self, description: str) -> Parameter:
        """The parameter with its description."""
        return replace(self, description=description)

    @property
    def _item(self) -> type:
        """Type of a value, or of each item of a list."""
        return type(self.default[0]) if isinstance(self.default, list) else type(self.default)

    @property
    def expected(self) -> str:
        """The allowed values, in words."""
        if isinstance(self.default, list):
            text = "a list of texts" if self._item is str else "a list of 2 numbers"
        else:
            text = _TYPES[type(self.default)]
        if self.choices:
            text = "one of " + ", ".join(self.choices)
        if self.solid:
            text += " without spaces"
        if self.low is not None and self.high is not None:
            text += f" from {self.low:g} to {self.high:g}"
        if self.left is not None and not (self.low is not None and self.low <= self.left):
            text += f", or {self.left:g}"
        return text

    def check(self, value: Any) -> Value:
        """The value in this parameter's type."""
        kind, item = type(self.default), self._item
        if kind is list and hasattr(value, "__len__") and not isinstance(value, (str, bytes)):
            value = [float(one) if item is float and isinstance(one, (int, float)) else one for one in value]
        elif kind is list and item is str and isinstance(value, str):
            value = [value]
        elif kind is float and type(value) is int:
            value = float(value)
        items = value if isinstance(value, list) else [value]
        good = type(value) is kind and all(type(one) is item and self._allows(one) for one in items)
        if not good or (kind is list and item is float and len(items) != 2):
            raise BadInput(f"parameter {self.name} is {value!r}: expected {self.expected}")
        return value  # type: ignore[no-any-return]

    def _allows(self, value: Any) -> bool:
        if isinstance(value, str):
            solid = bool(value) and value.isprintable() and " " not in value
            named = bool(value) or not isinstance(self.default, list)
            return named and (not self.choices or value in self.choices) and (solid or not self.solid)
        low = -float("inf") if self.low is None else self.low
        high = float("inf") if self.high is None else self.high
        return low <= value <= high or value == self.left  # False for NaN


RIG = Parameter("rig", "shin2022").about("name of a rig in config/rigs, or path of a rig's YAML file")
JOINT = Parameter("joint", "free", choices=("free", "locked")).about("whether the joint moves or is held")
LOCK_ANGLE = Parameter("lock_angle", 0.0, -1.6, 1.6).about("angle at which a locked joint is held [rad]")
JOINT_NAME = Parameter("joint_name", "joint", solid=True).about("name of the joint in messages and diagnostics")
FRAME = Parameter("frame_id", "joint").about("frame of the joint in the messages")
SIMULATED_JOINT = (RIG, JOINT, LOCK_ANGLE, JOINT_NAME, FRAME)
"""Parameters of a node that knows the equations of the joint."""
SAFE_VOLTAGE = Parameter("safe_voltage", [-1.0, -1.0], -10.0, 10.0, left=-1.0).about(
    "voltages of both valves while no valid command comes [V]; -1: at which they keep the pressure at rest, by the rig "
    "file (write -1.001 for that voltage)"
)
SAFE_ACTION = Parameter("safe_action", "hold", choices=("hold", "vent")).about(
    "what the valves get while no valid command comes: hold keeps safe_voltage; vent moves slowly from there to "
    "vent_voltage"
)
VENT_VOLTAGE = Parameter("vent_voltage", [-1.0, -1.0], -10.0, 10.0, left=-1.0).about(
    "voltages at which both valves let the air out [V]; -1: the lowest of the rig file (write -1.001 for that voltage)"
)
VENT_RATE = Parameter("vent_rate", 1.0, 0.01, 1e3).about(
    "largest change of each voltage on the way to vent_voltage [V/s]"
)
SAFE_PRESSURE = Parameter("safe_pressure", [0.0, 0.0], 0.0, 2e6).about(
    "rig with regulators: absolute pressures that both are commanded to hold while no valid command comes; 0: the "
    "middle of their range [Pa]"
)
VENT_PRESSURE = Parameter("vent_pressure", [0.0, 0.0], 0.0, 2e6).about(
    "rig with regulators: absolute pressures at which vent ends; 0: the lower end of their range [Pa]"
)
VENT_PRESSURE_RATE = Parameter("vent_pressure_rate", 20e3, 1.0, 1e7).about(
    "rig with regulators: largest change of each pressure on the way to vent_pressure [Pa/s]"
)
SAFETY = (SAFE_VOLTAGE, SAFE_ACTION, VENT_VOLTAGE, VENT_RATE, SAFE_PRESSURE, VENT_PRESSURE, VENT_PRESSURE_RATE)
"""Parameters of every node that may apply safe voltages."""

# 2 V/ms: a full stroke in 5 ms, about as fast as a proportional valve itself. So the limit does not slow down control,
# and a single wrong command moves a valve by at most a fifth of its range.
SAMPLES = Parameter("samples", "topics", choices=("topics", "one")).about(
    "topics: pressures, valve state and angle of a sample come on topics of their own; one: all of a sample is one "
    "message on joint_sample, which takes less of the processor. All nodes of a joint need the same"
)
TOPIC_RATE = Parameter("topic_rate", 0.0, 0.1, 1e4, left=0.0).about(
    "with samples: one, rate of the other topics for people and larger stacks [Hz]; 0: full rate; excite and "
    "commission look at these: at least 100"
)
VALVE_OWNER = (
    *SAFETY,
    SAMPLES,
    TOPIC_RATE,
    Parameter("command_timeout", 0.0, 0.002, 1.0, left=0.0).about(
        "time without a command until the valves become safe [s]; 0: three samples of the rig, at least 0.02"
    ),
    Parameter("max_command_age", 0.05, 0.005, 10.0).about(
        "a command is ignored if the sample that it answers is older than this [s]; a command with stamp 0 is not "
        "checked"
    ),
    Parameter("max_slew", 2000.0, 1.0, 1e6).about("largest change of a valve's voltage by commands [V/s]"),
    # The whole range in 30 ms, faster than a regulator; a single wrong command moves it by at most 20 kPa at 1 kHz.
    Parameter("max_pressure_slew", 2e7, 1e3, 1e10).about(
        "rig with regulators: largest change of a regulator's pressure by commands [Pa/s]"
    ),
    Parameter("max_pressure", [0.0, 0.0], 0.0, 1e7).about(
        "absolute pressure of each muscle above which the valves stop; 0: 1.1 times the rig's supply pressure [Pa]"
    ),
    Parameter("over_pressure_time", 0.005, 0.001, 1.0).about("time above max_pressure after which the valves stop [s]"),
    Parameter("missing_time", 0.02, 0.001, 1.0).about(
        "time for which a pressure may be missing or not finite before the valves stop [s]"
    ),
    Parameter("frozen_time", 0.0, 0.0, 60.0).about(
        "time for which a pressure may keep exactly the same value before the valves stop [s]; 0: computed from the "
        "sensor's noise, at least 0.02"
    ),
)
"""Parameters of a node that owns the valves, the plant or a bridge; see docs/how-to/safety.md."""

ANGLE_SENSORS = ("none", "encoder")
"""Sensors that may measure the angle for the estimator."""
PRESSURE_SENSORS = ("measured", "none")
"""Whether the pressures are measured. With ``none`` the estimator uses the regulators' commands."""


AUTO = "auto"
"""A law of control that is left to the rig file."""


def by_rig(values: Mapping[str, Any], rig: Rig) -> dict[str, Any]:
    """Parameters, those filled in that are left to the rig file: -1 of a voltage, 0 of another quantity, the law."""
    if values.get("pressure_sensors") == "none" and rig.drive == "valve":
        raise BadInput(
            f"pressure_sensors is none, but rig {rig.name} has valves, whose voltages do not determine the pressures; "
            "expected a rig with pressure regulators (drive: regulator), or pressure_sensors: measured"
        )
    out = dict(values)
    if out.get("law") == AUTO:
        out["law"] = "model" if rig.drive == "regulator" else "pi"
    makers: dict[str, tuple[float, Callable[[], Sequence[float]]]] = {
        "safe_voltage": (-1.0, lambda: rest_voltage(rig)),
        "vent_voltage": (-1.0, lambda: (rig.valves.voltage_min,) * 2),
        "bias": (-1.0, lambda: (sum(rest_voltage(rig)) / 2.0,)),
        "initial_pressure": (0.0, lambda: (rest_pressure(rig),) * 2),
        "max_angle": (0.0, lambda: (angle_range(rig),)),
        "max_torque": (0.0, lambda: (largest_torque(rig),)),
        "stop_angle": (0.0, lambda: (stop_angle(rig),)),
        "command_timeout": (0.0, lambda: (max(_PATIENCE, _SAMPLES * rig.sample_period),)),
        "max_age": (0.0, lambda: (max(_PATIENCE, _SAMPLES * rig.sample_period),)),
    }
    for name, (left, make) in makers.items():
        if name not in out:
            continue
        given = out[name] if isinstance(out[name], list) else [out[name]]
        if left in given:
            filled = [own if value == left else value for value, own in zip(given, make(), strict=True)]
            out[name] = filled if isinstance(out[name], list) else filled[0]
    return out


AUTOSTART = Parameter("autostart", True).about(
    "whether the node configures and activates itself, without a lifecycle manager"
)
DIAGNOSTICS_PERIOD = Parameter("diagnostics_period", 1.0, 0.05, 60.0).about(
    "time between two messages on /diagnostics [s]"
)


def declare(node: Node, table: Sequence[Parameter], known_elsewhere: Sequence[str] = ()) -> dict[str, Any]:
    """Declare the parameters of a table and return their values.

    `known_elsewhere`: names of other nodes' parameters, which a shared parameter file may set.
    """
    # rclpy gives overrides only to declarations, so that a misspelled name would be silently ignored.
    given = dict(getattr(node, "_parameter_overrides", {}))
    names = [parameter.name for parameter in table]
    for name in given:
        if name not in (*names, *_ROS_OWN, *known_elsewhere) and not name.startswith(_ROS_PREFIXES):
            close = difflib.get_close_matches(name, names, 1)
            hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(names)}"
            raise BadInput(f"node {node.get_name()}: unknown parameter {name!r}; {hint}")
    values = {}
    for parameter in table:
        value: Value = parameter.default
        if parameter.name in given:
            try:
                value = parameter.check(given[parameter.name].value)
            except BadInput as error:
                raise BadInput(f"node {node.get_name()}: {error}") from None
        node.declare_parameter(parameter.name, value, _descriptor(parameter), ignore_override=True)
        values[parameter.name] = value
    return values


def refuse_base_8(arguments: Sequence[str]) -> None:
    """Refuse a number with a leading zero among a node's arguments, and in its parameter files.

    ROS 2 would read it in base 8, without an error.
    """
    for option, word in pairwise(arguments):
        name, text = "", ""
        if option in ("-p", "--param"):
            name, _, text = word.partition(":=")
        elif option == "--params-file":
            with contextlib.suppress(OSError, UnicodeDecodeError):  # ROS 2 says what is wrong with it
                name, text = word, Path(word).read_text(encoding="utf-8")
        for number in leading_zeros(text):
            raise BadInput(
                f"{name}: {number} begins with a zero, with which ROS 2 reads a number in base 8; expected it without "
                "the leading zero"
            )


def _descriptor(parameter: Parameter) -> Any:
    from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

    descriptor = ParameterDescriptor(
        name=parameter.name,
        description=parameter.description,
        additional_constraints=parameter.expected,
        read_only=parameter.read_only,
    )
    if parameter.low is not None and parameter.high is not None:
        low = parameter.low if parameter.left is None else min(parameter.low, parameter.left)
        if isinstance(parameter.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(low), to_value=float(parameter.high), step=0.0)
            ]
        elif type(parameter.default) is int:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(parameter.high), step=1)]
    return descriptor


def help_text(table: Sequence[Parameter]) -> str:
    """Text for ``--help``, with one paragraph for each parameter."""
    lines = []
    for parameter in table:
        fixed = "" if parameter.read_only else "; may change while the node runs"
        lines.append(f"  {parameter.name} (default {parameter.default!r})")
        lines.append(f"      {parameter.description}: {parameter.expected}{fixed}")
    return "\n".join(lines)
