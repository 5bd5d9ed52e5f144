"""The evidence of a monitor: a generalised likelihood ratio for each hypothesis and each onset, block by block.

A block of a second holds the score s = Σ gᵀ S⁻¹ ν and the information I = Σ g gᵀ-weighted by S⁻¹ of all responses g
(:mod:`~pam_antagonist.diagnosis.monitor_responses`). The uncertain parameters θ ~ N(μ, V) have what blocks before the
window say of them, and the rig file before that. For an onset t₀, over the blocks since then and with index h for the
hypothesis and n for the uncertain parameters,

    s̃ = Σ (s_h − I_hn μ) − I_hn (I_nn + V⁻¹)⁻¹ Σ (s_n − I_nn μ),    Ĩ = I_hh − I_hn (I_nn + V⁻¹)⁻¹ I_nh,

the size is s̃/Ĩ ± √(λ/Ĩ), and the evidence (a log likelihood ratio) s̃²/(2 λ Ĩ). Innovations of real filters are
neither white nor of the size that a filter says: λ is the robust variance of the standardised scores of one, four and
ten blocks, from the differences of neighbours, in which an onset counts once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.monitor_responses import Watched

Floats = NDArray[np.float64]

WINDOW = 120
"""Blocks that are searched for an onset."""
_LIMIT = 4.5
"""Evidence that a block gives at most: what happens once is no state of the joint."""
_HISTORY = 900
"""Blocks before the window from which λ is taken."""
_KEPT = 1.0 - 1.0 / 1800.0
"""Share of what is known of the uncertain parameters that is kept from block to block."""
_LEAST_INFLATION, _FIRST_INFLATION, _TOGETHER, _FEWEST = 0.05, 2.0, (1, 4, 10), 8
"""Bounds of λ at any time and before twenty blocks; blocks that are summed up for it; fewest such sums."""
_INEXACT = 0.01
"""Square of the relative error of a first-order response: what uncertain parameters explain but for it is no sign."""
_ROBUST = 1.0 / (0.6745 * math.sqrt(2.0))
_WITHIN = 2.0
"""An onset is possible while its evidence is within this of the largest."""
_ALIKE = 0.9
"""A hypothesis with this share of the largest evidence cannot be told from the first."""


@dataclass(frozen=True)
class Finding:
    """What a monitor says of a hypothesis at its best onset."""

    watched: Watched
    evidence: float  # of which no block gives more than a limit
    full: float  # without that limit
    onset_ns: int
    onset_std: float  # [s]
    size: float
    std: float


def alike(findings: Sequence[Finding]) -> list[str]:
    """Names that cannot be told from that of the first finding."""
    first = findings[0]
    near = [one for one in findings if one.full > _ALIKE * first.full]
    labels = [one.watched.name + (f" {one.watched.muscle}" if one.watched.muscle else "") for one in near]
    return list(dict.fromkeys(labels))[1:]


class Blocks:
    """The blocks of the window, and what is known from those before.

    `watched`: the hypotheses. `count`: of all responses, those of the uncertain parameters included.
    """

    def __init__(self, watched: Sequence[Watched], count: int) -> None:
        self.watched = watched
        low, high = ([getattr(item, name) / item.step for item in watched] for name in ("low", "high"))
        wide = [math.inf] * (count - len(watched))
        self._bounds = np.array([*low, *(-value for value in wide)]), np.array([*high, *wide])
        self._scores, self._information = np.zeros((WINDOW, count)), np.zeros((WINDOW, count, count))
        self._begins = np.zeros(WINDOW, dtype=np.int64)
        self._standard = np.zeros((0, count))
        self._known = np.arange(len(watched), count)
        self._certainty, self._sums = np.eye(len(self._known)), np.zeros(len(self._known))
        self.count = 0

    def add(self, begin_ns: int, score: Floats, information: Floats) -> None:
        """Add a block. `score`: (H,). `information`: (H, H)."""
        k = self.count % WINDOW
        if self.count >= WINDOW:
            self._to_history(k)
        self._scores[k], self._information[k], self._begins[k] = score, information, begin_ns
        self.count += 1

    def accept(self, finding: Finding) -> None:
        """Take a hypothesis for known from now on, with a size of any value; the window begins anew."""
        k = next(k for k, item in enumerate(self.watched) if item == finding.watched)
        if k not in self._known:
            size = len(self._known)
            self._known = np.append(self._known, k)
            wider = np.full((size + 1, size + 1), 0.0)
            wider[:size, :size] = self._certainty
            wider[size, size] = 1e-9 * float(self._information[:, k, k].sum()) + 1e-12
            self._certainty, self._sums = wider, np.append(self._sums, 0.0)
        self.count = 0

    def _to_history(self, k: int) -> None:
        info, known = self._information[k], self._known
        left = self._scores[k] - info[:, known] @ np.linalg.solve(self._certainty, self._sums)
        standard = left / np.sqrt(np.maximum(np.diagonal(info), 1e-300))
        self._standard = np.concatenate([self._standard, standard[None]])[-_HISTORY:]
        prior = np.where(known >= len(self.watched), 1.0, 0.0)
        kept = _KEPT * (self._certainty - np.diag(prior)) + np.diag(prior)
        self._certainty = kept + info[np.ix_(known, known)]
        self._sums = _KEPT * self._sums + self._scores[k][known]

    def findings(self) -> list[Finding]:
        """Every hypothesis at its best onset, the one with most evidence first."""
        if not self.count:
            return []
        known, order = self._known, self._order()
        info, left, weights, projected, information, inflation = self._projected(order)
        size = np.clip(projected / information, *self._bounds)
        full = size * (projected - 0.5 * size * information) / inflation
        begins, found = self._begins[order], []
        for k, item in enumerate(self.watched):
            if k in known:
                continue
            b = int(np.argmax(full[:, k]))
            near = begins[full[:, k] >= full[b, k] - _WITHIN]
            limit = _LIMIT * inflation[k]
            limited = self._limited(left[b:], info[b:], k, weights[b, :, k], float(size[b, k]), limit)
            found.append(
                Finding(
                    item, limited / inflation[k], float(full[b, k]), int(begins[b]),
                    0.5 * (float(near[-1] - near[0]) * 1e-9 + 1.0), item.step * float(size[b, k]),
                    item.step * float(np.sqrt(inflation[k] / information[b, k])),
                )
            )  # fmt: skip
        return sorted(found, key=lambda one: -one.full)

    def stds(self) -> Floats:
        """Standard deviation of each hypothesis's size over the whole window."""
        _, _, _, _, information, inflation = self._projected(self._order())
        steps = np.array([item.step for item in self.watched])
        return steps * np.sqrt(inflation / information[0])[: len(steps)]

    def _order(self) -> NDArray[np.int64]:
        return np.arange(max(0, self.count - WINDOW), self.count) % WINDOW

    def _projected(self, order: NDArray[np.int64]) -> tuple[Floats, ...]:
        """Of the blocks I, s − I μ, and since each of them the weights of the uncertain parameters, s̃, Ĩ; and λ."""
        info, known = self._information[order], self._known
        own = np.maximum(np.diagonal(info, axis1=1, axis2=2), 1e-300)
        left = self._scores[order] - info[:, :, known] @ np.linalg.solve(self._certainty, self._sums)
        inflation = _inflation(self._standard if len(self._standard) >= WINDOW // 2 else left / np.sqrt(own))
        whole, total, crossed = (np.cumsum(values[::-1], axis=0)[::-1] for values in (left, own, info[:, known]))
        weights = np.linalg.solve(crossed[:, :, known] + self._certainty, crossed)
        information = np.maximum(total - np.einsum("bnh,bnh->bh", crossed, weights), 0.0) + _INEXACT * total
        projected = whole - np.einsum("bnh,bn->bh", weights, whole[:, known])
        return info, left, weights, projected, information, inflation

    def _limited(self, left: Floats, info: Floats, k: int, weights: Floats, size: float, limit: float) -> float:
        """Evidence of hypothesis k, times λ, of which no block gives more than a limit."""
        known = self._known
        score = left[:, k] - left[:, known] @ weights
        own = info[:, k, k] - 2.0 * info[:, k, known] @ weights
        own = own + np.einsum("n,bnm,m->b", weights, info[:, known][:, :, known], weights)
        prior = 0.5 * size**2 * float(weights @ self._certainty @ weights)
        return float(np.minimum(size * score - 0.5 * size**2 * own - prior / len(own), limit).sum())


def _inflation(standard: Floats) -> Floats:
    """λ of each response, from the standardised scores of blocks (B, H)."""
    out = np.full(standard.shape[1], _LEAST_INFLATION if len(standard) >= 20 else _FIRST_INFLATION)
    for together in _TOGETHER:
        count = len(standard) // together
        if count < _FEWEST:
            continue
        sums = standard[len(standard) - count * together :].reshape(count, together, -1).sum(axis=1)
        spread = _ROBUST * np.median(np.abs(np.diff(sums, axis=0)), axis=0) / math.sqrt(together)
        out = np.maximum(out, spread**2)
    return out
