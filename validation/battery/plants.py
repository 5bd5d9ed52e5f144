"""Recordings to try a diagnosis on: a free and a locked minute of a joint whose effects only the seed knows.

Every joint has base parameters scattered by a percent, drawn anew for each recording, effects in another form than the
catalogue's (:mod:`forms`), and sensors with noise and converter as the rig declares them. It is a simulator of
this project, though: agreement with it says nothing about a real joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import scattered
from validation.battery import physics
from validation.battery.form import Deviation
from validation.battery.forms import FORMS

Floats = NDArray[np.float64]
KINDS = ("single", "pair", "none", "foreign", "calibration")
JOINTS = ("free", "locked")
RIG = "shin2022"
SPREAD = 0.01
"""Relative standard deviation of the base parameters [-]."""
DURATION = 60.0
_SUBSTEPS = Deviation().substeps
_FIRST_STAMP_NS = 1_000_000_000_000_000_000
_START_PRESSURE = 450e3
_LOWEST, _HIGHEST, _REST = 4.15, 8.0, 5.5
_VOLTAGE_STEP = 10.0 / 4096
_CLOSE = 1.1
"""A size is right to this factor."""
_ROUNDS = 8


@dataclass(frozen=True)
class Channels:
    """What happens at a joint, before any sensor."""

    angle: Floats  # (N,) [rad]
    pressure: Floats  # absolute (N, 2) [Pa]
    torque: Floats  # (N,) [N m]


@dataclass(frozen=True)
class Case:
    """One joint of the battery."""

    name: str  # such as ``012 leak 1``
    kind: str  # one of ``KINDS``
    effects: tuple[tuple[str, int | None], ...]  # name in the catalogue; muscle 1, 2 or None (both, or no muscle's)
    form: tuple[str, ...]  # how they are written
    seed: int  # of everything that is random in it
    # Of each effect: root mean square, over a minute of the free joint, by which it alone moves the channel that it
    # moves most, in noises of a sample.
    sizes: tuple[float, ...]
    # Whether the effects are adjusted until they have these sizes; otherwise they are the forms' amounts, and right to
    # a factor of about three.
    exact: bool = False
    # What the recordings of a joint with nothing wrong need corrected: a name of ``Corrections`` and its value.
    calibration: tuple[str, float] | None = None

    def recordings(self, duration: float = DURATION) -> tuple[Recording, Recording]:
        """The joint free, then locked at 0°; each of a length [s]."""
        free, locked = (self.recording(joint, duration) for joint in JOINTS)
        return free, locked

    def recording(self, joint: str, duration: float = DURATION) -> Recording:
        """One of them, as its sensors show it."""
        rig = load_rig(RIG)
        voltage = self.voltage(joint, duration)
        true = self.channels(joint, duration)
        sensors = rig.sensors
        rng = self._random(joint, "noise")
        pressure = _measured(true.pressure, sensors.pressure_std, sensors.pressure_step, rng)
        stamps = _FIRST_STAMP_NS + np.rint(np.arange(1, len(voltage) + 1) * rig.sample_period * 1e9).astype(np.int64)
        made = Recording(
            path=Path(f"{self.name} {joint}"),
            stamp_ns=stamps,
            pressure=pressure,
            voltage=voltage,
            angle=_measured(true.angle, sensors.angle_std, sensors.angle_step, rng),
            torque=_measured(true.torque, sensors.torque_std, sensors.torque_step, rng),
        )
        if self.calibration is None:
            return made
        undone: dict[str, Any] = {self.calibration[0]: -self.calibration[1]}
        return Corrections(**undone).applied(made)

    def voltage(self, joint: str, duration: float = DURATION) -> Floats:
        """What is put on the valves (N, 2) [V]."""
        period = load_rig(RIG).sample_period
        time = np.asarray(np.arange(1, round(duration / period) + 1) * period)
        return staircase(time, self._random(joint, "voltage"))

    def channels(self, joint: str, duration: float = DURATION) -> Channels:
        """What happens at the joint."""
        period = load_rig(RIG).sample_period
        return _played(self.parameters(joint), self.voltage(joint, duration), self.deviations(), period)

    def parameters(self, joint: str) -> np.ndarray:
        """Base parameters of the joint in one recording (parameters.SIZE,)."""
        return scattered(load_rig(RIG).parameters(joint), SPREAD, self._random(joint, "base"))

    def deviations(self) -> list[Deviation]:
        """What its effects change."""
        if self.exact or not self.effects:
            return [_of_size(self, index)[0] for index in range(len(self.effects))]
        rng = np.random.default_rng([self.seed, 1])
        return [
            FORMS[name].make(size, muscle, rng)
            for name, size, (_, muscle) in zip(self.form, self.sizes, self.effects, strict=True)
        ]

    @property
    def reached(self) -> tuple[float, ...]:
        """Sizes that the effects really have: a form may be too small or too large for the one that is wanted."""
        if not (self.exact and self.effects):
            return self.sizes
        return tuple(_of_size(self, index)[1] for index in range(len(self.effects)))

    def moved(self, duration: float = DURATION) -> dict[str, float]:
        """How far its effects move each channel, root mean square over the sensor's noise, by ``joint channel``."""
        out = {}
        for joint in JOINTS:
            moved = _apart(self.channels(joint, duration), _bare(self.seed, joint, duration))
            out.update({f"{joint} {name}": value for name, value in moved.items()})
        return out

    def _random(self, joint: str, what: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, JOINTS.index(joint), ("base", "voltage", "noise").index(what), 7])


