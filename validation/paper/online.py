"""Online estimation: the same profile with the live nodes at 1 kHz, and what a step of the filter costs."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import Estimator
from pam_antagonist.recording import Recording
from pam_antagonist.replays.accounting import STAGES
from pam_antagonist.replays.live import compare_with_live
from pam_antagonist.report import figures
from pam_antagonist.report.figure import TIME, Axis, Figure, Line, Panel, Reference
from pam_antagonist.report.style import ESTIMATE, MODEL
from pam_antagonist.report.table import Table, number, percent
from pam_antagonist.rig import Rig
from validation.paper import live
from validation.paper.offline import CONDITIONS, METHODS, UNITS, consistency, estimate_figure
from validation.paper.result import Beside, Context, Result, Spread
from validation.paper.seed_work import Errors, Track, filtered, judged, modelled

Floats = NDArray[np.float64]
LIVE_TUNING = "published"
_PAPER = {"angle": (1.16, 3.06, 0.0791), "torque": (0.0899, 0.299, 0.0601)}
_PAPER_STEP_MS = 0.346
_STAGES = tuple(stage for stage in STAGES if stage != "valve_command")


@dataclasses.dataclass(frozen=True, eq=False)
class Run:
    """One live run, replayed.

    Attributes:
        recording: the samples that have all three messages, from the first estimate on.
        tracks: the filter with both tunings and the model alone over it.
        errors: of each.
        equal: live estimates that a replay repeats bit by bit, and how many were compared.
        lost: samples without their message, by topic.
        pipeline_ms: from the reception of a sample's last message to that of its estimate, both by the recorder (M,).
        step_ms: what each step of the filter takes (N,).
    """

    recording: Recording
    tracks: dict[str, Track]
    errors: dict[str, Errors]
    equal: tuple[int, int]
    lost: dict[str, int]
    pipeline_ms: Floats
    step_ms: Floats


def result(context: Context) -> Result:
    """Run the pipeline twice, joint free and locked."""
    short = context.short
    seconds = {"angle": live.SHORT_S if short else live.FULL_S, "torque": live.SHORT_S if short else live.PART_S}
    runs = {}
    for quantity, joint in CONDITIONS.items():
        context.log(f"live nodes, joint {joint}, {seconds[quantity]:g} s")
        recording = live.estimation(context, joint, LIVE_TUNING, seconds[quantity])
        runs[quantity] = judge(recording, context.work.rig.declared, quantity, joint)
    step = np.concatenate([run.step_ms for run in runs.values()])
    return Result(
        name="online",
        title="Online estimation",
        question=(
            f"Plant (the virtual rig of seed {context.work.seed}), estimator and recorder as processes at 1 kHz; a "
            f"fourth process commands the profile: {seconds['angle']:g} s with the joint free, "
            f"{seconds['torque']:g} s with it locked. The live filter has tuning {LIVE_TUNING}. The other tuning is "
            "run by a replay of the recording, which gives the same bits as a live filter."
        ),
        beside=_beside(runs, step),
        tables=(*(_table(run, quantity) for quantity, run in runs.items()), _timing(runs)),
        findings=_findings(runs, short),
        figures=_figures(runs, context) if context.with_figures else (),
        numbers={quantity: _numbers(run) for quantity, run in runs.items()},
    )


def judge(recording: Recording, rig: Rig, quantity: str, joint: str) -> Run:
    """Errors of a live run, and what became of its samples.

    Args:
        recording: of the whole pipeline.
        rig: as the estimator had it.
        quantity: ``angle`` or ``torque``.
        joint: ``free`` or ``locked``.
    """
    lost = {stage: _lost(recording, stage) for stage in _STAGES}
    live_estimate = recording.estimate
    assert live_estimate is not None and len(live_estimate)
    # A filter that was started later than the recording began cannot be repeated from its beginning.
    first = int(live_estimate.started_ns[-1])
    begin = float(first - recording.stamp_ns[0]) * 1e-9
    part = recording.slice(begin, math.inf)
    estimator = Estimator(rig, LIVE_TUNING, joint)
    run = estimator.run(part.stamp_ns, part.pressure, part.voltage)
    compared = compare_with_live(live_estimate, run)
    whole = np.isfinite(part.pressure).all(axis=1) & np.isfinite(part.voltage).all(axis=1)
    assert part.angle is not None and part.torque is not None  # the plant publishes both
    whole &= np.isfinite(part.angle) & np.isfinite(part.torque)
    complete = Recording(
        path=part.path,
        stamp_ns=part.stamp_ns[whole],
        pressure=part.pressure[whole],
        voltage=part.voltage[whole],
        angle=part.angle[whole],
        torque=part.torque[whole],
    )
    tracks = {
        method: modelled(rig, complete, joint) if method == "model" else filtered(rig, complete, method, joint)
        for method in METHODS
    }
    return Run(
        recording=complete,
        tracks=tracks,
        errors={method: judged(track, complete, rig, quantity) for method, track in tracks.items()},
        equal=(compared.equal, compared.compared),
        lost=lost,
        pipeline_ms=_pipeline_times(recording),
        step_ms=step_times(rig, complete, joint),
    )


def _lost(recording: Recording, stage: str) -> int:
    stamps = recording.received_ns[stage].stamp_ns
    both = [recording.received_ns[name].stamp_ns for name in _STAGES]
    low, high = max(item[0] for item in both), min(item[-1] for item in both)
    expected = round((high - low) * 1e-9 / recording.sample_period_s) + 1
    return expected - int(np.count_nonzero((stamps >= low) & (stamps <= high)))


def _pipeline_times(recording: Recording) -> Floats:
    """From the last of a sample's three messages to its estimate, in stamp order [ms]."""
    estimate = recording.received_ns["joint_estimate"]
    last = np.full(len(estimate.stamp_ns), np.iinfo(np.int64).min)
    there = np.ones(len(last), dtype=bool)
    for stage in ("pressure_1", "pressure_2", "valve_state"):
        arrival = recording.received_ns[stage]
        at = np.clip(np.searchsorted(arrival.stamp_ns, estimate.stamp_ns), 0, len(arrival.stamp_ns) - 1)
        there &= arrival.stamp_ns[at] == estimate.stamp_ns
        last = np.maximum(last, arrival.log_ns[at])
    return np.asarray((estimate.log_ns - last)[there] * 1e-6)


