"""Motion of a joint in ``demo --mode impedance``: measured angle compared with spring and damper."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pam_antagonist.control import Mode
from pam_antagonist.control.tracking import held, yielded
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.replays import Replay
from pam_antagonist.report.document import Tile
from pam_antagonist.report.figure import FloatArray
from pam_antagonist.report.table import number, percent


def spring_and_damper(recording: Recording, damped: bool = True) -> FloatArray:
    """Angle of the commanded spring and damper at each sample, under the applied torque (N,) [rad]."""
    reference, applied = recording.reference, recording.external_torque
    if reference is None or applied is None:
        raise BadInput(f"{recording.path}: no reference or no measured/external_torque was recorded")
    asked = np.where(reference.mode == Mode.IMPEDANCE, reference.value, np.nan)
    columns = (asked, reference.stiffness, np.nan_to_num(reference.damping) * damped)
    equilibrium, stiffness, damping = (held(recording.stamp_ns, reference.stamp_ns, column) for column in columns)
    period = float(np.median(np.diff(recording.stamp_ns))) * 1e-9
    return yielded(applied, equilibrium, stiffness, damping, period)


@dataclass(frozen=True)
class Yielding:
    """Comparison of the joint with the commanded spring and damper.

    Attributes:
        rmse_deg: RMS difference of the measured angle from that of spring and damper [°].
        largest_deg: largest difference [°].
        moved_deg: root mean square of the motion of spring and damper [°].
        within: share of the samples with a difference within the 95 % interval, from the covariance of angle and
            external torque [-].
    """

    rmse_deg: float
    largest_deg: float
    moved_deg: float
    within: float

    @classmethod
    def of(cls, replay: Replay) -> Yielding:
        """Compare a replay with spring and damper."""
        recording, rows = replay.recording, replay.run.rows
        if recording.angle is None:
            raise BadInput(f"{recording.path}: no measured angle was recorded")
        wanted = spring_and_damper(recording)[replay.run.index]
        reference = recording.reference
        assert reference is not None  # spring_and_damper() has checked it
        stiffness = held(replay.run.stamp_ns, reference.stamp_ns, reference.stiffness)
        error = recording.angle[replay.run.index] - wanted
        # The law moves the estimated angle to that of spring and damper under the estimated torque.
        of_torque = rows["external_torque_covariance"]
        variance = rows["covariance"][:, 0, 0] - 2.0 * of_torque[:, 0] / stiffness + of_torque[:, 3] / stiffness**2
        known = np.isfinite(error)
        if not known.any():
            raise BadInput(f"{recording.path}: no sample has both a reference and a measurement")
        centre = held(replay.run.stamp_ns, reference.stamp_ns, reference.value)
        return cls(
            math.degrees(math.sqrt(np.mean(error[known] ** 2))),
            math.degrees(np.max(np.abs(error[known]))),
            math.degrees(math.sqrt(np.mean((wanted - centre)[known] ** 2))),
            float(np.mean(np.abs(error[known]) <= 1.96 * np.sqrt(variance[known]))),
        )

    @property
    def sentence(self) -> str:
        """The result in words."""
        return (
            f"The pushes would move the spring and damper by {number(self.moved_deg, 2)}° (RMS); the joint differed "
            f"from them by {number(self.rmse_deg, 2)}°."
        )

    def tiles(self) -> list[Tile]:
        """The two main numbers."""
        return [
            Tile("Joint minus spring and damper", f"{number(self.rmse_deg, 2)}°", "root mean square"),
            Tile("They move by", f"{number(self.moved_deg, 2)}°", "root mean square"),
        ]

    def rows(self) -> list[tuple[str, str]]:
        """Rows of the table."""
        return [
            ("Measured angle minus that of spring and damper, RMSE", f"{number(self.rmse_deg)}°"),
            ("The same, largest", f"{number(self.largest_deg)}°"),
            ("Motion of spring and damper, RMS", f"{number(self.moved_deg)}°"),
            ("Difference within the 95 % interval of angle and torque", percent(self.within)),
        ]
