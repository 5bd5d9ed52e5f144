"""Whether a replay gives the very bits that were published live."""

from __future__ import annotations

from typing import Any

import numpy as np

from pam_antagonist.estimation import ESTIMATE_DTYPE, EstimateRun
from pam_antagonist.recording import RecordedEstimate

LATE = 64
"""The one flag that depends on when a sample arrived, which a replay cannot know."""


def same_bits(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Where two arrays (N, ...) of doubles hold the same bits in all of a row, (N,); any NaN equals any other."""
    a = np.ascontiguousarray(one, dtype=np.float64).reshape(len(one), -1)
    b = np.ascontiguousarray(other, dtype=np.float64).reshape(len(other), -1)
    return np.asarray(((a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))).all(axis=1))


def compare_with_live(live: RecordedEstimate, run: EstimateRun) -> dict[str, Any]:
    """Compare recorded estimates with replayed ones, sample by sample.

    Args:
        live: what the live node published.
        run: the replay.

    Returns:
        ``compared``: samples that both have; ``equal``: those of them that agree in every field, the ``LATE`` flag
        aside; ``only_live``: samples that the replay has no estimate for; ``only_replay``: samples between the first
        and the last recorded estimate that were not recorded; ``first_difference_ns``: a stamp, or null;
        ``differing``: for each field that differs, in how many samples it does.
    """
    _, at_live, at_run = np.intersect1d(live.stamp_ns, run.stamp_ns, return_indices=True)
    differing: dict[str, int] = {}
    equal = live.started_ns[at_live] == run.started_ns[at_run]
    if not equal.all():
        differing["started"] = int(np.count_nonzero(~equal))
    for name in ESTIMATE_DTYPE.names or ():
        recorded = np.asarray(getattr(live, name))[at_live]
        replayed = run.rows[name][at_run]
        if name == "flags":
            recorded = recorded.astype(np.int64) & ~LATE
            replayed = replayed.astype(np.int64)
        same = same_bits(recorded, replayed)
        if not same.all():
            differing[name] = int(np.count_nonzero(~same))
        equal &= same
    within = (run.stamp_ns >= live.stamp_ns[0]) & (run.stamp_ns <= live.stamp_ns[-1]) if len(live.stamp_ns) else []
    stamps = live.stamp_ns[at_live]
    return {
        "compared": len(at_live),
        "equal": int(np.count_nonzero(equal)),
        "only_live": len(live.stamp_ns) - len(at_live),
        "only_replay": int(np.count_nonzero(within)) - len(at_run),
        "first_difference_ns": int(stamps[~equal][0]) if not equal.all() else None,
        "differing": differing,
    }
