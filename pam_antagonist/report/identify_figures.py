"""The figures of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pam_antagonist.estimation import metrics
from pam_antagonist.identification.result import Held
from pam_antagonist.report import figures
from pam_antagonist.report.figure import TIME, Axis, Band, Figure, FloatArray, Line, Panel, Points, Region, Series
from pam_antagonist.report.replay_figures import time
from pam_antagonist.report.style import BAND, ESTIMATE, FAINT, MEASURED, MODEL, QUIET, SECOND
from pam_antagonist.rig import Reading, Rig

if TYPE_CHECKING:
    from pam_antagonist.report.identify import ParameterEntry


def held_out_figures(held: Held, rig: Rig) -> list[Figure]:
    """Measurement, estimates and errors of one recording with two rigs; the held-out part is shaded."""
    replay, out, reading = held.whole, [], rig.sensors.reading
    if held.identified.joint.condition == "free" and _known(replay.measured_angle):
        out.append(_held_out(held, "angle", "Joint angle", "°", float(np.degrees(1.0)), 0, reading("angle")))
    if _known(replay.measured_torque):
        out.append(_held_out(held, "torque", "Joint torque", "N m", 1.0, 2, reading("torque")))
    out.append(_pressures(held))
    return out


def _known(measured: FloatArray | None) -> bool:
    return measured is not None and bool(np.isfinite(measured).any())


def _mean_error(x: FloatArray, name: str, error: FloatArray, color: str, period: float, quiet: bool = False) -> Line:
    """Mean of an error over 0.1 s."""
    return Line(name, x, figures.moving_mean(error, max(1, round(0.1 / period))), color, width=1.8, quiet=quiet)


def _held_out(held: Held, name: str, title: str, unit: str, scale: float, place: int, reading: Reading) -> Figure:
    before, now = held.replays["as_configured"], held.whole
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
    shade = Region(held.from_s, float(x[-1]))
    panels = (
        Panel(TIME, Axis(f"{name.capitalize()} [{unit}]"), (shade, *signal), 200),
        Panel(TIME, Axis(f"Model error [{unit}]"), (shade, *alone), 170),
        Panel(TIME, Axis(f"UKF error [{unit}]"), (shade, *filtered), 170),
    )
    about = (
        "Errors are estimate minus measurement, mean over 0.1 s. The shaded end was held out: it was used neither for "
        "the parameters nor for the tuning."
    )
    return Figure(f"{title}: before and after", about, panels, held.name)


def _pressures(held: Held) -> Figure:
    shown = (
        ("as_configured", "as configured", QUIET),
        ("identified", "identified", MODEL),
        ("own", "own values", SECOND),
    )
    shade = Region(held.from_s, float(time(held.whole)[-1]))
    panels = []
    for muscle in (0, 1):
        parts: list[Series] = [shade]
        for key, label, color in shown:
            replay = held.replays.get(key)
            if replay is not None:
                error = (replay.model.pressure[:, muscle] - replay.measured_pressure[:, muscle]) * 1e-3
                parts.append(
                    _mean_error(time(replay), label, error, color, replay.recording.sample_period_s, muscle > 0)
                )
        panels.append(Panel(TIME, Axis(f"P{muscle + 1} error [kPa]"), tuple(parts), 160))
    about = "Predicted minus measured pressure, mean over 0.1 s; the model sees voltages only."
    return Figure("Muscle pressures: before and after", about, tuple(panels), held.name)


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