def step_times(rig: Rig, recording: Recording, joint: str) -> Floats:
    """What every step of the filter takes, called sample by sample as the node calls it (N,) [ms].

    Args:
        rig: of the filter.
        recording: what it is given.
        joint: ``free`` or ``locked``.
    """
    estimator = Estimator(rig, LIVE_TUNING, joint)
    samples = list(
        zip(recording.stamp_ns.tolist(), recording.pressure.tolist(), recording.voltage.tolist(), strict=True)
    )
    took = np.empty(len(samples))
    clock = time.perf_counter_ns
    for k, (stamp, (p1, p2), (u1, u2)) in enumerate(samples):
        begin = clock()
        estimator.step(stamp, p1, p2, u1, u2)
        took[k] = clock() - begin
    return took * 1e-6


def _beside(runs: dict[str, Run], step: Floats) -> tuple[Beside, ...]:
    rows = []
    for quantity, run in runs.items():
        errors, paper = run.errors[LIVE_TUNING], _PAPER[quantity]
        for sign, ours, theirs, unit in (
            ("𝕀", errors.rmse, paper[0], UNITS[quantity]),
            ("𝕄", errors.largest, paper[1], UNITS[quantity]),
            ("ℚ", errors.ratio, paper[2], "%"),
        ):
            why = (
                "One virtual rig against one real one: the result depends on the seed (the offline table has the range "
                "over seeds). Live and replayed estimates have the same bits, so online differs from offline only in "
                "the times of the steps and in the noise."
            )
            label = f"{quantity}, UKF, tuning {LIVE_TUNING}, live, {sign}"
            rows.append(Beside(label, Spread.of([ours]), theirs, unit, why))
    time_of_step = Spread(float(np.mean(step)), float(np.min(step)), float(np.max(step)), len(step))
    rows.append(
        Beside(
            "Processing time of a filter's step, mean (least … largest)",
            time_of_step,
            _PAPER_STEP_MS,
            "ms",
            "A compiled kernel on today's processor against one of 2012 and later; ours is timed over the recorded "
            "samples, one call from Python a sample. The largest are steps that the machine interrupted. The "
            "pipeline's times are below.",
        )
    )
    return tuple(rows)