@lru_cache(maxsize=4)
def _bare(seed: int, joint: str, duration: float) -> Channels:
    """A joint without effects: sizes of many effects are measured against the same."""
    return Case("", "none", (), (), seed, ()).channels(joint, duration)


def _apart(one: Channels, other: Channels) -> dict[str, float]:
    """Root mean squares of the differences, in noises of a sample, by channel."""
    sensors = load_rig(RIG).sensors
    differences = {
        "angle": (one.angle - other.angle) / sensors.angle_std,
        "torque": (one.torque - other.torque) / sensors.torque_std,
        "pressure_1": (one.pressure - other.pressure)[:, 0] / sensors.pressure_std,
        "pressure_2": (one.pressure - other.pressure)[:, 1] / sensors.pressure_std,
    }
    return {name: float(np.sqrt(np.mean(values**2))) for name, values in differences.items()}


@lru_cache(maxsize=16)
def _of_size(case: Case, index: int) -> tuple[Deviation, float]:
    """One of a case's effects with the amount that gives it its size, and the size that it then has."""
    form, muscle, size = FORMS[case.form[index]], case.effects[index][1], case.sizes[index]
    p, voltage, period = case.parameters("free"), case.voltage("free"), load_rig(RIG).sample_period
    without = _bare(case.seed, "free", DURATION)
    amount, tried = size, []
    for _ in range(_ROUNDS):
        amount = min(max(amount, form.smallest), form.largest)
        # The same draws for every amount.
        deviation = form.make(amount, muscle, np.random.default_rng([case.seed, 1, index]))
        reached = max(_apart(_played(p, voltage, [deviation], period), without).values())
        tried.append((abs(np.log(max(reached, 1e-9) / size)), reached, deviation))
        if tried[-1][0] < np.log(_CLOSE):
            break
        # What sticks jumps: no leap further than a factor of three.
        amount *= float(np.clip(size / max(reached, 1e-9), 1.0 / 3.0, 3.0))
    _, reached, deviation = min(tried, key=lambda item: item[0])
    return deviation, reached


def staircase(time: Floats, rng: np.random.Generator) -> Floats:
    """Voltages (N, 2) [V] in pieces of 3 to 7 s: a jump to a random level that is held, or a ramp, in 12 bits."""
    edges, values = [0.0], [rng.uniform(_LOWEST, _HIGHEST, 2) if rng.random() < 0.5 else np.full(2, _REST)]
    while edges[-1] <= time[-1]:
        begin, now = edges[-1], values[-1]
        target = rng.uniform(_LOWEST, _HIGHEST, 2)
        if rng.random() < 0.6:
            edges.append(begin + 1e-6)
            values.append(np.where(rng.random(2) < 0.85, target, now))
            target = values[-1]
        edges.append(begin + float(rng.uniform(3.0, 7.0)))
        values.append(target)
    table = np.array(values)
    voltage = np.column_stack([np.interp(time, edges, table[:, i]) for i in (0, 1)])
    return np.asarray(np.rint(voltage / _VOLTAGE_STEP) * _VOLTAGE_STEP)


def _measured(values: Floats, std: float, step: float, rng: np.random.Generator) -> Floats:
    noisy = values + std * rng.standard_normal(values.shape)
    return np.asarray(np.rint(noisy / step) * step if step > 0.0 else noisy)


def _played(p: np.ndarray, voltage: Floats, deviations: Sequence[Deviation], period: float) -> Channels:
    """A joint under these voltages."""
    substeps = max((deviation.substeps for deviation in deviations), default=_SUBSTEPS)
    step = period / substeps
    fine = np.asarray(np.arange(len(voltage) * substeps) * step)
    time = np.asarray(np.arange(1, len(voltage) + 1) * period)
    at_valve: Floats = np.repeat(voltage, substeps, axis=0)
    push, supply = np.zeros(len(voltage)), np.zeros(len(voltage))
    numbers: dict[str, float] = {}
    factors: dict[str, float] = {}
    for deviation in deviations:
        numbers.update(deviation.numbers)
        factors.update(deviation.parameters)
        at_valve = at_valve if deviation.voltage is None else deviation.voltage(fine, at_valve)
        push = push if deviation.push is None else push + deviation.push(time)
        supply = supply if deviation.supply is None else supply + deviation.supply(time)
    changes = {name: p[par.INDEX[name]] * factor for name, factor in factors.items()}
    p = par.changed(p, {**changes, "friction.time_step": step})
    q = physics.numbers(numbers)
    angle, pressure, torque = physics.simulate(0.0, _START_PRESSURE, at_valve, push, supply, p, q, period, substeps)
    for deviation in deviations:
        angle = angle if deviation.angle is None else deviation.angle(angle)
        pressure = pressure if deviation.pressure is None else deviation.pressure(time, pressure)
    return Channels(angle, pressure, torque)
