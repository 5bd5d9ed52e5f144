"""Make the controller's laws from its parameters, and describe them for ``/diagnostics``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from pam_antagonist.control import (
    PI_MODES,
    Box,
    Gains,
    Governor,
    Laws,
    Limits,
    Mode,
    ModelController,
    ModelGains,
    PiController,
    Reachable,
    VoltageLimits,
)
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig


def pi_gains(values: Mapping[str, Any], mode: Mode) -> Gains:
    """Gains of the PI."""
    name = mode.name.lower()
    velocity = values["angle_velocity"] if mode is Mode.ANGLE else 0.0
    return Gains(values[f"{name}_proportional"], values[f"{name}_integral"], values["bias"], velocity)


def model_gains(values: Mapping[str, Any]) -> ModelGains:
    """Gains of the law through the model, from parameters by name."""
    return ModelGains(values["pressure_bandwidth"], values["model_integral"], values["approach"])


def make_laws(values: Mapping[str, Any], rig: Rig, limits: VoltageLimits, safe_voltage: tuple[float, float]) -> Laws:
    """Both laws of a rig.

    Args:
        safe_voltage: (2,) [V].
    """
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

    limits = Limits(
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
