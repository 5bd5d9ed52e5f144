"""The report of ``demo``: the replay of its recording, and what control and pipeline did."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.control import Mode
from pam_antagonist.control.tracking import SHORTEST_STEP, STEADY_PART, Tracking, held, tracking
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.replays import Replay
from pam_antagonist.replays.accounting import Accounting, account
from pam_antagonist.report import html
from pam_antagonist.report.channels import judged
from pam_antagonist.report.document import Block, Document, Section, Text
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.figures import tracking_figure
from pam_antagonist.report.replay import document as replay_document
from pam_antagonist.report.replay import errors_table
from pam_antagonist.report.replay import numbers as replay_numbers
from pam_antagonist.report.replay_figures import time
from pam_antagonist.report.table import Table, number, percent

_PAPER = {Mode.ANGLE: 0.9475, Mode.TORQUE: 0.95}  # steady-state performance reported there
_UNIT = {Mode.ANGLE: "deg", Mode.TORQUE: "nm"}
_SIGN = {Mode.ANGLE: "°", Mode.TORQUE: " N m"}


@dataclass(frozen=True)
class Simulated:
    """What the joint was.

    Attributes:
        mismatch: relative standard deviation of its parameters from the rig's [-].
        seed: of that scatter and of the sensor noise.
    """

    mismatch: float
    seed: int


@dataclass(frozen=True, eq=False)
class Demo:
    """A finished demo: the key ``demo`` of ``report.json``; angles in degrees, torques in N m, times in ms.

    Attributes:
        replay: of its recording.
        mode: what was controlled.
        simulated: what the joint was.
        tracking: how the reference was followed, in degrees or N m.
        accounting: what became of the samples; None where a stage is missing in the recording.
    """

    replay: Replay
    mode: Mode
    simulated: Simulated
    tracking: Tracking
    accounting: Accounting | None

    @classmethod
    def of(cls, replay: Replay, mode: Mode, simulated: Simulated) -> Demo:
        """Judge the recording of a demo.

        Args:
            replay: of the demo's recording.
            mode: what was controlled.
            simulated: what the joint was.


        Raises:
            BadInput: there is no reference, or no measurement, to judge by.
        """
        followed = follow(replay.recording, mode)
        return cls(replay, mode, simulated, followed, account(replay.recording, replay.rig.sample_period))

    def to_json(self) -> dict[str, Any]:
        """The entry of ``report.json``; the unit of what was controlled is part of the keys."""
        unit, followed = _UNIT[self.mode], self.tracking
        return {
            "mode": self.mode.name.lower(),
            "simulated_joint": self.simulated,
            "tracking": {
                f"rmse_{unit}": followed.rmse,
                f"max_{unit}": followed.largest,
                f"worst_steady_error_{unit}": followed.worst_steady_error,
                f"reference_range_{unit}": followed.range,
                "steady_state_performance": followed.performance,
                "steps": [
                    {
                        "start_s": step.start_s,
                        "length_s": step.length_s,
                        f"reference_{unit}": step.reference,
                        f"steady_error_{unit}": step.steady_error,
                    }
                    for step in followed.steps
                ],
            },
            "pipeline": self.accounting,
        }


def write_report(folder: Path, demo: Demo, with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into a folder that exists.

    Args:
        folder: where to.
        demo: what was done.
        with_figures: False leaves the figures out of the page.
    """
    html.write(folder, document(demo, with_figures), replay_numbers([demo.replay], demo=demo))


def document(demo: Demo, with_figures: bool = True) -> Document:
    """The replay's report with control and pipeline before it."""
    first: list[Block] = [Section("Closed loop", (control_table(demo), Text(_definitions(demo))), 2, "loop")]
    if with_figures:
        first.append(_figure(demo))
    return replay_document([demo.replay], "Sensor-less control, live", with_figures, first)


def summary(demo: Demo) -> tuple[Block, ...]:
    """What the terminal shows."""
    return errors_table(demo.replay.report), control_table(demo)


