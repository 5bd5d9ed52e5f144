"""The report of ``demo``: replay of its recording, and performance of control and pipeline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.control.command import Mode
from pam_antagonist.control.tracking import SETTLED, SHORTEST_STEP, STEADY_PART, Tracking, held, tracking, yielded
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.metrics import rmse
from pam_antagonist.recording import Recording
from pam_antagonist.replays import Replay
from pam_antagonist.replays.accounting import STAGES, Accounting, account
from pam_antagonist.replays.result import judged
from pam_antagonist.replays.result import numbers as replay_numbers
from pam_antagonist.report.document import Block, Document, Section, Table, Text
from pam_antagonist.report.figure import ESTIMATE, MEASURED, MODEL, SECOND, TIME, Axis, Figure, FloatArray, Line, Panel
from pam_antagonist.report.replay import document as replay_document
from pam_antagonist.report.replay_figures import time
from pam_antagonist.report.result import Result
from pam_antagonist.rig.physical import rest_pressure, rest_voltage
from pam_antagonist.shown import number, percent

_PAPER = {Mode.ANGLE: 0.9475, Mode.TORQUE: 0.95}  # steady-state performance in the paper
_UNIT = {Mode.ANGLE: "deg", Mode.TORQUE: "nm"}
_SIGN = {Mode.ANGLE: "°", Mode.TORQUE: " N m"}
_MOST_HELD = 0.3
"""[-] Share of samples with safe commands from which on a demo was not controlled: its first second counts little."""
_MOST_LATE = 0.05
"""[-] Share of late or lost samples. Single stalls of 0.3 s, as on any shared machine, are 2.5 % of a demo."""
_LAWS = {
    "fast": "fast gains",
    "published": "published gains",
    "model": "law through the model",
    "found": "gains found for it",
}


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
    """Comparison of the joint with the commanded spring and damper."""

    rmse_deg: float  # RMS difference of the measured angle from that of spring and damper [°]
    largest_deg: float  # largest difference [°]
    moved_deg: float  # root mean square of the motion of spring and damper [°]
    within: float  # share of the samples in the 95 % interval, by the covariance of angle and external torque [-]

    @classmethod
    def of(cls, replay: Replay) -> Yielding:
        """Compare a replay with spring and damper."""
        recording, rows, reference = replay.recording, replay.run.rows, replay.recording.reference
        wanted = spring_and_damper(recording)[replay.run.index]
        if recording.angle is None or reference is None:
            raise BadInput(f"{recording.path}: no measured angle was recorded")
        stiffness = held(replay.run.stamp_ns, reference.stamp_ns, reference.stiffness)
        centre = held(replay.run.stamp_ns, reference.stamp_ns, reference.value)
        error = recording.angle[replay.run.index] - wanted
        # The law moves the estimated angle to that of spring and damper under the estimated torque.
        of_torque = rows["external_torque_covariance"]
        variance = rows["covariance"][:, 0, 0] - 2.0 * of_torque[:, 0] / stiffness + of_torque[:, 3] / stiffness**2
        known = np.isfinite(error)
        if not known.any():
            raise BadInput(f"{recording.path}: no sample has both a reference and a measurement")
        return cls(
            math.degrees(rmse(error[known])),
            math.degrees(np.max(np.abs(error[known]))),
            math.degrees(rmse((wanted - centre)[known])),
            float(np.mean(np.abs(error[known]) <= 1.96 * np.sqrt(variance[known]))),
        )


@dataclass(frozen=True, eq=False, repr=False)
class Demo(Result):
    """A finished demo; angles in degrees, torques in N m, times in ms."""

    replay: Replay
    mode: Mode
    mismatch: float  # relative standard deviation of the simulated joint's parameters from the rig's [-]
    seed: int  # of the simulated joint
    gains: str  # of the controller: ``fast`` or ``published``, ``model`` for that law, ``found`` for those of a file
    tracking: Tracking
    stiffness: Tracking | None  # tracking of the estimated stiffness [N m/rad]; None without a reference for it
    yielding: Yielding | None  # motion under pushes; None in other modes than IMPEDANCE
    accounting: Accounting | None  # account of the samples; None where a stage is missing in the recording
    stopped: str = ""  # why the joint was stopped for safety, in words; empty where it was not

    @classmethod
    def of(cls, replay: Replay, mode: Mode, mismatch: float, seed: int, gains: str = "fast", stopped: str = "") -> Demo:
        """Evaluate the recording of a demo."""
        yielding = Yielding.of(replay) if mode is Mode.IMPEDANCE else None
        followed = follow(replay.recording, mode)
        stiffness = tracking(replay.run.stamp_ns, *_stiffness(replay)) if mode.has_stiffness else None
        accounting = account(replay.recording, replay.rig.sample_period)
        return cls(replay, mode, mismatch, seed, gains, followed, stiffness, yielding, accounting, stopped)

    @override
    def to_json(self) -> dict[str, Any]:
        about = {
            "mode": self.mode.name.lower(),
            "simulated_joint": {"mismatch": self.mismatch, "seed": self.seed},
            "gains": self.gains,
            "tracking": self.tracking.numbers(_UNIT[self.mode.quantity]),
            "stiffness": self.stiffness,
            "yielding": self.yielding,
            "pipeline": self.accounting,
            "stopped_for_safety": self.stopped or None,
        }
        return {**replay_numbers([self.replay]), "demo": about}

    @override
    def document(self, figures: bool = True) -> Document:
        replayed = replay_document([self.replay], figures)
        what = self.mode.quantity.name.lower()
        task = "yielded to pushes" if self.yielding is not None else f"followed steps of its {what}"
        if self.stopped:
            task = f"was to follow steps of its {what}"
        lede = (
            f"A simulated joint {task}. The controller had no {what} sensor: it saw only the "
            "estimate from two pressure sensors. All of it ran live at 1 kHz, was recorded, and was replayed for this "
            "report."
        )
        # Lede and verdict of the replay are in the section on the estimate.
        verdict, estimate, ends = replayed.blocks[1], replayed.blocks[2:-2], replayed.blocks[-2:]
        first: tuple[Block, ...] = (Text(lede, "lede"), Text(_verdict(self), "verdict"))
        blocks: tuple[Block, ...] = (
            *(first[::-1] if self.stopped else first),
            *((_figure(self), *_stiffness_figure(self)) if figures else ()),
            Section("Control and pipeline", (control_table(self),), 2, "loop", brief=True),
            Section("How these numbers are defined", (Text(_definitions(self)),), folded=True),
            Section("The estimate", (verdict, *estimate), 2, "estimate", brief=True),
            *ends,
        )
        return Document(f"Demo: a simulated joint, controlled by its {what}", "Sensor-less control, live", blocks)


def _verdict(demo: Demo) -> str:
    return " ".join(filter(None, (_result(demo), _too_slow(demo))))


def _too_slow(demo: Demo) -> str:
    accounting, hertz = demo.accounting, 1.0 / demo.replay.rig.sample_period
    if accounting is None or not accounting.expected:
        return ""
    share = (accounting.late + max(accounting.lost.values())) / accounting.expected
    if share <= _MOST_LATE:
        return ""
    return (
        f"This computer is too slow for {hertz:g} samples a second: {percent(min(share, 1.0))} of them were lost or "
        "came late (over 20 ms)."
    )


def _result(demo: Demo) -> str:
    if demo.stopped:
        return f"Stopped for safety by the {demo.stopped}. From then on the valves had the safe voltages."
    if (yielding := demo.yielding) is not None:
        return (
            f"The pushes would move the spring and damper by {number(yielding.moved_deg, 2)}° (RMS); the joint "
            f"differed from them by {number(yielding.rmse_deg, 2)}°."
        )
    rig, followed = demo.replay.rig, demo.tracking
    safe = rest_voltage(rig) if rig.drive == "valve" else (rest_pressure(rig),) * 2
    at_rest = float(np.mean(np.all(demo.replay.recording.voltage == np.array(safe), axis=1)))
    if at_rest > _MOST_HELD:
        return (
            f"The joint had no commands: in {percent(at_rest)} of the samples the valves had the safe commands. "
            "Estimates or commands came too late, or were refused: logs/ and /diagnostics in the bag say which."
        )
    steps, slowest = len(followed.steps) - 1, _slowest(demo)
    if math.isfinite(slowest):
        settled = f"{'The step' if steps == 1 else f'Each of the {steps} steps'} settled within {slowest:.1f} s"
    else:
        no = "The step did not settle" if steps == 1 else f"Not each of the {steps} steps settled"
        settled = f"{no} within its time"
    worst = f"{number(followed.worst_steady_error, 2)}{_SIGN[demo.mode.quantity]}"
    steady = f", and the largest error in steady state was {worst}"
    return f"{settled}{steady if math.isfinite(followed.worst_steady_error) else ''}."


def _slowest(demo: Demo) -> float:
    """Settling time of the slowest step [s]; NaN if a step did not settle."""
    return float(np.max([step.settling_s for step in demo.tracking.steps[1:]], initial=0.0))


def follow(recording: Recording, mode: Mode) -> Tracking:
    """Tracking of the reference, in ° or N m."""
    reference, measured = recording.reference, recording.angle if mode.quantity is Mode.ANGLE else recording.torque
    if reference is None or measured is None:
        raise BadInput(f"{recording.path}: no reference or no measured {mode.quantity.name.lower()} was recorded")
    scale = math.degrees(1.0) if mode.quantity is Mode.ANGLE else 1.0
    wanted = held(recording.stamp_ns, reference.stamp_ns, np.where(reference.mode == mode, reference.value, np.nan))
    if mode is Mode.IMPEDANCE:
        wanted = spring_and_damper(recording, damped=False)
    try:
        return tracking(recording.stamp_ns, wanted * scale, measured * scale)
    except ValueError as error:
        raise BadInput(f"{recording.path}: {error}") from None


def control_table(demo: Demo) -> Table:
    """Control and pipeline in one table."""
    sign, followed, report = _SIGN[demo.mode.quantity], demo.tracking, demo.replay.report
    steady = f"{number(followed.worst_steady_error)}{sign} (range of the references: {number(followed.range)}{sign})"
    slowest = _slowest(demo)
    rows = [
        (
            f"Time until a step settles to {100.0 * SETTLED:.0f} %, slowest",
            f"{slowest:.2f} s" if math.isfinite(slowest) else "not within the step",
        ),
        ("Tracking error (reference − measured), RMSE", f"{number(followed.rmse)}{sign}"),
        ("Worst steady-state error", steady),
        (
            "Steady-state performance",
            f"{percent(followed.performance)} (paper, its rig and gains: {percent(_PAPER[demo.mode.quantity])})",
        ),
    ]
    if (yielding := demo.yielding) is not None:
        rows = [
            ("Measured angle minus that of spring and damper, RMSE", f"{number(yielding.rmse_deg)}°"),
            ("The same, largest", f"{number(yielding.largest_deg)}°"),
            ("Motion of spring and damper, RMS", f"{number(yielding.moved_deg)}°"),
            ("Difference within the 95 % interval of angle and torque", percent(yielding.within)),
            ("Worst steady-state difference from the spring alone", f"{number(followed.worst_steady_error)}{sign}"),
        ]
    if demo.stiffness is not None:
        stiff = f"{number(demo.stiffness.worst_steady_error)} N m/rad (range: {number(demo.stiffness.range)} N m/rad)"
        rows.append(("Worst steady-state error of the stiffness, estimated", stiff))
    rows += [
        (f"Measured {item.channel.name} within the 95 % interval", percent(item.coverage)) for item in judged(report)
    ]
    if (live := report.live_equal) is not None:
        rows.append(("Live estimates that the replay repeats bit by bit", f"{live.equal} of {live.compared}"))
    return Table(("Control and pipeline", ""), (*rows, *_pipeline(demo.accounting)), prose=True)


def _pipeline(accounting: Accounting | None) -> list[tuple[str, str]]:
    if accounting is None:
        return [("Pipeline", "not judged: a stage of it is missing in the recording")]
    latency, lost = accounting.latency, accounting.lost
    took = f"{latency.median:.2f} ms median, {latency.p99:.2f} ms 99th percentile, {latency.largest:.1f} ms largest"
    published = max(lost.get(stage, 0) for stage in STAGES[:3])
    disordered = sum(accounting.out_of_order.values())
    missing = f"{published}, {lost['joint_estimate']}, {lost['valve_command']}"
    return [
        ("Latency, pressure to command", took),
        ("Samples expected after discovery", str(accounting.expected)),
        ("Lost: published, estimated, commanded", missing + (f"; {disordered} out of order" if disordered else "")),
        ("Estimates that came late (over 20 ms)", str(accounting.late)),
    ]


def _definitions(demo: Demo) -> str:
    what = demo.mode.quantity.name.lower()
    return (
        "The joint was this package's simulator. Its parameters differ from the rig's by "
        f"{100.0 * demo.mismatch:.1f} % (standard deviation, seed {demo.seed}). Only a recording "
        "of a real joint shows how well a real joint does. "
        f"The controller had the {_LAWS[demo.gains]}. Steady-state performance is defined as in the paper: 1 minus the "
        f"largest |reference − measured {what}| in steady state over the range of the references. The steady part is "
        f"the last {100.0 * STEADY_PART:.0f} % of every step of {SHORTEST_STEP:g} s or more. The measurement comes "
        "from a validation sensor with noise, which estimator and controller do not get. Latency counts from the "
        "first pressure of a sample to its command, both as received by the recorder."
    )


def _figure(demo: Demo) -> Figure:
    """Reference, measurement and estimate over time, and the tracking error below."""
    replay, mode = demo.replay, demo.mode.quantity
    recording, rows = replay.recording, replay.run.rows
    scale, sign = (math.degrees(1.0), "°") if mode is Mode.ANGLE else (1.0, "N m")
    about = "The controller sees the estimate, never the measurement."
    name = mode.name.lower()
    measured = replay.measured_angle if mode is Mode.ANGLE else replay.measured_torque
    assert recording.reference is not None and measured is not None  # follow() has checked it
    wanted = held(replay.run.stamp_ns, recording.reference.stamp_ns, recording.reference.value)
    if demo.yielding is not None:
        wanted = spring_and_damper(recording)[replay.run.index]
        about += " The reference is where spring and damper would be, by the torque that was applied."
    x, measured, wanted = time(replay), measured * scale, wanted * scale
    shown = (
        Line("measured", x, measured, MEASURED),
        Line("UKF", x, rows[name] * scale, ESTIMATE),
        Line("reference", x, wanted, MODEL, dash="dash"),
    )
    error = Line("tracking error", x, wanted - measured, SECOND, quiet=True)
    panels = (
        Panel(TIME, Axis(f"{name.capitalize()} [{sign}]"), shown, 250),
        Panel(TIME, Axis(f"Reference − measured [{sign}]"), (error,), 160),
    )
    return Figure(f"{name.capitalize()}: reference, measurement and estimate", about, panels, replay.name)


def _stiffness(replay: Replay) -> tuple[FloatArray, FloatArray]:
    """Reference and estimate of the stiffness at the estimates (N,) each [N m/rad]."""
    reference = replay.recording.reference
    assert reference is not None  # follow() has checked it
    return held(replay.run.stamp_ns, reference.stamp_ns, reference.stiffness), replay.run.rows["stiffness"]


def _stiffness_figure(demo: Demo) -> list[Figure]:
    if demo.stiffness is None:
        return []
    wanted, estimated = _stiffness(demo.replay)
    x = time(demo.replay)
    lines = (Line("UKF", x, estimated, ESTIMATE), Line("reference", x, wanted, MODEL, dash="dash"))
    panel = Panel(TIME, Axis("Stiffness [N m/rad]"), lines, 250)
    about = "−∂τ/∂ψ of the joint by the estimate; nothing measures it."
    return [Figure("Stiffness: reference and estimate", about, (panel,), demo.replay.name)]
