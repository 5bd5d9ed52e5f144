"""Parameters of the controller, the laws that they make, and their description for ``/diagnostics``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pam_antagonist.control.command import PI_MODES, Mode, VoltageLimits
from pam_antagonist.control.governor import Governor, JointLimits
from pam_antagonist.control.laws import LAWS, Laws, Reachable
from pam_antagonist.control.model_law import ModelController, ModelGains
from pam_antagonist.control.pi import PUBLISHED_GAINS, Gains, PiController
from pam_antagonist.control.reference import LOST
from pam_antagonist.control.stiffness import LEAST_FORCE, SUPPLY_MARGIN, Box
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.parameters import AUTO, JOINT_NAME, PRESSURE_SENSORS, RIG, SAFETY, Parameter
from pam_antagonist.rig import Rig

_MODEL = ModelGains()
_ANGLE, _TORQUE = PUBLISHED_GAINS[Mode.ANGLE], PUBLISHED_GAINS[Mode.TORQUE]

PARAMETERS = (
    RIG,
    JOINT_NAME,
    *SAFETY,
    Parameter("pressure_sensors", "measured", choices=PRESSURE_SENSORS).about(
        "none: the pressures are not measured, so estimates without them do not stop the controller; for a rig with "
        "drive: regulator"
    ),
    Parameter("bias", -1.0, -10.0, 10.0, read_only=False, left=-1.0).about(
        "voltage of both valves at rest [V]; -1: at which they keep the pressure at rest, by the rig file (write "
        "-1.001 for that voltage)"
    ),
    Parameter("angle_proportional", _ANGLE.proportional, 0.0, 1e3, read_only=False).about("T_P for the angle [V/rad]"),
    Parameter("angle_integral", _ANGLE.integral, 0.0, 1e9, read_only=False).about("T_I for the angle [V/(rad s)]"),
    Parameter("angle_velocity", 0.0, 0.0, 1e3, read_only=False).about(
        "feed-forward of the velocity that a trajectory or a joint_command asks for [V s/rad]"
    ),
    Parameter("torque_proportional", _TORQUE.proportional, 0.0, 1e3, read_only=False).about(
        "T_P for the torque [V/(N m)]"
    ),
    Parameter("torque_integral", _TORQUE.integral, 0.0, 1e9, read_only=False).about("T_I for the torque [V/(N m s)]"),
    Parameter("law", AUTO, choices=(AUTO, *LAWS), read_only=False).about(
        "law of control: pi, the paper's, which puts voltages on valves; model, which goes through the model's "
        "equations and has the modes ANGLE_STIFFNESS, TORQUE_STIFFNESS and IMPEDANCE as well; auto: pi for a rig with "
        "valves, model for one with pressure regulators"
    ),
    Parameter("pressure_bandwidth", _MODEL.bandwidth, 0.1, 200.0, read_only=False).about(
        "law model: rate at which a pressure's error is corrected [1/s]"
    ),
    Parameter("model_integral", _MODEL.integral, 0.0, 100.0, read_only=False).about(
        "law model: rate at which the torque follows an error of the angle times stiffness, or of the torque [1/s]"
    ),
    Parameter("approach", _MODEL.approach, 1e-4, 1.0, read_only=False).about(
        "law model: distance from the reference within which the torque against friction fades [rad]"
    ),
    Parameter("lowest_pressure", 0.0, 0.0, 1e7).about(
        "law model: least pressure of a muscle, absolute [Pa]; 0: a sixth of the supply's gauge pressure"
    ),
    Parameter("supply_margin", SUPPLY_MARGIN, 0.0, 1e7).about(
        "law model: how far the pressures stay below the supply's pressure [Pa]"
    ),
    Parameter("least_force", LEAST_FORCE, 0.0, 1e4).about("law model: least contraction force of a muscle [N]"),
    Parameter("governor", True).about(
        "law model: whether references are held back so that limits are kept (docs/explanation/control.md)"
    ),
    Parameter("governor_level", 0.999, 0.5, 0.999999).about("probability with which the governor keeps a limit [-]"),
    Parameter("governor_push", 0.0, 0.0, 1e3).about("torque from outside that the governor counts on [N m]"),
    Parameter("max_velocity", 0.0, 0.0, 1e3).about("largest velocity that the governor allows [rad/s]; 0: any"),
    Parameter("max_contraction", 0.0, 0.0, 1.0).about(
        "largest contraction (L_0 − l)/L_0 that the governor allows [-]; 0: any"
    ),
    Parameter("max_extension", 0.0, 0.0, 1.0).about(
        "largest extension (l − L_0)/L_0 that the governor allows [-]; 0: any"
    ),
    Parameter("max_angle", 0.0, 0.0, 1.6).about(
        "magnitude to which a reference of the angle is limited [rad]; 0: the rig file's joint.stop, or 25 degrees "
        "where it has none"
    ),
    Parameter("max_torque", 0.0, 0.0, 1e3).about(
        "magnitude to which a reference of the torque is limited [N m]; 0: what the muscles can do at angle 0"
    ),
    Parameter("max_angle_rate", 0.0, 0.0, 1e3).about("fastest change of the angle's reference [rad/s]; 0: any"),
    Parameter("max_torque_rate", 0.0, 0.0, 1e5).about("fastest change of the torque's reference [N m/s]; 0: any"),
    # An old angle reference only holds the joint. An old torque reference drives a free joint to its stop.
    Parameter("angle_reference_timeout", 0.0, 0.0, 3600.0).about(
        "time after which an angle reference that is not repeated is lost [s]; 0: never"
    ),
    Parameter("torque_reference_timeout", 0.5, 0.0, 3600.0).about(
        "time after which a torque reference that is not repeated is lost [s]; 0: never"
    ),
    Parameter("reference_lost", "safe", choices=LOST).about(
        "what follows a lost reference: safe, the safe voltages, or hold, which keeps the angle estimated at that "
        "moment"
    ),
    Parameter(
        "reference_source", "reference", choices=("reference", "joint_command", "commands", "joint_trajectory")
    ).about(
        "the one topic that references come from: reference (JointReference), joint_command (JointState: position or "
        "effort of joint_name, NaN: not asked), commands (Float64MultiArray), joint_trajectory (JointTrajectory)"
    ),
    Parameter("commands_mode", "angle", choices=("angle", "torque")).about("quantity of the numbers in topic commands"),
    Parameter("commands_index", 0, 0, 1000).about("index of this joint's number in topic commands, from 0 [-]"),
    Parameter("max_age", 0.0, 0.002, 10.0, left=0.0).about(
        "an estimate that is older than this is not used [s]; 0: three samples of the rig, at least 0.02"
    ),
    Parameter("resume_time", 0.5, 0.001, 60.0).about(
        "longest interruption after which the integral goes on as it was [s]"
    ),
    Parameter("start_enabled", True).about(
        "whether the controller sends commands as soon as it is active, without a call of ~/enable"
    ),
    Parameter("stop_angle", 0.0, 0.01, 1.6, left=0.0).about(
        "magnitude of the estimated angle beyond which the controller stops [rad]; 0: a degree beyond the rig file's "
        "joint.stop, or 26 degrees where it has none"
    ),
    Parameter("stop_angle_time", 0.01, 0.001, 1.0).about("time beyond stop_angle after which the controller stops [s]"),
    # 99.9 % quantile for two pressures. On recordings of joints whose parameters differ from the model by one or two
    # per cent, or that have an unmodelled effect, at most 2 % of the samples in any 0.1 s are above.
    Parameter("nis_limit", 13.8, 0.1, 1e9).about("normalised innovation squared that counts as out of bounds [-]"),
    Parameter("nis_time", 0.1, 0.01, 60.0).about(
        "the controller stops when 15 % of the samples within this time are out of bounds [s]"
    ),
    Parameter("blind_time", 0.1, 0.001, 10.0).about(
        "time for which estimates may lack one of the pressures before the controller stops [s]"
    ),
    Parameter("stop_on", [""]).about(
        "names of effects, as monitor publishes them on health, that stop the controller until clear_stop: [leak]; an "
        "empty text counts for nothing"
    ),
    Parameter("blend_time", 0.5, 0.001, 60.0).about(
        "time constant with which the offset of a bumpless start fades [s]"
    ),
)


def pi_gains(values: Mapping[str, Any], mode: Mode) -> Gains:
    """Gains of the PI."""
    name = mode.name.lower()
    velocity = values["angle_velocity"] if mode is Mode.ANGLE else 0.0
    return Gains(values[f"{name}_proportional"], values[f"{name}_integral"], values["bias"], velocity)


def model_gains(values: Mapping[str, Any]) -> ModelGains:
    """Gains of the law through the model, from parameters by name."""
    return ModelGains(values["pressure_bandwidth"], values["model_integral"], values["approach"])


def make_laws(values: Mapping[str, Any], rig: Rig, limits: VoltageLimits, safe_voltage: tuple[float, float]) -> Laws:
    """Both laws of a rig. `safe_voltage`: (2,) [V]."""
    period, resume, blend = rig.sample_period, values["resume_time"], values["blend_time"]
    pi = None
    if rig.drive == "valve":
        pi = PiController(
            {mode: pi_gains(values, mode) for mode in PI_MODES}, sample_period=period, limits=limits,
            safe_voltage=safe_voltage, resume_time=resume, blend_time=blend,
        )  # fmt: skip
    elif values["law"] == "pi":
        raise BadInput(f"law: pi puts voltages on valves, rig {rig.name} has pressure regulators: set law to model")
    p = rig.parameters()
    try:
        box = Box.of(p, values["lowest_pressure"] or None, values["supply_margin"], values["least_force"])
    except BadInput:
        if values["law"] == "model" or pi is None:
            raise
        return Laws(pi, None, None)  # the supply is too low for the model law: only the PI remains
    model = ModelController(
        p, box, model_gains(values), sample_period=period, limits=limits, safe_voltage=safe_voltage,
        resume_time=resume, blend_time=min(blend, ModelController.BLEND_TIME),
    )  # fmt: skip
    governor = _governor(values, p, box) if values["governor"] else None
    return Laws(pi, model, Reachable(p, box), values["law"], governor)


def _governor(values: Mapping[str, Any], p: np.ndarray, box: Box) -> Governor:
    """The governor; its pressure limits are the law's range, widened by ``supply_margin``."""

    def limit(name: str) -> float:
        return float(values[name]) or math.inf

    limits = JointLimits(
        box.lowest - values["supply_margin"], box.highest + values["supply_margin"], limit("max_angle"),
        limit("max_velocity"), limit("max_extension"), limit("max_contraction"),
    )  # fmt: skip
    return Governor(p, box, limits, values["governor_level"], values["governor_push"])


