"""The paper's experiments: one table of them, and one way to run them and to put their numbers beside the paper's."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from joblib import Parallel, delayed

from pam_antagonist.report.document import percent
from validation.paper import control, estimates, figures, live, model, muscles
from validation.paper.virtual import JOINT, TUNINGS, UNITS, VirtualRig


class Row(NamedTuple):
    """A number beside the paper's."""

    what: str  # name of the value that the experiment gives
    unit: str  # of both; ``%`` for fractions, which are shown a hundred times as large
    paper: float | None = None
    why: str = ""  # on the difference


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


_OFFLINE = {
    ("angle", "model"): (1.053, 3.50, 0.0887),
    ("angle", "published"): (0.838, 2.42, 0.0613),
    ("torque", "model"): (0.162, 0.494, 0.1023),
    ("torque", "published"): (0.108, 0.238, 0.0494),
}
_OFFLINE_WHY = {
    "model": "The mismatches were chosen so that ℚ is near the paper's.",
    "published": "With this Q the filter's joint creeps where the real one sticks (docs/explanation/model.md, "
    "correction 11).",
    "default": "The paper has no such tuning: small process noise, parameters considered uncertain.",
    "told": "The rig file holds the hysteresis, and says by how much each group of parameters is off.",
}
_ONLINE = {"angle": (1.16, 3.06, 0.0791), "torque": (0.0899, 0.299, 0.0601)}
_TABLE_3 = {"proposed": 0.0791, "linear": 0.192, "simple": 0.0990, "tondu": 0.0983, "none": 0.113}
_TABLE_3_WHY = {
    "proposed": "The paper's value is that of its online run; here the error that the tuning itself brings dominates.",
    "linear": "A state-space model from 60 s of random steps. The paper gives neither the data of its own nor its "
    "order.",
    "simple": "The constant as printed is too large for this joint, whichever unit is taken.",
    "tondu": "The paper's constants, taken in N m and rad/s; the print leaves the units out.",
    "none": "Without friction nothing holds the filter's joint where the real one sticks.",
}
_TABLE_4 = {"linear": 0.0601, "hildebrandt": 0.135, "sarosi": 0.106, "polynomial": 0.193}
_PERFORMANCE = {"angle": 0.9475, "torque": 0.95}


def _signs(unit: str) -> tuple[tuple[str, str], ...]:
    return ("𝕀", unit), ("𝕄", unit), ("ℚ", "%")


def _offline_rows() -> tuple[Row, ...]:
    return tuple(
        Row(f"{quantity}, {label}, {sign}", unit, (_OFFLINE.get((quantity, method)) or (None,) * 3)[k],
            _OFFLINE_WHY[method])
        for quantity in JOINT for method, label in estimates.LABELS.items()
        for k, (sign, unit) in enumerate(_signs(UNITS[quantity]))
    )  # fmt: skip


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
        ratio.columns = list(_TABLE_3)
        best = int((ratio.idxmin(axis=1) == "proposed").sum())
        order = " < ".join(ratio.median().sort_values().index)
        out.append(f"Tuning {tuning}, by ℚ: the proposed model, the paper's best, is the best on {best} of "
                   f"{len(ratio)} "
                   f"rigs. Order of the medians: {order}.")  # fmt: skip
    return out


def _control_said(values: pd.DataFrame) -> list[str]:
    return [
        f"{name.capitalize()}: {int((values[f'steady-state performance, {name}, tuning {tuning}'] >= paper).sum())} of "
        f"{len(values)} rigs are at or above the paper's {100 * paper:.4g} % with tuning {tuning}."
        for name, paper in _PERFORMANCE.items() for tuning in TUNINGS
    ]  # fmt: skip


def _kappa_rows() -> tuple[Row, ...]:
    near = "Near the supply's pressure a small error of pressure is a large one of open rate; it matters little there."
    supply = "The supply pressure, which the virtual rig has about 2 % off."
    why = {("found", "median"): supply, ("found", "largest"): near}
    return tuple(
        Row(f"error of the {name} open rate, {word}", "-", None, why.get((name, word), "The declared mismatch."))
        for word in ("median", "largest") for name in ("found", "declared")
    )  # fmt: skip


