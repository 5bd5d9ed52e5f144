"""The figures of an identification."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import metrics
from pam_antagonist.identification.prediction import BLOCK
from pam_antagonist.identification.session import Identified
from pam_antagonist.identification.stages import Stage
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.replay import Replay
from pam_antagonist.report import figures
from pam_antagonist.report.figures import Band, Clock, Line, Panel, Part
from pam_antagonist.report.held_out import Judged
from pam_antagonist.report.html import Figure
from pam_antagonist.report.identify import ParameterEntry
from pam_antagonist.report.style import BAND, ESTIMATE, MEASURED, MODEL, QUIET, SECOND
from pam_antagonist.rig import Reading

FloatArray = NDArray[np.float64]

_PALETTE = (MODEL, ESTIMATE, SECOND, "#cc79a7", "#e69f00", "#56b4e9")
"""Okabe and Ito's colours."""


def held_out_figures(judged: Judged, found: Identified, index: int) -> list[Figure]:
    """What one recording measured and what the two rigs make of it, with the part shaded that was held out."""
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


def _clock(replay: Replay) -> Clock:
    return Clock.from_stamps(replay.run.stamp_ns, int(replay.recording.stamp_ns[0]), replay.rig.sample_period)


def _held_out(judged: Judged, name: str, title: str, unit: str, scale: float, place: int, reading: Reading) -> Figure:
    before, now = judged.whole["as_configured"], judged.whole["identified"]
    recorded = now.measured_angle if name == "angle" else now.measured_torque
    assert recorded is not None
    measured = np.asarray(recorded * scale)
    window = max(1, round(0.1 / now.rig.sample_period))
    half = metrics.interval_half_width(now.run.rows["covariance"][:, place, place] * scale**2, reading.scaled(scale))
    value = now.run.rows[name] * scale
    signal: list[Part] = [Line("measured", measured, MEASURED), Line("UKF, identified", value, ESTIMATE)]
    alone: list[Part] = []
    for replay, label, color in ((before, "as configured", QUIET), (now, "identified", MODEL)):
        error = getattr(replay.model, name) * scale - measured
        alone.append(Line(f"model, {label}", figures.moving_mean(error, window), color, width=1.8))
    filtered: list[Part] = [Band("95 % interval", -half, half, BAND)]
    for replay, label, color in ((before, "as configured", QUIET), (now, "identified", ESTIMATE)):
        error = replay.run.rows[name] * scale - measured
        filtered.append(
            Line(
                f"UKF, {label}",
                figures.moving_mean(error, window),
                color,
                quiet=replay is now,  # the signal above has it in the legend
                dash="dot" if color == QUIET else "",
                width=1.8,
            )
        )
    panels = [
        Panel(f"{name.capitalize()} [{unit}]", signal, 200),
        Panel(f"Model error [{unit}]", alone, 170),
        Panel(f"UKF error [{unit}]", filtered, 170),
    ]
    about = (
        "Errors are estimate minus measurement, mean over 0.1 s. The shaded end was held out: neither parameters nor "
        "tuning have seen it."
    )
    return Figure(f"{title}: before and after", about, _shaded(panels, now, judged), judged.name)


def _pressures(judged: Judged) -> Figure:
    panels = []
    for muscle in (0, 1):
        parts: list[Part] = []
        for key, label, color in (
            ("as_configured", "as configured", QUIET),
            ("identified", "identified", MODEL),
            ("own", "own values", SECOND),
        ):
            replay = judged.whole.get(key)
            if replay is None:
                continue
            error = (replay.model.pressure[:, muscle] - replay.measured_pressure[:, muscle]) * 1e-3
            window = max(1, round(0.1 / replay.rig.sample_period))
            smooth = figures.moving_mean(error, window)
            parts.append(Line(label, smooth, color, width=1.5, quiet=muscle > 0))
        panels.append(Panel(f"P{muscle + 1} error [kPa]", parts, 160))
    about = "Predicted minus measured pressure, mean over 0.1 s; the model sees voltages only."
    replay = judged.whole["identified"]
    return Figure("Muscle pressures: before and after", about, _shaded(panels, replay, judged), judged.name)


