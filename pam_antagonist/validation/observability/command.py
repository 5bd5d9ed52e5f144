"""``observability``: which sensor tells angle and torque from outside, and where.

The empirical observability Gramian: each state of the model is moved a little to either side, and the difference of the
outputs over a second, in standard deviations of their noise, is its column of S. With a prior of each state,
(Sᵀ S + P₀⁻¹)⁻¹ is what could be known of the states at best, by whoever knows the model exactly.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.cli import common
from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import DISTURBANCE
from pam_antagonist.model.effects.external_torque import UNBOUNDED
from pam_antagonist.report import terminal
from pam_antagonist.report.table import Table, number
from pam_antagonist.rig import Rig, load_rig

_DESCRIPTION = """\
Compute how well angle and torque from outside can be known after one second, at best.

Sensors: pressures alone, with an encoder (0.03 deg), and with the angle of an IMU (1 deg). Motion: at rest, and swung
by hand by 0.6 N m at 2 Hz. Chambers: valves open, or sealed with an unknown charge. The standard deviations come from
the empirical observability Gramian of the model. Friction is included; errors of the model are not.
"""
_EXAMPLES = """\
examples:
  {run} observability
"""
SENSORS = {"pressures alone": math.inf, "IMU angle": math.radians(1.0), "encoder": 5e-4}
"""Standard deviation of the measured angle [rad]; infinite: none."""
SECONDS = 1.0
PRESSURES = (300e3, 400e3, 500e3)
"""[Pa] Mean of both muscles, absolute."""
_PRIOR = np.array([math.radians(10.0), 1.0, 20e3, 20e3])  # of angle, velocity and both pressures
_MOVED = np.array([math.radians(0.5), 0.02, 500.0, 500.0, 0.05])  # to either side


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("observability", _DESCRIPTION, _EXAMPLES)
    out.add_argument(
        "--rig",
        default="shin2022_external_torque",
        metavar="RIG",
        help="the rig file (default: shin2022_external_torque)",
    )
    common.add_new_json(out, "the figures")
    out.add_argument(
        "--maps", type=Path, metavar="DIR",
        help="write torque.png and angle.png as well: the same over more angles, beside the filter's own standard "
        "deviations",
    )  # fmt: skip
    return out


def main(argv: list[str] | None = None) -> int:
    """Run the command; the result is its exit status."""
    return common.run(parser, _main, argv)


def _main(arguments: argparse.Namespace) -> int:
    rig = load_rig(arguments.rig)
    found = measure(rig)
    common.show(terminal.table(table(found), indent=""), found, arguments.json)
    if arguments.maps is not None:
        from pam_antagonist.validation.observability import maps

        maps.write(arguments.maps, rig)
        print(f"maps: {arguments.maps / 'torque.png'} and angle.png")
    return common.DONE


def measure(rig: Rig, angles: Sequence[float] = (0.0, 10.0)) -> list[dict[str, Any]]:
    """What can be known, for pressures of 300, 400 and 500 kPa on average.

    Args:
        rig: of whose effects the torque from outside alone counts.
        angles: of the joint [°].

    Returns:
        A row for each place, with the standard deviations of angle [rad] and torque [N m] by sensor.

    Raises:
        BadInput: the rig declares no prior of the torque from outside.
    """
    prior = rig.value(f"effects.{DISTURBANCE}.prior")
    if prior >= UNBOUNDED:
        raise BadInput(
            f"rig {rig.name}: expected effects: external_torque: with a prior in its file, as in "
            "shin2022_external_torque"
        )
    still = {"noise": 1e-6, "prior": prior}  # a torque that stays for the second
    out = []
    for sealed in (False, True):
        valves = rig.valves.replaced(sealed=sealed)
        p = rig.replaced(effects={DISTURBANCE: still}, valves=valves).parameters()
        for common_pressure in PRESSURES:
            for degrees in angles:
                for motion in ("rest", "motion"):
                    where = {"chambers": "sealed" if sealed else "open valves", "pressure": common_pressure}
                    where |= {"angle_deg": degrees, "joint": motion}
                    x0, inputs = place(p, rig, common_pressure, math.radians(degrees), motion == "motion")
                    known = _known(p, rig, x0, inputs, prior)
                    out.append({**where, "std": known})
    return out


def place(
    p: NDArray[np.float64], rig: Rig, middle: float, angle: float, moving: bool, seconds: float = SECONDS
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A joint at rest at an angle, and what then drives it.

    Args:
        p: parameter vector (parameters.SIZE,).
        rig: of the joint.
        middle: mean of both pressures [Pa].
        angle: [rad].
        moving: whether it is swung by hand.
        seconds: how long.

    Returns:
        State (n,), and both voltages and the torque from outside at each sample (N, 3).
    """
    low, high = -250e3, 250e3
    for _ in range(40):
        half = 0.5 * (low + high)
        if equilibrium.rest_angle(middle + half, middle - half, p) < angle:
            low = half
        else:
            high = half
    count = round(seconds / rig.sample_period)
    voltage = np.full((count, 2), 5.5)
    x0 = equilibrium.initial_state(angle, middle + low, middle - low, voltage[0], p)
    if not p[par.VALVE : par.VALVE + 2 * par.VALVE_SIZE].any():
        held = voltage
    else:
        held = np.tile([_holding(i, x0, p) for i in range(2)], (count, 1))
    # In motion, the joint is swung by hand: the torque is known to the model as an input.
    swing = 0.6 * np.sin(2.0 * math.pi * 2.0 * np.arange(count) * rig.sample_period) if moving else np.zeros(count)
    return x0, np.column_stack([held, swing])


