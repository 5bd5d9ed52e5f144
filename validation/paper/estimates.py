"""Offline estimation: the model alone against the filter, models by their angle, force maps by their torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from scipy.optimize import minimize_scalar

from pam_antagonist.estimation import metrics
from pam_antagonist.identification.tobit import Undetermined
from pam_antagonist.rig import Rig
from validation.paper import linear, model
from validation.paper.virtual import (
    JOINT,
    METHODS,
    TUNINGS,
    Track,
    VirtualRig,
    filtered,
    judged,
    measured_of,
    modelled,
)

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
"""Table III."""
FORMS = {
    "linear": "Equation (6)",
    "hildebrandt": "Polynomial model 1 (Hildebrandt 2005)",
    "sarosi": "Polynomial model 2 (Sárosi 2010)",
    "polynomial": "Polynomial model 3 (2012)",
}
"""Table IV."""
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
    out = {f"factor of the fitted constants, {law}": _factor(rig, law) for law in ("simple", "tondu")}
    laws = {law: rig.declared.replaced(model=rig.declared.model.replaced(friction=law))
            for law in ("simple", "tondu", "none")}  # fmt: skip
    for law in ("simple", "tondu"):
        laws[f"{law}_fitted"] = _scaled(laws[law], out[f"factor of the fitted constants, {law}"])
    for name, label in MODELS.items():
        if name == "linear":
            found = _linear(rig)
            out |= {f"{label}, tuning {tuning}, {key}": found[key] for tuning in TUNINGS for key in found}
        else:
            out |= _judged(rig, laws.get(name, rig.declared), "angle", label, TUNINGS)
    return out


def _judged(rig: VirtualRig, other: Rig, quantity: str, label: str, tunings: Sequence[str]) -> dict[str, float]:
    """Errors of a filter with another model, over the part of the profile that is compared."""
    out: dict[str, float] = {}
    joint, samples = JOINT[quantity], round(COMPARED_S / rig.declared.sample_period)
    for tuning in tunings:
        recording = getattr(rig, joint)
        found = judged(filtered(other, recording, tuning, joint, samples), recording, rig.declared, quantity)
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


def _linear(rig: VirtualRig) -> dict[str, float]:
    """The linear model identified from another recording of the same rig; its own filter in place of a tuning."""
    samples, data = round(COMPARED_S / rig.declared.sample_period), rig.identification
    found = linear.identify(measured_of(data, "angle"), data.pressure, data.voltage)
    angle = linear.estimate(found, rig.free.pressure[:samples], rig.free.voltage[:samples])
    return judged(Track(angle, angle), rig.free, rig.declared, "angle")


def compare_torque(rig: VirtualRig) -> dict[str, float]:
    """Errors of each force map, fitted to the rig's static test, with both tunings; NaN where it is undetermined."""
    out: dict[str, float] = {}
    for form, label in FORMS.items():
        try:
            fits = model.static_fits(rig, form)
        except Undetermined:  # a straight map leaves the exponent of a curved form free
            out[f"{label}, tuning published, ℚ"] = math.nan
            continue
        changes: dict[str, Any] = {"model": rig.declared.model.replaced(force=form)}
        for which, found in zip((1, 2), fits, strict=True):
            part = getattr(rig.declared, f"muscle_{which}")
            values = dict(zip(found.names, found.coefficients.tolist(), strict=True))
            changes[f"muscle_{which}"] = part.replaced(force=part.force.replaced(**values))
        fitted = rig.declared.replaced(name=f"{rig.declared.name}, {form} fitted", **changes)
        out |= _judged(rig, fitted, "torque", label, ("published",))
    return out
