"""The figures of a replayed recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pam_antagonist.estimation import metrics
from pam_antagonist.replays import Replay
from pam_antagonist.report import figures
from pam_antagonist.report.figure import TIME, Axis, Band, Figure, FloatArray, Line, Panel, Region, Series
from pam_antagonist.report.style import BAND, EDGE, ESTIMATE, MEASURED, MODEL, SECOND
from pam_antagonist.rig import Reading

_LAGS = 40
"""Largest lag that is shown [samples]."""
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
    return max(1, round(0.1 / replay.recording.sample_period_s))


def replay_figures(replay: Replay, held_from: float | None = None) -> tuple[Figure, ...]:
    """Figures of a recording and its estimate, the most important one first.

    `held_from`: begin of the held-out part [s], which is shaded; None: nothing was fitted.
    """
    x = time(replay)
    link = replay.name
    window = _tenth(replay)
    rows, variance, reading = replay.run.rows, replay.run.rows["covariance"], replay.rig.sensors.reading
    out: list[Figure | None] = []
    if replay.joint.condition == "free":
        scale = float(np.degrees(1.0))
        estimate = (rows["angle"] * scale, variance[:, 0, 0] * scale**2, replay.model.angle * scale)
        measured = None if replay.measured_angle is None else replay.measured_angle * scale
        names = ("Joint angle", "Angle", "°")
        out.append(_estimate_figure(names, x, estimate, measured, reading("angle").scaled(scale), window, link))
    names = ("Joint torque", "Torque", "N m")
    estimate = (rows["torque"], variance[:, 2, 2], replay.model.torque)
    out.append(_estimate_figure(names, x, estimate, replay.measured_torque, reading("torque"), window, link))
    out += [_disturbance(replay, x, link), _pressures(replay, x, link)]
    known = (figure for figure in out if figure is not None)
    return tuple(known if held_from is None else (_shaded(figure, held_from, float(x[-1])) for figure in known))


def filter_figures(replay: Replay) -> tuple[Figure, ...]:
    """Figures of the filter: input, innovations and active equations."""
    x, link, rows = time(replay), replay.name, replay.run.rows
    window = max(1, round(1.0 / replay.recording.sample_period_s))
    nis = figures.nis_figure(x, rows["nis"], metrics.chi_square_bounds(2), window, link)
    voltages = None if replay.rig.valves.sealed else _voltages(replay, x, link)
    found = (nis, _correlation(replay, link), voltages, _subsystems(replay, x, link))
    return tuple(figure for figure in found if figure is not None)


def _shaded(figure: Figure, begin: float, end: float) -> Figure:
    """The figure with a range of time shaded in every panel."""
    panels = (replace(panel, series=(Region(begin, end), *panel.series)) for panel in figure.panels)
    return replace(figure, about=f"{figure.about} The shaded end was held out.", panels=tuple(panels))


def time(replay: Replay) -> FloatArray:
    """Time of a replay's samples since the recording's first one, (N,) [s]."""
    return figures.seconds(replay.run.stamp_ns, int(replay.recording.stamp_ns[0]))


def _estimate_figure(
    names: tuple[str, str, str],
    x: FloatArray,
    estimate: tuple[FloatArray, FloatArray, FloatArray],
    measured: FloatArray | None,
    reference: Reading,
    window: int,
    link: str,
) -> Figure:
    """Signal above, error below; `estimate` holds value, variance and model alone, in the axis' unit."""
    title, quantity, unit = names
    value, variance, model = estimate
    half = metrics.interval_half_width(variance, reference)
    signal: list[Series] = [Band("95 % interval", x, value - half, value + half, BAND)]
    if measured is not None:
        signal.append(Line("measured", x, measured, MEASURED))
    signal += [Line("model alone", x, model, MODEL), Line("UKF", x, value, ESTIMATE)]
    panels = [Panel(TIME, Axis(f"{quantity} [{unit}]"), tuple(signal), 250)]
    if measured is None:
        about = "There was no sensor for it, so its error is not known."
    else:
        errors: tuple[Series, ...] = (
            Band("95 % interval", x, -half, half, BAND, quiet=True),
            *figures.with_mean("model alone", x, model - measured, MODEL, window),
            *figures.with_mean("UKF", x, value - measured, ESTIMATE, window),
            *(Line("95 % interval", x, sign * half, EDGE, "dot", width=1.0, quiet=True) for sign in (-1.0, 1.0)),
        )
        panels.append(Panel(TIME, Axis(f"Error [{unit}]"), errors, 190))
        about = (
            "Below: estimate minus measurement. Single samples are faint, the mean over 0.1 s is in front. The error "
            "of a right filter lies in the shaded interval 95 % of the time."
        )
    return Figure(f"{title}: measured, estimated, and by the model alone", about, tuple(panels), link)


