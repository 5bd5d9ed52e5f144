"""Joints that a monitor watches: sensor-less control by the package's classes, faster than real time, in one process.

Filter, law and commands run at 100 Hz on means of ten samples; physics, sensors' noise and what the monitor gets are at
the rig's own rate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.model_law import ModelController, ModelGains, Seen
from pam_antagonist.control.stiffness import Box
from pam_antagonist.diagnosis.monitor import RATE, slower
from pam_antagonist.diagnosis.monitor_responses import hypotheses
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import drive, dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import rest_pressure, rest_voltage
from pam_antagonist.rig.schema import Reading
from pam_antagonist.simulation.plant import scattered
from validation.sensors import FIRST_STAMP_NS, shown

Floats = NDArray[np.float64]

SPREAD = 0.01
"""Relative standard deviation of the joint's parameters from its rig file."""
GAINS = ModelGains(integral=1.0, approach=0.1)
_SHARE, _LARGEST, _HOLD = 0.6, math.radians(25.0), (2.0, 6.0)
"""Steps of the angle: of what is within reach, at most [rad], and how long each is held [s]."""
_ROUNDS, _CLOSE = 8, 1.05
_WEAKER = tuple(f"muscle_1.force.{name}" for name in ("v1", "v2", "w1", "w2", "c1", "c3"))


class Samples(NamedTuple):
    """What a monitor gets."""

    stamps: NDArray[np.int64]
    pressure: Floats
    voltage: Floats
    angle: Floats


class Joint:
    """A joint that differs from its rig file, under sensor-less control of its angle."""

    def __init__(self, rig: Rig, seed: int, moving: bool, spread: float = SPREAD) -> None:
        self._rig, self._moving, self._rng = rig, moving, np.random.default_rng([seed, moving])
        slow = slower(rig)
        self._every, self.p = round(slow.sample_period / rig.sample_period), rig.parameters()
        self.p = scattered(self.p, spread, np.random.default_rng([seed, 7]))
        self._substeps = integration.substeps_of(rig.sample_period)
        self.p[par.FRICTION_STEP] = rig.sample_period / self._substeps
        box, declared = Box.of(rig.parameters()), slow.parameters()
        self._command = (rest_pressure(rig),) * 2 if rig.drive == "regulator" else rest_voltage(rig)
        self._law = ModelController(
            declared, box, replace(GAINS, bandwidth=min(GAINS.bandwidth, 0.4 * RATE)), sample_period=slow.sample_period,
            limits=VoltageLimits(*rig.command_limits), safe_voltage=self._command,
        )  # fmt: skip
        self._filter = Estimator(slow, "default", "free")
        low, high = Reachable(declared, box).angles
        self._span = min(_SHARE * min(-low, high), _LARGEST)
        self._goal, self._until = 0.0, 0.0
        self.x = _rest(rig, self.p, np.array(self._command), self.p)
        self.time, self.misread = 0.0, 0.0

    def change(self, p: NDArray[np.float64]) -> None:
        """Other parameters from now on; states that they add begin at rest."""
        names, before = par.added_states(p), dict(zip(par.added_states(self.p), self.x[par.BASE_STATES :], strict=True))
        x = equilibrium.initial_state(self.x[0], self.x[2], self.x[3], np.array(self._command), p)
        x[: par.BASE_STATES] = self.x[: par.BASE_STATES]
        for k, name in enumerate(names):
            x[par.BASE_STATES + k] = before.get(name, x[par.BASE_STATES + k])
        self.x, self.p = x, p

    def run(self, seconds: int) -> Samples:
        """The next whole seconds."""
        rig, every, dt = self._rig, self._every, self._rig.sample_period
        count = round(seconds / dt)
        states, voltage = np.empty((count, len(self.x))), np.empty((count, 2))
        noise = self._rng.standard_normal((count, 3))
        pressure, angle = np.empty((count, 2)), np.empty(count)
        begun = round(self.time / dt)
        stamps = FIRST_STAMP_NS + np.rint(np.arange(begun + 1, begun + count + 1) * dt * 1e9).astype(np.int64)
        for first in range(0, count, every):
            rows = slice(first, first + every)
            voltage[rows] = self._command
            driven = np.tile(self._command, (every + 1, 1))
            states[rows] = drive.course(self.x, driven, self.p, dt, self._substeps)[0][1:]
            self.x = states[first + every - 1].copy()
            pressure[rows] = shown(readings(states[rows], self.p), rig.sensors.reading("pressure"), noise[rows, :2])
            self._control(int(stamps[first + every - 1]), pressure[rows].mean(axis=0))
        if rig.encoder is not None:
            angle = states[:, 0] + rig.encoder.offset + self.misread
            angle = shown(angle, Reading(rig.encoder.std, rig.encoder.step), noise[:, 2])
        self.time += seconds
        return Samples(stamps, pressure, voltage, angle)

    def _control(self, stamp: int, pressure: Floats) -> None:
        now = (stamp - FIRST_STAMP_NS) * 1e-9
        if self._moving and now >= self._until:
            self._goal = float(self._rng.uniform(-self._span, self._span))
            self._until = now + float(self._rng.uniform(*_HOLD))
        row = self._filter.step_in_place(stamp, pressure[0], pressure[1], *self._command)
        if row is not None:
            self._command = self._law.step(Mode.ANGLE, self._goal, math.nan, Seen.of(row)).voltage


