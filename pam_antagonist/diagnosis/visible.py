"""Which effects recordings could show at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis.select import STRONG, Model
from pam_antagonist.inference.candidates import Candidate
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import Fitted
from pam_antagonist.inference.likelihood import BLOCKS_PER_ERROR, solve
from pam_antagonist.inference.trial import ANGLE
from pam_antagonist.model.effects import DISTURBANCE

Floats = NDArray[np.float64]


def invisible(experiments: Sequence[Experiment], base: Model, jobs: int) -> tuple[str, ...]:
    """Effects that would not show in these recordings, even if nothing else were wrong.

    An effect shows where one of its sizes, neither small nor large, moves what was measured beyond the sensors' noise
    in a way that the base parameters cannot imitate, by strong evidence.

    Args:
        experiments: the recordings.
        base: the recalibrated model.
        jobs: threads.
    """
    pairs = list(zip(experiments, base.fits, strict=True))
    names = [candidate.effect for candidate in experiments[0].candidates({})]
    shown = Parallel(n_jobs=jobs, prefer="threads")(delayed(_shows)(name, *pair) for name in names for pair in pairs)
    count = len(pairs)
    out = [name for k, name in enumerate(names) if not any(shown[k * count : (k + 1) * count])]
    if not any(ANGLE in experiment.channels for experiment in experiments):
        out.append(DISTURBANCE)
    return tuple(out)


def _shows(name: str, experiment: Experiment, fitted: Fitted) -> bool:
    candidate = Candidate(name)
    shapes = {shape.path: shape.item.neutral for shape in candidate.shapes}
    scale, none = fitted.scale, np.zeros((*fitted.residual.shape, 0))
    for size in candidate.sizes:
        values = dict.fromkeys(size.paths, size.bounded(size.item.scale))
        change = experiment.residual(Point(fitted.point.theta, {**shapes, **values})) - fitted.residual
        # As a fit would see it, were the rest noise.
        step = solve(
            change, fitted.base, none, scale, experiment.prior, np.zeros(experiment.size), rounds=1,
            first=scale.noise**2, length=np.full(len(scale.noise), BLOCKS_PER_ERROR),
        )  # fmt: skip
        rise = np.log1p(np.mean(step.residual**2, axis=0) / scale.noise**2)
        if len(change) / BLOCKS_PER_ERROR * float(rise.sum()) - float(np.log(change.size / BLOCKS_PER_ERROR)) > STRONG:
            return True
    return False
