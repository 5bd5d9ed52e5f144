"""The arm's day in eight parts: what the log book says after ``identify`` of each."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from pam_antagonist import identify
from pam_antagonist.api.history import history, log
from pam_antagonist.recording.recording import Recording
from pam_antagonist.report.history import HistoryResult
from pam_antagonist.rig import load_rig

PARTS, _FEWEST = 8, 30
"""Parts, and episodes in each at least."""
_DATE_NS = 1_565_136_000 * 10**9
"""7 August 2019, from which the episodes are counted: the file has no date."""
_RIG = """\
based_on: regulator_joint
name: arm
source: stand-ins
effects:
  friction_by_pressure: {slope_1: 4.0e-7, slope_2: 4.0e-7}
"""


def by_parts(recording: Recording, progress: Callable[[str], None], jobs: int) -> HistoryResult | None:
    """The log book of a rig that was identified from each part of a recording; None: there are too few episodes."""
    begins = recording.episode_ns
    if begins is None or len(begins) < PARTS * _FEWEST:
        return None
    bounds = [*(part[0] for part in np.array_split(begins, PARTS)), np.iinfo(np.int64).max]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.yaml"
        file.write_text(_RIG, encoding="utf-8")
        rig = load_rig(file, regulators=True)
        for k, (low, high) in enumerate(pairwise(bounds), 1):
            progress(f"part {k} of {PARTS}")
            part = recording.take(np.flatnonzero((recording.stamp_ns >= low) & (recording.stamp_ns < high)))
            later = _DATE_NS - int(recording.stamp_ns[0])
            part = replace(
                part, path=Path(f"part_{k}"), stamp_ns=part.stamp_ns + later,
                episode_ns=begins[(begins >= low) & (begins < high)] + later,
            )  # fmt: skip
            log("identify", file, [part], rig, identify(part, rig, jobs=jobs))
        return history(file)
