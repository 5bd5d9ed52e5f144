"""What a law does to the recordings when the model runs with it, and its values where it does best.

The chambers run along the measured motion, the joint along the measured pressures, and the torque along both. A
regression may be misled by a disturbance that moves the very state that seems to explain it; a simulation is not. Each
part of the model runs by itself, so every drive can be judged, and errors of one do not hide those of the other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from pam_antagonist.diagnosis.law_regression import Regression, operated, roughness
from pam_antagonist.diagnosis.residual_equations import base_groups, with_base
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import TORQUE, Inputs
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.model.effects.places import TABLE
from pam_antagonist.model.parameters import LONGEST_STEP
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, numbers_of

Floats = NDArray[np.float64]

_BLOCK_S = 0.010
_FINEST_S = 0.002
_SLOPE_S = 0.015
_ANEW_S = 1.0
"""[s] The joint's motion starts anew so often: a joint that sticks goes elsewhere after the least error."""
_LONGEST = 2.0 * LONGEST_STEP
_PARTS = ("air", "torque", "angle")
_STEP = 0.05
_TOGETHER = 30.0
"""Blocks that a systematic error of the model makes worth one."""
_FARTHEST = 6.0
"""Standard deviations by which a step moves a base direction at most."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording in which a law is looked for."""

    # without holes, of the part that may be fitted: time [s], pressure (N, 2) [Pa], command (N, 2), angle [rad] and
    # torque [N m] (NaN: none) by name.
    stretches: Sequence[Mapping[str, Floats]]
    period: float  # of its samples [s]
    locked: bool  # whether the joint was held
    p: Floats  # parameter vector of the rig (m,), free


@dataclass(frozen=True, eq=False)
class Course:
    """A stretch of a recording to simulate, pressures and angle as means over about 10 ms."""

    time: Floats
    pressure: Floats
    command: Floats
    angle: Floats
    measured: Floats  # block means of pressures, torque and angle (B, 4); NaN where there are none
    size: int  # rows of a block
    samples: int  # samples of a block
    locked: bool


def courses(subject: Subject) -> list[Course]:
    """The stretches of a recording, ready to be simulated. Rows closer than about 2 ms become one."""
    merged = max(int(_FINEST_S / subject.period + 1e-6), 1)
    size = max(round(_BLOCK_S / (subject.period * merged)), 1)
    out = []
    for part in subject.stretches:
        count = len(part["time"]) // (size * merged) * size * merged
        if count < 10 * size * merged:
            continue
        cut = {key: np.asarray(values)[:count] for key, values in part.items()}
        smooth = {name: smoothed(cut[name], subject.period) for name in ("pressure", "angle")}
        columns = np.column_stack([cut["pressure"], cut["torque"], cut["angle"]])
        time, pressure, command, angle, measured = (
            _blocks(v, merged) for v in (cut["time"], smooth["pressure"], cut["command"], smooth["angle"], columns)
        )
        measured = _blocks(measured, size)
        out.append(Course(time, pressure, command, angle, measured, size, size * merged, subject.locked))
    return out


def _blocks(values: Floats, size: int) -> Floats:
    return np.asarray(values.reshape(-1, size, *values.shape[1:]).mean(axis=1))


def smoothed(values: Floats, period: float) -> Floats:
    """Means over about 10 ms around each sample (N, ...)."""
    return np.asarray(uniform_filter1d(values, 2 * int(0.5 * _BLOCK_S / period) + 1, axis=0, mode="nearest"))


def misread(law: Law | None, pressure: Floats, angle: Floats, period: float) -> tuple[Floats, Floats]:
    """By how much sensors read too high under a law that stands in no rig: pressures (N, 2) [Pa], angle (N,) [rad]."""
    out, turned = np.zeros(pressure.shape), np.zeros(len(angle))
    if law is None:
        return out, turned
    seen = {"angle": angle, "pressure_difference": pressure[:, 0] - pressure[:, 1], "none": np.zeros(len(angle))}
    for i in (0, 1) if law.place == "sensor" else (2,):
        if i < 2:
            seen |= {"pressure": pressure[:, i], "other_pressure": pressure[:, 1 - i]}
        fresh = np.arange(len(angle)) == 0
        held = operated(seen[law.argument], law.operator, law.time or law.width, period, fresh)
        if i == 2:
            turned = np.interp(held, law.nodes, law.values)
        elif law.muscle in (i + 1, "both"):
            out[:, i] = np.interp(held, law.nodes, law.values)
    return out, turned


