"""The filter of a joint with many episodes: its noise and covariance from fitted episodes, its errors on later ones.

It gets what an identification gives to other filters (:mod:`~pam_antagonist.identification.filter_stage`), from the
last of the fitted episodes. Each episode starts the filter anew, at rest where the pressures are in balance. So its
first angle is as uncertain as friction makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pam_antagonist.identification.filter_stage import with_process_noise, with_unknown_torque
from pam_antagonist.identification.runs import is_long
from pam_antagonist.inference.held_episodes import held_out
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import joint_condition
from pam_antagonist.replays import replay
from pam_antagonist.rig import Rig
from pam_antagonist.shown import number, percent
from pam_antagonist.strict_json import picked

_USED = 200
"""Most episodes that tell of the noise."""


@dataclass(frozen=True)
class EpisodeFilter:
    """A rig with its filter, and what the filter does on episodes that no fit has seen."""

    rig: Rig
    error_deg: float  # of the angle on later episodes, RMS
    model_alone_deg: float  # the same of the model alone, driven by the commands
    coverage: float  # share of these angles in their 95 % intervals

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        return picked(self, "error_deg", "model_alone_deg", "coverage")

    @property
    def sentence(self) -> str:
        """What it does."""
        return (
            f"On later episodes the filter errs by {number(self.error_deg)}°, the model alone along the commands by "
            f"{number(self.model_alone_deg)}°; {percent(self.coverage)} of the angles are in the filter's 95 % "
            "intervals."
        )


def with_filter(
    rig: Rig, recording: Recording, episodes: Sequence[slice], share: float, later: Recording | None = None,
    jobs: int = 1, progress: Callable[[str], None] = lambda text: None,
) -> EpisodeFilter | None:  # fmt: skip
    """A rig with the noise and the covariance of its filter; None without commands or episodes of a second.

    Args:
        rig: fitted to the episodes of the recording.
        recording: with all episodes.
        episodes: rows of those that are whole (E,), of which the fits have held out the same ones.
        share: of them that is held out at the end, where no other recording is.
        later: a recording that is held out as a whole.
        jobs: threads.
        progress: is called with what is being done.
    """
    if recording.drive != rig.drive or not np.isfinite(recording.voltage).all():
        return None
    held = held_out(len(episodes), 0.0 if later is not None else share)
    fitted, last = ([episodes[k] for k in which] for which in (held.pool[-_USED:], held.later))
    seen = _part(recording, fitted)
    if not any(is_long(seen.time_s[rows]) for rows in seen.episodes):
        return None
    condition = joint_condition(seen, "free", None, rig.joint.stop)
    progress("noise of the filter")
    followed = with_process_noise(rig, [(seen, condition, "episodes")], jobs)
    covered = with_unknown_torque(followed, [(seen, condition, "episodes")], jobs, progress).rig
    progress("the filter on later episodes")
    report = replay(_part(recording, last) if later is None else later, covered).report
    angle, alone = report.ukf.angle, report.model_alone.angle
    if angle is None or alone is None or angle.coverage95 is None:
        return None
    return EpisodeFilter(covered, angle.rmse, alone.rmse, angle.coverage95)


def _part(recording: Recording, episodes: Sequence[slice]) -> Recording:
    """The recording from the first to the last of some episodes, without the angles of others in between."""
    angle = np.full(len(recording), np.nan)
    assert recording.angle is not None
    for rows in episodes:
        angle[rows] = recording.angle[rows]
    time, end = recording.time_s, episodes[-1].stop
    until = time[end] if end < len(time) else np.inf
    return replace(recording, angle=angle).slice(float(time[episodes[0].start]), float(until))
