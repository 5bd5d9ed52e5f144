"""``replay``: a recording through the estimator that runs live, and through the model alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from pam_antagonist.api.given import Bag, RigGiven, as_recording, as_rig
from pam_antagonist.optional import needs
from pam_antagonist.output import output_folder
from pam_antagonist.replays import Replay
from pam_antagonist.replays import replay as _replay
from pam_antagonist.replays.table import columns, write_estimate
from pam_antagonist.report import terminal
from pam_antagonist.report.replay import summary, write_report

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, eq=False)
class ReplayResult(Replay):
    """A replayed recording.

    Attributes:
        recording: what was recorded.
        rig: the rig as configured.
        tuning: name of the filter's tuning.
        joint: whether the joint could move.
        run: the estimates, M of them; ``run.index`` are their samples in the recording.
        model: the model alone at the same samples.
        report: the numbers of ``report.json``.
        plan: where the filter was started.
    """

    def summary(self) -> str:
        """The tables that the command prints."""
        return terminal.render(summary(self))

    def save(self, path: str | Path, figures: bool = True) -> Path:
        """Write the report, or the estimate.

        Args:
            path: of a new folder for ``report.html`` and ``report.json``, or of a new file ``*.csv`` or ``*.mcap`` for
                the estimate.
            figures: False leaves the figures out of the page.

        Returns:
            The path.

        Raises:
            BadInput: it exists already, or cannot be written.
        """
        path = Path(path)
        if path.suffix in (".csv", ".mcap"):
            write_estimate(path, self)
        else:
            with output_folder(path) as folder:
                write_report(folder, [self], with_figures=figures)
        return path

    def to_dataframe(self) -> DataFrame:
        """A row for each estimate, with its standard deviations and what was measured (needs pandas).

        The columns are those of ``replay --save estimate.csv``; the unit stands in each name.
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
    """Run a recording through the estimator and through the model alone, and judge both.

    Args:
        recording: a recording or its bag.
        rig: a rig, its name or its file.
        tuning: name of one of its tunings.
        joint: ``free``, ``locked`` or ``auto`` (detected).
        lock_angle: of a locked joint [rad], where it is known.
        progress: is called now and then with the number of samples done since the last call.
        read_seconds: what reading the recording took [s], for the real-time factor.
        begin_s: time from the first sample from which on there is to be an estimate [s]; None: all of it. The
            estimates are those of the whole.
        angle_sensor: ``none``, ``encoder`` (the recording's topic ``angle_sensor`` is an input of the filter as well),
            or ``auto``: as the live filter, where its checkpoints tell, else none.

    Returns:
        Estimates, errors against what was measured, and the consistency of the filter.

    Raises:
        BadInput: a tuning or joint condition that does not exist, or no sample to start from, or none from that
            time on.

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
