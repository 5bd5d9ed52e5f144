"""Sensor-less control: steps of angle and torque on the estimate, live once and in one process for every seed."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.control.command import PI_MODES, Mode
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.tracking import SHORTEST_STEP, STEADY_PART, Tracking, held, tracking
from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import Recording
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.figures import seconds, tracking_figure
from pam_antagonist.report.table import Table, number
from validation.paper import live
from validation.paper.result import Beside, Context, Result, Spread
from validation.paper.seed_work import TUNINGS, SeedWork

Floats = NDArray[np.float64]
LIVE_TUNING = "default"
_PAPER = {Mode.ANGLE: 0.9475, Mode.TORQUE: 0.95}
_UNIT = {Mode.ANGLE: "°", Mode.TORQUE: "N m"}
_SCALE = {Mode.ANGLE: math.degrees(1.0), Mode.TORQUE: 1.0}
_JOINT = {Mode.ANGLE: "free", Mode.TORQUE: "locked"}
_REST_S = 2.0
_STEP_S = {Mode.ANGLE: 9.0, Mode.TORQUE: 4.5}
_VALUES = {Mode.ANGLE: (20.0, -20.0, 0.0, 10.0), Mode.TORQUE: (2.0, -2.0, 0.0, 1.0)}
"""Within ±20° and ±2 N m, as in the paper."""


def references(mode: Mode, short: bool = False) -> tuple[list[tuple[float, float]], float]:
    """Steps: time [s] and value [rad or N m]; and the length of the experiment [s]."""
    values = _VALUES[mode][:2] if short else _VALUES[mode]
    steps = [(0.0, 0.0)]
    steps += [(_REST_S + k * _STEP_S[mode], value / _SCALE[mode]) for k, value in enumerate(values)]
    return steps, _REST_S + len(values) * _STEP_S[mode]


def closed_loop(work: SeedWork, mode: Mode, tuning: str) -> tuple[Floats, Floats, Floats]:
    """The loop in one process, without transport: the classes that the nodes run.

    Args:
        work: the virtual rig.
        mode: what is controlled.
        tuning: of the filter.

    Returns:
        Reference, measurement and estimate (N,), in ° or N m.
    """
    rig, joint = work.rig.declared, _JOINT[mode]
    steps, seconds = references(mode)
    plant, estimator = work.rig.plant(joint), Estimator(rig, tuning, joint)
    controller = PiController(sample_period=rig.sample_period)
    at = np.arange(round(seconds / rig.sample_period)) * rig.sample_period
    times, values = np.array(steps).T
    wanted = values[np.searchsorted(times, at, side="right") - 1]
    measured, estimated = np.empty(len(at)), np.empty(len(at))
    voltage = controller.safe_voltage
    name = mode.name.lower()
    period_ns = round(rig.sample_period * 1e9)
    for k, reference in enumerate(wanted.tolist()):
        sample = plant.step(voltage)
        row = estimator.step((k + 1) * period_ns, *sample.pressure, *sample.voltage)
        assert row is not None  # every sample is newer than the one before
        estimated[k] = row[name]
        measured[k] = sample.angle if mode is Mode.ANGLE else sample.torque
        voltage, _ = controller.step(mode, reference, float(estimated[k]))
    scale = _SCALE[mode]
    return wanted * scale, measured * scale, estimated * scale


def of_seed(work: SeedWork) -> dict[str, Any]:
    """Steady-state performance of either mode with both tunings."""
    out: dict[str, Any] = {}
    for mode in PI_MODES:
        out[mode.name.lower()] = {}
        for tuning in TUNINGS:
            wanted, measured, estimated = closed_loop(work, mode, tuning)
            stamps = np.arange(len(wanted), dtype=np.int64) * round(work.rig.declared.sample_period * 1e9)
            followed = tracking(stamps, wanted, measured)
            out[mode.name.lower()][tuning] = {
                "performance": followed.performance,
                "worst_steady_error": followed.worst_steady_error,
                "rmse": followed.rmse,
                "estimate_rmse": float(np.sqrt(np.mean((estimated - measured) ** 2))),
            }
    return out


def result(context: Context) -> Result:
    """Run both modes live, and put the seeds beside them."""
    runs: dict[Mode, tuple[Recording, Tracking]] = {}
    for mode in PI_MODES:
        steps, seconds = references(mode, context.short)
        context.log(f"live nodes, {mode.name.lower()} control, {seconds:g} s")
        recording = live.control(context, mode, LIVE_TUNING, steps, seconds)
        runs[mode] = recording, _followed(recording, mode)
    return Result(
        name="control",
        title="Sensor-less control",
        question=(
            "Steps within ±20° (joint free) and ±2 N m (locked) with the paper's PI gains on the estimate. Live: "
            f"plant (virtual rig of seed {context.work.seed}), estimator (tuning {LIVE_TUNING}) and controller as "
            "processes. Over the seeds: the same classes in one process, both tunings."
        ),
        beside=_beside(context, runs),
        tables=(_table(context, runs),),
        findings=_findings(context),
        figures=tuple(_figure(recording, mode, context) for mode, (recording, _) in runs.items())
        if context.with_figures
        else (),
        numbers={
            "live": {mode.name.lower(): dataclasses.asdict(followed) for mode, (_, followed) in runs.items()},
            "seeds": list(context.seeds),
            "of_seed": list(context.of_seeds),
        },
    )


def _series(recording: Recording, mode: Mode) -> tuple[Floats, Floats]:
    """Reference and measurement (N,) in ° or N m."""
    reference, measured = recording.reference, recording.angle if mode is Mode.ANGLE else recording.torque
    assert reference is not None and measured is not None  # the pipeline has both
    wanted = held(recording.stamp_ns, reference.stamp_ns, np.where(reference.mode == mode, reference.value, np.nan))
    return wanted * _SCALE[mode], measured * _SCALE[mode]


def _followed(recording: Recording, mode: Mode) -> Tracking:
    return tracking(recording.stamp_ns, *_series(recording, mode))


def _beside(context: Context, runs: dict[Mode, tuple[Recording, Tracking]]) -> tuple[Beside, ...]:
    rows = []
    for mode in PI_MODES:
        name = mode.name.lower()
        rows.append(
            Beside(
                f"Steady-state performance, {name}, live (seed {context.work.seed}, tuning {LIVE_TUNING})",
                Spread.of([runs[mode][1].performance]),
                _PAPER[mode],
                "%",
                "One rig, one run, as in the paper. It reads the steady state from a figure by eye; ours is "
                f"the last {100.0 * STEADY_PART:g} % of each step.",
            )
        )
        for tuning in TUNINGS:
            rows.append(
                Beside(
                    f"Steady-state performance, {name}, all seeds, tuning {tuning}",
                    context.spread(name, tuning, "performance"),
                    _PAPER[mode] if tuning == "published" else None,
                    "%",
                    _why(mode, tuning),
                )
            )
    return tuple(rows)


def _why(mode: Mode, tuning: str) -> str:
    if tuning == "default":
        return "Not in the paper."
    if mode is Mode.ANGLE:
        return "The loop holds the estimate at its reference, so what is left is the error of the estimated angle."
    return (
        "What is left is the error of the estimated torque. It comes from the force maps, and the loop cannot see it."
    )


def _table(context: Context, runs: dict[Mode, tuple[Recording, Tracking]]) -> Table:
    rows = []
    for mode in PI_MODES:
        name, unit = mode.name.lower(), _UNIT[mode]
        followed = runs[mode][1]
        rows.append(
            (
                f"{name}, live, seed {context.work.seed}, {LIVE_TUNING}",
                number(100.0 * followed.performance, 4),
                f"{number(followed.worst_steady_error)} of {number(followed.range)} {unit}",
                f"{number(followed.rmse)} {unit}",
                "–",
            )
        )
        for tuning in TUNINGS:
            spread = {
                key: context.spread(name, tuning, key)
                for key in ("performance", "worst_steady_error", "rmse", "estimate_rmse")
            }
            rows.append(
                (
                    f"{name}, {len(context.seeds)} seeds, {tuning}",
                    spread["performance"].text(100.0, 4),
                    f"{spread['worst_steady_error'].text()} {unit}",
                    f"{spread['rmse'].text()} {unit}",
                    f"{spread['estimate_rmse'].text()} {unit}",
                )
            )
    header = (
        "", "steady-state performance [%]", "worst steady error", "tracking error, RMSE", "error of the estimate, RMSE",
    )  # fmt: skip
    return Table(
        header,
        tuple(rows),
        f"Steady: the last {100.0 * STEADY_PART:g} % of each step that lasts {SHORTEST_STEP:g} s or more",
    )


def _findings(context: Context) -> tuple[str, ...]:
    out = []
    for mode in PI_MODES:
        name = mode.name.lower()
        shares = [
            f"{int(np.sum(np.array(context.values(name, tuning, 'performance')) >= _PAPER[mode]))} of "
            f"{len(context.seeds)} with {tuning}"
            for tuning in TUNINGS
        ]
        out.append(
            f"{name.capitalize()}: rigs at or above the paper's {100.0 * _PAPER[mode]:g} %: {', '.join(shares)}."
        )
    out.append(
        "Two things are added to the paper's PI. The integral stops while a valve is at its limit (anti-windup), and a "
        "loop that takes over starts from the valves' present voltages (bumpless start). The paper mentions neither."
    )
    return tuple(out)


def _figure(recording: Recording, mode: Mode, context: Context) -> Figure:
    wanted, measured = _series(recording, mode)
    estimate = recording.estimate
    assert estimate is not None  # the pipeline has an estimator
    name, unit = mode.name.lower(), _UNIT[mode]
    estimated = np.full(len(measured), np.nan)
    _, ours, theirs = np.intersect1d(recording.stamp_ns, estimate.stamp_ns, return_indices=True)
    estimated[ours] = getattr(estimate, name)[theirs] * _SCALE[mode]
    x = seconds(recording.stamp_ns, int(recording.stamp_ns[0]))
    about = "The controller sees the estimate, never the measurement. Simulated joint, live nodes."
    title = f"Sensor-less {name} control, live"
    return tracking_figure(title, about, (name, unit), x, (measured, estimated, wanted), f"control {name}")