def _known(
    p: NDArray[np.float64], rig: Rig, x0: NDArray[np.float64], inputs: NDArray[np.float64], prior: float
) -> dict[str, dict[str, float]]:
    """Standard deviations of angle and torque from outside, by sensor."""

    def outputs(start: NDArray[np.float64]) -> NDArray[np.float64]:
        states, _ = integration.course(start, inputs, p, rig.sample_period, 1)
        return np.asarray(states[:, [2, 3, 0]])

    columns = []
    for k in range(len(x0)):
        step = np.zeros(len(x0))
        step[k] = _MOVED[k]
        columns.append((outputs(x0 + step) - outputs(x0 - step)) / (2.0 * _MOVED[k]))
    slopes = np.stack(columns, axis=-1)
    start = np.diag(1.0 / np.append(_PRIOR, prior) ** 2)
    out = {}
    for name, std in SENSORS.items():
        noise = np.array([rig.sensors.error("pressure")] * 2 + [std])
        scaled = (slopes / noise[None, :, None]).reshape(-1, len(x0))
        known = np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled + start)))
        out[name] = {"angle": float(known[0]), "external_torque": float(known[4])}
    return out


def _holding(i: int, x: NDArray[np.float64], p: NDArray[np.float64]) -> float:
    """The voltage at which the pressure of a muscle at rest stays as it is."""
    low, high, rate = 0.0, 10.0, np.empty(len(x))
    for _ in range(40):
        middle = 0.5 * (low + high)
        dynamics.derivative(x, np.array([middle, middle]), p, rate)
        low, high = (middle, high) if rate[2 + i] < 0.0 else (low, middle)
    return 0.5 * (low + high)


def table(found: Sequence[dict[str, Any]]) -> Table:
    """The figures as a table: one row a place.

    Args:
        found: what :func:`measure` gives.
    """
    rows = []
    for one in found:
        cells = [f"{one['chambers']}, {one['pressure'] / 1e3:.0f} kPa, {one['angle_deg']:.0f}°, {one['joint']}"]
        for known in one["std"].values():
            cells += [number(math.degrees(known["angle"]), 2), number(known["external_torque"], 2)]
        rows.append(tuple(cells))
    header = ["where"]
    for name in SENSORS:
        header += [f"{name}: angle [deg]", "torque [N m]"]
    caption = "Standard deviations of angle and torque from outside after a second, at best"
    return Table(tuple(header), tuple(rows), caption)
