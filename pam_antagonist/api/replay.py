"""``replay``: run a recording through the live estimator, and through the model alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.api.given import Bag, RigGiven, as_recording
from pam_antagonist.optional import needs
from pam_antagonist.output import output_folder
from pam_antagonist.replays import Replay
from pam_antagonist.replays import replay as _replay
from pam_antagonist.replays.result import columns, write_estimate
from pam_antagonist.report import terminal
from pam_antagonist.report.replay import summary, write_report
from pam_antagonist.rig import as_rig

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False, repr=False)
class ReplayResult(Replay):
    """A replayed recording.

    Attributes:
        recording: the recording.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint was free or locked.
        run: M estimates; ``run.index`` are their samples in the recording.
        model: the model alone at the same samples.
        report: the numbers of ``report.json``.
        plan: where the filter was started.
    """

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.render(summary(self))

    def save(self, path: str | Path, figures: bool = True, overwrite: bool = False) -> Path:
        """Write the report or the estimates.

        Args:
            path: of a new folder for ``report.html`` and ``report.json``, or of a new file ``*.csv`` or ``*.mcap`` for
                the estimates.
            figures: False leaves the figures out of the page.
            overwrite: True replaces an earlier result there.

        Returns:
            The path.

        Raises:
            BadInput: the path exists, or cannot be written.
        """
        path = Path(path)
        if path.suffix in (".csv", ".mcap"):
            write_estimate(path, self, overwrite)
        else:
            with output_folder(path, overwrite=overwrite) as folder:
                write_report(folder, [self], with_figures=figures)
        return path

    def to_dataframe(self) -> DataFrame:
        """A row for each estimate, with standard deviations and measurements (needs pandas).

        The columns are those of ``replay --save estimate.csv``; each name contains the unit.
        """
        with needs("import", "a data frame"):
            import pandas as pd
        return pd.DataFrame(columns(self))


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
    return ReplayResult(**{item.name: getattr(done, item.name) for item in fields(Replay)})
