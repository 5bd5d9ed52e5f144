"""The evidence of a monitor: a generalised likelihood ratio for each hypothesis and each onset, block by block.

A block of a second holds the score s = Σ gᵀ S⁻¹ ν and the information I = Σ g gᵀ-weighted by S⁻¹ of all responses g
(:mod:`~pam_antagonist.diagnosis.monitor_responses`). The uncertain parameters θ ~ N(μ, V) have what blocks before the
window say of them, and the rig file before that. For an onset t₀, over the blocks since then and with index h for the
hypothesis and n for the uncertain parameters,

    s̃ = Σ (s_h − I_hn μ) − I_hn (I_nn + V⁻¹)⁻¹ Σ (s_n − I_nn μ),    Ĩ = I_hh − I_hn (I_nn + V⁻¹)⁻¹ I_nh,

the size is s̃/Ĩ ± √(λ/Ĩ), and the evidence (a log likelihood ratio) s̃²/(2 λ Ĩ). Innovations of real filters are
neither white nor of the size that a filter says: λ is the robust variance of the standardised scores of one, four and
ten blocks, from the differences of neighbours, in which an onset counts once. Nor have they a mean of 0: a filter's own
errors make a small bias that lasts. So the mean β of the standardised scores of all blocks before t₀, with a prior of
its own, is taken from those since then, and its variance is added to λ: what is found is a change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.monitor_responses import Watched

Floats = NDArray[np.float64]

WINDOW = 120
"""Blocks that are searched for an onset."""
_KNOCK, _LIMIT = 2, 4.5
"""Blocks with the most evidence, and how much each gives at most: what happens once is no state of the joint."""
_SMALL = 6.0
"""Evidence up to which that limit does not matter."""
_HISTORY = 900
"""Blocks before the window from which λ is taken."""
_KEPT = 1.0 - 1.0 / 1800.0
"""Share of what is known of the uncertain parameters that is kept from block to block."""
_MOVES = 0.3
"""Of their uncertainty, by which uncertain parameters may move until an onset."""
_BIAS, _DRIFT, _LARGEST = 1.0, 0.2, 6.0
"""Standard deviations of β and of its change until an onset, and largest standardised score of a block in it."""
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
class MonitorFinding:
    """What a monitor says of a hypothesis at its best onset."""

    watched: Watched
    evidence: float  # of which no knock gives more than a limit; of the first, the largest of those alike
    full: float  # without that limit
    onset_ns: int
    onset_std: float  # [s]
    size: float
    std: float


def alike(findings: Sequence[MonitorFinding]) -> list[str]:
    """Names that cannot be told from that of the first finding."""
    first = findings[0]
    near = [one for one in findings if one.full > _ALIKE * first.full]
    labels = [one.watched.name + (f" {one.watched.muscle}" if one.watched.muscle else "") for one in near]
    return list(dict.fromkeys(labels))[1:]


class _Window(NamedTuple):
    """Of B blocks, K uncertain parameters and H responses; `score` to `inflation` are those since each block."""

    info: Floats  # I (B, H, H)
    scores: Floats  # s (B, H)
    roots: Floats  # √I_hh (B, H)
    mean: Floats  # μ, before each block (B, K)
    bias: Floats  # β, before each block (B, H)
    certainty: Floats  # V⁻¹ (B, K, K)
    weights: Floats  # (I_nn + V⁻¹)⁻¹ I_nh (B, K, H)
    score: Floats  # s̃ (B, H)
    information: Floats  # Ĩ (B, H)
    inflation: Floats  # λ, with the variance of the bias (B, H)


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

    def accept(self, finding: MonitorFinding) -> None:
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
        prior = np.where(known >= len(self.watched), 1.0, 0.0)
        kept = _KEPT * (self._certainty - np.diag(prior)) + np.diag(prior)
        self._certainty = kept + info[np.ix_(known, known)]
        self._sums = _KEPT * self._sums + self._scores[k][known]
        left = self._scores[k] - info[:, known] @ np.linalg.solve(self._certainty, self._sums)
        standard = np.clip(left / np.sqrt(np.maximum(np.diagonal(info), 1e-300)), -_LARGEST, _LARGEST)
        self._standard = np.concatenate([self._standard, standard[None]])[-_HISTORY:]

    def findings(self) -> list[MonitorFinding]:
        """Every hypothesis at its best onset, the one with most evidence first."""
        if not self.count:
            return []
        order, window = self._order(), self._window()
        inflation, information = window.inflation, window.information
        size = np.clip(window.score / information, *self._bounds)
        full = size * (window.score - 0.5 * size * information) / inflation
        begins, found = self._begins[order], []
        for k, item in enumerate(self.watched):
            if k in self._known:
                continue
            b = int(np.argmax(full[:, k]))
            near = begins[full[:, k] >= full[b, k] - _WITHIN]
            evidence = float(full[b, k])
            if evidence > _SMALL:
                evidence = self._limited(window, b, k, float(size[b, k]))
            found.append(
                MonitorFinding(
                    item, evidence, float(full[b, k]), int(begins[b]),
                    0.5 * (float(near[-1] - near[0]) * 1e-9 + 1.0), item.step * float(size[b, k]),
                    item.step * float(np.sqrt(inflation[b, k] / information[b, k])),
                )
            )  # fmt: skip
        found.sort(key=lambda one: -one.full)
        near = [one.evidence for one in found if one.full >= _ALIKE * found[0].full]
        return [replace(found[0], evidence=max([found[0].evidence, *near])), *found[1:]]

    def stds(self, blocks: int) -> Floats:
        """Standard deviation of the size that each hypothesis has had in the last blocks."""
        window, steps = self._window(), np.array([item.step for item in self.watched])
        return steps * np.sqrt(window.inflation / window.information)[-blocks, : len(steps)]

    def _order(self) -> NDArray[np.int64]:
        return np.arange(max(0, self.count - WINDOW), self.count) % WINDOW

    def _window(self) -> _Window:
        order, known = self._order(), self._known
        info, scores = self._information[order], self._scores[order]
        roots = np.sqrt(np.maximum(np.diagonal(info, axis1=1, axis2=2), 1e-300))
        own, cross = roots**2, info[:, known]
        # What all blocks before each onset say of the uncertain parameters, which may have moved since then.
        certainty = self._certainty + _before(cross[:, :, known])
        sums = self._sums + _before(scores[:, known])
        mean: Floats = np.asarray(np.linalg.solve(certainty, sums[..., None])[..., 0], dtype=np.float64)
        moves = np.where(known >= len(self.watched), _MOVES**2, 0.0)
        certainty = np.asarray(np.linalg.inv(np.linalg.inv(certainty) + np.diag(moves)))
        # The bias before each onset, and its variance.
        standard = (scores - np.einsum("bnh,n->bh", cross, mean[-1])) / roots
        inflation = _inflation(np.concatenate([self._standard, standard]))
        left = _before(scores / roots) - np.einsum("bnh,bn->bh", _before(cross / roots[:, None]), mean)
        blocks = len(self._standard) + np.arange(len(order))[:, None]
        variance = 1.0 / (1.0 / _BIAS**2 + blocks / inflation)
        bias = variance * (self._standard.sum(axis=0) + left) / inflation
        whole, total, since, crossed = (_since(values) for values in (scores, own, roots, cross))
        whole = whole - np.einsum("bnh,bn->bh", crossed, mean) - bias * since
        weights: Floats = np.asarray(np.linalg.solve(crossed[:, :, known] + certainty, crossed), dtype=np.float64)
        information = np.maximum(total - np.einsum("bnh,bnh->bh", crossed, weights), 0.0) + _INEXACT * total
        score = whole - np.einsum("bnh,bn->bh", weights, whole[:, known])
        inflation = inflation + (variance + _DRIFT**2) * since**2 / total
        return _Window(info, scores, roots, mean, bias, certainty, weights, score, information, inflation)

    def _limited(self, window: _Window, b: int, k: int, size: float) -> float:
        """Evidence of hypothesis k since block b, of which no knock gives more than a limit."""
        known, weights, info = self._known, window.weights[b, :, k], window.info[b:]
        left = window.scores[b:] - info[:, :, known] @ window.mean[b] - window.bias[b] * window.roots[b:]
        score = left[:, k] - left[:, known] @ weights
        own = info[:, k, k] - 2.0 * info[:, k, known] @ weights
        own = own + np.einsum("n,bnm,m->b", weights, info[:, known][:, :, known], weights)
        prior = 0.5 * size**2 * float(weights @ window.certainty[b] @ weights)
        each = (size * score - 0.5 * size**2 * own - prior / len(own)) / window.inflation[b, k]
        return float(each.sum() - np.maximum(np.sort(each)[-_KNOCK:] - _LIMIT, 0.0).sum())


def _since(values: Floats) -> Floats:
    """Sums from each block on."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


def _before(values: Floats) -> Floats:
    """Sums of the blocks before each."""
    return np.asarray(np.cumsum(values, axis=0) - values)


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