def _rest(rig: Rig, p: Floats, command: Floats, q: Floats) -> Floats:
    """The state with parameters q at the rest of parameters p."""
    pressure = rest_pressure(rig)
    angle = equilibrium.rest_angle(pressure, pressure, p)
    return np.asarray(equilibrium.initial_state(angle, pressure, pressure, command, q))


def readings(states: Floats, p: Floats) -> Floats:
    """Pressures as the sensors show them without noise (N, 2) [Pa]."""
    gains = [[dynamics.reading(i, value, p) for value in (0.0, 1e5)] for i in (0, 1)]
    return np.column_stack([low + (high - low) * states[:, 2 + i] * 1e-5 for i, (low, high) in enumerate(gains)])


@dataclass(frozen=True)
class Fault:
    """What can come to a running joint. `change`: values that a size of 1 adds to parameters, by dotted path."""

    label: str
    name: str
    muscle: int | None
    change: Mapping[str, float]
    largest: float = math.inf  # size
    misread: float = 0.0  # what a size of 1 adds to the encoder's reading [rad]

    def applied(self, p: Floats, size: float) -> Floats:
        """Parameters with it."""
        return par.changed(p, {path: float(p[par.INDEX[path]]) + size * step for path, step in self.change.items()})


def faults(rig: Rig) -> list[Fault]:
    """Each effect that a monitor watches, of muscle 1 where it is of a muscle; and a muscle that gets weaker."""
    p, out = rig.parameters(), []
    for item in hypotheses(rig, True):
        if item.muscle == 2:
            continue
        change, misread = dict.fromkeys(item.paths, item.step), 0.0 if item.paths else item.step
        out.append(Fault(item.label, item.name, item.muscle, change, item.high / item.step, misread))
    weaker = {path: -0.01 * float(p[par.INDEX[path]]) for path in _WEAKER}
    return [*out, Fault("muscle 1 weaker, share", "weaker", 1, weaker, 50.0)]


def size_of(fault: Fault, noises: float, rig: Rig, minute: Samples) -> float | None:
    """The size that moves a reading by so many noises of a sample; None: no allowed size does.

    Root mean square over a minute of a moving joint under the same voltages, of the reading that it moves most.
    """
    if fault.misread:
        assert rig.encoder is not None
        return noises * rig.encoder.std / fault.misread
    size = 1.0
    for _ in range(_ROUNDS):
        size = min(size, fault.largest)
        reached = _moved(fault, size, rig, minute)
        if abs(math.log(max(reached, 1e-9) / noises)) < math.log(_CLOSE):
            return size
        size *= float(np.clip(noises / max(reached, 1e-9), 0.2, 5.0))
    return size if 0.8 < reached / noises < 1.25 else None


def _moved(fault: Fault, size: float, rig: Rig, minute: Samples) -> float:
    p = rig.parameters()
    p[par.FRICTION_STEP] = rig.sample_period
    found = []
    for q in (p, fault.applied(p, size)):
        x, substeps = _rest(rig, p, minute.voltage[0], q), integration.substeps_of(rig.sample_period)
        states, _ = drive.course(x, minute.voltage, q, rig.sample_period, substeps)
        found.append(np.column_stack([readings(states, q), states[:, 0]]))
    assert rig.encoder is not None
    stds = np.array([rig.sensors.pressure_std] * 2 + [rig.encoder.std])
    moved = float(np.max(np.sqrt(np.mean(((found[1] - found[0]) / stds) ** 2, axis=0))))
    return moved if math.isfinite(moved) else math.inf
