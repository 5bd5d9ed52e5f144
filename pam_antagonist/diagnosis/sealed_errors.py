"""Errors of a sealed joint's models on held-out data, with the keys of ``report.json``.

``torque`` and ``pressure`` are errors of what the measured motion needs and does (:mod:`driven`), ``angle`` is that of
the model alone, run from the recording's start under the torque from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import errors
from pam_antagonist.estimation import Estimator, metrics
from pam_antagonist.inference.angle_driven import BALANCE, SLIDING, AngleDriven
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.inference.valve_driven import predict, start_of
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]


def channels_of(trial: Trial) -> tuple[int, ...]:
    """What is judged: the torque where it was recorded, the angle where the model can be run under that torque."""
    return (ANGLE, TORQUE, PRESSURE_1, PRESSURE_1 + 1) if trial.has(TORQUE) else (PRESSURE_1, PRESSURE_1 + 1)


def held_out(trial: Trial, fitted: int, rig: Rig) -> dict[str, Any]:
    """Errors of a rig's model on the samples that were held out.

    Args:
        trial: the recording.
        fitted: how many of its samples may have been fitted.
        rig: the model.

    Returns:
        Figures of each channel; of the torque also those of sliding and of sticking alone.
    """
    driven = AngleDriven(rig, trial, fitted, part=BALANCE)
    pressure, needed = driven.driven(driven.origin, whole=True)
    start = start_of(trial)
    alone = np.full(len(trial), np.nan)
    if trial.has(TORQUE):
        alone = predict(trial, rig.parameters("free"), start)[:, ANGLE]
    error = (trial.measured - np.column_stack([alone, needed, pressure]))[fitted:]
    out = errors.of(error, trial.measured[fitted:], channels_of(trial))
    out["pressure"]["mean_rmse_pa"] = float(np.sqrt(np.nanmean(error[:, PRESSURE_1:].mean(axis=1) ** 2)))
    if out["torque"] is not None:
        slides = np.abs(driven.motion.velocity[fitted:]) > SLIDING
        for name, rows in (("sliding", slides), ("sticking", ~slides)):
            known = error[rows, TORQUE][np.isfinite(error[rows, TORQUE])]
            out["torque"][f"rmse_{name}_nm"] = float(np.sqrt(np.mean(known**2))) if len(known) else None
        out["torque"]["sliding_share"] = float(np.mean(slides))
    return out


def of_estimator(recording: Recording, rig: Rig, trial: Trial, fitted: int) -> dict[str, Any]:
    """Errors of the estimator, which knows the two pressures only, on the samples that were held out.

    Args:
        recording: as read; the filter runs over all of it.
        rig: whose default tuning is used; ``torque`` is judged where it has the effect ``external_torque``.
        trial: the same recording on its even grid.
        fitted: how many of its samples may have been fitted.
    """
    run = Estimator(rig, joint="free").run(recording.stamp_ns, recording.pressure, recording.voltage)
    late = recording.stamp_ns[run.index] >= recording.stamp_ns[0] + round(fitted * trial.dt * 1e9)
    rows, index = run.rows[late], run.index[late]
    outside = run.added.get("external_torque")
    measured = np.full((len(rows), 4), np.nan)
    measured[:, PRESSURE_1:] = recording.pressure[index]
    channels = [PRESSURE_1, PRESSURE_1 + 1]
    estimate = np.column_stack([rows["angle"], np.full(len(rows), np.nan), rows["pressure"]])
    if recording.angle is not None:
        measured[:, ANGLE] = recording.angle[index]
        channels.append(ANGLE)
    if outside is not None and recording.external_torque is not None:
        measured[:, TORQUE] = recording.external_torque[index]
        estimate[:, TORQUE] = outside[late]
        channels.append(TORQUE)
    result = errors.of(measured - estimate, measured, channels)
    if result["angle"] is not None:
        result["angle"]["coverage95"] = metrics.coverage(
            measured[:, ANGLE] - estimate[:, ANGLE], rows["covariance"][:, 0, 0], rig.sensors.reading("angle")
        )
    normal = rows["innovation"] / np.sqrt(np.diagonal(rows["innovation_covariance"], axis1=1, axis2=2))
    result["innovation"] = {
        "nis_mean": float(np.nanmean(rows["nis"])),
        "whiteness_p": metrics.whiteness_p(normal),
        "largest_correlation": metrics.largest_autocorrelation(normal),
    }
    return result


def static_map(trials: Sequence[Trial], cuts: Sequence[int]) -> dict[str, float] | None:
    """Errors of what knows no physics: the torque as a straight line of the angle, and of angle and pressures.

    Fitted by least squares to what may be fitted, judged on the rest; None where no torque from outside was recorded.

    Args:
        trials: the recordings.
        cuts: how many samples of each may be fitted.
    """
    known = [(trial, cut) for trial, cut in zip(trials, cuts, strict=True) if trial.has(TORQUE)]
    if not known:
        return None
    out = {}
    for name, columns in (("angle", [ANGLE]), ("angle_and_pressures", [ANGLE, PRESSURE_1, PRESSURE_1 + 1])):
        parts = []
        for trial, cut in known:
            measured = trial.measured / np.array([1.0, 1.0, 1e5, 1e5])
            rows = np.isfinite(measured).all(axis=1)
            design = np.column_stack([np.ones(len(measured)), measured[:, columns]])
            parts.append((design, measured[:, TORQUE], rows & (np.arange(len(trial)) < cut), rows))
        early = np.concatenate([design[fit] for design, _, fit, _ in parts])
        given = np.concatenate([torque[fit] for _, torque, fit, _ in parts])
        solution = np.linalg.lstsq(early, given, rcond=None)[0]
        left = np.concatenate([(torque - design @ solution)[rows & ~fit] for design, torque, fit, rows in parts])
        out[name] = float(np.sqrt(np.mean(left**2)))
    return out