def simulated(course: Course, p: Floats, parts: Sequence[str] = _PARTS, law: Law | None = None) -> Floats:
    """Block means of pressures, torque and angle by the model (B, 4); NaN of what was not simulated.

    ``p`` is of a free joint, with all effects and laws but one by which sensors read wrongly, which is given apart.
    """
    out = np.full(course.measured.shape, np.nan)
    period = float(np.median(np.diff(course.time)))
    raised, turned = misread(law, course.pressure, course.angle, period)
    angle = course.angle - turned
    if "air" in parts:
        start = dynamics.pressures_behind(course.measured[:1, :2] - raised[:1], p)
        along = Inputs.at(course.time, _LONGEST, command=course.command, motion=angle[:, None])
        shown = along.driven(along.settled(angle[:1], start, p), p)[0][:, 2:4]
        # By the simulated pressures, which hold none of the noise that is to be explained.
        out[:, :2] = _blocks(dynamics.readings(shown, p) + misread(law, shown, angle, period)[0], course.size)
    wanted = {
        "torque": "torque" in parts and bool(np.isfinite(course.measured[:, 2]).any()),
        "angle": "angle" in parts and not course.locked,
    }
    if not any(wanted.values()):
        return out
    behind = dynamics.pressures_behind(course.pressure - raised, p)
    reach = max(round(_SLOPE_S / period), 1)
    velocity = np.zeros(len(course.time))
    if not course.locked:
        velocity[reach:-reach] = (angle[2 * reach :] - angle[: -2 * reach]) / (2.0 * reach * period)
    # The measured pressures have what regulators do.
    p = par.changed(p, NO_REGULATORS)
    given = {"command": course.command, "pressure": behind}
    if wanted["torque"]:
        along = Inputs.at(course.time, _LONGEST, motion=np.column_stack([angle, velocity]), **given)
        out[:, 2] = _blocks(along.driven(along.settled(angle[:1], behind[:1], p), p, TORQUE)[1][0], course.size)
    if wanted["angle"]:
        begin = np.arange(0, len(course.time), max(round(_ANEW_S / period), 2 * reach))
        along = Inputs.at(course.time, _LONGEST, np.append(begin, len(course.time)), **given)
        # What effects and laws remember goes on where the motion is set anew.
        start = along.settled(angle[begin], behind[begin], p, velocity[begin])
        turning = along.driven(start, p, keeps=begin > 0)[0][:, 0]
        out[:, 3] = _blocks(turning + misread(law, course.pressure, turning, period)[1], course.size)
    return out


@dataclass(frozen=True, eq=False)
class Simulated:
    """A law, or none, whose values and base were fitted in a simulation."""

    law: Law | None  # None for none
    excess: Floats  # mean square error over the noise's of each recording and channel: pressures, torque, angle (R, 4)
    left: float  # what is left, on the logarithmic scale on which shares are counted
    amounts: tuple[Floats, ...]  # of the base directions of each recording, in standard deviations
    covariance: Floats = field(default_factory=lambda: np.zeros((0, 0)))  # of the law's values (N, N)
    regression: Regression | None = None  # where it started; None for none