def retune(laws: Laws, before: Mapping[str, Any], after: Mapping[str, Any], mode: Mode | None) -> None:
    """Apply changed parameters without a bump, either all or none."""
    gains = {each: pi_gains(after, each) for each in PI_MODES}
    of_model = model_gains(after)
    laws.choose(after["law"], mode)
    for each in PI_MODES:
        if laws.pi is not None and gains[each] != pi_gains(before, each):
            laws.pi.retune(each, gains[each])
    if laws.model is not None and of_model != model_gains(before):
        laws.model.retune(of_model)


def described(laws: Laws) -> dict[str, object]:
    """State of the active law, for ``/diagnostics``."""
    if laws.pi is not None and (laws.name == "pi" or laws.model is None):
        return {"law": "pi", "integral term [V]": f"{laws.pi.integral:.4f}"}
    assert laws.model is not None  # there is one law at least
    values: dict[str, object] = {"law": "model", "integral term [N m]": f"{laws.model.integral:.4f}"}
    reached = laws.model.reached
    if reached is not None:
        values["pressures asked for [kPa]"] = f"{reached.pressure_1 * 1e-3:.1f}, {reached.pressure_2 * 1e-3:.1f}"
        values["stiffness within reach [N m/rad]"] = f"{reached.softest:.2f} to {reached.stiffest:.2f}"
        values["torque out of reach [N m]"] = f"{reached.missing:.3f}"
    if laws.governor is not None:
        active = laws.governor.active
        values["governor"] = f"holds the reference back: {active}" if active else "lets the reference through"
        values["held back by the governor"] = laws.governor.held_back
    return values
