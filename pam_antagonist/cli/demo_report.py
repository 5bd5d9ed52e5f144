"""What ``demo`` says about its recording: estimation, control and the pipeline itself."""

from __future__ import annotations

import dataclasses
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist import strict_json
from pam_antagonist.cli import common
from pam_antagonist.control import Mode
from pam_antagonist.control.tracking import SHORTEST_STEP, STEADY_PART, Tracking, held, tracking
from pam_antagonist.errors import BadInput
from pam_antagonist.nodes.accounting import Accounting, account
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.report import figures, replay_tables, terminal
from pam_antagonist.report import replay as replaying
from pam_antagonist.report.document import Block, Section, Text
from pam_antagonist.report.html import Figure, render
from pam_antagonist.report.replay_page import document, page
from pam_antagonist.report.style import ESTIMATE, MEASURED, MODEL, SECOND
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.rig import Rig

_PAPER = {Mode.ANGLE: 0.9475, Mode.TORQUE: 0.95}  # steady-state performance reported there
_UNIT = {Mode.ANGLE: "deg", Mode.TORQUE: "nm"}
_SIGN = {Mode.ANGLE: "°", Mode.TORQUE: " N m"}


@dataclasses.dataclass(frozen=True)
class Simulated:
    """What the joint was.

    Attributes:
        mismatch: relative standard deviation of its parameters from the rig's [-].
        seed: of that scatter and of the sensor noise.
    """

    mismatch: float
    seed: int


def judge(out: Path, rig: Rig, tuning: str, mode: Mode, simulated: Simulated, with_figures: bool = True) -> None:
    """Replay OUT/bag, print the tables, write OUT/report.html and OUT/report.json.

    Args:
        out: the demo's folder.
        rig: as the estimator had it.
        tuning: of its filter.
        mode: what was controlled.
        simulated: what the joint was.
        with_figures: False leaves the figures out of the page.

    Raises:
        BadInput: the recording cannot be used.
    """
    begin = time.perf_counter()
    recording = read_bag(out / "bag")
    read_seconds = time.perf_counter() - begin
    joint, lock_angle = ("free", None) if mode is Mode.ANGLE else ("locked", 0.0)
    with common.progress(len(recording.stamp_ns), "replay") as bar:
        replay = replaying.replay(recording, rig, tuning, joint, lock_angle, read_seconds, progress=bar.update)
    followed = follow(recording, mode)
    accounting = account(recording, rig.sample_period)
    table = demo_table(replay.report, followed, accounting, mode)
    print(f"\n{terminal.table(replay_tables.errors_table(replay.report))}\n\n{terminal.table(table)}\n")
    first: list[Block] = [
        Section(
            "Closed loop", (dataclasses.replace(table, prose=True), Text(_definitions(mode, simulated))), 2, "loop"
        ),
    ]
    if with_figures:
        first.append(_figure(replay, mode))
    strict_json.write_json(out / "report.json", document([replay], demo=_entry(mode, followed, accounting, simulated)))
    html = render(page([replay], "Sensor-less control, live", with_figures=with_figures, first=first))
    (out / "report.html").write_text(html, encoding="utf-8")
    print(f"report: {out / 'report.html'} and report.json; recording: {out / 'bag'}")


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


def _entry(mode: Mode, followed: Tracking, accounting: Accounting | None, simulated: Simulated) -> dict[str, Any]:
    """The key ``demo`` of ``report.json``; angles in degrees, torques in N m, times in ms."""
    unit = _UNIT[mode]
    return {
        "mode": mode.name.lower(),
        "simulated_joint": dataclasses.asdict(simulated),
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
        "pipeline": None if accounting is None else dataclasses.asdict(accounting),
    }


