"""The figures of a replayed recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import metrics
from pam_antagonist.replay import Replay
from pam_antagonist.report import figures
from pam_antagonist.report.figures import Band, Clock, Level, Line, Panel, Part
from pam_antagonist.report.html import Figure
from pam_antagonist.report.style import BAND, EDGE, ESTIMATE, MEASURED, MODEL, QUIET, SECOND
from pam_antagonist.rig import Reading

FloatArray = NDArray[np.float64]

_LAGS = 40
"""Samples of lag that are shown."""
_REGIMES = ("inflow choked", "both choked", "outflow choked")
SUBSYSTEMS = tuple(
    f"{1 + 6 * first + 2 * second + slides}: muscle 1 {_REGIMES[first]}, muscle 2 {_REGIMES[second]}, "
    f"joint {'sliding' if slides else 'sticking'}"
    for first in range(3)
    for second in range(3)
    for slides in range(2)
)
"""Names of the subsystems σ = 1..18, in the model's order."""


def _tenth(replay: Replay) -> int:
    """Samples in 0.1 s."""
    return max(1, round(0.1 / replay.rig.sample_period))


def replay_figures(replay: Replay) -> tuple[Figure, ...]:
    """All figures of one recording, the most telling first."""
    clock = Clock.from_stamps(replay.run.stamp_ns, int(replay.recording.stamp_ns[0]), replay.rig.sample_period)
    link = replay.name
    out = []
    rows, variance = replay.run.rows, replay.run.rows["covariance"]
    if replay.joint.condition == "free":
        scale = np.degrees(1.0)
        out.append(
            _estimate_figure(
                "Joint angle",
                "Angle [°]",
                (rows["angle"] * scale, variance[:, 0, 0] * scale**2, replay.model.angle * scale),
                None if replay.measured_angle is None else replay.measured_angle * scale,
                replay.rig.sensors.reading("angle").scaled(scale),
                clock,
                link,
                _tenth(replay),
            )
        )
    out.append(
        _estimate_figure(
            "Joint torque",
            "Torque [N m]",
            (rows["torque"], variance[:, 2, 2], replay.model.torque),
            replay.measured_torque,
            replay.rig.sensors.reading("torque"),
            clock,
            link,
            _tenth(replay),
        )
    )
    outside = _outside(replay, clock, link)
    out += [*([outside] if outside else []), _pressures(replay, clock, link)]
    if not replay.rig.valves.sealed:
        out.append(_voltages(replay, clock, link))
    out.append(_nis(replay, clock, link))
    correlation = _correlation(replay, link)
    return (*out, *([correlation] if correlation else []), _subsystems(replay, clock, link))


def _estimate_figure(
    title: str,
    axis: str,
    estimate: tuple[FloatArray, FloatArray, FloatArray],
    measured: FloatArray | None,
    reference: Reading,
    clock: Clock,
    link: str,
    window: int,
) -> Figure:
    """Signal above, error below; estimate is value, variance and model alone, in the axis' unit."""
    value, variance, model = estimate
    half = metrics.interval_half_width(variance, reference)
    signal: list[Part] = [Band("95 % interval", value - half, value + half, BAND)]
    if measured is not None:
        signal.append(Line("measured", measured, MEASURED))
    signal += [Line("model alone", model, MODEL), Line("UKF", value, ESTIMATE)]
    panels = [Panel(axis, signal, 250)]
    if measured is None:
        about = "It was not measured, so the error is not known."
    else:
        errors: list[Part] = [
            Band("95 % interval", -half, half, BAND, quiet=True),
            *figures.with_mean("model alone", model - measured, MODEL, window),
            *figures.with_mean("UKF", value - measured, ESTIMATE, window),
            *(Line("95 % interval", sign * half, EDGE, dash="dot", width=1.0, quiet=True) for sign in (-1.0, 1.0)),
        ]
        panels.append(Panel(f"Error {axis[axis.index('[') :]}", errors, 190))
        about = (
            "Below: estimate minus measurement, every sample faint, the mean over 0.1 s in front. An honest filter "
            "stays within its shaded interval 95 % of the time."
        )
    return Figure(f"{title}: measured, estimated, and by the model alone", about, figures.stack(panels, clock), link)


def _outside(replay: Replay, clock: Clock, link: str) -> Figure | None:
    """The torque from outside, where the rig's filter estimates it."""
    estimate = replay.run.added.get("external_torque")
    if estimate is None:
        return None
    parts: list[Part] = []
    about = (
        "What the filter takes for a torque from outside, which it is not told. Where the joint sticks, friction hides "
        "it."
    )
    if replay.recording.external_torque is not None:
        parts.append(Line("applied", replay.recording.external_torque[replay.run.index], MEASURED))
    parts.append(Line("UKF", estimate, ESTIMATE))
    return Figure("Torque from outside", about, figures.stack([Panel("Torque [N m]", parts, 220)], clock), link)


