"""``replay``: run a recording through the live estimator, and through the model alone."""

from __future__ import annotations

from collections.abc import Callable

from pam_antagonist.api.given import Bag, RigGiven, as_recording
from pam_antagonist.replays import replay as _replay
from pam_antagonist.report.replay import ReplayResult
from pam_antagonist.rig import as_rig
from pam_antagonist.shown import widened

__all__ = ["ReplayResult", "replay"]


def replay(
    recording: Bag,
    rig: RigGiven,
    tuning: str = "default",
    joint: str = "auto",
    lock_angle: float | None = None,
    progress: Callable[[int], None] | None = None,
    read_seconds: float = 0.0,
    begin_s: float | None = None,
    angle_sensor: str = "auto",
) -> ReplayResult:
    """Run a recording through the estimator and through the model alone, and compute the errors of both.

    Args:
        recording: a recording or its bag.
        rig: a rig, its name or its file.
        tuning: name of one of its tunings.
        joint: ``free``, ``locked`` or ``auto`` (detected).
        lock_angle: of a locked joint [rad], where it is known.
        progress: called regularly with the number of samples done since the last call.
        read_seconds: time that reading the recording took [s], for the real-time factor.
        begin_s: time from the first sample at which the estimates begin [s]; None: at the start. The estimates equal
            those of a complete replay.
        angle_sensor: ``none``, ``encoder`` (the recording's topic ``angle_sensor`` is an additional input of the
            filter), or ``auto``: as in the live filter's checkpoints, without any ``none``.

    Returns:
        Estimates, errors against the measurements, and the consistency of the filter.

    Raises:
        BadInput: a tuning or joint condition that does not exist, no complete sample to start from, no estimate after
            ``begin_s``, or a recording whose drive is not the rig's.

    Example:
        >>> from pam_antagonist import read_bag, replay
        >>> recording = read_bag("examples/recordings/leak_free").slice(0.0, 6.0)
        >>> result = replay(recording, "shin2022")
        >>> result.report.samples
        6000
        >>> result.run.rows["angle"].shape  # [rad], with the covariance of angle, velocity and torque beside it
        (6000,)
    """
    chosen = as_rig(rig, regulators=True)
    given = as_recording(recording, chosen)
    done = _replay(given, chosen, tuning, joint, lock_angle, read_seconds, progress, begin_s, angle_sensor)
    return widened(ReplayResult, done)
