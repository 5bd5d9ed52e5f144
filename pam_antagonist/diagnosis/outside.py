"""Whether what no law explains is something that pushes the joint now and then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from pam_antagonist.diagnosis import pushes
from pam_antagonist.diagnosis.candidates import UNKNOWN_INPUT
from pam_antagonist.diagnosis.experiment import Experiment
from pam_antagonist.diagnosis.refit import cost_of, excess
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.select import Model, price

NOTE = (
    "a push is known only afterwards: the model alone cannot foresee it, and its errors stay; the estimator has it as "
    "a state"
)
_CLEAN = 2.0
"""A recording in which nothing can push is that clean, in multiples of the noise."""
_UNKNOWNS = 3
"""Begin, end and height of each push."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Pushes as the explanation of all recordings."""

    model: Model
    effect: FoundEffect
    values: Mapping[str, float]
    share: float


def explain(experiments: Sequence[Experiment], base: Model, jobs: int) -> Explanation | None:
    """Explain all recordings by pushes, if they come and go and leave little; else None.

    Args:
        experiments: the recordings.
        base: the recalibrated model.
        jobs: threads.
    """
    found = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(pushes.find)(e, f) for e, f in zip(experiments, base.fits, strict=True)
    )
    seen, fits, evidence = [], [], 0.0
    for experiment, fitted, push in zip(experiments, base.fits, found, strict=True):
        if np.max(excess(experiment, fitted.residual)) < _CLEAN:
            fits.append(fitted)
            continue
        if push is None or not push.explains:
            return None
        seen.append((experiment.trial.name, push))
        fits.append(push.model())
        gain = cost_of(experiment, fitted.point, fitted.residual, fitted.scale)
        gain -= cost_of(experiment, push.fitted.point, push.fitted.residual, fitted.scale)
        evidence += fitted.scale.share * gain - price(experiment, fitted, _UNKNOWNS * push.episodes)
    if not seen:
        return None
    noise = float(np.sqrt(np.mean([push.noise**2 for _, push in seen])))
    spread = float(np.ptp([push.noise for _, push in seen])) / 2.0
    # A root of a mean square over so many pushes is known to its inverse root.
    std = max(spread, noise / np.sqrt(2.0 * sum(push.episodes for _, push in seen)))
    share = min(push.shares[0] for _, push in seen)
    names = tuple(name for name, _ in seen)
    effect = FoundEffect(UNKNOWN_INPUT, None, {"noise": (noise, std, "N m/s^0.5")}, evidence, share, names, (NOTE,))
    values = {"effects.external_torque.noise": noise}
    return Explanation(Model((UNKNOWN_INPUT,), tuple(fits)), effect, values, share)