def _pressures(replay: Replay, clock: Clock, link: str) -> Figure:
    measured, window = replay.measured_pressure * 1e-3, _tenth(replay)
    panels = [
        Panel("Pressure [kPa abs]", [Line("P1", measured[:, 0], MEASURED), Line("P2", measured[:, 1], SECOND)], 200)
    ]
    for muscle in (0, 1):
        model = replay.model.pressure[:, muscle] * 1e-3 - measured[:, muscle]
        ukf = replay.run.rows["pressure"][:, muscle] * 1e-3 - measured[:, muscle]
        faint_model, mean_model = figures.with_mean("model alone", model, MODEL, window)
        faint_ukf, mean_ukf = figures.with_mean("UKF", ukf, ESTIMATE, window)
        named = [replace(line, quiet=muscle > 0) for line in (mean_model, mean_ukf)]
        panels.append(Panel(f"P{muscle + 1} error [kPa]", [faint_model, faint_ukf, *named], 150))
    about = (
        "Above: the measured absolute pressures. Below: what the model alone and the filter make of them, minus the "
        "measurement. The filter is told the pressures, so its error is what it takes for sensor noise."
    )
    return Figure("Muscle pressures", about, figures.stack(panels, clock), link)


def _voltages(replay: Replay, clock: Clock, link: str) -> Figure:
    voltage = replay.recording.voltage[replay.run.index]
    parts = [Line("u1", voltage[:, 0], MEASURED), Line("u2", voltage[:, 1], SECOND)]
    return Figure(
        "Valve voltages", "What drove the joint.", figures.stack([Panel("Voltage [V]", parts, 180)], clock), link
    )


def _nis(replay: Replay, clock: Clock, link: str) -> Figure:
    nis = replay.run.rows["nis"]
    lower, upper = metrics.chi_square_bounds(2)
    window = max(1, round(1.0 / replay.rig.sample_period))
    parts: list[Part] = [
        Line("each sample", np.maximum(nis, 1e-3), "#c3c8ce", width=0.8),
        Line("mean over 1 s", figures.moving_mean(nis, window), ESTIMATE, width=2.0),
        Level(upper, "97.5 %", QUIET),
        Level(2.0, "expected mean: 2", MEASURED),
        Level(lower, "2.5 %", QUIET),
    ]
    about = (
        "Normalised innovation squared: below the lower bound the filter is too cautious about the pressures, above "
        "the upper one it is surprised by them. One sample in twenty may lie outside."
    )
    panel = Panel("NIS [-]", parts, 230, log=True, bounds=(1e-3, max(30.0, float(np.nanmax(nis, initial=0.0)) * 1.5)))
    return Figure("Does the filter believe what it should? (NIS)", about, figures.stack([panel], clock), link)


def _correlation(replay: Replay, link: str) -> Figure | None:
    rows = replay.run.rows
    series = metrics.normalised_innovation(rows["innovation"], rows["innovation_covariance"])
    present = int(np.isfinite(series).all(axis=1).sum())
    if present < 5 * _LAGS:
        return None
    gamma = metrics.autocorrelation(series, _LAGS)
    own = np.diagonal(gamma, axis1=1, axis2=2) / np.diagonal(gamma[0])
    lag = np.arange(1.0, _LAGS + 1.0) * (replay.rig.sample_period * 1e3)
    groups = [(f"P{muscle + 1}", own[1:, muscle], (MEASURED, SECOND)[muscle]) for muscle in (0, 1)]
    about = "Correlation of the innovation with itself some time later. A right model's stays between the dashed lines."
    plot = figures.bars(lag, groups, 1.96 / np.sqrt(present), "Lag [ms]", "Correlation [-]")
    return Figure("Is anything left in the pressures? (innovation autocorrelation)", about, plot, f"{link} lags")


def _subsystems(replay: Replay, clock: Clock, link: str) -> Figure:
    sigma = replay.run.rows["subsystem"].astype(np.int64) - 1
    about = (
        "The model switches between 18 sets of equations. Rows are those that were active, darker where more of the "
        "time was spent; point at one to read which flows are choked and whether the joint slides."
    )
    return Figure("Active subsystem of the model", about, figures.strip(SUBSYSTEMS, sigma, clock), link)
