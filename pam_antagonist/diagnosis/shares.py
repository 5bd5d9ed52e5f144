"""How much of what one model leaves beyond the sensors' noise another one takes away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.experiment import Experiment
from pam_antagonist.diagnosis.refit import Fitted

Floats = NDArray[np.float64]


class Left(NamedTuple):
    """What a model leaves of a recording.

    Attributes:
        held: residual of the held-out part (B, C).
        fitted: of the fitted part (B, C).
    """

    held: Floats
    fitted: Floats


def left_by(experiments: Sequence[Experiment], fits: Sequence[Fitted]) -> list[Left]:
    """What the models of all recordings leave."""
    return [Left(e.held(e.residual(f.point, whole=True)), f.residual) for e, f in zip(experiments, fits, strict=True)]


def held_share(experiments: Sequence[Experiment], before: Sequence[Left], after: Sequence[Left]) -> float:
    """Share of the held-out excess that is gone; negative where it has grown."""
    return share_of([e.taken_away(b.held, a.held) for e, b, a in zip(experiments, before, after, strict=True)])


def fitted_share(experiments: Sequence[Experiment], before: Sequence[Left], after: Sequence[Left]) -> float:
    """Likewise of the fitted one."""
    return share_of([e.taken_away(b.fitted, a.fitted) for e, b, a in zip(experiments, before, after, strict=True)])


def whole_share(experiments: Sequence[Experiment], before: Sequence[Left], after: Sequence[Left]) -> float:
    """Likewise of both together."""
    parts = []
    for experiment, old, new in zip(experiments, before, after, strict=True):
        parts += [experiment.taken_away(b, a) for b, a in zip(old, new, strict=True)]
    return share_of(parts)


def lost_share(
    experiments: Sequence[Experiment], base: Sequence[Left], without: Sequence[Left], whole: Sequence[Left]
) -> float:
    """Share of the base model's held-out excess that comes back without an effect.

    Args:
        experiments: the recordings.
        base: what the model without effects leaves.
        without: what the model without this one leaves.
        whole: what the model with all leaves.
    """
    gone = [e.taken_away(w.held, m.held)[0] for e, w, m in zip(experiments, without, whole, strict=True)]
    there = [e.taken_away(b.held, b.held)[1] for e, b in zip(experiments, base, strict=True)]
    return share_of(list(zip(gone, there, strict=True)))


def share_of(parts: Sequence[tuple[float, float]]) -> float:
    """Share of what was there that is gone, over parts of each of which that is known."""
    gone, there = np.sum(parts, axis=0)
    return float(gone) / float(there) if there > 0.0 else 0.0
