"""The figures of a recording that was replayed: with one rig, or before and after an identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import metrics
from pam_antagonist.replays import Replay
from pam_antagonist.report.figure import (
    BAND,
    EDGE,
    ESTIMATE,
    FAINT,
    MEASURED,
    MODEL,
    QUIET,
    SECOND,
    TIME,
    Axis,
    Band,
    Bars,
    Figure,
    FloatArray,
    Heatmap,
    Line,
    Panel,
    Reference,
    Region,
    Series,
)

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


def seconds(stamp_ns: NDArray[np.int64], origin_ns: int) -> FloatArray:
    """Time of samples (N,) since an origin [s], from stamps [ns]."""
    return np.asarray((stamp_ns - origin_ns) * 1e-9, dtype=np.float64)


def moving_mean(values: FloatArray, window: int) -> FloatArray:
    """Centred mean of the finite values in `window` samples (N,); NaN without finite values."""
    known = np.isfinite(values)
    total = np.concatenate(([0.0], np.cumsum(np.where(known, values, 0.0))))
    count = np.concatenate(([0], np.cumsum(known)))
    low = np.maximum(np.arange(len(values)) - window // 2, 0)
    high = np.minimum(low + window, len(values))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((total[high] - total[low]) / (count[high] - count[low]))


def with_mean(name: str, x: FloatArray, values: FloatArray, color: str, window: int) -> tuple[Line, Line]:
    """Single samples as a faint line, and in front their moving mean, which reduces the sensor's noise."""
    faint = Line(name, x, values, color, width=0.8, quiet=True, opacity=0.3)
    return faint, Line(name, x, moving_mean(values, window), color, width=1.8, quiet=True)


