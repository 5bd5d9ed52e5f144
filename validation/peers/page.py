"""The tables, the page and the figure of ``peers``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pam_antagonist.cli import common
from pam_antagonist.program import versions
from pam_antagonist.report import terminal
from pam_antagonist.report.document import MISSING, Table, markdown, number, percent
from pam_antagonist.report.figure import PALETTE
from validation.peers.joints import ARM

_WORDS = {
    "linear": "linear map of the two pressures",
    "lagged": "ridge regression, half a second of all inputs",
    "gp": "Gaussian process, inputs at three times",
    "gru": "recurrent network, GRU, 2 × 64",
    "before": "our filter, rig as configured",
    "identified": "our filter, rig of identify",
    "after": "our filter, rig of close_loop",
    "ekf": "extended Kalman filter, rig of close_loop",
    "filterpy": "UKF of filterpy, rig of close_loop",
    "sindy": "identify, and PySINDy on what it leaves",
    "gp_residual": "identify, and a Gaussian process on what it leaves",
}
_SENSORS = {name: words for name, words in _WORDS.items() if name not in ("sindy", "gp_residual")}
_ALONE = {
    "before": "our model, as configured",
    "identified": "our model, after identify",
    "after": "our model, after close_loop",
    **{name: _WORDS[name] for name in ("sindy", "gp_residual")},
}
_COLUMNS = ("joint", "peer", "part", "whole_s", "why", "cpu_s", "rmse_deg", "coverage", "alone_deg", "before_deg",
            "numbers", "said")  # fmt: skip
CURVES = ("linear", "lagged", "gp", "gru", "after")
_SHORT = {"rig_a_lab/supply_droop": "rig A, supply that droops", ARM: "the arm"}
_TEXT = """\
# Peers, side by side

Ours beside what others would use. This page is written by a command; the recordings are not part of this package:

    ./run peers --data DATA --out DIR --docs docs/evidence/peers.md

* **Fitted**: rig A (valves, 1 kHz), the first two thirds of a free and a locked minute; the wrist (regulators, 50 Hz),
  the elbow (valves, 100 Hz) and the bench (valves, 1 kHz): the recordings of [three other laboratories](other_rigs.md)
  that may be fitted; [the arm](../pamy.md): the first two thirds of the episodes.
* **Held out**: whole recordings of the three laboratories; for the others the last third. All errors are of the angle.
* Soft sensors without physics get the pressures and what drives the joint, 100 times a second at most; on the arm also
  the next joint's pressures, and the network the first angle of an episode.
* The other filters get the rig that `close_loop` found, with its tuning. They lack what ours adds to the covariance:
  the uncertainty of the parameters.
* *Numbers* are those that were fitted or kept. Processor time is that of the fit and of the held-out samples, on one
  core of a busy machine; other filters are charged for their own run only.
"""


def _frame(done: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The entries, with a column for the error of the model alone; the arm's ``before`` is in its ``after``."""
    frame = pd.DataFrame(done).reindex(columns=[*_COLUMNS]).set_index(["peer", "joint"], drop=False)
    arm = frame[(frame.joint == ARM) & (frame.peer == "after")]
    before = arm.assign(peer="before", alone_deg=arm.before_deg, rmse_deg=None).set_index(["peer", "joint"], drop=False)
    return pd.concat([frame[(frame.joint != ARM) | (frame.peer != "before")], before])


