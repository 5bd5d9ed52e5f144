"""Maps over angle, co-contraction and motion: what can be known at best, beside what the filter claims to know."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.estimator import ANGLE_SENSORS
from pam_antagonist.model import integration
from pam_antagonist.report import figures
from pam_antagonist.report.figure import Figure
from pam_antagonist.report.matplotlib_renderer import picture
from pam_antagonist.report.style import DEEP, PALE
from pam_antagonist.rig import Rig
from pam_antagonist.validation.observability.command import PRESSURES, SECONDS, SENSORS, measure, place

ANGLES = (-10.0, -5.0, 0.0, 5.0, 10.0)
"""[°]"""
_JOINTS = ("rest", "motion")
_COLUMNS = tuple(f"{joint}, {angle:g}°" for joint in _JOINTS for angle in ANGLES)
_ROWS = tuple(f"{pressure * 1e-3:.0f} kPa" for pressure in PRESSURES)
_LARGEST = {"external_torque": 0.5, "angle": 10.0}
"""[N m], [°]: the priors, at which the colours end."""

Floats = NDArray[np.float64]
Grids = dict[str, tuple[Floats, Floats]]


def claimed(rig: Rig) -> Grids:
    """What the filter claims of angle [rad] and torque from outside [N m] within a second, by angle sensor.

    It is the median of the second half: for some milliseconds after the onset of a push, the filter claims nothing.

    Args:
        rig: with the state ``external_torque`` and an encoder.

    Returns:
        Standard deviations, of each (pressures, joints and angles).
    """
    p, rng = rig.parameters(), np.random.default_rng(0)
    out = {
        name: (np.empty((len(_ROWS), len(_COLUMNS))), np.empty((len(_ROWS), len(_COLUMNS)))) for name in ANGLE_SENSORS
    }
    for row, pressure in enumerate(PRESSURES):
        for column, (joint, angle) in enumerate((joint, angle) for joint in _JOINTS for angle in ANGLES):
            x0, inputs = place(p, rig, pressure, math.radians(angle), joint == "motion", SECONDS)
            states, _ = integration.course(x0, inputs, p, rig.sample_period, 1)
            stamps = np.rint(np.arange(1, len(inputs) + 1) * rig.sample_period * 1e9).astype(np.int64)
            measured = states[:, 2:4] + rng.normal(0.0, rig.sensors.error("pressure"), (len(states), 2))
            encoder = states[:, 0] + rng.normal(0.0, SENSORS["encoder"], len(states))
            for name, (of_angle, of_torque) in out.items():
                rows = Estimator(rig, angle_sensor=name).run(stamps, measured, inputs[:, :2], encoder).rows
                late = rows[len(rows) // 2 :]
                of_angle[row, column] = math.sqrt(np.median(late["covariance"][:, 0, 0]))
                of_torque[row, column] = math.sqrt(np.median(late["external_torque_covariance"][:, 3]))
    return out


def at_best(rig: Rig) -> Grids:
    """The same by the Gramian, by chambers and sensor.

    Args:
        rig: with the state ``external_torque`` and a prior of it.
    """
    shape = (len(_ROWS), len(_COLUMNS))
    out: Grids = {}
    for one in measure(rig, ANGLES):
        at = (
            PRESSURES.index(one["pressure"]),
            _JOINTS.index(one["joint"]) * len(ANGLES) + ANGLES.index(one["angle_deg"]),
        )
        for sensor, known in one["std"].items():
            grids = out.setdefault(f"{one['chambers']}, {sensor}", (np.empty(shape), np.empty(shape)))
            grids[0][at], grids[1][at] = known["angle"], known["external_torque"]
    return out


def write(folder: Path, rig: Rig) -> None:
    """Write ``torque.png`` and ``angle.png``.

    Args:
        folder: where to; made where it is not there.
        rig: with the state ``external_torque``, a prior of it, and an encoder.

    Raises:
        BadInput: the folder cannot be made.
    """
    grids = {f"at best: {name}": pair for name, pair in at_best(rig).items()}
    said = {"none": "pressures alone", "encoder": "encoder"}
    grids |= {f"the filter claims: open valves, {said[name]}": pair for name, pair in claimed(rig).items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"{folder}: cannot be made: {error.strerror}") from None
    for name, which, unit in (("torque", 1, "N m"), ("angle", 0, "°")):
        scale = math.degrees(1.0) if which == 0 else 1.0
        largest = _LARGEST["angle" if which == 0 else "external_torque"]
        shown = [(f"{title} [{unit}]", scale * pair[which]) for title, pair in grids.items()]
        panels = figures.matrix(shown, _ROWS, _COLUMNS, (PALE, DEEP), (0.0, largest), "{value:.2g}")
        (folder / f"{name}.png").write_bytes(picture(Figure(f"Standard deviation of the {name}", "", panels, "")))
