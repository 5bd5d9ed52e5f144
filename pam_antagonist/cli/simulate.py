"""Make a recording of a simulated joint: a rosbag2 (MCAP) with the topics of a live one.

The model runs at a finer step than the estimator's. Its sensors are noisy and quantised. With --mismatch, its
parameters differ from the declared ones. It is this package's own model: agreement with it says nothing about a real
joint. The same arguments give the same recording.

examples:
  {run} simulate --rig shin2022 --out my_bag --duration 30
  {run} simulate --rig shin2022 --out my_bag --profile steps --seed 7 --mismatch 0.01 --joint locked
  {run} simulate --rig my_rig.yaml --out my_bag --profile voltages.csv
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.api.simulate import simulate
from pam_antagonist.cli import common
from pam_antagonist.cli.progress import counted
from pam_antagonist.cli.recordings import span
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation import excitation


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("simulate", __doc__)
    out.shared("--rig")
    out.shared("--out", help="folder of the bag; a new one")
    out.option(
        "--profile", f"valve voltages: {', '.join(excitation.PROFILES)} (default: paper), or a CSV file t_s,u1,u2 in s "
        "and V; for a rig with pressure regulators, u1 and u2 are the commanded pressures in Pa",
        None, "paper", "NAME|FILE.csv",
    )  # fmt: skip
    out.option("--duration", "length [s] (default: 130 for paper, 60, or that of the CSV file)", float, metavar="S")
    out.shared("--joint", "--lock-angle", "--seed")
    mismatch = "relative deviation of the joint's parameters from the rig file (default: 0)"
    out.shared("--mismatch", help=mismatch, default=0.0)
    out.shared("--no-noise")
    return out


def _main(arguments: argparse.Namespace) -> int:
    common.check_output(arguments.out)
    rig = load_rig(arguments.rig, regulators=True)
    angle = common.lock_angle(arguments) or 0.0
    voltage = _voltages(arguments, rig)
    with counted(len(voltage), "simulate") as done:
        recording = simulate(
            rig, voltage, joint=arguments.joint, lock_angle=angle, seed=arguments.seed, mismatch=arguments.mismatch,
            noise=not arguments.no_noise, path=arguments.out, progress=done,
        )  # fmt: skip
    with common.output_folder(arguments.out, make=False) as folder:
        write_bag(folder, recording, pressure_variance=rig.sensors.pressure_std**2)
    print(_summary(recording, rig, arguments))
    return common.DONE


def _voltages(arguments: argparse.Namespace, rig: Rig) -> NDArray[np.float64]:
    """Commands of every sample (N, 2) [V] or [Pa], checked against what the rig's valves or regulators may be given."""
    name, duration, period = arguments.profile, arguments.duration, rig.sample_period
    low, high = rig.command_limits
    if duration is not None and not period <= duration <= 86_400.0:
        raise BadInput(f"--duration {duration:g}: expected {period:g} to 86400 s")
    if name in excitation.PROFILES:
        chosen = duration or (excitation.PAPER_DURATION if name == "paper" else 60.0)
        return excitation.for_rig(rig, name, chosen, arguments.seed)
    if not name.endswith(".csv"):
        raise BadInput(f"--profile {name!r}: expected one of {', '.join(excitation.PROFILES)}, or a .csv file")
    time, voltage = excitation.read_table(Path(name))
    outside = np.flatnonzero(((voltage < low) | (voltage > high)).any(axis=1))
    if len(outside):
        what = f"valve voltages, {low:g} to {high:g} V" if rig.drive == "valve" else f"range, {low:g} to {high:g} Pa"
        raise BadInput(f"{name}: row {outside[0] + 2} is outside the rig's {what}")
    return excitation.held(time, voltage, duration or float(time[-1] - time[0]) + period, period)


def _summary(recording: Recording, rig: Rig, arguments: argparse.Namespace) -> str:
    return (
        f"{arguments.out}: {len(recording.stamp_ns)} samples of rig {rig.name}, joint {arguments.joint}\n"
        f"  pressures {span(recording.pressure[:, 0], 1e-3, 'kPa')} and {span(recording.pressure[:, 1], 1e-3, 'kPa')}\n"
        f"  angle {span(recording.angle, np.degrees(1.0), 'deg')}, torque {span(recording.torque, 1.0, 'N m')}\n"
        f"{common.next_command('replay', [arguments.out], f'--rig {arguments.rig} --out DIR')}"
    )


main = common.command(parser, _main)