def _whole(done: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Entries that were fitted to all."""
    frame = _frame(done)
    return frame[frame.part.isna()].groupby(level=[0, 1], sort=False).tail(1)


def _short(joint: str) -> str:
    return _SHORT.get(joint, f"the {Path(joint).name}")


def _range(values: pd.Series) -> str:
    ends = [f"{value:.0f}" if value >= 100.0 else number(value, 2) for value in (values.min(), values.max())]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def _table(first: str, errors: pd.DataFrame, error: str, peers: Mapping[str, str], more: bool) -> Table:
    """A row a peer, a column a joint: errors, with coverage where there is one."""
    joints = list(dict.fromkeys(errors.joint))
    rows = []
    for peer, words in peers.items():
        mine = errors[(errors.peer == peer) & errors[error].notna()]
        if mine.empty:
            continue
        cells = []
        for joint in joints:
            one = mine[mine.joint == joint]
            covered = "" if not more or one.coverage.isna().all() else f", {percent(float(one.coverage.iloc[0]))}"
            cells.append(MISSING if one.empty else f"{number(float(one[error].iloc[0]))}°{covered}")
        rows.append((words, *cells, *((_range(mine.numbers.astype(float)), _range(mine.cpu_s)) if more else ())))
    last = ("numbers", "processor time [s]") if more else ()
    return Table((first, *map(_short, joints), *last), tuple(rows))


def sensors_table(done: Sequence[Mapping[str, Any]]) -> Table:
    """Errors of what estimates the angle from the pressures, with coverage, numbers and time."""
    return _table("peer", _whole(done), "rmse_deg", _SENSORS, more=True)


def alone_table(done: Sequence[Mapping[str, Any]]) -> Table:
    """Errors of free runs from the inputs alone; of the arm, from its measured pressures."""
    return _table("model alone", _whole(done), "alone_deg", _ALONE, more=False)


def said_table(done: Sequence[Mapping[str, Any]]) -> Table:
    """What close_loop said."""
    found = _whole(done)
    said = found[(found.peer == "after") & found.said.notna()]
    return Table(("joint", "close_loop says"), tuple((_short(one.joint), one.said) for one in said.itertuples()))


def curves_figure(done: Sequence[Mapping[str, Any]]) -> Any:
    """Held-out error against the length of what was fitted, a panel for each joint; None where there is no curve."""
    from matplotlib.figure import Figure

    frame = _frame(done)
    alone = (frame.joint == ARM) & (frame.peer == "after")
    frame = frame.assign(error=frame.rmse_deg.where(~alone, frame.alone_deg), length=frame.part.fillna(frame.whole_s))
    frame = frame[frame.error.notna() & frame.peer.isin(CURVES)]
    frame = frame[frame.groupby(level=[0, 1]).error.transform("count") > 1]
    joints = list(dict.fromkeys(frame.joint))
    if not joints:
        return None
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    for axes, joint in zip(figure.subplots(1, len(joints), squeeze=False)[0], joints, strict=True):
        for peer, color in zip(CURVES, PALETTE, strict=False):
            mine = frame[(frame.joint == joint) & (frame.peer == peer)].sort_values("length")
            axes.loglog(mine.length, mine.error, "o-", color=color, markersize=3, label=_WORDS[peer])
        axes.set(title=_short(joint), xlabel="Fitted [s]")
    figure.axes[0].set_ylabel("Error [°]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8)
    return figure


def texts(done: Sequence[Mapping[str, Any]]) -> list[str]:
    """What a terminal shows."""
    tables = (sensors_table(done), alone_table(done), said_table(done))
    return [terminal.table(table, indent="") for table in tables if table.rows]


def write(done: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the page, and its figure into a folder of the page's name beside it."""
    lines = [_TEXT, *markdown(sensors_table(done)), ""]
    lines += ["## The model alone", "", "Free runs from voltages or commands; of the arm, from the measured pressures.",
              "PySINDy (polynomials of second degree) and the Gaussian process are fitted to the rates of velocity and",
              "pressures that a step of 10 ms of the identified model leaves.", "",
              *markdown(alone_table(done)), ""]  # fmt: skip
    figure = curves_figure(done)
    if figure is not None:
        folder = path.with_suffix("")
        folder.mkdir(exist_ok=True)
        figure.savefig(folder / "curves.png", dpi=110)
        lines += [
            "## Data needed",
            "",
            f"![Held-out error of the angle against the length of what was fitted]({folder.name}/curves.png)",
            "",
        ]
    failed = _whole(done)[lambda found: found.why.notna()]
    why = [f"* {_short(one.joint)}, {_WORDS[one.peer]}: {one.why}" for one in failed.itertuples()]
    lines += ["## What gave no figure", "", *why, ""] if why else []
    lines += ["Software: " + ", ".join(f"{name} {version}" for name, version in versions().items()) + ".", ""]
    common.write_text(path, "\n".join(lines))
