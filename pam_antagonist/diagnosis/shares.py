"""How much of what one model leaves beyond the sensors' noise another one takes away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted

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
    return further_share(experiments, before, before, after, fitted=False)


def fitted_share(experiments: Sequence[Experiment], before: Sequence[Left], after: Sequence[Left]) -> float:
    """Likewise of the fitted one."""
    return share_of([e.excess_removed(b.fitted, a.fitted) for e, b, a in zip(experiments, before, after, strict=True)])


def whole_share(experiments: Sequence[Experiment], before: Sequence[Left], after: Sequence[Left]) -> float:
    """Likewise of both together."""
    return further_share(experiments, before, before, after)


def further_share(
    experiments: Sequence[Experiment],
    base: Sequence[Left],
    before: Sequence[Left],
    after: Sequence[Left],
    fitted: bool = True,
) -> float:
    """Share of the base model's excess that goes with one effect among others.

    Args:
        experiments: the recordings.
        base: what the model without effects leaves.
        before: what the model without this one leaves.
        after: what the model with it leaves.
        fitted: whether the fitted parts count as well as the held-out ones.
    """
    parts = []
    for experiment, first, old, new in zip(experiments, base, before, after, strict=True):
        for b, w, a in list(zip(first, old, new, strict=True))[: 2 if fitted else 1]:
            parts.append((experiment.excess_removed(w, a)[0], experiment.excess_removed(b, b)[1]))
    return share_of(parts)


def share_of(parts: Sequence[tuple[float, float]]) -> float:
    """Share of what was there that is gone, over parts of each of which that is known."""
    gone, there = np.sum(parts, axis=0)
    return float(gone) / float(there) if there > 0.0 else 0.0
