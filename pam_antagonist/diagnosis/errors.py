"""Errors of a model on held-out data, with the keys of ``report.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import EstimateRun, Estimator, metrics
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]


def held_out(experiment: Experiment, point: Point) -> dict[str, Any]:
    """Errors of the model alone, run from the recording's start, on the samples that were held out."""
    measured = experiment.trial.measured[experiment.fitted :]
    return of(measured - experiment.simulated(point, whole=True)[experiment.fitted :], measured, experiment.channels)


def of(error: Floats, measured: Floats, channels: Sequence[int]) -> dict[str, Any]:
    """Error figures of all channels.

    Args:
        error: (N, 4), NaN where nothing was measured.
        measured: (N, 4).
        channels: those that were measured and can tell something.
    """

    def figures(channel: int, unit: str, factor: float) -> dict[str, float] | None:
        if channel not in channels:
            return None
        e = error[np.isfinite(error[:, channel]), channel]
        span = float(np.nanmax(measured[:, channel]) - np.nanmin(measured[:, channel]))
        most = float(np.max(np.abs(e)))
        return {
            f"rmse_{unit}": factor * float(np.sqrt(np.mean(e**2))),
            f"max_{unit}": factor * most,
            "q": most / span if span > 0.0 else float("nan"),
        }

    pressures = [float(np.sqrt(np.nanmean(error[:, PRESSURE_1 + i] ** 2))) for i in (0, 1)]
    return {
        "angle": figures(ANGLE, "deg", float(np.degrees(1.0))),
        "torque": figures(TORQUE, "nm", 1.0),
        "pressure": {"rmse_pa": pressures},
    }


@dataclass(frozen=True, eq=False)
class FilterRun:
    """The estimator over a recording, on the samples that were held out.

    Attributes:
        figures: its errors, with the keys of ``report.json``.
        time: of each sample since the recording's first (M,) [s].
        innovation: what the pressures were beside the prediction, in its standard deviations (M, 2).
    """

    figures: dict[str, Any]
    time: Floats
    innovation: Floats


def filtered(recording: Recording, rig: Rig, experiment: Experiment) -> tuple[EstimateRun, NDArray[np.bool_]]:
    """The estimator over a recording, and which of its samples were held out (M,).

    Args:
        recording: as read; the filter runs over all of it.
        rig: whose default tuning is used.
        experiment: the recording on its even grid: condition of the joint, what was held out.
    """
    trial = experiment.trial
    estimator = Estimator(rig, joint=trial.joint, lock_angle=trial.lock_angle)
    run = estimator.run(recording.stamp_ns, recording.pressure, recording.voltage)
    late = recording.stamp_ns[run.index] >= recording.stamp_ns[0] + round(experiment.fitted * trial.dt * 1e9)
    return run, np.asarray(late)


def of_estimator(recording: Recording, rig: Rig, experiment: Experiment) -> FilterRun:
    """Errors of the estimator, which knows pressures and voltages only, on the samples that were held out.

    Args:
        recording: as read; the filter runs over all of it.
        rig: whose default tuning is used.
        experiment: the recording on its even grid: condition of the joint, measurements, what was held out.
    """
    run, late = filtered(recording, rig, experiment)
    rows, index = run.rows[late], run.index[late]
    measured = np.full((len(rows), 4), np.nan)
    for channel, values in ((ANGLE, recording.angle), (TORQUE, recording.torque)):
        if values is not None:
            measured[:, channel] = values[index]
    measured[:, PRESSURE_1:] = recording.pressure[index]
    estimate = np.column_stack([rows["angle"], rows["torque"], rows["pressure"]])
    result = of(measured - estimate, measured, experiment.channels)
    for name, channel in (("angle", ANGLE), ("torque", TORQUE)):
        if result[name] is not None:
            variance = rows["covariance"][:, 0, 0] if channel == ANGLE else rows["covariance"][:, 2, 2]
            result[name]["coverage95"] = metrics.coverage(
                measured[:, channel] - estimate[:, channel], variance, rig.sensors.reading(name)
            )
    normal = rows["innovation"] / np.sqrt(np.diagonal(rows["innovation_covariance"], axis1=1, axis2=2))
    result["innovation"] = {
        "nis_mean": float(np.nanmean(rows["nis"])),
        "whiteness_p": metrics.whiteness_p(normal),
        "largest_correlation": metrics.largest_autocorrelation(normal),
    }
    time = (recording.stamp_ns[index] - recording.stamp_ns[0]) * 1e-9
    return FilterRun(result, np.asarray(time, dtype=np.float64), np.asarray(normal, dtype=np.float64))


def together(parts: Sequence[Mapping[str, Any]], samples: Sequence[int]) -> dict[str, Any]:
    """Errors over several recordings: root mean squares over all samples, the largest of the others."""

    def channel(name: str, unit: str) -> dict[str, float] | None:
        known = [(part[name], count) for part, count in zip(parts, samples, strict=True) if part[name] is not None]
        if not known:
            return None
        total = sum(count for _, count in known)
        square = sum(item[f"rmse_{unit}"] ** 2 * count for item, count in known) / total
        return {
            f"rmse_{unit}": float(np.sqrt(square)),
            f"max_{unit}": max(item[f"max_{unit}"] for item, _ in known),
            "q": max(item["q"] for item, _ in known),
        }

    squares = np.array([np.array(part["pressure"]["rmse_pa"]) ** 2 for part in parts])
    weights = np.array(samples, float) / sum(samples)
    return {
        "angle": channel("angle", "deg"),
        "torque": channel("torque", "nm"),
        "pressure": {"rmse_pa": [float(value) for value in np.sqrt(weights @ squares)]},
    }
