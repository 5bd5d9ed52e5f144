"""The figures of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_antagonist.estimation import metrics
from pam_antagonist.identification.session import Identified
from pam_antagonist.identification.stages import Stage
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.report import figures
from pam_antagonist.report.figure import (
    TIME,
    Axis,
    Band,
    Figure,
    FloatArray,
    Heatmap,
    Line,
    Panel,
    Points,
    Region,
    Series,
)
from pam_antagonist.report.held_out import Judged
from pam_antagonist.report.identify_entries import ParameterEntry
from pam_antagonist.report.replay_figures import time
from pam_antagonist.report.style import BAND, ESTIMATE, FAINT, MEASURED, MODEL, PALETTE, PAPER, QUIET, SECOND
from pam_antagonist.rig import Reading

_CHANNELS = ((ANGLE, "Angle [°]", float(np.degrees(1.0))), (TORQUE, "Torque [N m]", 1.0),
             (PRESSURE_1, "P1 [kPa]", 1e-3), (PRESSURE_1 + 1, "P2 [kPa]", 1e-3))  # fmt: skip
"""Column, title and scale of each channel of a stage's residuals."""


def held_out_figures(judged: Judged, found: Identified, index: int) -> list[Figure]:
    """Measurement, estimates and errors of one recording with two rigs; the held-out part is shaded.

    Args:
        judged: the recording, replayed with the compared rigs.
        found: the identification.
        index: of the recording.
    """
    trial = found.trials[index]
    out = []
    scale = float(np.degrees(1.0))
    reading = found.tuned.rig.sensors.reading
    if trial.has(ANGLE):
        out.append(_held_out(judged, "angle", "Joint angle", "°", scale, 0, reading("angle")))
    if trial.has(TORQUE):
        out.append(_held_out(judged, "torque", "Joint torque", "N m", 1.0, 2, reading("torque")))
    out.append(_pressures(judged))
    return out


def _mean_error(x: FloatArray, name: str, error: FloatArray, color: str, period: float, quiet: bool = False) -> Line:
    """Mean of an error over 0.1 s."""
    return Line(name, x, figures.moving_mean(error, max(1, round(0.1 / period))), color, width=1.8, quiet=quiet)


def _held_out(judged: Judged, name: str, title: str, unit: str, scale: float, place: int, reading: Reading) -> Figure:
    before, now = judged.whole["as_configured"], judged.whole["identified"]
    recorded = now.measured_angle if name == "angle" else now.measured_torque
    assert recorded is not None
    measured, period, x = np.asarray(recorded * scale), now.recording.sample_period_s, time(now)
    half = metrics.interval_half_width(now.run.rows["covariance"][:, place, place] * scale**2, reading.scaled(scale))
    value = now.run.rows[name] * scale
    signal = (Line("measured", x, measured, MEASURED), Line("UKF, identified", x, value, ESTIMATE))
    alone: list[Series] = []
    filtered: list[Series] = [Band("95 % interval", x, -half, half, BAND)]
    for replay, label, color in ((before, "as configured", QUIET), (now, "identified", ESTIMATE)):
        at = time(replay)
        error = getattr(replay.model, name) * scale - measured
        alone.append(_mean_error(at, f"model, {label}", error, QUIET if replay is before else MODEL, period))
        error = replay.run.rows[name] * scale - measured
        # The panel above has the identified rig in the legend.
        line = _mean_error(at, f"UKF, {label}", error, color, period, quiet=replay is now)
        filtered.append(replace(line, dash="dot") if replay is before else line)
    shade = Region(judged.from_s, float(x[-1]))
    panels = (
        Panel(TIME, Axis(f"{name.capitalize()} [{unit}]"), (shade, *signal), 200),
        Panel(TIME, Axis(f"Model error [{unit}]"), (shade, *alone), 170),
        Panel(TIME, Axis(f"UKF error [{unit}]"), (shade, *filtered), 170),
    )
    about = (
        "Errors are estimate minus measurement, mean over 0.1 s. The shaded end was held out: it was used neither for "
        "the parameters nor for the tuning."
    )
    return Figure(f"{title}: before and after", about, panels, judged.name)


def _pressures(judged: Judged) -> Figure:
    shown = (
        ("as_configured", "as configured", QUIET),
        ("identified", "identified", MODEL),
        ("own", "own values", SECOND),
    )
    shade = Region(judged.from_s, float(time(judged.whole["identified"])[-1]))
    panels = []
    for muscle in (0, 1):
        parts: list[Series] = [shade]
        for key, label, color in shown:
            replay = judged.whole.get(key)
            if replay is not None:
                error = (replay.model.pressure[:, muscle] - replay.measured_pressure[:, muscle]) * 1e-3
                parts.append(
                    _mean_error(time(replay), label, error, color, replay.recording.sample_period_s, muscle > 0)
                )
        panels.append(Panel(TIME, Axis(f"P{muscle + 1} error [kPa]"), tuple(parts), 160))
    about = "Predicted minus measured pressure, mean over 0.1 s; the model sees voltages only."
    return Figure("Muscle pressures: before and after", about, tuple(panels), judged.name)


