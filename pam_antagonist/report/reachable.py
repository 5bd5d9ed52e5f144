"""The report of the reachable set of a joint: angle and torque together with stiffness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.control import Box, Reachable
from pam_antagonist.control.tracking import largest_torque
from pam_antagonist.report import html
from pam_antagonist.report.document import Block, Document, Text, Tile, Tiles, background
from pam_antagonist.report.figure import Axis, Band, Figure, Line, Panel
from pam_antagonist.report.style import BAND, ESTIMATE, MODEL
from pam_antagonist.report.table import Table, number
from pam_antagonist.rig import Rig

_POINTS = 121
_TABLE_STEP = 5.0  # between two rows of the table [°]
_FREQUENCIES, _DAMPING = (0.25, 0.5, 1.0, 2.0, 4.0), (0.0, 0.25, 0.5)
"""[Hz], [N m s/rad] Frequencies and dampings of the table of torques to which a joint yields."""
_DEFINITIONS = (
    (
        "Stiffness",
        "−∂τ/∂ψ of the muscles at constant pressures, by (2), (6), (7) and (9). Positive: the joint pulls back.",
    ),
    (
        "Within reach",
        "There are pressures within the bounds at which the joint rests at the angle, or gives the torque, with this "
        "stiffness, and at which no muscle is slack. Without a torque from outside, and without friction.",
    ),
)


@dataclass(frozen=True)
class ReachableReport:
    """Content of ``report.json``.

    Attributes:
        lowest_pressure: of the bounds, absolute [Pa].
        highest_pressure: of the bounds, absolute [Pa].
        least_force: of a muscle [N].
        angles: lowest and highest angle of rest (2,) [rad].
        torques: lowest and highest torque at angle 0 (2,) [N m].
        angle: angles of rest (N,) [rad].
        softest: least stiffness at each (N,) [N m/rad].
        stiffest: largest stiffness at each (N,) [N m/rad].
        torque: torques at angle 0 (N,) [N m].
        torque_softest: least stiffness at each (N,) [N m/rad].
        torque_stiffest: largest stiffness at each (N,) [N m/rad].
    """

    rig: str
    lowest_pressure: float
    highest_pressure: float
    least_force: float
    angles: tuple[float, float]
    torques: tuple[float, float]
    angle: NDArray[np.float64]
    softest: NDArray[np.float64]
    stiffest: NDArray[np.float64]
    torque: NDArray[np.float64]
    torque_softest: NDArray[np.float64]
    torque_stiffest: NDArray[np.float64]

    @classmethod
    def of(cls, rig: Rig, box: Box) -> ReachableReport:
        """Compute the reachable set of a rig, within bounds of pressures and forces."""
        reach = Reachable(rig.parameters(), box)
        torques = reach.torques(0.0)
        angle, torque = np.linspace(*reach.angles, _POINTS), np.linspace(*torques, _POINTS)
        at_angle = [reach.at_angle(float(value)) for value in angle]
        at_torque = [reach.at_torque(float(value), 0.0) for value in torque]
        return cls(
            rig.name, *box, reach.angles, torques,
            angle, np.array([each.softest for each in at_angle]), np.array([each.stiffest for each in at_angle]),
            torque, np.array([each.softest for each in at_torque]), np.array([each.stiffest for each in at_torque]),
        )  # fmt: skip


def write_report(folder: Path, rig: Rig, report: ReachableReport, with_figures: bool = True) -> None:
    """Write ``report.json`` and ``report.html`` into an existing folder."""
    html.write(folder, document(rig, report, with_figures), report)


def summary(rig: Rig, report: ReachableReport) -> tuple[Block, ...]:
    """Blocks for the terminal."""
    return Text(_lede(report)), table(rig, report), *_yielding(rig, report)


def table(rig: Rig, report: ReachableReport) -> Table:
    """Stiffness over the angle, with the pressures at both ends."""
    reach = Reachable(rig.parameters(), Box(report.lowest_pressure, report.highest_pressure, report.least_force))
    low, high = (math.degrees(angle) for angle in report.angles)
    inner = [step * _TABLE_STEP for step in range(math.ceil(low / _TABLE_STEP), math.floor(high / _TABLE_STEP) + 1)]
    rows = []
    for degrees in sorted({low, *inner, high}):
        angle = math.radians(degrees)
        found = reach.at_angle(angle)
        ends = [reach.pressures(angle, stiffness) for stiffness in (found.softest, found.stiffest)]
        pressures = [", ".join(f"{pressure * 1e-3:.0f}" for pressure in pair) for pair in ends]
        rows.append((f"{degrees:.1f}", number(found.softest), pressures[0], number(found.stiffest), pressures[1]))
    header = ("angle [°]", "softest [N m/rad]", "at [kPa]", "stiffest [N m/rad]", "at [kPa]")
    return Table(header, tuple(rows), "Stiffness within reach, and the absolute pressures of muscle 1 and 2")


def _yielding(rig: Rig, report: ReachableReport) -> tuple[Table, ...]:
    """Largest torques to which the joint yields in mode IMPEDANCE around angle 0; none for pressure regulators."""
    if rig.drive != "valve":
        return ()
    box = Box(report.lowest_pressure, report.highest_pressure, report.least_force)
    middle = Reachable(rig.parameters(), box).at_angle(0.0)
    stiffness = 0.5 * (middle.softest + middle.stiffest)
    rows = [
        (f"{hertz:g}", *(number(largest_torque(rig.parameters(), box, stiffness, each, hertz)) for each in _DAMPING))
        for hertz in _FREQUENCIES
    ]
    header = ("frequency [Hz]", *(f"damping {each:g} N m s/rad" for each in _DAMPING))
    about = f"Largest torque from outside [N m] that the valves follow, yielding with {number(stiffness)} N m/rad"
    return (Table(header, tuple(rows), f"{about}; friction aside"),)


def document(rig: Rig, report: ReachableReport, with_figures: bool = True) -> Document:
    """The report as a document."""
    low, high = (f"{math.degrees(angle):.1f}" for angle in report.angles)
    tiles = (
        Tile("Angles of rest", f"{low} to {high}°"),
        Tile("Stiffness", f"{number(report.softest.min())} to {number(report.stiffest.max())} N m/rad"),
        Tile("Torque at angle 0", f"{report.torques[0]:.2f} to {report.torques[1]:.2f} N m"),
    )
    blocks: tuple[Block, ...] = (Text(_lede(report), "lede"), Tiles(tiles))
    blocks += figures(report) if with_figures else ()
    return Document(
        "What a joint can reach",
        rig.name,
        (*blocks, table(rig, report), *_yielding(rig, report), *background(_DEFINITIONS, [("Rig", rig.name)])),
    )


def figures(report: ReachableReport) -> tuple[Figure, ...]:
    """The set over the angle of rest, and over the torque at angle 0."""

    def panel(axis: str, x: NDArray[np.float64], ends: Sequence[NDArray[np.float64]]) -> Panel:
        series = (
            Band("within reach", x, ends[0], ends[1], BAND),
            Line("softest", x, ends[0], MODEL, width=1.8),
            Line("stiffest", x, ends[1], ESTIMATE, width=1.8),
        )
        return Panel(Axis(axis), Axis("Stiffness [N m/rad]", from_zero=True), series, 300)

    about = "Lines: the softest and stiffest pressures within the bounds. Beyond their ends nothing is within reach."
    return (
        Figure(
            "Angle and stiffness", about, (panel("Angle of rest [°]", np.degrees(report.angle),
                                                 (report.softest, report.stiffest)),)
        ),
        Figure(
            "Torque and stiffness, held at angle 0", about,
            (panel("Torque [N m]", report.torque, (report.torque_softest, report.torque_stiffest)),),
        ),
    )  # fmt: skip


def _lede(report: ReachableReport) -> str:
    low, high = (f"{math.degrees(angle):.1f}" for angle in report.angles)
    return (
        f"Rig {report.rig} with {report.lowest_pressure * 1e-3:.0f} to {report.highest_pressure * 1e-3:.0f} kPa in its "
        f"muscles and {report.least_force:g} N in each at least: it rests at {low} to {high}°, with a stiffness of "
        f"{number(report.softest.min())} to {number(report.stiffest.max())} N m/rad that depends on the angle."
    )