def shares(category: NDArray[np.int64], categories: int, columns: int) -> tuple[NDArray[np.int64], FloatArray]:
    """Share of each stretch of time that is spent in each category.

    `category`: (N,) values 0..categories - 1. Returns index of each stretch's middle sample (C,), and the shares
    (categories, C), each column adding up to 1.
    """
    width = max(1, -(-len(category) // columns))
    stretch = np.arange(len(category)) // width
    table = np.zeros((categories, -(-len(category) // width)))
    np.add.at(table, (category, stretch), 1.0)
    middle = np.minimum(np.arange(table.shape[1]) * width + width // 2, max(len(category) - 1, 0))
    return middle, table / np.maximum(table.sum(axis=0), 1.0)


def strip(names: Sequence[str], category: NDArray[np.int64], x: FloatArray, columns: int = 400) -> Panel:
    """Active category over time: one row for each category, darker where it is active for more of the time.

    `names`: of the categories, with a short name before a colon; a category that never occurs has no row. `category`:
    (N,) indices into `names`.
    """
    middle, share = shares(category, len(names), columns)
    seen = [int(number) for number in np.flatnonzero(share.sum(axis=1) > 0.0)]
    cells = np.where(share[seen] > 0.0, share[seen], np.nan)
    rows = tuple(names[number] for number in seen)
    short = tuple(name.split(":")[0] for name in rows)
    y = Axis("Subsystem σ [-]", labels=short, bounds=(-0.5, len(seen) - 0.5))
    return Panel(TIME, y, (Heatmap(x[middle], cells, rows),), max(66, 26 * len(seen) + 36))


def time(replay: Replay) -> FloatArray:
    """Time of a replay's samples since the recording's first one, (N,) [s]."""
    return seconds(replay.run.stamp_ns, int(replay.recording.stamp_ns[0]))


def _samples(replay: Replay, seconds: float) -> int:
    return max(1, round(seconds / replay.recording.sample_period_s))


def replay_figures(replay: Replay, held_from: float | None = None, before: Replay | None = None) -> tuple[Figure, ...]:
    """Figures of a recording and its estimate, the most important one first.

    `held_from`: begin of the held-out part [s], which is shaded; None: nothing was fitted. `before`: the recording with
    the rig as configured, whose errors are drawn as well.
    """
    x = time(replay)
    out = [_estimate(replay, before, x, "angle")] if replay.joint.condition == "free" else []
    out += [_estimate(replay, before, x, "torque"), *_disturbance(replay, x), _pressures(replay, before, x)]
    if held_from is None:
        return tuple(out)
    shade = Region(held_from, float(x[-1]))
    return tuple(
        replace(
            figure, about=f"{figure.about} The shaded end was held out.",
            panels=tuple(replace(panel, series=(shade, *panel.series)) for panel in figure.panels),
        )
        for figure in out
    )  # fmt: skip


def filter_figures(replay: Replay) -> tuple[Figure, ...]:
    """Figures of the filter: innovations, input and active equations."""
    x = time(replay)
    commands = () if replay.rig.valves.sealed else (_commands(replay, x),)
    return _nis(replay, x), *_correlation(replay), *commands, _subsystems(replay, x)


def _estimate(replay: Replay, before: Replay | None, x: FloatArray, name: str) -> Figure:
    """Angle or torque: the signal above, the errors below."""
    is_angle, window = name == "angle", _samples(replay, 0.1)
    unit, scale, place = ("°", float(np.degrees(1.0)), 0) if is_angle else ("N m", 1.0, 2)

    def measured(one: Replay) -> FloatArray | None:
        values = one.measured_angle if is_angle else one.measured_torque
        return None if values is None else values * scale

    variance = replay.run.rows["covariance"][:, place, place] * scale**2
    half = metrics.interval_half_width(variance, replay.rig.sensors.reading(name).scaled(scale))
    value, model, wanted = replay.run.rows[name] * scale, getattr(replay.model, name) * scale, measured(replay)
    known = [] if wanted is None else [Line("measured", x, wanted, MEASURED)]
    signal: list[Series] = [Band("95 % interval", x, value - half, value + half, BAND), *known]
    signal += [Line("model alone", x, model, MODEL), Line("UKF", x, value, ESTIMATE)]
    panels = [Panel(TIME, Axis(f"{name.capitalize()} [{unit}]"), tuple(signal), 250)]
    title = f"Joint {name}: measured, estimated, and by the model alone"
    if wanted is None:
        about = "There was no sensor for it, so its error is not known."
        return Figure(title, about, tuple(panels), replay.name)
    shade = Band("95 % interval", x, -half, half, BAND, quiet=True)
    edges = [Line("95 % interval", x, sign * half, EDGE, "dot", width=1.0, quiet=True) for sign in (-1.0, 1.0)]
    of_model = with_mean("model alone", x, model - wanted, MODEL, window)
    of_filter = with_mean("UKF", x, value - wanted, ESTIMATE, window)
    inside = "The error of a right filter lies in the shaded interval 95 % of the time."
    old = None if before is None else measured(before)
    if before is None or old is None:
        panels.append(Panel(TIME, Axis(f"Error [{unit}]"), (shade, *of_model, *of_filter, *edges), 190))
        about = (
            f"Below: estimate minus measurement. Single samples are faint, the mean over 0.1 s is in front. {inside}"
        )
        return Figure(title, about, tuple(panels), replay.name)
    compared: tuple[tuple[str, Line, FloatArray, tuple[Series, ...]], ...] = (
        ("UKF", of_filter[1], before.run.rows[name], (shade, *edges)),
        ("Model", of_model[1], getattr(before.model, name), ()),
    )
    for what, now, then, behind in compared:
        mean = moving_mean(then * scale - old, window)
        dotted = Line("as configured", time(before), mean, QUIET, "dot", 1.6, quiet=what != "UKF")
        panels.append(Panel(TIME, Axis(f"{what} error [{unit}]"), (*behind, dotted, now), 170))
    about = f"Below: estimate minus measurement, mean over 0.1 s; dotted: with the rig as configured. {inside}"
    return Figure(title, about, tuple(panels), replay.name)


def _disturbance(replay: Replay, x: FloatArray) -> list[Figure]:
    """The disturbance torque, where the rig's filter estimates it."""
    estimate, applied = replay.run.added.get("external_torque"), replay.recording.external_torque
    if estimate is None:
        return []
    parts = [] if applied is None else [Line("applied", x, applied[replay.run.index], MEASURED)]
    # The noise of the estimate would hide what was applied.
    panel = Panel(TIME, Axis("Torque [N m]"), (Line("UKF", x, estimate, ESTIMATE), *parts), 220)
    about = "The filter estimates the disturbance torque from the pressures. Where the joint sticks, friction hides it."
    return [Figure("Disturbance torque", about, (panel,), replay.name)]


def _pressures(replay: Replay, before: Replay | None, x: FloatArray) -> Figure:
    measured, window = replay.measured_pressure * 1e-3, _samples(replay, 0.1)
    both = (Line("P1", x, measured[:, 0], MEASURED), Line("P2", x, measured[:, 1], SECOND))
    panels = [Panel(TIME, Axis("Pressure [kPa abs]"), both, 200)]
    for muscle in (0, 1):
        model = replay.model.pressure[:, muscle] * 1e-3 - measured[:, muscle]
        ukf = replay.run.rows["pressure"][:, muscle] * 1e-3 - measured[:, muscle]
        faint_model, mean_model = with_mean("model alone", x, model, MODEL, window)
        faint_ukf, mean_ukf = with_mean("UKF", x, ukf, ESTIMATE, window)
        shown = [faint_model, faint_ukf, mean_model, mean_ukf]
        if before is not None:
            error = (before.model.pressure - before.measured_pressure)[:, muscle] * 1e-3
            mean = moving_mean(error, window)
            shown = [Line("model, as configured", time(before), mean, QUIET, "dot", 1.6), mean_model, mean_ukf]
        lines = (replace(line, quiet=muscle > 0 or line.opacity < 1.0) for line in shown)
        panels.append(Panel(TIME, Axis(f"P{muscle + 1} error [kPa]"), tuple(lines), 150))
    about = (
        "Above: the measured absolute pressures. Below: the pressures of the model alone and of the filter, minus the "
        "measurement. The filter gets the measured pressures, so its error is what it counts as sensor noise."
    )
    return Figure("Muscle pressures", about, tuple(panels), replay.name)


def _commands(replay: Replay, x: FloatArray) -> Figure:
    regulated = replay.rig.drive == "regulator"
    first, second = replay.recording.voltage[replay.run.index].T * (1e-3 if regulated else 1.0)
    title, axis, about = (
        ("Commanded pressures", "Pressure asked for [kPa abs]", "What the two regulators were asked for.") if regulated
        else ("Valve voltages", "Voltage [V]", "Measured voltages on the two valves.")
    )  # fmt: skip
    panel = Panel(TIME, Axis(axis), (Line("u1", x, first, MEASURED), Line("u2", x, second, SECOND)), 180)
    return Figure(title, about, (panel,), replay.name)


def _nis(replay: Replay, x: FloatArray) -> Figure:
    """Normalised innovation squared over time, with the bounds of a consistent filter's 95 %."""
    nis, (low, high) = replay.run.rows["nis"], metrics.chi_square_bounds(2)
    parts = (
        Line("each sample", x, np.maximum(nis, 1e-3), FAINT, width=0.8),
        Line("mean over 1 s", x, moving_mean(nis, _samples(replay, 1.0)), ESTIMATE, width=2.0),
        Reference(high, "97.5 %"),
        Reference(2.0, "expected mean: 2", MEASURED),
        Reference(low, "2.5 %"),
    )
    about = (
        "The pressures' innovations, relative to the covariance that the filter expects. Values below the lower bound "
        "are smaller than expected, values above the upper one larger. One sample in twenty lies outside by chance."
    )
    top = max(30.0, float(np.nanmax(nis, initial=0.0)) * 1.5)
    panel = Panel(TIME, Axis("NIS [-]", log=True, bounds=(1e-3, top)), parts, 230)
    return Figure("Normalised innovation squared (NIS)", about, (panel,), replay.name)


def _correlation(replay: Replay) -> list[Figure]:
    rows = replay.run.rows
    series = metrics.normalised_innovation(rows["innovation"], rows["innovation_covariance"])
    present = int(np.isfinite(series).all(axis=1).sum())
    if present < 5 * _LAGS:
        return []
    gamma = metrics.autocorrelation(series, _LAGS)
    own = np.diagonal(gamma, axis1=1, axis2=2) / np.diagonal(gamma[0])
    lag = np.arange(1.0, _LAGS + 1.0) * (replay.recording.sample_period_s * 1e3)
    bars = [Bars(f"P{muscle + 1}", lag, own[1:, muscle], (MEASURED, SECOND)[muscle]) for muscle in (0, 1)]
    bounds = [Reference(sign * 1.96 / np.sqrt(present)) for sign in (-1.0, 1.0)]
    panel = Panel(Axis("Lag [ms]"), Axis("Correlation [-]"), (*bars, *bounds), 182)
    about = "Correlation of each innovation with itself at a lag. White innovations stay between the dashed lines."
    return [Figure("Innovation autocorrelation", about, (panel,), f"{replay.name} lags")]


def _subsystems(replay: Replay, x: FloatArray) -> Figure:
    sigma = replay.run.rows["subsystem"].astype(np.int64) - 1
    about = (
        "The model switches between 18 sets of equations. Rows are those that were active, darker where more of the "
        "time was spent; point at one to read which flows are choked and whether the joint slides."
    )
    panel = strip(SUBSYSTEMS, sigma, x)
    return Figure("Active subsystem of the model", about, (panel,), replay.name)