def _shaded(panels: Sequence[Panel], replay: Replay, judged: Judged) -> dict[str, Any]:
    clock = _clock(replay)
    plot = figures.stack(panels, clock)
    for number in range(len(panels)):
        suffix = str(number + 1) if number else ""
        plot["layout"]["shapes"].append(
            {
                "type": "rect",
                "xref": "x" + suffix,
                "yref": f"y{suffix} domain",
                "x0": judged.from_s,
                "x1": float(clock.seconds[-1]),
                "y0": 0,
                "y1": 1,
                "fillcolor": "rgba(11, 92, 138, 0.07)",
                "line": {"width": 0},
                "layer": "below",
            }
        )
    return plot


def _xy(
    title_x: str, title_y: str, lines: Sequence[tuple[str, FloatArray, FloatArray, str, str]], height: int = 280
) -> dict[str, Any]:
    """Curves (``lines``), points (``markers``) or dashed curves (``dash``) over a common axis."""
    layout = figures.base_layout(height)
    layout["hovermode"] = "closest"
    layout["xaxis"] = figures.axis(title={"text": title_x, "standoff": 6}, zeroline=False)
    layout["yaxis"] = figures.axis(title={"text": title_y, "standoff": 4})
    data = []
    for name, x, y, color, kind in lines:
        trace: dict[str, Any] = {
            "type": "scatter",
            "mode": "markers" if kind == "markers" else "lines",
            "name": name,
            "x": [float(v) for v in np.round(x, 6)],
            "y": [float(f"{v:.5g}") if np.isfinite(v) else None for v in y],
        }
        if kind == "markers":
            trace["marker"] = {"color": color, "size": 4, "opacity": 0.6}
        else:
            trace["line"] = {"color": color, "width": 1.6, **({"dash": "dot"} if kind == "dash" else {})}
        data.append(trace)
    return {"data": data, "layout": layout}


def stage_figure(stage: Stage, trials: Sequence[Trial]) -> Figure | None:
    """The one figure of a step, None where it was skipped."""
    if stage.balance is not None:
        return _balance_figure(stage)
    known = [finding for finding in stage.curves if len(finding.voltage)]
    if known:
        lines = []
        for finding in known:
            color = (MODEL, ESTIMATE)[finding.valve]
            lines.append((f"valve {finding.valve + 1}, declared", finding.voltage, finding.declared, color, "dash"))
            lines.append((f"valve {finding.valve + 1}, measured", finding.voltage, finding.open_rate, color, "markers"))
        plot = _xy("Voltage [V]", "Open rate α [-]", lines)
        return Figure(
            "Valve curve κ(u) from steady pressures", "Points: the three steps of the paper.", plot, stage.name
        )
    if stage.values and stage.traces:
        return _residual_figure(stage, trials)
    return None


