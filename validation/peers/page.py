"""The tables, the page and the figure of ``peers``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist.cli import common
from pam_antagonist.report import terminal
from pam_antagonist.report.figure import Axis, Figure, Line, Panel
from pam_antagonist.report.style import PALETTE
from pam_antagonist.report.table import MISSING, Table, markdown, number, percent
from pam_antagonist.software import versions
from validation.peers.joints import ARM
from validation.pictures import picture

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
_SENSORS = ("linear", "lagged", "gp", "gru", "before", "identified", "after", "ekf", "filterpy")
_ALONE = ("before", "identified", "after", "sindy", "gp_residual")
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


def _latest(done: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], Mapping[str, Any]]:
    """Entries that were fitted to all, by joint and peer."""
    return {(item["joint"], item["peer"]): item for item in done if item["part"] is None}


def _joints(done: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(item["joint"] for item in done))


def _short(joint: str) -> str:
    return _SHORT.get(joint, f"the {Path(joint).name}")


def _range(values: Sequence[float], digits: int = 2) -> str:
    known = sorted(values)
    if not known:
        return MISSING
    ends = [f"{value:.0f}" if value >= 100.0 else number(value, digits) for value in (known[0], known[-1])]
    return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"


def sensors_table(done: Sequence[Mapping[str, Any]]) -> Table:
    """Errors of what estimates the angle from the pressures, with coverage, numbers and time."""
    known, names = _latest(done), _joints(done)

    def cell(joint: str, peer: str) -> str:
        item = known.get((joint, peer))
        value = None if item is None else item.get("rmse_deg")
        if value is None:
            return MISSING
        covered = item["coverage"] if item is not None else None
        return f"{number(value)}°" + ("" if covered is None else f", {percent(covered)}")

    rows = []
    for peer in _SENSORS:
        items = [known[joint, peer] for joint in names if known.get((joint, peer), {}).get("rmse_deg") is not None]
        if items:
            numbers, times = ([float(item[key]) for item in items] for key in ("numbers", "cpu_s"))
            rows.append((_WORDS[peer], *(cell(joint, peer) for joint in names), _range(numbers), _range(times)))
    return Table(("peer", *map(_short, names), "numbers", "processor time [s]"), tuple(rows))


def alone_table(done: Sequence[Mapping[str, Any]]) -> Table:
    """Errors of free runs from the inputs alone; of the arm, from its measured pressures."""
    known, names = _latest(done), _joints(done)

    def value(joint: str, peer: str) -> float | None:
        item = known.get((joint, "after" if joint == ARM else peer), {})
        if joint == ARM:
            return {"before": item.get("before_deg"), "after": item.get("alone_deg")}.get(peer)
        found = item.get("alone_deg")
        return None if found is None else float(found)

    words = {"before": "our model, as configured", "identified": "our model, after identify",
             "after": "our model, after close_loop"}  # fmt: skip

    def cell(joint: str, peer: str) -> str:
        found = value(joint, peer)
        return MISSING if found is None else f"{number(found)}°"

    rows = tuple((words.get(peer, _WORDS[peer]), *(cell(joint, peer) for joint in names)) for peer in _ALONE)
    return Table(("model alone", *map(_short, names)), rows)


def said_table(done: Sequence[Mapping[str, Any]]) -> Table:
    """What close_loop said."""
    known = _latest(done)
    rows = ((_short(joint), str(known[joint, "after"].get("said") or MISSING)) for joint in _joints(done)
            if (joint, "after") in known)  # fmt: skip
    return Table(("joint", "close_loop says"), tuple(rows))


def curves_figure(done: Sequence[Mapping[str, Any]]) -> Figure | None:
    """Held-out error against the length of what was fitted, a panel for each joint."""
    panels: list[Panel] = []
    for joint in _joints(done):
        series = []
        for peer, color in zip(CURVES, PALETTE, strict=False):
            error = "alone_deg" if joint == ARM and peer == "after" else "rmse_deg"
            mine = [item for item in done if (item["joint"], item["peer"]) == (joint, peer)]
            points = sorted((item["part"] or item["whole_s"], item[error]) for item in mine if item.get(error))
            if len(points) > 1:
                x, y = np.array(points, float).T
                series.append(Line(_WORDS[peer], x, y, color, width=2.0, quiet=bool(panels)))
        if series:
            axis = Axis("Error [°]" if not panels else "", log=True)
            panels.append(Panel(Axis("Fitted [s]", log=True), axis, tuple(series), 260, _short(joint)))
    if not panels:
        return None
    about = "Held-out error of the angle against the length of what was fitted."
    return Figure("Data needed", about, tuple(panels), beside=True)


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
        (folder / "curves.png").write_bytes(picture(figure))
        lines += ["## Data needed", "", f"![{figure.about}]({folder.name}/curves.png)", ""]
    why = [f"* {_short(item['joint'])}, {_WORDS[item['peer']]}: {item['why']}" for item in _latest(done).values()
           if item["why"] and not (item["joint"] == ARM and item["peer"] == "before")]  # fmt: skip
    lines += ["## What gave no figure", "", *why, ""] if why else []
    lines += ["Software: " + ", ".join(f"{name} {version}" for name, version in versions().items()) + ".", ""]
    common.write_text(path, "\n".join(lines))