def _influence_rows() -> tuple[Row, ...]:
    falls = "The guideline says that it falls."
    slower = f"{falls} The term −k_2 V̇ P/V works against every change of pressure that moves the joint."
    back = "It fails for a joint that comes back from beyond: dry friction holds it anywhere in a band."
    return (
        Row("steady pressures, largest change", "Pa", 0.0, "The proposition holds; this is the rest of the transient."),
        Row("transient parameters: steady angle, largest change", "°", 0.0, "It holds for a joint from one side."),
        Row("transient parameters: angle after a pulse, largest change", "°", 0.0, back),
        *(Row(f"{name} up by half: size of the steady ψ", "°", None, "The guideline says that it decreases.")
          for name in model.STEADY),
        *(Row(f"{name} up by half: time of ψ to 90 %", "s", None, slower if name == "k_2" else falls)
          for name in ("A_0", "k_1", "k_2")),
    )  # fmt: skip


def _online_rows() -> tuple[Row, ...]:
    quick = "A compiled kernel on today's processor, called from Python for each sample."
    return (
        *(Row(f"{quantity}, live, {sign}", unit, _ONLINE[quantity][k], "One virtual rig against one real one.")
          for quantity in JOINT for k, (sign, unit) in enumerate(_signs(UNITS[quantity]))),
        *(Row(f"{quantity}, {what}", unit) for quantity in JOINT
          for what, unit in (("estimates that a replay repeats bit by bit", "%"), ("samples lost", "-"))),
        Row("angle, time of a filter's step, mean", "ms", 0.346, quick),
    )  # fmt: skip


def _table_3_rows() -> tuple[Row, ...]:
    models = {**_TABLE_3, "simple_fitted": None, "tondu_fitted": None}
    rows = [
        Row(f"{estimates.MODELS[name]}, tuning {tuning}, ℚ", "%", paper if tuning == "published" else None,
            _TABLE_3_WHY[name] if paper and tuning == "published" else "")
        for name, paper in models.items() for tuning in TUNINGS
    ]  # fmt: skip
    return (*rows, *(Row(f"factor of the fitted constants, {name}", "-") for name in ("simple", "tondu")))


