"""A planned experiment on a simulated joint in this process: without ROS, and faster than real time.

The joint is that of the plant node, and so are the limits at which the plan ends. What is not in it is time: delays of
messages, and a computer that is busy.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from pam_antagonist.design import Limits, Plan
from pam_antagonist.design.exploration import Program
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import Rig
from pam_antagonist.rig.limits import vented
from pam_antagonist.safety.supervision import RETREAT, TICK, Lookout
from pam_antagonist.simulation.plant import Plant, PlantSample

_FIRST_STAMP_NS = 1_000_000_000_000_000_000


def rehearse(rig: Rig, plan: Plan, seed: int, mismatch: float, bag: Path) -> tuple[int, str]:
    """Drive a simulated joint by a plan, and write the recording: when it began [ns], and in words why it ended early.

    ``mismatch`` is the standard deviation of the joint's parameters from the rig's [-].
    """
    start = (plan.pressure, plan.pressure)
    plant = Plant(rig, plan.joint, plan.lock_angle, seed, mismatch=mismatch, initial_pressure=start)
    lookout, every = Lookout(), max(1, round(TICK / plan.period))
    samples: list[PlantSample] = []
    rest, ended, left = np.array(plan.rest), "", len(plan.voltage)
    while left:
        k = len(samples)
        sample = plant.step(rest if ended else plan.voltage[k])
        samples.append(sample)
        left -= 1
        if ended or k % every:
            continue
        if reason := lookout.ends(plan.limits.broken(sample.pressure, sample.angle)):
            ended, left = f"after {k * plan.period:.1f} s {reason}", round(RETREAT / plan.period)
    _write(rig, samples, plan.period, bag)
    return _FIRST_STAMP_NS, ended


def explore(
    rig: Rig, program: Program, limits: Limits, seed: int, mismatch: float, bag: Path
) -> tuple[list[PlantSample], str]:
    """Drive a simulated joint by what is measured of it, from muscles without air on, and write the recording."""
    least, command = vented(rig)
    plant = Plant(rig, seed=seed, mismatch=mismatch, initial_pressure=(least, least))
    samples: list[PlantSample] = []
    period, ended = rig.sample_period, ""
    lookout, every = Lookout(), max(1, round(TICK / period))
    while len(samples) * period < program.seconds:
        samples.append(plant.step(command))
        seen, k = samples[-1], len(samples) - 1
        given = program.command(k * period, seen.pressure, seen.angle)
        if given is None:
            break
        command = given
        angle = seen.angle if program.confined else math.nan
        if k % every == 0 and (reason := lookout.ends(limits.broken(seen.pressure, angle))):
            ended = f"after {k * period:.1f} s {reason}"
            break
    _write(rig, samples, period, bag)
    return samples, ended


def _write(rig: Rig, samples: list[PlantSample], period: float, bag: Path) -> None:
    stamps = _FIRST_STAMP_NS + np.rint(np.arange(1, len(samples) + 1) * period * 1e9).astype(np.int64)
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
