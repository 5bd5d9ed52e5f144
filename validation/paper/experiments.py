"""The paper's experiments: what makes each, what its values say, and one way to run them.

Titles, questions and the numbers beside the paper's stand in ``experiments.yaml``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from matplotlib.figure import Figure

from pam_antagonist.control.command import PI_MODES
from pam_antagonist.estimation import metrics
from pam_antagonist.report.document import percent
from pam_antagonist.report.figure import ESTIMATE, MEASURED, MODEL, SECOND
from pam_antagonist.strict_yaml import load_bounded
from validation.paper import estimates, live, model
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


def offline_figures(rig: VirtualRig, values: pd.DataFrame) -> dict[str, Figure]:
    """Signal and error over the profile."""
    out = {}
    for quantity, joint in JOINT.items():
        figure, ((signal,), (error,)) = _panels(2, 1, 5.0)
        measured = measured_of(getattr(rig, joint), quantity)
        x = _time(rig, len(measured))[::_EVERY]
        signal.plot(x, measured[::_EVERY], color=MEASURED, label="measured")
        for method, color in _COLORS.items():
            value = getattr(rig.track(joint, method), quantity)
            signal.plot(x, value[::_EVERY], color=color, label=estimates.LABELS[method], linewidth=0.9)
            error.plot(x, (value - measured)[::_EVERY], color=color, linewidth=0.9)
        half = metrics.interval_half_width(getattr(rig.track(joint, "default"), f"{quantity}_variance"))[::_EVERY]
        error.fill_between(x, -half, half, color=ESTIMATE, alpha=0.2, label="95 % interval of default")
        signal.set_ylabel(f"{quantity} [{UNITS[quantity]}]")
        error.set(xlabel="Time [s]", ylabel=f"error [{UNITS[quantity]}]")
        signal.legend(ncols=4, fontsize=8, loc="upper right")
        error.legend(fontsize=8, loc="upper right")
        out[quantity] = figure
    return out


def models_figure(rig: VirtualRig, values: pd.DataFrame) -> dict[str, Figure]:
    """ℚ of each model on each rig, both tunings."""
    figure, ((axes,),) = _panels(1, 1, 4.0)
    rows = [
        (f"{label} · {tuning}", f"{label}, tuning {tuning}, ℚ")
        for label in estimates.MODELS.values()
        for tuning in TUNINGS
    ]
    _spreads(axes, values, rows)
    axes.set_xscale("log")
    return {"models": figure}


def steps_figure(rig: VirtualRig, values: pd.DataFrame) -> dict[str, Figure]:
    """Reference, measurement and estimate of either mode with tuning default."""
    figure, pairs = _panels(1, 2, 3.2)
    for axes, mode in zip(pairs[0], PI_MODES, strict=True):
        wanted, measured, estimated = live.closed_loop(rig, mode, "default")
        x = _time(rig, len(wanted))
        for line, color, label in ((measured, MEASURED, "measured"), (estimated, ESTIMATE, "estimate")):
            axes.plot(x[::_EVERY], line[::_EVERY], color=color, label=label)
        axes.plot(x, wanted, "k--", linewidth=0.9, label="reference")
        unit = "°" if math.isclose(live.SCALE[mode], math.degrees(1.0)) else "N m"
        axes.set(xlabel="Time [s]", ylabel=f"{mode.name.lower()} [{unit}]")
    pairs[0][0].legend(fontsize=8, loc="upper right")
    return {"steps": figure}


_THREE = "𝕀, 𝕄, ℚ"
_TABLE_3 = ["proposed", "linear", "simple", "tondu", "none"]
_PERFORMANCE = {"angle": 0.9475, "torque": 0.95}


class Row(NamedTuple):
    """One value or three beside the paper's."""

    what: str
    names: tuple[str, ...]  # of the values that the experiment gives
    units: tuple[str, ...]  # ``%`` for fractions, which are shown a hundred times as large
    paper: tuple[float | None, ...]
    why: str  # on the difference


def _row(what: str, unit: str, paper: Any, why: str) -> Row:
    if not what.endswith(_THREE):
        return Row(what, (what,), (unit,), (paper,), why)
    names = tuple(what.replace(_THREE, sign) for sign in _THREE.split(", "))
    return Row(what, names, (unit, unit, "%"), tuple(paper or (None,) * 3), why)


class Experiment(NamedTuple):
    """An experiment of the paper: values of a virtual rig by name, and which of them stand beside the paper's."""

    title: str
    question: str  # what was done, in a sentence or two
    rows: tuple[Row, ...]
    of_seed: Callable[..., dict[str, float]]
    said: Callable[[pd.DataFrame], list[str]] = lambda values: []
    figures: Callable[[VirtualRig, pd.DataFrame], dict[str, Any]] = lambda rig, values: {}
    once: bool = False  # whether it is made with the first seed only
    live: bool = False  # whether it starts ROS 2 nodes