_FITTED = "Fitted to the rig's own static test; the paper does not say to what its coefficients were fitted."
_LEFT = "What is left is the error of the estimate, which the loop cannot see."
_BY_EYE = "One rig, one run, as in the paper, which reads the steady state from a figure by eye."
EXPERIMENTS: dict[str, Experiment] = {
    "static": Experiment(
        "Static characteristics",
        "Force at six lengths and eleven pressures, each length from both sides, with hysteresis and 0.5 N of noise: a "
        "line at each length (6), then slope and intercept against length (7). Errors are the largest of three points.",
        (Row("fitted map", "N", None, "Hysteresis averages out: both ways are measured. The paper shows a picture."),
         Row("declared map", "N", None, "The declared mismatch: a force map is off by 2 % as a whole, about 1 N.")),
        muscles.static,
    ),
    "kappa": Experiment(
        "The valve curve κ(u)",
        "13 voltages, each held for 25 s on both valves; the curve follows by the paper's three steps.",
        _kappa_rows(), model.kappa,
    ),
    "influence": Experiment(
        "Proposition 1 and the influence of parameters",
        "One parameter of the declared model at a time is 1.5 times as large. The model is driven to the same voltages "
        "by a step, slowly (over 120 s), and by pulses beyond them.",
        _influence_rows(), model.influence, once=True,
    ),
    "profile": Experiment(
        "Input profile and the 18 subsystems",
        "130 s of steps of both valves, with the joint free. The paper shows its own as a picture; this one is ours.",
        (Row("length", "s", 130.0, "The same."),
         Row("lowest pressure", "kPa", 200.0, "Set by voltage, so it depends on the rig's valves."),
         Row("highest pressure", "kPa", 700.0, "Bounded by the supply: 710 kPa, 2 % off here."),
         Row("subsystems visited, of 18", "-", None, "The paper names 18 and does not say which its run visits.")),
        model.profile,
    ),
    "offline": Experiment(
        "Offline estimation",
        "The profile with the joint free (angle) and locked at 0° (torque). The model alone is given the voltages and "
        "the first pressures, the filter the voltages and all pressures.",
        _offline_rows(), estimates.offline, _offline_said, figures.offline,
    ),
    "online": Experiment(
        "Online estimation",
        "Plant, estimator and recorder as processes at 1 kHz: 130 s with the joint free, 62 s with it locked. The live "
        "filter has tuning published.",
        _online_rows(), live.online, once=True, live=True,
    ),
    "compare_angle": Experiment(
        "Comparison of models: angle",
        "The first 62 s of the profile with the joint free. Each model in the same filter; the linear one in its own "
        "stationary Kalman filter. All see the pressures only. The plant follows the proposed law of friction, which "
        "favours it; the linear model and the fitted constants come from data of the rig that they are tried on.",
        _table_3_rows(), estimates.compare_angle, _angle_said, figures.compare_angle,
    ),
    "compare_torque": Experiment(
        "Comparison of force maps: torque",
        "The first 62 s of the profile with the joint locked. Each form of the contraction force is fitted to the same "
        "static test of the rig's muscles and runs in the same filter. The virtual muscles follow (6), so this cannot "
        "tell which form real ones follow ([a measured map](evidence/force_map.md) can).",
        tuple(Row(f"{muscles.FORMS[name]}, tuning published, ℚ", "%", paper, _FITTED)
              for name, paper in _TABLE_4.items()),
        muscles.compare_torque,
    ),
    "control": Experiment(
        "Sensor-less control",
        "Steps within ±20° (joint free) and ±2 N m (locked) with the paper's PI gains on the estimate, in one process. "
        "Steady is the last 20 % of each step.",
        tuple(Row(f"steady-state performance, {name}, tuning {tuning}", "%", paper if tuning == "published" else None,
                  _LEFT) for name, paper in _PERFORMANCE.items() for tuning in TUNINGS),
        control.control, _control_said, figures.control,
    ),
    "control_live": Experiment(
        "Sensor-less control, live",
        "The same steps with plant, estimator (tuning default) and controller as processes.",
        tuple(Row(f"steady-state performance, {name}", "%", paper, _BY_EYE) for name, paper in _PERFORMANCE.items()),
        live.control, once=True, live=True,
    ),
}  # fmt: skip
"""In the order of the page."""


@dataclass(frozen=True)
class Done:
    """Experiments that were made: values by experiment, a row a seed, and what each took [s]."""

    seeds: Sequence[int]
    values: dict[str, pd.DataFrame]
    seconds: dict[str, float]

    def compared(self, name: str) -> pd.DataFrame:
        """Numbers beside the paper's: median, least and largest over the virtual rigs."""
        rows = EXPERIMENTS[name].rows
        found = self.values[name].reindex(columns=[row.what for row in rows])
        spread = found.agg(["median", "min", "max", "count"]).T
        return spread.assign(paper=[row.paper for row in rows], unit=[row.unit for row in rows],
                             why=[row.why for row in rows])  # fmt: skip


def run(names: Sequence[str], seeds: Sequence[int], jobs: int, short: bool, folder: Path) -> Done:
    """Make experiments: those that repeat with all seeds at once, then the others with the first seed."""
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
    return Done(seeds, {name: values[name] for name in EXPERIMENTS if name in values}, seconds)


def of_seed(names: Sequence[str], seed: int) -> dict[str, dict[str, float]]:
    """Values of one virtual rig; recordings and filters are shared among the experiments."""
    rig = VirtualRig(seed)
    return {name: EXPERIMENTS[name].of_seed(rig) for name in names}
