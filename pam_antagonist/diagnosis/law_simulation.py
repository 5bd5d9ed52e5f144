"""What a law does to the recordings when the model runs with it.

The chambers run along the measured motion, the joint along the measured pressures, and the torque along both.

A regression may be misled by a disturbance that moves the very state that seems to explain it; a simulation is not.
Each part of the model runs by itself, so every drive can be judged, and errors of one do not hide those of the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.arguments import operated
from pam_antagonist.diagnosis.law_kernels import driven_angles, imposed_torque
from pam_antagonist.model import command_driven, sensor
from pam_antagonist.model import parameters as par
from pam_antagonist.model.parameters import LONGEST_STEP
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law

Floats = NDArray[np.float64]

_SMOOTH_S = 0.010
_BLOCK_S = 0.010
_FINEST_S = 0.002
_SLOPE_S = 0.015
_ANEW_S = 1.0
"""[s] The joint's motion starts anew so often: a joint that sticks goes elsewhere after the least error."""
_LONGEST = 2.0 * LONGEST_STEP
CHANNELS = ("pressure 1", "pressure 2", "torque", "angle")
PARTS = ("air", "torque", "angle")


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
    """The stretches of a recording, ready to be simulated. Rows closer than about 2 ms become one.

    Args:
        stretches: arrays (N,) or (N, 2) by name, as of
            :func:`~pam_antagonist.diagnosis.residual_equations.equations`.
        period: of the samples [s].
        locked: whether the joint was held.
    """
    width = smoothing(period)
    merged = max(int(_FINEST_S / period + 1e-6), 1)
    size = max(round(_BLOCK_S / (period * merged)), 1)
    out = []
    for part in stretches:
        count = len(part["time"]) // (size * merged) * size * merged
        if count < 10 * size * merged:
            continue
        cut = {key: np.asarray(values)[:count] for key, values in part.items()}
        cut["smooth"] = np.column_stack([smoothed(column, width) for column in cut["pressure"].T])
        cut["angle_smooth"] = smoothed(cut["angle"], width)
        rows = {key: v.reshape(-1, merged, *v.shape[1:]).mean(axis=1) for key, v in cut.items()}
        columns = np.column_stack([rows["pressure"], rows["torque"], rows["angle"]])
        measured = columns.reshape(-1, size, 4).mean(axis=1)
        out.append(
            Course(
                rows["time"],
                rows["smooth"],
                rows["command"],
                rows["angle_smooth"],
                measured,
                size,
                size * merged,
                locked,
            )
        )
    return out


def smoothing(period: float) -> int:
    """Samples over which measured pressures and angles are averaged."""
    return 2 * int(0.5 * _SMOOTH_S / period) + 1


def smoothed(values: Floats, width: int) -> Floats:
    """Means around each sample (N,)."""
    if width < 3:
        return values
    half = width // 2
    padded = np.concatenate([np.repeat(values[:1], half), values, np.repeat(values[-1:], half)])
    total = np.cumsum(np.concatenate([np.zeros(1), padded]))
    return np.asarray((total[width:] - total[:-width]) / width)


def misread(law: Law | None, pressure: Floats, angle: Floats, period: float) -> tuple[Floats, Floats]:
    """By how much sensors read too high under a law that stands in no rig: pressures (N, 2) [Pa], angle (N,) [rad].

    Args:
        law: of a sensor or the encoder; None for none.
        pressure: (N, 2) [Pa].
        angle: (N,) [rad].
        period: of the rows [s].
    """
    out, turned = np.zeros(pressure.shape), np.zeros(len(angle))
    fresh = np.arange(len(angle)) == 0

    def value(argument: Floats) -> Floats:
        assert law is not None
        held = operated(argument, law.operator, law.time or law.width, period, fresh)
        return np.asarray(np.interp(held, law.nodes, law.values))

    if law is not None and law.place == "encoder":
        turned = value(angle)
    elif law is not None:
        seen = {"pressure_difference": pressure[:, 0] - pressure[:, 1], "none": np.zeros(len(angle))}
        for i in (0, 1):
            if law.muscle in (i + 1, "both"):
                own = {"pressure": pressure[:, i], "other_pressure": pressure[:, 1 - i], **seen}
                out[:, i] = value(own[law.argument])
    return out, turned


def simulated(course: Course, p: Floats, parts: Sequence[str] = PARTS, law: Law | None = None) -> Floats:
    """Block means of pressures, torque and angle by the model (B, 4); NaN of what was not simulated.

    Args:
        course: the stretch.
        p: parameter vector of a free joint (m,), with all effects and laws.
        parts: what is simulated.
        law: by which sensors read wrongly, and which is not in ``p``.
    """
    out = np.full(course.measured.shape, np.nan)
    period = float(np.median(np.diff(course.time)))
    raised, turned = misread(law, course.pressure, course.angle, period)
    true_angle = course.angle - turned
    whole, begun = np.array([0, len(course.time)]), np.array([True])
    held = p.copy()
    held[par.LOCKED] = 1.0
    behind = sensor.pressures_behind(course.pressure - raised, p) if set(parts) != {"air"} else course.pressure
    if "air" in parts:
        start = sensor.pressures_behind(course.measured[:1, :2] - raised[:1], p)
        shown = command_driven.pressures(whole, start, course.time, course.command, true_angle, held, _LONGEST, begun)
        # By the simulated pressures, which hold none of the noise that is to be explained.
        out[:, :2] = _blocks(sensor.readings(shown, p) + misread(law, shown, true_angle, period)[0], course.size)
    if "torque" in parts and np.isfinite(course.measured[:, 2]).any():
        torque = imposed_torque(course.time, behind, true_angle, course.command, held, _LONGEST)
        out[:, 2] = _blocks(torque, course.size)
    if "angle" in parts and not course.locked:
        free = p.copy()
        free[par.LOCKED] = 0.0
        reach = max(round(_SLOPE_S / period), 1)
        velocity = np.zeros(len(course.time))
        velocity[reach:-reach] = (true_angle[2 * reach :] - true_angle[: -2 * reach]) / (2.0 * reach * period)
        anew = np.arange(len(course.time)) % max(round(_ANEW_S / period), 2 * reach) == 0
        angle = driven_angles(course.time, behind, true_angle, velocity, anew, free, _LONGEST)
        out[:, 3] = _blocks(angle + misread(law, course.pressure, angle, period)[1], course.size)
    return out


def _blocks(values: Floats, size: int) -> Floats:
    return np.asarray(values.reshape(-1, size, *values.shape[1:]).mean(axis=1))


def errors(
    all_courses: Sequence[Course], p: Floats, rig: Rig, parts: Sequence[str] = PARTS, law: Law | None = None
) -> Floats:
    """Simulated less measured, in noises of a block mean, joined over stretches (B, 4).

    Args:
        all_courses: the stretches.
        p: parameter vector (m,).
        rig: for its sensors.
        parts: what is simulated.
        law: by which sensors read wrongly, and which is not in ``p``.
    """
    error = rig.sensors.error
    noise = np.array([error("pressure"), error("pressure"), error("torque"), max(error("angle"), 1e-5)])
    return np.concatenate(
        [(simulated(one, p, parts, law) - one.measured) * np.sqrt(one.samples) / noise for one in all_courses]
    )