def _disturbance(replay: Replay, x: FloatArray, link: str) -> Figure | None:
    """The disturbance torque, where the rig's filter estimates it."""
    estimate = replay.run.added.get("external_torque")
    if estimate is None:
        return None
    applied = replay.recording.external_torque
    parts = [] if applied is None else [Line("applied", x, applied[replay.run.index], MEASURED)]
    parts.append(Line("UKF", x, estimate, ESTIMATE))
    about = "The filter estimates the disturbance torque from the pressures. Where the joint sticks, friction hides it."
    return Figure("Disturbance torque", about, (Panel(TIME, Axis("Torque [N m]"), tuple(parts), 220),), link)


def _pressures(replay: Replay, x: FloatArray, link: str) -> Figure:
    measured, window = replay.measured_pressure * 1e-3, _tenth(replay)
    both = (Line("P1", x, measured[:, 0], MEASURED), Line("P2", x, measured[:, 1], SECOND))
    panels = [Panel(TIME, Axis("Pressure [kPa abs]"), both, 200)]
    for muscle in (0, 1):
        model = replay.model.pressure[:, muscle] * 1e-3 - measured[:, muscle]
        ukf = replay.run.rows["pressure"][:, muscle] * 1e-3 - measured[:, muscle]
        faint_model, mean_model = figures.with_mean("model alone", x, model, MODEL, window)
        faint_ukf, mean_ukf = figures.with_mean("UKF", x, ukf, ESTIMATE, window)
        named = [replace(line, quiet=muscle > 0) for line in (mean_model, mean_ukf)]
        panels.append(Panel(TIME, Axis(f"P{muscle + 1} error [kPa]"), (faint_model, faint_ukf, *named), 150))
    about = (
        "Above: the measured absolute pressures. Below: the pressures of the model alone and of the filter, minus the "
        "measurement. The filter gets the measured pressures, so its error is what it counts as sensor noise."
    )
    return Figure("Muscle pressures", about, tuple(panels), link)


def _voltages(replay: Replay, x: FloatArray, link: str) -> Figure:
    voltage = replay.recording.voltage[replay.run.index]
    regulated = replay.rig.drive == "regulator"
    first, second = voltage.T * 1e-3 if regulated else voltage.T
    parts = (Line("u1", x, first, MEASURED), Line("u2", x, second, SECOND))
    if regulated:
        panel = Panel(TIME, Axis("Pressure asked for [kPa abs]"), parts, 180)
        return Figure("Commanded pressures", "What the two regulators were asked for.", (panel,), link)
    return Figure(
        "Valve voltages", "Measured voltages on the two valves.", (Panel(TIME, Axis("Voltage [V]"), parts, 180),), link
    )


def _correlation(replay: Replay, link: str) -> Figure | None:
    rows = replay.run.rows
    series = metrics.normalised_innovation(rows["innovation"], rows["innovation_covariance"])
    present = int(np.isfinite(series).all(axis=1).sum())
    if present < 5 * _LAGS:
        return None
    gamma = metrics.autocorrelation(series, _LAGS)
    own = np.diagonal(gamma, axis1=1, axis2=2) / np.diagonal(gamma[0])
    lag = np.arange(1.0, _LAGS + 1.0) * (replay.recording.sample_period_s * 1e3)
    groups = [(f"P{muscle + 1}", own[1:, muscle], (MEASURED, SECOND)[muscle]) for muscle in (0, 1)]
    about = "Correlation of each innovation with itself at a lag. White innovations stay between the dashed lines."
    panel = figures.autocorrelation(lag, groups, float(1.96 / np.sqrt(present)))
    return Figure("Innovation autocorrelation", about, (panel,), f"{link} lags")


def _subsystems(replay: Replay, x: FloatArray, link: str) -> Figure:
    sigma = replay.run.rows["subsystem"].astype(np.int64) - 1
    about = (
        "The model switches between 18 sets of equations. Rows are those that were active, darker where more of the "
        "time was spent; point at one to read which flows are choked and whether the joint slides."
    )
    return Figure("Active subsystem of the model", about, (figures.strip(SUBSYSTEMS, sigma, x),), link)
