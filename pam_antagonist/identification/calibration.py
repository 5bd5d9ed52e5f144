"""How wrong the estimate is where nothing was fitted: one scale for all uncertain directions of the parameters.

It is told by the errors of the measured angle and torque beyond the part that an inner fit had. A process noise of the
angle was tried beside it: such errors gave it no size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from pam_antagonist.identification.directions import considered_directions, run_filter, short_part, with_directions
from pam_antagonist.identification.fit import Fit
from pam_antagonist.inference.trial import ANGLE, TORQUE, Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

INNER_SHARE = 2.0 / 3.0
"""Of the fitted part, what an inner fit gets; the rest tells how wrong such a fit is where it was not fitted."""
_SCALES = (1.0, 8.0)
"""Not below 1: a handful of slow errors can show that the parameters' covariance is too small, but not that it is too
large."""
_CALIBRATIONS = 12


def calibrate(rig: Rig, trials: Sequence[Trial], inner: Fit, covariance: Floats, jobs: int) -> tuple[float, bool]:
    """The scale under which the errors of measured angles and torques are most likely, and whether there were any.

    They are those after the part that ``inner`` was fitted to: in that part a fit comes nearer to what was measured
    than to the truth, by as much as it is uncertain.

    Args:
        rig: with the values of ``inner``, noise and Q.
        trials: recordings beyond the part that ``inner`` was fitted to.
        inner: a fit of their beginnings.
        covariance: of its parameters (F, F), in units of the priors.
        jobs: threads.
    """
    fields = {ANGLE: ("angle", 0), TORQUE: ("torque", 2)}
    judged = [(k, channel) for k, trial in enumerate(trials) for channel in fields if trial.has(channel)]
    parts = [short_part(trial) for trial in trials]
    directions = considered_directions(rig, parts, inner.problem.free, covariance, jobs)
    if not judged or not directions:
        return 1.0, False
    noise = {ANGLE: rig.sensors.error("angle") ** 2, TORQUE: rig.sensors.error("torque") ** 2}

    def against(logarithm: float) -> float:
        now = with_directions(rig, directions, math.exp(logarithm))
        runs = Parallel(n_jobs=jobs, prefer="threads")(delayed(run_filter)(now, trial) for trial in trials)
        total = 0.0
        for k, channel in judged:
            name, place = fields[channel]
            begin = round(INNER_SHARE * len(runs[k].rows))
            rows, index = runs[k].rows[begin:], runs[k].index[begin:]
            error = rows[name] - trials[k].measured[index, channel]
            variance = rows["covariance"][:, place, place] + max(noise[channel], 1e-12)
            good = np.isfinite(error)
            total += float(np.mean(0.5 * error[good] ** 2 / variance[good] + 0.5 * np.log(variance[good])))
        return total

    bounds = (math.log(_SCALES[0]), math.log(_SCALES[1]))
    options = {"xatol": 0.05, "maxiter": _CALIBRATIONS}
    found = minimize_scalar(against, bounds=bounds, method="bounded", options=options)
    return float(math.exp(found.x)), True
