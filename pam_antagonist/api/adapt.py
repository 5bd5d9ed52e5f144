"""``adapt``: a rig file that follows its joint from day to day, by one more recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pam_antagonist.api.diagnose import IdentifyResult, refuse_sealed, result_of
from pam_antagonist.api.given import Bag, RigGiven, as_recordings, named
from pam_antagonist.api.ways import EPISODES, SEALED, way
from pam_antagonist.errors import BadInput
from pam_antagonist.identification.from_pressures import identify
from pam_antagonist.identification.walk import free_sizes, walking
from pam_antagonist.rig import as_rig

__all__ = ["adapt"]


def adapt(
    recordings: Bag | Sequence[Bag],
    rig: RigGiven,
    *,
    joint: str = "auto",
    lock_angle: float | None = None,
    jobs: int = 2,
    progress: Callable[[str], None] | None = None,
) -> IdentifyResult:
    """Update an identified rig by a recording of today.

    Each number may walk a little from its value: friction and leaks more than forces, geometry not at all. What the
    recording does not determine stays as it is.

    Args:
        recordings: one of half a minute is enough; a free joint with its angle shows most.
        rig: an identified rig, or its file.
        joint: ``free``, ``locked`` or ``auto`` (found from the recordings).
        lock_angle: of a locked joint [rad], where it is known.
        jobs: threads.
        progress: called with a text about each step.

    Returns:
        The updated rig with all results. Where it is ``rejected``, the rig as it was is not worse.

    Raises:
        BadInput: a rig that was never identified, a recording of another rig, or one in which nothing moves.

    Example:
        >>> from pam_antagonist import adapt, load_rig, simulate
        >>> monday = load_rig("shin2022").with_value("identified", "monday")
        >>> today = simulate(monday.with_value("friction.shaft", 0.3), duration=8.0)
        >>> round(adapt(today, monday).rig.value("friction.shaft"), 1)
        0.3
    """
    chosen = as_rig(rig, regulators=True)
    if not chosen.identified:
        raise BadInput(f"rig {chosen.name} was never identified; expected one that identify or close_loop wrote")
    given = as_recordings(recordings, chosen)
    if not given:
        raise BadInput("no recording: expected one at least")
    if (kind := way(given, chosen)) in (EPISODES, SEALED):
        raise BadInput(f"not for {kind.words}: run identify with all of its recordings")
    read = named(given, chosen, joint, lock_angle)
    refuse_sealed(read, chosen)
    found = identify(
        read, chosen, starts=1, jobs=jobs, progress=progress, free=free_sizes(chosen), walk=walking(chosen)
    )
    now, line = found.pooled("identified"), found.pooled("linear")
    if now > line:
        raise BadInput(
            f"the recording is of another rig than {chosen.name}, or the joint was rebuilt: with today's values the "
            f"filter errs by {now:.2g}°, a linear map of the two pressures by {line:.2g}°; identify it anew"
        )
    return result_of(found, read)