def follow(recording: Recording, mode: Mode) -> Tracking:
    """How the reference was followed, in ° or N m.

    Raises:
        BadInput: there is no reference, or no measurement, to judge by.
    """
    reference, measured = recording.reference, recording.angle if mode is Mode.ANGLE else recording.torque
    if reference is None or measured is None:
        raise BadInput(f"{recording.path}: no reference or no measured {mode.name.lower()} was recorded")
    scale = math.degrees(1.0) if mode is Mode.ANGLE else 1.0
    wanted = held(recording.stamp_ns, reference.stamp_ns, np.where(reference.mode == mode, reference.value, np.nan))
    try:
        return tracking(recording.stamp_ns, wanted * scale, measured * scale)
    except ValueError as error:
        raise BadInput(f"{recording.path}: {error}") from None


def control_table(demo: Demo) -> Table:
    """Control and pipeline in one table."""
    sign, followed, report = _SIGN[demo.mode], demo.tracking, demo.replay.report
    steady = f"{number(followed.worst_steady_error)}{sign} (range of the references: {number(followed.range)}{sign})"
    rows = [
        ("Tracking error (reference − measured), RMSE", f"{number(followed.rmse)}{sign}"),
        ("Worst steady-state error", steady),
        ("Steady-state performance", f"{percent(followed.performance)} (paper's rig: {percent(_PAPER[demo.mode])})"),
    ]
    rows += [
        (f"Measured {item.channel.name} within the 95 % interval", percent(item.coverage)) for item in judged(report)
    ]
    live = report.live_equal
    if live is not None:
        rows.append(("Live estimates that the replay repeats bit by bit", f"{live.equal} of {live.compared}"))
    return Table(("Control and pipeline", ""), (*rows, *_pipeline(demo.accounting)), prose=True)


def _pipeline(accounting: Accounting | None) -> list[tuple[str, str]]:
    if accounting is None:
        return [("Pipeline", "not judged: a stage of it is missing in the recording")]
    latency, lost = accounting.latency, accounting.lost
    took = f"{latency.median:.2f} ms median, {latency.p99:.2f} ms 99th percentile, {latency.largest:.1f} ms largest"
    published = max(lost["pressure_1"], lost["pressure_2"], lost["valve_state"])
    disordered = sum(accounting.out_of_order.values())
    missing = f"{published}, {lost['joint_estimate']}, {lost['valve_command']}"
    return [
        ("Latency, pressure to command", took),
        ("Samples expected after discovery", str(accounting.expected)),
        ("Lost: published, estimated, commanded", missing + (f"; {disordered} out of order" if disordered else "")),
        ("Estimates that came late (over 20 ms)", str(accounting.late)),
    ]


def _definitions(demo: Demo) -> str:
    what = demo.mode.name.lower()
    return (
        "The joint was this package's simulator. Its parameters differ from the rig's by "
        f"{demo.simulated.mismatch:.1%} (standard deviation, seed {demo.simulated.seed}). Only a recording of a real "
        "joint shows how well a real joint does. Steady-state performance is the paper's: 1 minus the worst "
        f"steady-state |reference − measured {what}| over the range of the references. The steady part is the last "
        f"{STEADY_PART:.0%} of every step that lasts {SHORTEST_STEP:g} s or more. The measurement is the validation "
        "sensor's, with its noise; estimator and controller do not get it. Latency counts from the reception of a "
        "sample's first pressure to that of its command, both at the recorder."
    )


def _figure(demo: Demo) -> Figure:
    """Reference, measurement and estimate over time, and the tracking error below."""
    replay, mode = demo.replay, demo.mode
    recording, rows = replay.recording, replay.run.rows
    scale, sign = (math.degrees(1.0), "°") if mode is Mode.ANGLE else (1.0, "N m")
    name = mode.name.lower()
    measured = replay.measured_angle if mode is Mode.ANGLE else replay.measured_torque
    assert recording.reference is not None and measured is not None  # follow() has looked
    wanted = held(replay.run.stamp_ns, recording.reference.stamp_ns, recording.reference.value)
    signals = (measured * scale, rows[name] * scale, wanted * scale)
    about = "The controller sees the estimate, never the measurement."
    return tracking_figure(f"Sensor-less {name} control", about, (name, sign), time(replay), signals, replay.name)