def stage_figure(stage: Stage, trials: Sequence[Trial]) -> Figure | None:
    """The figure of a step, None for a skipped step."""
    if stage.balance is not None:
        return _balance_figure(stage)
    known = [finding for finding in stage.curves if len(finding.voltage)]
    if known:
        parts: list[Series] = []
        for finding in known:
            color, name = (MODEL, ESTIMATE)[finding.valve], f"valve {finding.valve + 1}"
            parts.append(Line(f"{name}, declared", finding.voltage, finding.declared, color, "dot", width=1.6))
            measured = Points(f"{name}, measured", finding.voltage, finding.open_rate, color, size=4.0, opacity=0.6)
            parts.append(measured)
        panel = Panel(Axis("Voltage [V]"), Axis("Open rate α [-]"), tuple(parts), 202)
        about = "Points: the three steps of the paper."
        return Figure("Valve curve κ(u) from steady pressures", about, (panel,), stage.name)
    return _residual_figure(stage, trials) if stage.values and stage.traces else None


def _balance_figure(stage: Stage) -> Figure:
    balance = stage.balance
    assert balance is not None
    step = max(1, len(balance.time) // 1500)
    wanted = balance.wanted[::step]
    parts = tuple(
        Points(name, wanted, values[::step] - wanted, color, size=4.0, opacity=0.6)
        for name, values, color in (("before", balance.before, QUIET), ("after", balance.after, MODEL))
    )
    panel = Panel(Axis("Torque from the measurement [N m]"), Axis("Residual [N m]"), parts, 202)
    about = "Each point is a mean over 20 ms: the model's torque at measured pressures minus what was measured."
    return Figure(f"{stage.name.capitalize()}: residual torque", about, (panel,), stage.name)


def _residual_figure(stage: Stage, trials: Sequence[Trial]) -> Figure:
    """Residuals of the simulated model in block means, one recording after the other."""
    before, after = (
        np.concatenate([np.vstack([pair[k], np.full((1, 4), np.nan)]) for pair in stage.traces]) for k in (0, 1)
    )
    x = np.asarray(np.arange(len(before)) * trials[0].block_s, dtype=np.float64)
    wanted = _CHANNELS if stage.name == "joint refinement" else _CHANNELS[2:]
    shown = [item for item in wanted if np.isfinite(before[:, item[0]]).any()]
    columns = [channel for channel, _, _ in shown]
    models = [("before", before[:, columns], QUIET), ("after", after[:, columns], MODEL)]
    channels = [(title, scale) for _, title, scale in shown]
    title = f"{stage.name.capitalize()}: residuals"
    about = "Simulated minus measured, means over 20 samples, fitted parts of all recordings one after the other."
    return figures.residual_figure(title, about, x, models, channels, None, f"stage {stage.name}")


def parameters_figure(parameters: Sequence[ParameterEntry]) -> Figure:
    """Change of each parameter with its 95 % interval, and the prior's interval."""
    items = [item for item in parameters if item.start]
    scale = np.array([100.0 / abs(item.start) for item in items])
    change, prior, now = (
        scale * np.array(values, dtype=np.float64)
        for values in (
            [item.value - item.start for item in items],
            [1.96 * item.prior_std for item in items],
            [1.96 * item.std for item in items],
        )
    )
    rows = np.arange(len(items), dtype=np.float64)
    parts = (
        Points("before: prior, 95 %", 0.0 * rows, rows, FAINT, size=1.0, half_width=prior, bar_width=7.0),
        Points("identified, 95 %", change, rows, MODEL, half_width=now),
    )
    names = tuple(item.name for item in items)
    panel = Panel(Axis("Change from the configured value [%]"), Axis(labels=names), parts, 12 + 24 * len(items))
    about = "Where a blue bar is as wide as the grey one, the recordings do not determine that parameter."
    return Figure("Parameters with 95 % intervals", about, (panel,), "parameters")


def profiles_figure(found: Identified) -> Figure | None:
    """Profile likelihoods over standard errors; None without profiles."""
    if not found.profiles:
        return None
    x = np.linspace(-3.0, 3.0, len(found.profiles[0].value))
    fine = np.linspace(-3.0, 3.0, 61)
    tried = [
        Line(item.name, x, item.loss, PALETTE[k % (len(PALETTE) - 2)], width=1.6)
        for k, item in enumerate(found.profiles)
    ]
    panel = figures.profile_panel(
        "Parameter held away from its value [standard errors]",
        "Loss of log-likelihood [-]",
        tried,
        ("standard error alone", fine, 0.5 * fine**2, QUIET),
        1.92,
        262,
    )
    about = (
        "One parameter is held away from its best value and the others are fitted again. A profile below the dotted "
        "parabola means a wider interval than the standard error gives, a profile above it a narrower one."
    )
    return Figure("Profile likelihoods", about, (panel,), "profiles")


def correlation_figure(found: Identified) -> Figure:
    """Correlations of all parameters."""
    names = tuple(item.name for item in found.free)
    hover = "{column}\n{row}\n{value:.2f}"
    places = np.arange(len(names), dtype=np.float64)
    colors = (MODEL, PAPER, ESTIMATE)
    part = Heatmap(places, found.fit.correlation, names, colors, (-1.0, 1.0), hover, scale=True)
    panel = Panel(Axis(labels=names), Axis(labels=names), (part,), 62 + 22 * len(names))
    about = "±1: the recordings determine a combination of the two, not each by itself."
    return Figure("Correlations", about, (panel,), "correlations")
