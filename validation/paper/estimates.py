"""Offline estimation: the model alone against the filter, and models compared by their angle (Table III)."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import minimize_scalar

from pam_antagonist.estimation import metrics
from pam_antagonist.rig import Rig
from validation.paper import linear
from validation.paper.virtual import JOINT, METHODS, TUNINGS, VirtualRig, filtered, judged, measured_of, modelled

COMPARED_S = 62.0
"""The part of the profile that models are compared over [s]: up to here it has been at all its extremes."""
LABELS = dict(zip(METHODS, ("model alone", "UKF, tuning published", "UKF, tuning default", "UKF, mismatches declared"),
                  strict=True))  # fmt: skip
MODELS = {
    "proposed": "Proposed model",
    "linear": "Linear model",
    "simple": "Simple friction model, the paper's constant",
    "tondu": "Tondu's friction model, the paper's constants",
    "none": "No friction term",
    "simple_fitted": "Simple friction model, constant fitted",
    "tondu_fitted": "Tondu's friction model, constants fitted",
}
_LARGEST_FACTOR = 5.0


def offline(rig: VirtualRig) -> dict[str, float]:
    """Errors of the model alone and of the filters over the whole profile."""
    out: dict[str, float] = {}
    for quantity, joint in JOINT.items():
        for method, label in LABELS.items():
            found = judged(rig.track(joint, method), getattr(rig, joint), rig.declared, quantity)
            out |= {f"{quantity}, {label}, {key}": value for key, value in found.items()}
    return out


def compare_angle(rig: VirtualRig) -> dict[str, float]:
    """Errors of each model with both tunings, over the part of the profile that is compared."""
    samples = round(COMPARED_S / rig.declared.sample_period)
    out = {f"factor of the fitted constants, {law}": _factor(rig, law) for law in ("simple", "tondu")}
    laws = {law: rig.declared.replaced(model=rig.declared.model.replaced(friction=law))
            for law in ("simple", "tondu", "none")}  # fmt: skip
    for law in ("simple", "tondu"):
        laws[f"{law}_fitted"] = _scaled(laws[law], out[f"factor of the fitted constants, {law}"])
    for name, label in MODELS.items():
        for tuning in TUNINGS:
            if name == "linear":
                found = _linear(rig, samples)
            else:
                track = filtered(laws.get(name, rig.declared), rig.free, tuning, "free", samples)
                found = judged(track, rig.free, rig.declared, "angle")
            out |= {f"{label}, tuning {tuning}, {key}": value for key, value in found.items()}
    return out


def _scaled(rig: Rig, factor: float) -> Rig:
    """A rig with the constants of the compared laws of friction times a factor."""
    friction = rig.friction
    changed = {name: factor * getattr(friction, name) for name in ("lever_force", "static", "kinetic")}
    return rig.replaced(friction=friction.replaced(**changed))


def _factor(rig: VirtualRig, law: str) -> float:
    """What the law's constants have to be multiplied by, so that the model alone errs least on the other recording."""
    recording = rig.identification
    other = rig.declared.replaced(model=rig.declared.model.replaced(friction=law))
    measured = measured_of(recording, "angle")

    def error(factor: float) -> float:
        return metrics.rmse(modelled(_scaled(other, factor), recording, "free").angle - measured)

    found = minimize_scalar(error, bounds=(0.0, _LARGEST_FACTOR), method="bounded", options={"xatol": 0.05})
    return float(found.x)


def _linear(rig: VirtualRig, samples: int) -> dict[str, float]:
    """The linear model identified from another recording of the same rig; its own filter in place of a tuning."""
    data = rig.identification
    model = linear.identify(measured_of(data, "angle"), data.pressure, data.voltage)
    angle, variance, nis = linear.estimate(model, rig.free.pressure[:samples], rig.free.voltage[:samples])
    measured = measured_of(rig.free, "angle")[:samples]
    reading = rig.declared.sensors.reading("angle").scaled(math.degrees(1.0))
    return {
        "𝕀": metrics.rmse(angle - measured),
        "𝕄": metrics.max_error(angle - measured),
        "ℚ": metrics.estimation_ratio(angle - measured, measured),
        "in 95 %": metrics.coverage(angle - measured, np.full(samples, variance), reading),
        "NIS": float(nis.mean()),
    }
