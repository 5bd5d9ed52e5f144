"""What a law does to the recordings when the model runs with it: the chambers along the measured motion, the joint
along the measured pressures, and the torque along both.

A regression may be misled by a disturbance that moves the very state that seems to explain it; a simulation is not.
Each part of the model runs by itself, so every drive can be judged, and errors of one do not hide those of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.model import command_driven, dynamics, equilibrium, integration, pressure_driven, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, PRESSURE_2, VELOCITY
from pam_antagonist.model.integration import STAGES
from pam_antagonist.model.parameters import FRICTION_STEP, LONGEST_STEP
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_rk4_step, _initial_state, _torque = integration.rk4_step_within, equilibrium.initial_state, dynamics.torque
_SMOOTH_S = 0.010
_BLOCK_S = 0.010
_FINEST_S = 0.002
_LONGEST = 2.0 * LONGEST_STEP
CHANNELS = ("pressure 1", "pressure 2", "torque", "angle")
PARTS = ("air", "torque", "angle")


@kernel
def _imposed(time, pressure, angle, command, p, longest):
    """Torque of the muscles along measured pressures and angle, with all states that effects add (N,) [N m]."""
    p = p.copy()
    x = _initial_state(angle[0], pressure[0, 0], pressure[0, 1], command[0], p)
    scratch, out = np.empty((STAGES + 1, x.shape[0])), np.empty(time.shape[0])
    for k in range(time.shape[0]):
        if k > 0:
            dt = time[k] - time[k - 1]
            steps = max(1, int(np.ceil(dt / longest - 0.1)))
            p[FRICTION_STEP] = dt / steps
            for s in range(steps):
                share = (s + 0.5) / steps
                x[ANGLE] = angle[k - 1] + share * (angle[k] - angle[k - 1])
                x[VELOCITY] = (angle[k] - angle[k - 1]) / dt
                for i in range(2):
                    x[PRESSURE_1 + i] = pressure[k - 1, i] + share * (pressure[k, i] - pressure[k - 1, i])
                _rk4_step(x, command[k], p, dt / steps, x, scratch)
        x[ANGLE], x[PRESSURE_1], x[PRESSURE_2] = angle[k], pressure[k, 0], pressure[k, 1]
        out[k] = _torque(x, p)
    return out


@dataclass(frozen=True, eq=False)
class Course:
    """A stretch of a recording to simulate.

    Attributes:
        time: (N,) [s].
        pressure: measured, as a mean over about 10 ms (N, 2) [Pa].
        command: (N, 2).
        angle: a mean over about 10 ms (N,) [rad].
        measured: block means of pressures, torque and angle (B, 4); NaN where there are none.
        size: rows of a block.
        samples: samples of a block.
        locked: whether the joint was held.
    """

    time: Floats
    pressure: Floats
    command: Floats
    angle: Floats
    measured: Floats
    size: int
    samples: int
    locked: bool


def courses(stretches: Sequence[Mapping[str, Floats]], period: float, locked: bool) -> list[Course]:
    """The stretches of a recording, ready to be simulated; arguments as of
    :func:`~pam_antagonist.diagnosis.residual_equations.equations`. Rows closer than about 2 ms become one."""
    width = 2 * int(0.5 * _SMOOTH_S / period) + 1
    merged = max(int(_FINEST_S / period + 1e-6), 1)
    size = max(round(_BLOCK_S / (period * merged)), 1)
    out = []
    for part in stretches:
        count = len(part["time"]) // (size * merged) * size * merged
        if count < 10 * size * merged:
            continue
        cut = {key: np.asarray(values)[:count] for key, values in part.items()}
        cut["smooth"] = np.column_stack([_smoothed(column, width) for column in cut["pressure"].T])
        cut["angle_smooth"] = _smoothed(cut["angle"], width)
        rows = {key: v.reshape(-1, merged, *v.shape[1:]).mean(axis=1) for key, v in cut.items()}
        columns = np.column_stack([rows["pressure"], rows["torque"], rows["angle"]])
        measured = columns.reshape(-1, size, 4).mean(axis=1)
        out.append(
            Course(rows["time"], rows["smooth"], rows["command"], rows["angle_smooth"], measured, size, size * merged, locked)
        )
    return out


def _smoothed(values: Floats, width: int) -> Floats:
    if width < 3:
        return values
    half = width // 2
    padded = np.concatenate([np.repeat(values[:1], half), values, np.repeat(values[-1:], half)])
    total = np.cumsum(np.concatenate([np.zeros(1), padded]))
    return np.asarray((total[width:] - total[:-width]) / width)


def simulated(course: Course, p: Floats, parts: Sequence[str] = PARTS) -> Floats:
    """Block means of pressures, torque and angle by the model (B, 4); NaN of what was not simulated.

    Args:
        course: the stretch.
        p: parameter vector of a free joint, with all effects and laws.
        parts: what is simulated.
    """
    out = np.full(course.measured.shape, np.nan)
    whole, anew = np.array([0, len(course.time)]), np.array([True])
    held = p.copy()
    held[par.LOCKED] = 1.0
    behind = sensor.pressures_behind(course.pressure, p) if set(parts) != {"air"} else course.pressure
    if "air" in parts:
        start = sensor.pressures_behind(course.measured[:1, :2], p)
        shown = command_driven.pressures(whole, start, course.time, course.command, course.angle, held, _LONGEST, anew)
        out[:, :2] = _blocks(sensor.readings(shown, p), course.size)
    if "torque" in parts and np.isfinite(course.measured[:, 2]).any():
        torque = _imposed(course.time, behind, course.angle, course.command, held, _LONGEST)
        out[:, 2] = _blocks(torque, course.size)
    if "angle" in parts and not course.locked:
        free = p.copy()
        free[par.LOCKED] = 0.0
        start = np.array([[course.measured[0, 3], 0.0]])
        signals = np.zeros((len(course.time), 0))
        angle = pressure_driven.angles(whole, start, course.time, behind, signals, free, _LONGEST)
        out[:, 3] = _blocks(angle, course.size)
    return out


def _blocks(values: Floats, size: int) -> Floats:
    return np.asarray(values.reshape(-1, size, *values.shape[1:]).mean(axis=1))


def errors(all_courses: Sequence[Course], p: Floats, rig: Rig, parts: Sequence[str] = PARTS) -> Floats:
    """Simulated less measured, in noises of a block mean, joined over stretches (B, 4)."""
    error = rig.sensors.error
    noise = np.array([error("pressure"), error("pressure"), error("torque"), max(error("angle"), 1e-5)])
    return np.concatenate(
        [(simulated(one, p, parts) - one.measured) * np.sqrt(one.samples) / noise for one in all_courses]
    )
