"""The normal equations of several trials that share parameters and have some values of their own.

The fitted vector holds F common values, then for each trial G deviations from them and the values of its start. A trial
depends on its K local values only: the parameters as they are in this trial, then its start. All values have a standard
normal prior. So the information matrix has the shape of an arrow: own values of two trials have no common entry. If
each trial's own values are eliminated first, time and memory grow as the number of trials does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def weighted(values: Floats, std: Floats) -> Floats:
    """Residuals or Jacobians of blocks in standard deviations, as rows.

    Args:
        values: (B, C), or (B, C, K).
        std: standard deviation of each channel (C,).

    Returns:
        Rows (B C,) or (B C, K); missing values (NaN) are 0.
    """
    scaled = values / std.reshape(-1, *[1] * (values.ndim - 2))
    return np.nan_to_num(scaled, copy=False).reshape(-1, *values.shape[2:])


@dataclass(frozen=True, eq=False)
class Local:
    """Information of one trial about its K local values: free parameters, then its start.

    Attributes:
        information: JᵀJ of its weighted residuals (K, K).
        pull: right-hand side of its normal equations (K,).
    """

    information: Floats
    pull: Floats


@dataclass(frozen=True, eq=False)
class Arrow:
    """Information and right-hand side of all trials, and of the prior's information.

    Attributes:
        common: information of the common values (F, F).
        between: of common and own values of each trial (N, F, O).
        own: of the own values of each trial (N, O, O).
        pull: right-hand side of the common values (F,).
        own_pull: right-hand side of the own values of each trial (N, O).
    """

    common: Floats
    between: Floats
    own: Floats
    pull: Floats
    own_pull: Floats

    @classmethod
    def of(cls, trials: Sequence[Local], deviations: Floats | None, count: int) -> Arrow:
        """Put trials together.

        Args:
            trials: information of each.
            deviations: change of the common values (F, G) by a trial's deviations of 1; None: there are none.
            count: number of common values F.
        """
        information = np.stack([trial.information for trial in trials])
        pull = np.stack([trial.pull for trial in trials])
        width = information.shape[1]
        ways = 0 if deviations is None else deviations.shape[1]
        # Local values that the own ones move.
        moves = np.zeros((width, ways + width - count))
        if deviations is not None:
            moves[:count, :ways] = deviations
        moves[count:, ways:] = np.eye(width - count)
        seen = information @ moves
        return cls(
            np.eye(count) + information[:, :count, :count].sum(axis=0),
            seen[:, :count],
            np.eye(moves.shape[1]) + moves.T @ seen,
            pull[:, :count].sum(axis=0),
            pull @ moves,
        )

    def whole(self) -> tuple[Floats, Floats]:
        """Information (S, S) and right-hand side (S,) of the fitted vector."""
        count, (trials, own) = len(self.common), self.own_pull.shape
        information = np.zeros((count + trials * own,) * 2)
        information[:count, :count] = self.common
        for index in range(trials):
            place = slice(count + index * own, count + (index + 1) * own)
            information[:count, place] = self.between[index]
            information[place, :count] = self.between[index].T
            information[place, place] = self.own[index]
        return information, np.concatenate([self.pull, self.own_pull.ravel()])

    def log_evidence(self) -> float:
        """−½ log det H + ½ bᵀ H⁻¹ b of information H and right-hand side b; own values are eliminated first."""
        right = np.concatenate([self.between.transpose(0, 2, 1), self.own_pull[:, :, None]], axis=2)
        solved = np.linalg.solve(self.own, right)
        left = self.common - (self.between @ solved[:, :, :-1]).sum(axis=0)
        pull = self.pull - (self.between @ solved[:, :, -1:]).sum(axis=0)[:, 0]
        volume = np.linalg.slogdet(left)[1] + np.linalg.slogdet(self.own)[1].sum()
        gain = pull @ np.linalg.solve(left, pull) + np.sum(self.own_pull * solved[:, :, -1])
        return float(0.5 * gain - 0.5 * volume)
