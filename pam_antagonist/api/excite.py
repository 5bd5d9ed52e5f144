"""``excite``: the design of an experiment that determines a rig's parameters well."""

from __future__ import annotations

from collections.abc import Callable

from pam_antagonist.api.given import RigGiven
from pam_antagonist.design import SHORTEST, Limits, designed
from pam_antagonist.errors import number
from pam_antagonist.report.experiments import ExciteResult
from pam_antagonist.rig import as_rig
from pam_antagonist.shown import widened

__all__ = ["ExciteResult", "excite"]


def excite(
    rig: RigGiven,
    duration: float = 60.0,
    *,
    joint: str = "free",
    lock_angle: float = 0.0,
    limits: Limits | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> ExciteResult:
    """Design the voltages of an experiment, as the command ``excite`` does with ``--plan-only``.

    Args:
        rig: with valves: a rig, its name or its file.
        duration: of the experiment [s].
        joint: ``free`` or ``locked``.
        lock_angle: of a locked joint [rad].
        limits: of pressures, angle and rate; default: those of the rig.
        seed: of the search.
        progress: called with the seconds of the experiment that are done since the last call.

    Returns:
        The plan: ``plan.voltage`` (N, 2) [V], row k over sample period k. :func:`simulate` takes it.

    Raises:
        BadInput: a duration out of range, or a rig with pressure regulators.

    Example:
        >>> from pam_antagonist import excite, simulate
        >>> plan = excite("shin2022", 10.0)
        >>> recording = simulate("shin2022", plan.voltage)
        >>> recording.drive
        'valve'
    """
    chosen = as_rig(rig)
    length = number("duration", duration, SHORTEST, 3600.0)
    given = Limits.of(chosen) if limits is None else limits
    plan = designed(chosen, given, length, joint, lock_angle, seed, progress or (lambda seconds: None))
    return widened(ExciteResult, plan, rig=chosen)
