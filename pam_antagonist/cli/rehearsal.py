"""A planned experiment on a simulated joint in this process: without ROS, and faster than real time.

The joint is that of the plant node, and so are the limits at which the plan ends. What is not in it is time: delays of
messages, and a computer that is busy.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from pam_antagonist.design import Plan
from pam_antagonist.design.exploration import Program
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import Rig
from pam_antagonist.safety.supervision import RETREAT, TICK, Lookout
from pam_antagonist.simulation.plant import Plant

_FIRST_STAMP_NS = 1_000_000_000_000_000_000


def rehearse(rig: Rig, plan: Plan, program: Program, seed: int, mismatch: float, bag: Path) -> tuple[int, str]:
    """Drive a simulated joint by a program, and write the recording.

    Returns when it began [ns], and in words why it ended early. `plan` says where the joint begins and what its limits
    are. `mismatch` is the standard deviation of the joint's
    parameters from the rig's [-].
    """
    start, period = (plan.pressure, plan.pressure), plan.period
    plant = Plant(rig, plan.joint, plan.lock_angle, seed, mismatch=mismatch, initial_pressure=start)
    lookout, every, ended = Lookout(), max(1, round(TICK / period)), ""
    samples = [plant.step(plan.rest)]
    while (k := len(samples) - 1) * period < program.seconds:
        seen = samples[-1]
        command = program.command(k * period, seen.pressure, seen.angle)
        if command is None:
            break
        samples.append(plant.step(command))
        angle = seen.angle if program.confined else math.nan
        if k % every == 0 and (reason := lookout.ends(plan.limits.broken(seen.pressure, angle))):
            ended = f"after {k * period:.1f} s {reason}"
            samples += [plant.step(plan.rest) for _ in range(round(RETREAT / period))]
            break
    stamps = _FIRST_STAMP_NS + np.rint(np.arange(len(samples)) * period * 1e9).astype(np.int64)
    recording = Recording(
        path=bag,
        stamp_ns=stamps,
        pressure=np.array([sample.pressure for sample in samples]),
        voltage=np.array([sample.voltage for sample in samples]),
        angle=np.array([sample.angle for sample in samples]),
        torque=np.array([sample.torque for sample in samples]),
        angle_sensor=None if rig.encoder is None else np.array([sample.encoder for sample in samples]),
        drive=rig.drive,
    )
    write_bag(bag, recording, pressure_variance=rig.sensors.pressure_std**2)
    return _FIRST_STAMP_NS, ended
