"""A live pipeline around a virtual rig: plant, estimator and, where wanted, controller as processes, recorded."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pam_antagonist.control.command import Mode
from pam_antagonist.nodes.processes import Processes, free_domain, ros_arguments
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.rig.write import write_rig
from pam_antagonist.simulation.excitation import PAPER_DURATION
from validation.paper.comparison import COMPARED_S
from validation.paper.result import Context

FULL_S, PART_S, SHORT_S = PAPER_DURATION, COMPARED_S, 30.0
"""Lengths of live runs [s]: the whole profile, the part of it with its extremes, and a short one."""
_DRAIN = 0.3
_LOOP = 0.05
_COMMAND_TIMEOUT = 0.5
"""[s] A driver that stalls with the machine must not put the safe voltages on the valves in the middle of a step."""


@contextmanager
def _domain() -> Iterator[None]:
    """A ROS domain of its own, so that two pipelines cannot hear each other."""
    names = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    before = {name: os.environ.get(name) for name in names}
    os.environ.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _pipeline(context: Context, folder: Path, joint: str, tuning: str, controlled: bool) -> Iterator[Processes]:
    """Everything but who gives commands or references; the bag is in ``folder/bag`` afterwards."""
    rig = context.work.rig
    folder.mkdir(parents=True)
    write_rig(
        rig.actual, folder / "virtual_rig.yaml", ["What the plant was; its parameters are scattered in addition."]
    )
    write_rig(rig.declared, folder / "declared_rig.yaml", ["What the estimator was given."])
    declared: dict[str, object] = {"rig": str((folder / "declared_rig.yaml").resolve())}
    condition: dict[str, object] = {"joint": "free"} if joint == "free" else {"joint": "locked", "lock_angle": 0.0}
    plant: dict[str, object] = {
        **condition,
        "rig": str((folder / "virtual_rig.yaml").resolve()),
        "seed": rig.seed,
        "mismatch": rig.spread,
        "wait_for_subscribers": 2,
    }
    if not controlled:
        plant["command_timeout"] = _COMMAND_TIMEOUT
    with _domain(), Processes(folder) as processes:
        processes.start("record", ["--out", str(folder / "bag")])
        processes.start("estimator", ros_arguments({**declared, **condition, "tuning": tuning}, {}))
        if controlled:
            processes.start("controller", ros_arguments(declared, {}))
        processes.start("plant", ros_arguments(plant, {}))
        try:
            yield processes
        finally:
            # From the source to the sink, so that every sample that was sent is estimated and recorded.
            processes.stop("plant")
            time.sleep(_DRAIN)
            processes.stop(*(("controller",) if controlled else ()), "estimator", "record")


@contextmanager
def _bar(seconds: float, what: str) -> Iterator[Any]:
    from tqdm import tqdm

    look = "{desc}: {percentage:3.0f} %|{bar:20}| {n:.0f}/{total:g} s"
    with tqdm(total=seconds, desc=what, bar_format=look, leave=False, disable=None) as bar:
        yield bar


def estimation(context: Context, joint: str, tuning: str, seconds: float) -> Recording:
    """The profile on the live plant, with the estimator beside it.

    Args:
        context: whose first virtual rig is the plant.
        joint: ``free`` or ``locked``.
        tuning: of the live filter.
        seconds: how much of the profile.

    Raises:
        ProcessFailed: a node has ended or does not start.
    """
    from pam_antagonist.nodes.client import DriveClient, planned

    folder = context.folder / f"online_{joint}"
    period = context.work.rig.declared.sample_period
    voltage = context.work.voltage[: round(seconds / period)]
    with (
        _pipeline(context, folder, joint, tuning, controlled=False) as processes,
        DriveClient(also=("joint_estimate",)) as drive,
    ):

        def missing() -> str:
            drive.send(voltage[0])
            return drive.missing()

        processes.wait(missing)
        with _bar(seconds, f"live, joint {joint}") as bar:
            plan, unlimited = planned(voltage, period), lambda _pressures, _angle: ""
            drive.follow(plan, seconds, voltage[0], unlimited, processes.check, bar.update)
    return _read(folder)


def control(context: Context, mode: Mode, tuning: str, steps: list[tuple[float, float]], seconds: float) -> Recording:
    """Steps of the reference on the live closed loop.

    Args:
        context: whose first virtual rig is the plant.
        mode: what is controlled.
        tuning: of the live filter.
        steps: time [s] and value [rad or N m].
        seconds: length.

    Raises:
        ProcessFailed: a node has ended or does not start.
    """
    from pam_antagonist.nodes.client import ReferenceClient

    name = mode.name.lower()
    folder = context.folder / f"control_{name}"
    joint = "free" if mode is Mode.ANGLE else "locked"
    with _pipeline(context, folder, joint, tuning, controlled=True) as processes, ReferenceClient() as watch:
        processes.wait(watch.missing)
        with _bar(seconds, f"live, {name} control") as bar:
            start = time.monotonic()
            while (elapsed := time.monotonic() - start) < seconds:
                processes.check()
                watch.send(mode, next(value for at, value in reversed(steps) if at <= elapsed))
                bar.update(elapsed - bar.n)
                time.sleep(_LOOP)
    return _read(folder)


def _read(folder: Path) -> Recording:
    """The recording, in memory; the folder with its bag (a megabyte a second) is removed."""
    recording = read_bag(folder / "bag")
    shutil.rmtree(folder)
    return recording
