"""The control loop in one process, without ROS: the simulated joint, the filter, and the laws that the node runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.cli.tried_gains import seen
from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.governor import Governor, Limits
from pam_antagonist.control.laws import Laws, Reachable
from pam_antagonist.control.model_law import ModelController
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import dynamics
from pam_antagonist.rig import Rig
from pam_antagonist.simulation.plant import Plant

Floats = NDArray[np.float64]
MISMATCH = 0.02
"""Standard deviation by which each parameter of the simulated joint is off [-]."""


_COLUMNS = {
    "value": 0, "angle": 1, "velocity": 2, "torque": 3, "stiffness": 4, "wanted_stiffness": 5, "estimated_angle": 10,
    "estimated_torque": 11, "push": 12,
}  # fmt: skip


@dataclass(frozen=True)
class Course:
    """What happened in a run; N samples.

    Attributes:
        value: wanted (N,) [rad] or [N m].
        angle: true (N,) [rad].
        velocity: true (N,) [rad/s].
        torque: true (N,) [N m].
        stiffness: −∂τ/∂ψ of the joint itself (N,) [N m/rad].
        wanted_stiffness: (N,) [N m/rad]; NaN: free.
        pressure: true (N, 2) [Pa].
        force: true (N, 2) [N].
        estimated_angle: (N,) [rad].
        estimated_torque: (N,) [N m].
        push: torque from outside (N,) [N m].
        held_back: whether the governor held the reference back (N,).
    """

    value: Floats
    angle: Floats
    velocity: Floats
    torque: Floats
    stiffness: Floats
    wanted_stiffness: Floats
    pressure: Floats
    force: Floats
    estimated_angle: Floats
    estimated_torque: Floats
    push: Floats
    held_back: NDArray[np.bool_]


def make_laws(rig: Rig, name: str, limits: Limits | None = None, level: float = 0.999, push: float = 0.3) -> Laws:
    """The laws of a rig as the node makes them.

    Args:
        rig: that is controlled.
        name: of the law in force.
        limits: for the governor; None: without one.
        level: of the governor.
        push: of the governor [N m].
    """
    p, period = rig.parameters(), rig.sample_period
    box = Box.of(p) if limits is None else limits.inner()
    valves = VoltageLimits(rig.valves.voltage_min, rig.valves.voltage_max)
    governor = None if limits is None else Governor(p, box, limits, level, push)
    pi = PiController(sample_period=period, limits=valves)
    model = ModelController(p, box, sample_period=period, limits=valves)
    return Laws(pi, model, Reachable(p, box), name, governor)


def run(
    rig: Rig,
    laws: Laws,
    wanted: Iterable[Wanted],
    joint: str = "free",
    seed: int = 0,
    mismatch: float = MISMATCH,
    push: Callable[[int], float] = lambda k: 0.0,
    push_is_known: bool = False,
    truth: Rig | None = None,
) -> Course:
    """Run the loop: one sample of the plant, one of the filter, one command.

    Args:
        rig: as declared; the joint is off it.
        laws: of control.
        wanted: the reference at each sample.
        joint: ``free`` or ``locked``.
        seed: of the joint's parameters and the sensors' noise.
        mismatch: standard deviation of the parameters [-].
        push: torque from outside [N m] at sample k.
        push_is_known: whether the law is told of it, as by a torque sensor.
        truth: what the joint is, but for its mismatch; default: as declared.
    """
    plant, estimator = Plant(truth or rig, joint, seed=seed, mismatch=mismatch), Estimator(rig, "default", joint)
    p, period = plant.parameters, round(rig.sample_period * 1e9)
    assert laws.pi is not None  # a rig with valves
    voltage = laws.pi.safe_voltage
    rows = []
    for k, reference in enumerate(wanted):
        outside = push(k)
        sample = plant.step(voltage, outside)
        row = estimator.step((k + 1) * period, *sample.pressure, *sample.voltage)
        assert row is not None  # every sample is newer than the one before
        x = sample.truth
        estimate = seen(row)
        if push_is_known:
            estimate = estimate._replace(external_torque=outside, external_variance=0.0)
        voltage = laws.step(reference, estimate).voltage
        rows.append(
            (
                reference.value, x[0], x[1], dynamics.torque(x, p), -dynamics.torque_slope(x, p), reference.stiffness,
                x[2], x[3], *dynamics.forces(x, p), row["angle"], row["torque"], outside,
                laws.governor is not None and bool(laws.governor.active),
            )
        )  # fmt: skip
    out = np.array(rows, dtype=np.float64)
    columns = {name: out[:, k] for name, k in _COLUMNS.items()}
    return Course(**columns, pressure=out[:, 6:8], force=out[:, 8:10], held_back=out[:, 13] > 0.0)


def held(mode: Mode, parts: Iterable[tuple[float, float, float]], period: float) -> list[Wanted]:
    """References that are held, one a sample.

    Args:
        mode: what the values are.
        parts: seconds, value [rad] or [N m], and stiffness [N m/rad] of each.
        period: of a sample [s].
    """
    return [
        Wanted(mode, value, stiffness=stiffness)
        for seconds, value, stiffness in parts
        for _ in range(math.ceil(seconds / period - 1e-9))
    ]