def _table(run: Run, quantity: str) -> Table:
    rows = []
    for method, label in METHODS.items():
        errors, track = run.errors[method], run.tracks[method]
        more = consistency(track, run.recording)
        rows.append(
            (
                label + (", live" if method == LIVE_TUNING else ", replayed" if method != "model" else ""),
                number(errors.rmse),
                number(errors.largest),
                number(100.0 * errors.ratio),
                percent(errors.coverage),
                number(more["nis_mean"]),
            )
        )
    unit = UNITS[quantity]
    header = ("", f"𝕀 [{unit}]", f"𝕄 [{unit}]", "ℚ [%]", "in the 95 % interval", "mean NIS (2)")
    return Table(
        header, tuple(rows), f"{quantity.capitalize()}, joint {CONDITIONS[quantity]}, {len(run.recording)} samples"
    )


def _timing(runs: dict[str, Run]) -> Table:
    rows = []
    for quantity, run in runs.items():
        for what, values in (
            ("step of the filter", run.step_ms),
            ("last message of a sample → estimate, recorder's clock", run.pipeline_ms),
        ):
            cells = (
                np.mean(values),
                np.median(values),
                np.percentile(values, 99),
                np.max(values),
                np.mean(values > 1.0),
            )
            rows.append(
                (
                    f"joint {CONDITIONS[quantity]}: {what}",
                    *(number(float(value)) for value in cells[:4]),
                    percent(float(cells[4])),
                )
            )
    header = ("Time [ms]", "mean", "median", "99th percentile", "largest", "over 1 ms")
    return Table(header, tuple(rows), "Processing times; the machine may have been busy with other work")


def _findings(runs: dict[str, Run], short: bool) -> tuple[str, ...]:
    out = []
    for run, joint in zip(runs.values(), CONDITIONS.values(), strict=True):
        equal, compared = run.equal
        out.append(
            f"Joint {joint}: {equal} of {compared} live estimates are repeated bit by bit by a replay; samples lost: "
            + ", ".join(f"{name} {count}" for name, count in run.lost.items())
            + "."
        )
    if short:
        out.append(
            "Short runs: the extremes of the profile are not in them, so ℚ and 𝕄 are not those of the whole profile."
        )
    return tuple(out)


def _numbers(run: Run) -> dict[str, Any]:
    return {
        **{method: dataclasses.asdict(errors) for method, errors in run.errors.items()},
        "samples": len(run.recording),
        "bit_equal": run.equal[0],
        "compared": run.equal[1],
        "lost": run.lost,
        "step_ms": _statistics(run.step_ms),
        "pipeline_ms": _statistics(run.pipeline_ms),
    }


def _statistics(values: Floats) -> dict[str, float]:
    return {
        "mean": float(np.mean(values)),
        "median": float(np.median(values)),
        "p99": float(np.percentile(values, 99)),
        "max": float(np.max(values)),
    }


def _figures(runs: dict[str, Run], context: Context) -> tuple[Figure, ...]:
    out = []
    for quantity, run in runs.items():
        out.append(estimate_figure(quantity, run.recording, run.tracks, f"seed {context.work.seed}, live"))
    run = runs["angle"]
    stamps = run.recording.stamp_ns
    x = figures.seconds(stamps, int(stamps[0]))
    pipeline = np.full(len(stamps), np.nan)
    pipeline[: min(len(stamps), len(run.pipeline_ms))] = run.pipeline_ms[: len(stamps)]
    sample = Reference(1.0, "sample period")
    step = (Line("step", x, run.step_ms, ESTIMATE, quiet=True), sample, Reference(_PAPER_STEP_MS, "the paper's mean"))
    whole = (Line("pipeline", x, np.maximum(pipeline, 1e-3), MODEL, quiet=True), sample)
    of_step = Axis("Step of the filter [ms]", True, (1e-3, max(3.0, float(run.step_ms.max()) * 1.2)))
    of_whole = Axis("Messages → estimate [ms]", True, (1e-2, max(3.0, float(np.nanmax(pipeline)) * 1.2)))
    panels = (Panel(TIME, of_step, step, 200), Panel(TIME, of_whole, whole, 200))
    about = (
        "Above: each step of the filter by itself. Below: from the reception of a sample's last message to that of "
        "its estimate, with the transport there and back in it. Joint free."
    )
    out.append(Figure("Processing time per step", about, panels, "time"))
    return tuple(out)
