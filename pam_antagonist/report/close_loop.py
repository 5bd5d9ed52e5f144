"""``report.json`` of ``close_loop``.

Keys that others read::

    verdict         "effect", "none" or "unexplained"
    effects         [{name, muscle: 1 | 2 | null, parameters: {p: {value, std, unit}}, delta_bic, holdout_gain, ...}]
    ambiguous_with  names of effects that the recordings cannot tell from these
    errors          {as_configured, recalibrated, extended}, each with angle, torque, pressure, on held-out data
    parts           [{name, verdict, share_explained}] of each part of the joint that was judged by itself
    ambiguities     [{found, other, ambiguous, evidence, residual, ...}]: rivals that were compared on equal terms
    reference       errors [N m] of straight-line maps that know no physics, null where there is none

`holdout_gain` is the share of the held-out excess over sensor noise that goes with the effect;
`share_explained` that of all effects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.result import Diagnosis
from pam_antagonist.rig import Rig
from pam_antagonist.software import versions


def document(
    found: Diagnosis, rig: Rig, hashes: Sequence[str], seed: int, holdout: float | Sequence[str]
) -> dict[str, Any]:
    """What goes into ``report.json``.

    Args:
        found: the diagnosis.
        rig: as configured.
        hashes: SHA-256 of each bag, those held out as a whole behind the others.
        seed: as asked.
        holdout: share of each recording that was held out, or names of the recordings that were.
    """
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "effects": [
            {
                "name": effect.name,
                "muscle": effect.muscle,
                "parameters": {
                    name: {"value": value, "std": std, "unit": unit}
                    for name, (value, std, unit) in effect.parameters.items()
                },
                "delta_bic": effect.delta_bic,
                "holdout_gain": effect.holdout_gain,
                "recordings": list(effect.recordings),
            }
            for effect in found.effects
        ],
        "ambiguous_with": list(found.ambiguous_with),
        "experiments": dict(found.experiment),
        "share_explained": found.share,
        "parts": [
            {"name": part.name, "verdict": part.verdict, "share_explained": part.share} for part in found.parts
        ],
        "ambiguities": [
            {
                "found": item.found, "other": item.other, "ambiguous": item.ambiguous, "evidence": item.evidence,
                "residual": list(item.residual), "unit": item.unit, "shape": item.shape, "about": item.about,
                "size": None if math.isnan(item.size) else item.size,
            }
            for item in found.ambiguities
        ],
        "reference": None if found.reference is None else dict(found.reference),
        "base_friction_removed": found.base_friction_removed,
        "errors": dict(found.errors),
        "recordings": [
            {**part, "sha256": value} for part, value in zip(found.by_recording, hashes, strict=True)
        ],
        "ranking": [
            {
                "name": item.effect, "round": item.round, "score": item.score, "delta_bic": item.delta_bic,
                "holdout_gain": None if item.shares is None else item.shares[0], "taken": item.taken,
                "score_by_muscle": None if item.muscles is None else list(item.muscles),
            }
            for item in found.ranking
        ],
        "profiles": [dict(item) for item in found.profiles],
        "remaining": [left.line() for left in found.remaining],
        "left": [
            {
                "recording": left.recording, "channel": left.channel, "unit": left.unit,
                "times_noise": left.times_noise, "depends_on": left.depends_on, "bands": left.bands,
                "period_s": left.period,
                "form": {
                    "terms": [{"term": name, "coefficient": value} for name, value in left.form.terms],
                    "share": left.form.share, "share_held_out": left.form.held_out,
                },
            }
            for left in found.remaining
        ],
        "unseen": list(found.unseen),
        "warnings": list(found.warnings),
        "settings": {
            "rig": rig.name,
            "rig_source": " ".join(rig.source.split()),
            "seed": seed,
            "holdout": holdout if isinstance(holdout, float) else list(holdout),
            "strong_evidence": thresholds.STRONG,
            "first_share": thresholds.FIRST_SHARE,
            "further_share": thresholds.FURTHER_SHARE,
            "explained_share": thresholds.EXPLAINED,
        },
        "timing": dict(found.seconds),
        "software": versions(),
    }  # fmt: skip