def demo_table(report: dict[str, Any], followed: Tracking, accounting: Accounting | None, mode: Mode) -> Table:
    """Control and pipeline in one table."""
    sign = _SIGN[mode]
    rows = [
        ("Tracking error (reference − measured), RMSE", f"{number(followed.rmse)}{sign}"),
        ("Worst steady-state error", f"{number(followed.worst_steady_error)}{sign} of {number(followed.range)}{sign}"),
        (
            "Steady-state performance",
            f"{percent(followed.performance)} (on the paper's rig: {percent(_PAPER[mode])})",
        ),
    ]
    for name in ("angle", "torque"):
        if report["ukf"][name] is not None and not (name == "angle" and mode is Mode.TORQUE):
            rows.append((f"Measured {name} within the 95 % interval", percent(report["ukf"][name]["coverage95"])))
    live = report["live_equal"]
    if live is not None:
        rows.append(("Live estimates that the replay repeats bit by bit", f"{live['equal']} of {live['compared']}"))
    if accounting is None:
        rows.append(("Pipeline", "a stage of it is missing in the recording"))
    else:
        latency = accounting.latency
        took = f"{latency.median:.2f} ms median, {latency.p99:.2f} ms 99th percentile, {latency.largest:.1f} ms largest"
        rows += [
            ("Latency, pressure to command", took),
            ("Samples expected after discovery", str(accounting.expected)),
            ("Lost: published, estimated, commanded", _lost(accounting)),
            ("Estimates that came late (over 20 ms)", str(accounting.late)),
        ]
    return Table(("Control and pipeline", ""), tuple(rows))


def _lost(accounting: Accounting) -> str:
    lost = accounting.lost
    published = max(lost["pressure_1"], lost["pressure_2"], lost["valve_state"])
    disordered = sum(accounting.out_of_order.values())
    text = f"{published}, {lost['joint_estimate']}, {lost['valve_command']}"
    return text + (f"; {disordered} out of order" if disordered else "")


def _definitions(mode: Mode, simulated: Simulated) -> str:
    what = mode.name.lower()
    return (
        f"The joint was this package's simulator, its parameters off the rig's by {simulated.mismatch:.1%} (standard "
        f"deviation, seed {simulated.seed}): how well a real joint does, only a recording of it can tell. "
        f"Steady-state performance is the paper's: 1 minus the worst steady-state |reference − measured {what}| over "
        f"the range of the references. Steady is the last {STEADY_PART:.0%} of every step that lasts "
        f"{SHORTEST_STEP:g} s or more; the measurement is the validation sensor's, with its noise, which estimator and "
        "controller never see. Latency is counted from the recorder's reception of a sample's first pressure to that "
        "of its command."
    )


def _figure(replay: replaying.Replay, mode: Mode) -> Figure:
    """Reference, measurement and estimate over time, and the tracking error below."""
    recording, rows = replay.recording, replay.run.rows
    scale, sign = (math.degrees(1.0), "°") if mode is Mode.ANGLE else (1.0, "N m")
    name = mode.name.lower()
    measured = replay.measured_angle if mode is Mode.ANGLE else replay.measured_torque
    assert recording.reference is not None and measured is not None  # follow() has looked
    wanted = held(replay.run.stamp_ns, recording.reference.stamp_ns, recording.reference.value)
    clock = figures.Clock.from_stamps(replay.run.stamp_ns, int(recording.stamp_ns[0]), replay.rig.sample_period)
    panels = [
        figures.Panel(
            f"{name.capitalize()} [{sign}]",
            [
                figures.Line("measured", measured * scale, MEASURED),
                figures.Line("UKF", rows[name] * scale, ESTIMATE),
                figures.Line("reference", wanted * scale, MODEL, dash="dash"),
            ],
            250,
        ),
        figures.Panel(
            f"Reference − measured [{sign}]",
            [figures.Line("tracking error", (wanted - measured) * scale, SECOND, quiet=True)],
            160,
        ),
    ]
    return Figure(
        f"Sensor-less {name} control",
        "The controller sees the estimate, never the measurement.",
        figures.stack(panels, clock),
        replay.report["recording"]["name"],
    )
