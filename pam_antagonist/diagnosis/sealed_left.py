"""What the models of a sealed joint leave unexplained, described as for any other joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pam_antagonist.diagnosis import dependence, residuals
from pam_antagonist.diagnosis.dependence import Surroundings
from pam_antagonist.diagnosis.remaining import Left
from pam_antagonist.diagnosis.select import Model
from pam_antagonist.inference.angle_driven import AngleDriven
from pam_antagonist.inference.experiment import Point
from pam_antagonist.inference.gauss_newton import AT_NOISE
from pam_antagonist.inference.trial import BLOCK, blocks


def describe(experiments: Sequence[AngleDriven], model: Model) -> list[Left]:
    """What is beyond the noise in each channel of a part of the joint."""
    out = []
    for experiment, fitted in zip(experiments, model.fits, strict=True):
        over = experiment.times_noise(fitted.residual)
        whole = experiment.residual(fitted.point, whole=True)
        step = BLOCK * experiment.trial.dt
        late = np.arange(len(whole)) >= -(-experiment.fitted // BLOCK)
        around = _around(experiment, fitted.point, step)
        for k, (name, unit, factor) in enumerate(experiment.titles):
            if over[k] < AT_NOISE:
                continue
            values = whole[:, k] * factor
            out.append(
                Left(
                    recording=experiment.trial.name,
                    channel=name[0].lower() + name[1:],
                    unit=unit,
                    times_noise=float(over[k]),
                    depends_on=dependence.shares(values[~late], around.take(~late)),
                    bands=dependence.bands(values[~late], step),
                    period=dependence.period(values[~late], step),
                    form=dependence.form(values[~late], around.take(~late), (values[late], around.take(late))),
                    values=values[~late],
                    around=around.take(~late),
                )
            )
    return out


def statistics(experiment: AngleDriven, point: Point) -> list[dict[str, Any]]:
    """The residuals of a part of the joint on what was held out, with the keys of ``report.json``.

    Args:
        experiment: air or balance of a recording.
        point: the model.
    """
    step = BLOCK * experiment.trial.dt
    first = -(-experiment.fitted // BLOCK)
    residual = experiment.residual(point, whole=True)[first:]
    around = _around(experiment, point, step)
    given = {"pressure 1": around.pressure[first:, 0], "pressure 2": around.pressure[first:, 1]}
    if around.angle is not None and around.velocity is not None:
        given |= {"angle": around.angle[first:], "velocity": around.velocity[first:]}
    out = []
    for k, (name, unit, factor) in enumerate(experiment.titles):
        row = residuals.row_of(factor * residual[:, k], factor * experiment.noise[k], given, step)
        out.append({"channel": name[0].lower() + name[1:], "kind": "sensor", "unit": unit, **row})
    return out


def _around(experiment: AngleDriven, point: Point, step: float) -> Surroundings:
    pressure, _ = experiment.driven(point, whole=True)
    motion = blocks(np.column_stack([experiment.motion.angle, experiment.motion.velocity]))
    count = len(motion)
    return Surroundings(
        blocks(pressure), np.zeros((count, 2)), np.asarray(np.arange(count) * step), motion[:, 0], motion[:, 1]
    )