class Simulation:
    """Simulations of the rig's next law with the base of each recording, and fits of both to what was measured."""

    def __init__(self, rig: Rig, subjects: Sequence[Subject], number: int) -> None:
        self.subjects, self.number = subjects, number
        self.groups = base_groups(rig)
        self.courses = [courses(subject) for subject in subjects]
        error = rig.sensors.error
        self.noise = np.array([error("pressure"), error("pressure"), error("torque"), max(error("angle"), 1e-5)])
        self.slopes: list[list[Floats]] = []
        """Of the errors by each base direction, by recording: those that were worked out last."""

    def point(self, r: int, law: Law | None, amounts: Floats) -> Floats:
        """Parameter vector of a recording with a law and moved base directions."""
        p = with_base(self.subjects[r].p, self.groups, amounts)
        if law is None or law.is_of_readings:
            return p
        numbers = numbers_of(law, self.number).items()
        return par.changed(p, {parameter_path("learned", name): value for name, value in numbers})

    def errors(self, r: int, law: Law | None, amounts: Floats, parts: Sequence[str] = _PARTS) -> Floats:
        """Simulated less measured, in noises of a block mean, joined over stretches (B, 4)."""
        p = self.point(r, law, amounts)
        shown = law if law is not None and law.is_of_readings else None
        each = [
            (simulated(one, p, parts, shown) - one.measured) * np.sqrt(one.samples) / self.noise
            for one in self.courses[r]
        ]
        return np.concatenate(each)

    def evaluated(self, law: Law | None, amounts: Sequence[Floats], start: Regression | None = None) -> Simulated:
        """A law as it is."""
        excess = np.full((len(amounts), 4), np.nan)
        for r, own in enumerate(amounts):
            errors = self.errors(r, law, own)
            bounded = np.where(np.isfinite(errors), np.clip(errors, -1e4, 1e4), np.where(np.isnan(errors), np.nan, 1e4))
            there = np.isfinite(bounded).any(axis=0)
            excess[r, there] = np.nanmean(bounded[:, there] ** 2, axis=0)
        # Half the logarithm of the excess is what a channel with an unknown noise loses a block.
        left = float(np.nansum(0.5 * np.log(np.maximum(excess, 1.0))))
        return Simulated(law, excess, left, tuple(amounts), regression=start)

    def fitted(self, start: Simulated, rounds: int, anew: bool = False) -> Simulated:
        """Gauss-Newton on values of the law and base directions; channels weigh by what they have left.

        ``anew``: the slopes by base directions are worked out anew before the first step.
        """
        now, covariance = start, start.covariance
        for number in range(rounds):
            law_step, steps, covariance = self._step(now, anew and number == 0)
            better = False
            for share in (1.0, 0.4, 0.15, 0.05):
                moved = [a + share * s for a, s in zip(now.amounts, steps, strict=True)]
                law = None if now.law is None else _moved(now.law, share * law_step)
                after = self.evaluated(law, moved, start.regression)
                if after.left < now.left:
                    better = now.left - after.left > 1e-3 * max(now.left, 1e-9)
                    now = after
                    break
            if not better:
                break
        return replace(now, covariance=covariance)

    def _slopes(self, r: int, law: Law | None, amounts: Floats) -> list[Floats]:
        now = self.errors(r, law, amounts)
        moves = zip(_STEP * np.eye(len(amounts)), self.groups, strict=True)
        return [(self.errors(r, law, amounts + move, _parts_of(names)) - now) / _STEP for move, (names, _) in moves]

    def _step(self, now: Simulated, anew: bool) -> tuple[Floats, list[Floats], Floats]:
        """A step of the law's values, then of the logarithm of its memory; of the base; and the values' covariance."""
        law, sizes = now.law, [len(a) for a in now.amounts]
        values = np.zeros(0) if law is None else np.array(law.values)
        unit = max(np.max(np.abs(values)), 1e-30) if len(values) else 1.0
        extra = len(values) + int(law is not None and law.operator != "none")
        base, total = sum(sizes), sum(sizes) + extra
        if anew or not self.slopes:
            self.slopes = [self._slopes(r, law, own) for r, own in enumerate(now.amounts)]
        matrix, right, at = np.zeros((total, total)), np.zeros(total), 0
        for r, own in enumerate(now.amounts):
            error = self.errors(r, law, own)
            # What lies above the noise hangs together: it is worth fewer values.
            above = np.maximum(np.nan_to_num(now.excess[r], nan=1.0), 1.0)
            weight = 1.0 / np.sqrt(above * np.minimum(above, _TOGETHER))
            columns = list(self.slopes[r])
            if law is not None:
                for k, move in enumerate(_STEP * np.eye(extra)):
                    moved = _moved(law, move * (unit if k < len(values) else 1.0))
                    columns.append((self.errors(r, moved, own, TABLE[law.place].shown_in) - error) / _STEP)
            jacobian = np.clip(_known(np.array(columns) * weight), -1e6, 1e6).reshape(len(columns), -1)
            where = np.r_[at : at + sizes[r], base:total]
            matrix[np.ix_(where, where)] += jacobian @ jacobian.T
            right[where] -= jacobian @ np.clip(_known(error * weight), -1e3, 1e3).ravel()
            at += sizes[r]
        prior, rows = np.eye(total), slice(base, base + len(values))
        right[:base] -= np.concatenate(now.amounts)
        if len(values):
            scale = np.trace(matrix[rows, rows]) / len(values)
            rough = 1e-4 * scale * roughness(len(values))
            prior[rows, rows] = rough + 1e-6 * max(scale, 1e-9) * np.eye(len(values))
            right[rows] -= rough @ (values / unit)
        inverse = np.linalg.inv(matrix + prior)
        step = inverse @ right
        step *= min(1.0, _FARTHEST / max(float(np.max(np.abs(step[:base]))), 1e-9))
        law_step = step[base:].copy()
        law_step[: len(values)] *= unit
        return law_step, np.split(step[:base], np.cumsum(sizes)[:-1]), inverse[rows, rows] * unit**2


def _known(values: Floats) -> Floats:
    return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)


def _moved(law: Law, step: Floats) -> Law:
    """A law whose values, and then the logarithm of its memory, are moved."""
    count = len(law.values)
    moved = replace(law, values=tuple(float(v) for v in np.array(law.values) + step[:count]))
    if len(step) > count:
        factor = math.exp(min(max(float(step[count]), -0.7), 0.7))
        moved = replace(moved, time=law.time * factor, width=law.width * factor)
    return moved


def _parts_of(names: Sequence[str]) -> tuple[str, ...]:
    """Parts of the model that base parameters act in."""
    if names[0].startswith(("joint.", "friction.")):
        return ("angle",)
    if ".force." in names[0]:
        return ("torque", "angle")
    return _PARTS if names[0].startswith("effects.") else ("air",)