def _balance_figure(stage: Stage) -> Figure:
    balance = stage.balance
    assert balance is not None
    step = max(1, len(balance.time) // 1500)
    wanted = balance.wanted[::step]
    plot = _xy(
        "Torque from the measurement [N m]",
        "Residual [N m]",
        [
            ("before", wanted, balance.before[::step] - wanted, QUIET, "markers"),
            ("after", wanted, balance.after[::step] - wanted, MODEL, "markers"),
        ],
    )
    about = "Each point is a mean over 20 samples: the model's torque at measured pressures minus what was measured."
    return Figure(f"{stage.name.capitalize()}: what is left of the torque", about, plot, stage.name)


def _residual_figure(stage: Stage, trials: Sequence[Trial]) -> Figure:
    """Block residuals of the simulated model, recordings one after the other."""
    dt = BLOCK * trials[0].dt
    before = np.concatenate([np.vstack([pair[0], np.full((1, 4), np.nan)]) for pair in stage.traces])
    after = np.concatenate([np.vstack([pair[1], np.full((1, 4), np.nan)]) for pair in stage.traces])
    count = len(before)
    clock = Clock(np.asarray(np.arange(count) * dt, dtype=np.float64), np.zeros(count, dtype=np.int64))
    rows = [
        (ANGLE, "Angle [°]", float(np.degrees(1.0))),
        (TORQUE, "Torque [N m]", 1.0),
        (PRESSURE_1, "P1 [kPa]", 1e-3),
        (PRESSURE_1 + 1, "P2 [kPa]", 1e-3),
    ]
    wanted = rows if stage.name == "joint refinement" else rows[2:]
    panels: list[Panel] = []
    for channel, title, scale in wanted:
        if not np.isfinite(before[:, channel]).any():
            continue
        parts: list[Part] = [
            Line("before", before[:, channel] * scale, QUIET, width=1.2, quiet=bool(panels)),
            Line("after", after[:, channel] * scale, MODEL, width=1.4, quiet=bool(panels)),
        ]
        panels.append(Panel(title, parts, 130))
    about = "Simulated minus measured, means over 20 samples, fitted parts of all recordings one after the other."
    return Figure(f"{stage.name.capitalize()}: residuals", about, figures.stack(panels, clock), f"stage {stage.name}")


def parameters_figure(parameters: Sequence[ParameterEntry]) -> Figure:
    """Change of each parameter with its 95 % interval, over the prior's."""
    items = [item for item in parameters if item.start][::-1]
    names = [item.name for item in items]
    scale = [100.0 / abs(item.start) for item in items]

    def bars(name: str, middle: list[float], half: list[float], color: str, width: float, size: int) -> dict[str, Any]:
        return {
            "type": "scatter",
            "mode": "markers",
            "name": name,
            "x": middle,
            "y": names,
            "marker": {"color": color, "size": size},
            "error_x": {"type": "data", "array": half, "color": color, "thickness": width, "width": 0},
        }

    zero = [0.0] * len(items)
    changes = [(item.value - item.start) * s for item, s in zip(items, scale, strict=True)]
    prior = [1.96 * item.prior_std * s for item, s in zip(items, scale, strict=True)]
    now = [1.96 * item.std * s for item, s in zip(items, scale, strict=True)]
    layout = figures.base_layout(90 + 24 * len(items))
    layout["hovermode"] = "closest"
    layout["margin"] = {**layout["margin"], "l": 66}
    layout["xaxis"] = figures.axis(title={"text": "Change from the configured value [%]", "standoff": 6})
    layout["yaxis"] = {**figures.axis(type="category"), "automargin": True, "tickfont": {"size": 10}}
    data = [
        bars("before: prior, 95 %", zero, prior, "#d5d9de", 7, 1),
        bars("identified, 95 %", changes, now, MODEL, 2, 6),
    ]
    about = "Where a blue bar is as wide as the grey one, the recordings told nothing of that parameter."
    return Figure("Parameters and what is known of them", about, {"data": data, "layout": layout}, "parameters")


def profiles_figure(found: Identified) -> Figure | None:
    """Profile likelihoods, all on one scale of standard errors; None where there are none."""
    if not found.profiles:
        return None
    lines = []
    x = np.linspace(-3.0, 3.0, len(found.profiles[0].value))
    for k, item in enumerate(found.profiles):
        lines.append((item.name, x, item.loss, _PALETTE[k % len(_PALETTE)], "lines"))
    fine = np.linspace(-3.0, 3.0, 61)
    lines.append(("standard error alone", fine, 0.5 * fine**2, QUIET, "dash"))
    lines.append(("95 %", np.array([-3.0, 3.0]), np.array([1.92, 1.92]), QUIET, "dash"))
    plot = _xy("Parameter held away from its value [standard errors]", "Loss of log-likelihood [-]", lines, 340)
    about = (
        "How much worse the best fit gets while one parameter is held elsewhere and the others are fitted anew. Below "
        "the dashed parabola the data say less than the standard error claims, above it more."
    )
    return Figure("Profile likelihoods", about, plot, "profiles")


def correlation_figure(found: Identified) -> Figure:
    """Correlations of all parameters."""
    names = [item.name for item in found.free]
    layout = figures.base_layout(140 + 22 * len(names))
    layout["hovermode"] = "closest"
    layout["xaxis"] = {**figures.axis(type="category"), "automargin": True, "tickfont": {"size": 9}, "tickangle": -60}
    layout["yaxis"] = {
        **figures.axis(type="category", autorange="reversed"),
        "automargin": True,
        "tickfont": {"size": 9},
    }
    trace = {
        "type": "heatmap",
        "x": names,
        "y": names,
        "z": [[float(v) for v in row] for row in np.round(found.fit.correlation, 3)],
        "zmin": -1.0,
        "zmax": 1.0,
        "colorscale": [[0.0, "#0072b2"], [0.5, "#ffffff"], [1.0, "#d55e00"]],
        "hovertemplate": "%{x}<br>%{y}<br>%{z:.2f}<extra></extra>",
        "colorbar": {"thickness": 10, "len": 0.6},
    }
    about = "±1: the recordings tell a combination of the two, not each by itself."
    return Figure("Correlations", about, {"data": [trace], "layout": layout}, "correlations")
