"""What is said of the values that an identification found."""

from __future__ import annotations

from pam_antagonist.identification.air_stage import SUPPLY
from pam_antagonist.identification.joint_stage import DELAY
from pam_antagonist.inference.fit import FAR, Fit

CLEAR = 3.0
"""A zero or a delay is said from so many standard errors on. It was 5 while these left out errors that last, and was
changed with a recording in view whose angle is late by 8 ms."""
_MEASURE = "measure it; if the rig file is right, the model lacks something there."
_MOST_PULLED = 3
"""Values of which it is said that recordings pull them apart: those that differ most."""


def values_in_words(joint: Fit, air: Fit | None) -> tuple[str, ...]:
    """What a user should know of the values that were found, in sentences."""
    out = []
    late, std = -joint.values.get(DELAY, 0.0), joint.stds.get(DELAY, 0.0)
    if abs(late) > max(CLEAR * std, 2e-3):
        words = "late against" if late > 0.0 else "ahead of"
        out.append(f"The angle is {words} the pressures by {abs(late) * 1e3:.1f} ± {std * 1e3:.1f} ms (corrected).")
    if joint.lost:
        out.append("The fit of joint and muscles stayed far from the measured angle: no value is determined.")
    for fit in [joint] if air is None else [joint, air]:
        out += put_back(fit)
        out += [
            f"{item.name} stands at the end of its range, {fit.values[item.name]:.4g}: {_MEASURE}"
            for item in fit.unknowns
            if item.name in fit.at_bounds and item.name not in fit.kept and not item.may_vanish
        ]
        for item, amount in zip(fit.unknowns, fit.amounts, strict=True):
            if item.name == SUPPLY and abs(amount) > FAR and item.name not in fit.at_bounds:
                moved = f"{item.name} went from {item.start:.4g} to {fit.values[item.name]:.4g} Pa"
                out.append(f"{moved}, though a gauge tells it within a few per cent: {_MEASURE}")
        out += _pulled_apart(fit)
    return tuple(out)


def put_back(fit: Fit) -> list[str]:
    """What is said of values that met a bound and have the rig file's value again."""
    return [
        f"{name} met its bound, {met:.4g}, and keeps the rig file's value, {fit.values[name]:.4g}: {_MEASURE}"
        for name, met in fit.kept.items()
    ]


def _pulled_apart(fit: Fit) -> list[str]:
    """Values that one recording pulls away from the others, in a sentence for each recording."""
    recordings: dict[str, list[str]] = {}
    for name, recording, without, _ in fit.pulled[:_MOST_PULLED]:
        words = f"{name} would be {without:.4g} in place of {fit.values[name]:.4g}"
        recordings.setdefault(recording, []).append(words)
    return [
        f"{recording} contradicts the other recordings: without it, {', and '.join(words)}. The standard errors have "
        "this difference. The model may lack an effect: close_loop looks for it."
        for recording, words in recordings.items()
    ]
