"""The report of the reachable set of a joint: angle and torque together with stiffness."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.stiffness import Box
from pam_antagonist.control.tracking import largest_torque
from pam_antagonist.report.document import Document, Table, page
from pam_antagonist.report.figure import BAND, ESTIMATE, MODEL, Axis, Band, Figure, Line, Panel
from pam_antagonist.report.result import Result
from pam_antagonist.rig import Rig
from pam_antagonist.shown import number

_POINTS = 121
_TABLE_STEP = 5.0  # between two rows of the table [°]
_FREQUENCIES, _DAMPING = (0.25, 0.5, 1.0, 2.0, 4.0), (0.0, 0.25, 0.5)
"""[Hz], [N m s/rad] Frequencies and dampings of the table of torques to which a joint yields."""


@dataclass(frozen=True, eq=False, repr=False)
class ReachableResult(Result):
    """The reachable set: angles of rest and torques at angle 0 with the least and largest stiffness at each."""

    rig: Rig
    box: Box  # bounds of pressures and of the force
    angles: tuple[float, float]  # lowest and highest angle of rest (2,) [rad]
    torques: tuple[float, float]  # lowest and highest torque at angle 0 (2,) [N m]
    angle: NDArray[np.float64]  # angles of rest (N,) [rad]
    softest: NDArray[np.float64]  # least stiffness at each (N,) [N m/rad]
    stiffest: NDArray[np.float64]  # largest stiffness at each (N,) [N m/rad]
    torque: NDArray[np.float64]  # torques at angle 0 (N,) [N m]
    torque_softest: NDArray[np.float64]  # least stiffness at each (N,) [N m/rad]
    torque_stiffest: NDArray[np.float64]  # largest stiffness at each (N,) [N m/rad]

    @classmethod
    def of(cls, rig: Rig, box: Box) -> ReachableResult:
        """Compute the reachable set of a rig, within bounds of pressures and forces."""
        reach = Reachable(rig.parameters(), box)
        torques = reach.torques(0.0)
        angle, torque = np.linspace(*reach.angles, _POINTS), np.linspace(*torques, _POINTS)
        at_angle = [reach.at_angle(float(value)) for value in angle]
        at_torque = [reach.at_torque(float(value), 0.0) for value in torque]
        return cls(
            rig, box, reach.angles, torques,
            angle, np.array([each.softest for each in at_angle]), np.array([each.stiffest for each in at_angle]),
            torque, np.array([each.softest for each in at_torque]), np.array([each.stiffest for each in at_torque]),
        )  # fmt: skip

    @override
    def to_json(self) -> dict[str, Any]:
        low, high, force = self.box
        given = {"rig": self.rig.name, "lowest_pressure": low, "highest_pressure": high, "least_force": force}
        return given | {item.name: getattr(self, item.name) for item in fields(self)[2:]}

    @override
    def document(self, figures: bool = True) -> Document:
        drawn = _figures(self) if figures else ()
        return page(
            "What a joint can reach", self.rig.name, (*drawn, table(self), *_yielding(self)), "reachable",
            [("Rig", self.rig.name)], verdict=_lede(self),
        )  # fmt: skip


def table(result: ReachableResult) -> Table:
    """Stiffness over the angle, with the pressures at both ends."""
    reach = Reachable(result.rig.parameters(), result.box)
    low, high = (math.degrees(angle) for angle in result.angles)
    inner = [step * _TABLE_STEP for step in range(math.ceil(low / _TABLE_STEP), math.floor(high / _TABLE_STEP) + 1)]
    rows = []
    for degrees in sorted({low, *inner, high}):
        angle = math.radians(degrees)
        at = reach.at_angle(angle)
        ends = [reach.pressures(angle, stiffness) for stiffness in (at.softest, at.stiffest)]
        pressures = [", ".join(f"{pressure * 1e-3:.0f}" for pressure in pair) for pair in ends]
        rows.append((f"{degrees:.1f}", number(at.softest), pressures[0], number(at.stiffest), pressures[1]))
    header = ("angle [°]", "softest [N m/rad]", "at [kPa]", "stiffest [N m/rad]", "at [kPa]")
    return Table(header, tuple(rows), "Stiffness within reach, and the absolute pressures of muscle 1 and 2")


def _yielding(result: ReachableResult) -> tuple[Table, ...]:
    """Largest torques to which the joint yields in mode IMPEDANCE around angle 0; none for pressure regulators."""
    if result.rig.drive != "valve":
        return ()
    rig, box = result.rig, result.box
    middle = Reachable(rig.parameters(), box).at_angle(0.0)
    stiffness = 0.5 * (middle.softest + middle.stiffest)
    rows = [
        (f"{hertz:g}", *(number(largest_torque(rig.parameters(), box, stiffness, each, hertz)) for each in _DAMPING))
        for hertz in _FREQUENCIES
    ]
    header = ("frequency [Hz]", *(f"damping {each:g} N m s/rad" for each in _DAMPING))
    about = f"Largest torque from outside [N m] that the valves follow, yielding with {number(stiffness)} N m/rad"
    return (Table(header, tuple(rows), f"{about}; friction aside"),)


def _figures(report: ReachableResult) -> tuple[Figure, ...]:
    """The set over the angle of rest, and over the torque at angle 0."""
    about = "Lines: the softest and stiffest pressures within the bounds. Beyond their ends nothing is within reach."
    out = []
    for title, axis, x, low, high in (
        ("Angle and stiffness", "Angle of rest [°]", np.degrees(report.angle), report.softest, report.stiffest),
        ("Torque and stiffness, held at angle 0", "Torque [N m]", report.torque, report.torque_softest,
         report.torque_stiffest),
    ):  # fmt: skip
        series = (
            Band("within reach", x, low, high, BAND),
            Line("softest", x, low, MODEL, width=1.8),
            Line("stiffest", x, high, ESTIMATE, width=1.8),
        )
        out.append(Figure(title, about, (Panel(Axis(axis), Axis("Stiffness [N m/rad]", from_zero=True), series, 300),)))
    return tuple(out)


def _lede(report: ReachableResult) -> str:
    low, high = (f"{math.degrees(angle):.1f}" for angle in report.angles)
    lowest, highest, force = report.box
    return (
        f"Rig {report.rig.name} with {lowest * 1e-3:.0f} to {highest * 1e-3:.0f} kPa in its "
        f"muscles and {force:g} N in each at least: it rests at {low} to {high}°, with a stiffness of "
        f"{number(report.softest.min())} to {number(report.stiffest.max())} N m/rad that depends on the angle. "
        f"At angle 0 it gives torques of {report.torques[0]:.2f} to {report.torques[1]:.2f} N m."
    )
