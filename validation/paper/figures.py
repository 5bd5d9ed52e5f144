"""The figures of the paper's page, drawn by matplotlib."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pam_antagonist.control.command import PI_MODES
from pam_antagonist.estimation import metrics
from pam_antagonist.report.figure import ESTIMATE, MEASURED, MODEL, SECOND
from validation.paper import control as loop
from validation.paper.estimates import LABELS, MODELS
from validation.paper.virtual import JOINT, TUNINGS, UNITS, Floats, VirtualRig, measured_of

_COLORS = {"model": MODEL, "published": SECOND, "default": ESTIMATE}
_EVERY = 20
"""Of so many samples one is drawn."""


def _panels(rows: int, columns: int, height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(9.0, height), layout="constrained")
    return figure, figure.subplots(rows, columns, sharex="col" if rows > 1 else False, squeeze=False)


def _time(rig: VirtualRig, count: int) -> Floats:
    return np.asarray(np.arange(count) * rig.declared.sample_period)


def _spreads(axes: Any, values: pd.DataFrame, rows: Sequence[tuple[str, str]]) -> None:
    """A row of points for each name, a point a virtual rig, and a bar at their median."""
    for k, (_, name) in enumerate(rows):
        one = 100.0 * values[name]
        axes.plot(one, np.full(len(one), k), "o", color=MODEL, alpha=0.5, markersize=4)
        axes.plot([one.median()] * 2, [k - 0.3, k + 0.3], color=ESTIMATE, linewidth=2.5)
    axes.set_yticks(range(len(rows)), [label for label, _ in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("ℚ [%]: a point is a virtual rig, the bar their median", fontname="DejaVu Sans")


def offline(rig: VirtualRig, values: pd.DataFrame) -> dict[str, Figure]:
    """Signal and error over the profile, and ℚ over the virtual rigs."""
    out = {}
    for quantity, joint in JOINT.items():
        figure, ((signal,), (error,)) = _panels(2, 1, 5.0)
        measured = measured_of(getattr(rig, joint), quantity)
        x = _time(rig, len(measured))[::_EVERY]
        signal.plot(x, measured[::_EVERY], color=MEASURED, label="measured")
        for method, color in _COLORS.items():
            value = getattr(rig.track(joint, method), quantity)
            signal.plot(x, value[::_EVERY], color=color, label=LABELS[method], linewidth=0.9)
            error.plot(x, (value - measured)[::_EVERY], color=color, linewidth=0.9)
        half = metrics.interval_half_width(getattr(rig.track(joint, "default"), f"{quantity}_variance"))[::_EVERY]
        error.fill_between(x, -half, half, color=ESTIMATE, alpha=0.2, label="95 % interval of default")
        signal.set_ylabel(f"{quantity} [{UNITS[quantity]}]")
        error.set(xlabel="Time [s]", ylabel=f"error [{UNITS[quantity]}]")
        signal.legend(ncols=4, fontsize=8)
        error.legend(fontsize=8)
        out[quantity] = figure
    figure, (pair,) = _panels(1, 2, 2.2)
    for axes, quantity in zip(pair, JOINT, strict=True):
        _spreads(axes, values, [(label, f"{quantity}, {label}, ℚ") for label in LABELS.values()])
        axes.set_title(quantity)
    return {**out, "q": figure}


def compare_angle(rig: VirtualRig, values: pd.DataFrame) -> dict[str, Figure]:
    """ℚ of each model on each rig, both tunings."""
    figure, ((axes,),) = _panels(1, 1, 4.0)
    rows = [(f"{label} · {tuning}", f"{label}, tuning {tuning}, ℚ") for label in MODELS.values() for tuning in TUNINGS]
    _spreads(axes, values, rows)
    axes.set_xscale("log")
    return {"models": figure}


def control(rig: VirtualRig, values: pd.DataFrame) -> dict[str, Figure]:
    """Reference, measurement and estimate of either mode with tuning default."""
    figure, pairs = _panels(1, 2, 3.2)
    for axes, mode in zip(pairs[0], PI_MODES, strict=True):
        wanted, measured, estimated = loop.closed_loop(rig, mode, "default")
        x = _time(rig, len(wanted))
        for line, color, label in ((measured, MEASURED, "measured"), (estimated, ESTIMATE, "estimate")):
            axes.plot(x[::_EVERY], line[::_EVERY], color=color, label=label)
        axes.plot(x, wanted, "k--", linewidth=0.9, label="reference")
        unit = "°" if math.isclose(loop.SCALE[mode], math.degrees(1.0)) else "N m"
        axes.set(xlabel="Time [s]", ylabel=f"{mode.name.lower()} [{unit}]")
    pairs[0][0].legend(fontsize=8)
    return {"steps": figure}