def _offline_said(values: pd.DataFrame) -> list[str]:
    out = []
    for quantity in JOINT:
        ratio = {name: values[f"{quantity}, {label}, ℚ"] for name, label in estimates.LABELS.items()}
        better = " and ".join(f"{percent((ratio[name] < ratio['model']).mean())} with {name}" for name in TUNINGS)
        covered = ", ".join(f"{percent(values[f'{quantity}, {estimates.LABELS[name]}, in 95 %'].median())} with {name}"
                            for name in (*TUNINGS, "told"))  # fmt: skip
        out.append(f"{quantity.capitalize()}: ℚ of the filter is below the model's on {better} of the rigs. Within the "
                   f"95 % interval (median): {covered}.")  # fmt: skip
    return out


def _angle_said(values: pd.DataFrame) -> list[str]:
    out = []
    for tuning in TUNINGS:
        ratio = values[[f"{estimates.MODELS[name]}, tuning {tuning}, ℚ" for name in _TABLE_3]]
        ratio.columns = _TABLE_3
        best = int((ratio.idxmin(axis=1) == "proposed").sum())
        out.append(f"Tuning {tuning}, by ℚ: the proposed model, the paper's best, is the best on {best} of "
                   f"{len(ratio)} rigs. Order of the medians: {' < '.join(ratio.median().sort_values().index)}."
                   )  # fmt: skip
    return out


def _control_said(values: pd.DataFrame) -> list[str]:
    return [
        f"{name.capitalize()}: {int((values[f'steady-state performance, {name}, tuning {tuning}'] >= paper).sum())} of "
        f"{len(values)} rigs are at or above the paper's {100 * paper:.4g} % with tuning {tuning}."
        for name, paper in _PERFORMANCE.items() for tuning in TUNINGS
    ]  # fmt: skip


_HOW: dict[str, dict[str, Any]] = {
    "static": {"of_seed": model.static},
    "kappa": {"of_seed": model.kappa},
    "influence": {"of_seed": model.influence, "once": True},
    "profile": {"of_seed": model.profile},
    "offline": {"of_seed": estimates.offline, "said": _offline_said, "figures": offline_figures},
    "online": {"of_seed": live.online, "once": True, "live": True},
    "compare_angle": {"of_seed": estimates.compare_angle, "said": _angle_said, "figures": models_figure},
    "compare_torque": {"of_seed": estimates.compare_torque},
    "control": {"of_seed": live.control, "said": _control_said, "figures": steps_figure},
    "control_live": {"of_seed": live.control_live, "once": True, "live": True},
}
_ABOUT = load_bounded(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
EXPERIMENTS = {
    name: Experiment(about["title"], about["question"], tuple(_row(*row) for row in about["rows"]), **_HOW[name])
    for name, about in _ABOUT.items()
}
"""In the order of the page."""


def run(
    names: Sequence[str], seeds: Sequence[int], jobs: int, short: bool, folder: Path
) -> tuple[dict[str, pd.DataFrame], dict[str, float]]:
    """Make experiments: those that repeat with all seeds at once, then the others with the first seed.

    Returns values by experiment, a row a seed, and what it took [s].
    """
    values: dict[str, pd.DataFrame] = {}
    seconds: dict[str, float] = {}
    repeated = [name for name in EXPERIMENTS if name in names and not EXPERIMENTS[name].once]
    if repeated:
        begin = time.perf_counter()
        print(f"{', '.join(repeated)}: {len(seeds)} virtual rigs, {min(jobs, len(seeds))} at a time", flush=True)
        found = Parallel(n_jobs=min(jobs, len(seeds)))(delayed(of_seed)(repeated, seed) for seed in seeds)
        values |= {name: pd.DataFrame([one[name] for one in found], index=list(seeds)) for name in repeated}
        seconds["seeds"] = time.perf_counter() - begin
    for name in [name for name in EXPERIMENTS if name in names and EXPERIMENTS[name].once]:
        begin, one = time.perf_counter(), EXPERIMENTS[name]
        print(f"{name}: {one.title}", flush=True)
        rig = VirtualRig(seeds[0])
        result = one.of_seed(rig, folder, short) if one.live else one.of_seed(rig)
        values[name] = pd.DataFrame([result], index=[seeds[0]])
        seconds[name] = time.perf_counter() - begin
    return {name: values[name] for name in EXPERIMENTS if name in values}, seconds


def of_seed(names: Sequence[str], seed: int) -> dict[str, dict[str, float]]:
    """Values of one virtual rig; recordings and filters are shared among the experiments."""
    rig = VirtualRig(seed)
    return {name: EXPERIMENTS[name].of_seed(rig) for name in names}
