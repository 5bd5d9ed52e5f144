"""``check`` and ``replay``: test rig, units and wiring of a recording; run it through the live estimator again."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pam_antagonist.api.given import Bag, RigGiven, as_recording, calibration
from pam_antagonist.checks import Checked, check_recording
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.recording.faults import faults_of, in_words
from pam_antagonist.recording.notes import Issue
from pam_antagonist.replays import replay as _replay
from pam_antagonist.report import terminal
from pam_antagonist.report.replay import ReplayResult
from pam_antagonist.report.result import DataFrame, frame_of
from pam_antagonist.rig import as_rig
from pam_antagonist.rig.units import assumption
from pam_antagonist.shown import widened
from pam_antagonist.strict_json import write_json

__all__ = ["CheckResult", "ReplayResult", "check", "replay"]

_MARKS = {"wrong": "✗", "doubtful": "!", "untested": "?", "good": "✓"}


@dataclass(frozen=True, repr=False)
class CheckResult(Checked):
    """Result of a check.

    Attributes:
        findings: the worst first.
        corrections: all corrections that the recording needs, with those that were given and are right.
        joint: ``free`` or ``locked``.
        assumption: the uncertainty that the rig claims; None for an identified one.
    """

    assumption: str | None = None

    def to_json(self) -> dict[str, Any]:
        """The result as plain values: ``assumption``, ``joint``, command line ``options``, and ``findings``."""
        return {
            "assumption": self.assumption,
            "joint": self.joint,
            "options": self.corrections.options(),
            "findings": [
                {
                    "status": finding.status, "text": finding.text, "options": list(finding.options),
                    "leave_out": list(finding.leave_out),
                }
                for finding in self.findings
            ],
        }  # fmt: skip

    def summary(self) -> str:
        """The findings that the command prints, the worst first, with what to do."""
        lines = []
        for finding in self.findings:
            text = finding.text
            if finding.todo:
                text += f". {finding.todo[0].upper()}{finding.todo[1:]}"
            lines.append(terminal.marked(text if text.endswith("?") else f"{text}.", _MARKS[finding.status]))
        options = self.corrections.options()
        if options and self.wrong:
            lines.append(f"With these options every command corrects this recording: {' '.join(options)}")
        return "\n".join(lines)

    def save(self, path: str | Path) -> Path:
        """Write the findings as JSON to a file; returns its path.

        Raises:
            BadInput: the file cannot be written.
        """
        try:
            write_json(Path(path), self.to_json())
        except OSError as error:
            raise BadInput(f"{path}: cannot be written: {error.strerror}") from None
        return Path(path)

    def to_dataframe(self) -> DataFrame:
        """A row for each finding: ``status``, ``text``, ``options``, ``leave_out`` (needs pandas)."""
        return frame_of(self.to_json()["findings"], ["status", "text", "options", "leave_out"])


def check(
    recording: Bag,
    rig: RigGiven,
    joint: str = "auto",
    lock_angle: float | None = None,
    corrections: Corrections | None = None,
) -> CheckResult:
    """Compare a recording with the model of its rig, driven by the recorded voltages.

    The check finds gauge pressures and other units, exchanged lines or valves, sensors with the wrong sign, delays, and
    recordings of another rig.

    Args:
        recording: a bag, or a recording, best read with ``read_bag(..., judge=False)``.
        rig: a rig, its name or its file.
        joint: ``free``, ``locked`` or ``auto`` (detected).
        lock_angle: of a locked joint [rad], where it is known.
        corrections: that are given for the recording: the check says which of them make it wrong. Default: those of
            the rig file (``calibration``); none for a recording that was read with corrections.

    Returns:
        The findings, with command line options that correct them.

    Raises:
        BadInput: a recording that is too short, or has no finite voltages or pressures.

    Example:
        >>> from pam_antagonist import check
        >>> checked = check("examples/recordings/leak_free", "shin2022")
        >>> checked.joint, len(checked.wrong)
        ('free', 0)
    """
    configured = as_rig(rig, regulators=True)
    given = calibration(configured) if corrections is None else corrections
    if corrections is None and isinstance(recording, Recording) and recording.corrected:
        given = Corrections()
    if not isinstance(recording, Recording):
        recording = read_bag(recording, corrections=Corrections(align_clocks=given.align_clocks), judge=False)
    found = check_recording(recording, configured, joint, lock_angle, given)
    return widened(CheckResult, found, assumption=assumption(configured))


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
        recording: a recording or its bag. The rig file's calibration is removed from both, but not from a recording
            that was read with corrections.
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
    told = [Issue(text, "missing") for _, text in in_words(faults_of(given), given.time_s)]
    given = dataclasses.replace(given, issues=(*given.issues, *told)) if told else given
    done = _replay(given, chosen, tuning, joint, lock_angle, read_seconds, progress, begin_s, angle_sensor)
    return widened(ReplayResult, done)
