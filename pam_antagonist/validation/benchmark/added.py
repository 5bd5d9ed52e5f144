"""What those parts of ``close_loop`` cost that an earlier checkout did not have: the rest is the same work."""

from __future__ import annotations

import cProfile
import pstats
import time
from collections.abc import Sequence

from pam_antagonist.api.diagnose import diagnose
from pam_antagonist.api.given import Bag
from pam_antagonist.diagnosis import calibrations, onset, splits, sticking

_PARTS = {
    "calibrations": (
        calibrations.tried, calibrations.hidden, calibrations.taken, calibrations.needed, calibrations.carried_on,
        calibrations.found,
    ),
    "splits": (splits.firmness,),
    "effects that begin or end": (onset.search, onset.parts_above_noise),
    "joints that stick": (sticking.search,),
}  # fmt: skip


def parts(recordings: Sequence[Bag], rig: str) -> dict[str, float]:
    """Processor time [s] of each part: its share of a run under a profiler, of the time of a run without one.

    Args:
        recordings: of a case.
        rig: name or path.
    """
    begin = time.process_time()
    diagnose(recordings, rig, jobs=1)
    whole = time.process_time() - begin
    # A profiler sees one thread. Its own time falls on all parts alike, more or less.
    profile = cProfile.Profile(time.process_time)
    profile.runcall(diagnose, recordings, rig, jobs=1)
    seen = {key: of[3] for key, of in pstats.Stats(profile).stats.items()}  # type: ignore[attr-defined]
    return {
        part: whole * sum(seen.get(_key(function), 0.0) for function in functions) / seen[_key(diagnose)]
        for part, functions in _PARTS.items()
    }


def _key(function: object) -> tuple[str, int, str]:
    code = function.__code__  # type: ignore[attr-defined]
    return code.co_filename, code.co_firstlineno, code.co_name
