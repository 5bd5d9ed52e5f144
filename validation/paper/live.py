"""The live nodes around a virtual rig at 1 kHz: estimation and sensor-less control, recorded and judged."""

from __future__ import annotations

import math
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pam_antagonist.control.command import PI_MODES, Mode
from pam_antagonist.control.tracking import held, tracking
from pam_antagonist.design.exploration import Planned
from pam_antagonist.estimation import Estimator
from pam_antagonist.nodes.processes import Processes, free_domain, ros_arguments
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays.accounting import STAGES
from pam_antagonist.replays.live import compare_with_live
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.simulation.excitation import PAPER_DURATION
from validation.paper.control import CONDITION, SCALE, references
from validation.paper.estimates import COMPARED_S
from validation.paper.virtual import JOINT, Floats, VirtualRig, filtered, judged, modelled

TUNING = {"estimation": "published", "control": "default"}
SECONDS = {"angle": PAPER_DURATION, "torque": COMPARED_S}
"""Lengths of live runs [s]: the whole profile, and the part of it with its extremes."""
_SHORT_S, _DRAIN, _LOOP, _COMMAND_TIMEOUT = 30.0, 0.3, 0.05, 0.5


@contextmanager
def _pipeline(rig: VirtualRig, folder: Path, joint: str, tuning: str, controlled: bool) -> Iterator[Processes]:
    """Everything but who gives commands or references; the bag is in ``folder/bag`` afterwards."""
    folder.mkdir(parents=True)
    write_rig(
        rig.actual, folder / "virtual_rig.yaml", ["What the plant was; its parameters are scattered in addition."]
    )
    write_rig(rig.declared, folder / "declared_rig.yaml", ["What the estimator was given."])
    declared: dict[str, object] = {"rig": str((folder / "declared_rig.yaml").resolve())}
    condition: dict[str, object] = {"joint": "free"} if joint == "free" else {"joint": "locked", "lock_angle": 0.0}
    plant: dict[str, object] = {
        **condition, "rig": str((folder / "virtual_rig.yaml").resolve()), "seed": rig.seed,
        "mismatch": rig.size.parameters, "wait_for_subscribers": 2,
    }  # fmt: skip
    if not controlled:
        # A driver that stalls with the machine must not put the safe voltages on the valves in the middle of a step.
        plant["command_timeout"] = _COMMAND_TIMEOUT
    # A ROS domain of its own, so that two pipelines cannot hear each other.
    os.environ.setdefault("ROS_DOMAIN_ID", str(free_domain()))
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with Processes(folder) as processes:
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


def _read(folder: Path) -> Recording:
    """The recording, in memory; the folder with its bag (a megabyte a second) is removed."""
    recording = read_bag(folder / "bag")
    shutil.rmtree(folder)
    return recording


def estimation(rig: VirtualRig, folder: Path, joint: str, seconds: float) -> Recording:
    """The profile on the live plant, with the estimator beside it."""
    from pam_antagonist.nodes.client import DriveClient

    period = rig.declared.sample_period
    voltage = rig.voltage[: round(seconds / period)]
    tuning = TUNING["estimation"]
    with (
        _pipeline(rig, folder, joint, tuning, controlled=False) as processes,
        DriveClient(also=("joint_estimate",)) as drive,
    ):

        def missing() -> str:
            drive.send(voltage[0])
            return drive.missing()

        processes.wait(missing)
        plan, unlimited = Planned(voltage, period), lambda _pressures, _angle: ""
        drive.follow(plan.command, plan.seconds, voltage[0], unlimited, processes.check, lambda elapsed: None)
    return _read(folder)


def controlled(rig: VirtualRig, folder: Path, mode: Mode, short: bool) -> Recording:
    """Steps of the reference on the live closed loop."""
    from pam_antagonist.nodes.client import ReferenceClient

    steps, seconds = references(mode, short)
    tuning = TUNING["control"]
    with _pipeline(rig, folder, CONDITION[mode], tuning, controlled=True) as processes, ReferenceClient() as watch:
        processes.wait(watch.missing)
        start = time.monotonic()
        while (elapsed := time.monotonic() - start) < seconds:
            processes.check()
            watch.send(mode, next(value for at, value in reversed(steps) if at <= elapsed))
            time.sleep(_LOOP)
    return _read(folder)


def online(rig: VirtualRig, folder: Path, short: bool) -> dict[str, float]:
    """Errors of the live estimates, bits that a replay repeats, lost samples, and times."""
    out: dict[str, float] = {}
    for quantity, joint in JOINT.items():
        recording = estimation(rig, folder / f"online_{joint}", joint, _SHORT_S if short else SECONDS[quantity])
        found = judge(recording, rig.declared, quantity, joint)
        out |= {f"{quantity}, {key}": value for key, value in found.items()}
    return out


def judge(recording: Recording, rig: Rig, quantity: str, joint: str) -> dict[str, float]:
    """Errors of a live run, and what became of its samples."""
    estimate = recording.estimate
    assert estimate is not None
    # A filter that was started later than the recording began cannot be repeated from its beginning.
    part = recording.slice(float(int(estimate.started_ns[-1]) - recording.stamp_ns[0]) * 1e-9, math.inf)
    run = Estimator(rig, TUNING["estimation"], joint).run(part.stamp_ns, part.pressure, part.voltage)
    compared = compare_with_live(estimate, run)
    assert part.angle is not None and part.torque is not None  # the plant publishes both
    signals = np.column_stack([part.pressure, part.voltage, part.angle, part.torque])
    whole = np.isfinite(signals).all(axis=1)
    complete = Recording(
        path=part.path, stamp_ns=part.stamp_ns[whole], pressure=part.pressure[whole], voltage=part.voltage[whole],
        angle=part.angle[whole], torque=part.torque[whole],
    )  # fmt: skip
    step = step_times(rig, complete, joint)
    out = {"samples": float(len(complete)),
           "estimates that a replay repeats bit by bit": compared.equal / compared.compared,
           "samples lost": float(_lost(recording)),
           "time of a filter's step, mean": float(step.mean()),
           "time of a filter's step, 99 %": float(np.quantile(step, 0.99)),
           "time of a filter's step, largest": float(step.max())}  # fmt: skip
    tracks = {"live": filtered(rig, complete, TUNING["estimation"], joint),
              "replayed with tuning default": filtered(rig, complete, "default", joint),
              "model alone": modelled(rig, complete, joint)}  # fmt: skip
    for name, track in tracks.items():
        out |= {f"{name}, {key}": value for key, value in judged(track, complete, rig, quantity).items()}
    return out


def _lost(recording: Recording) -> int:
    """Messages that are missing where all stages have begun and none has ended; nobody commands every sample here."""
    stamps = [recording.received_ns[stage].stamp_ns for stage in STAGES if stage != "valve_command"]
    low, high = max(stamp[0] for stamp in stamps), min(stamp[-1] for stamp in stamps)
    expected = round((high - low) * 1e-9 / recording.sample_period_s) + 1
    return sum(expected - int(np.count_nonzero((stamp >= low) & (stamp <= high))) for stamp in stamps)


def step_times(rig: Rig, recording: Recording, joint: str) -> Floats:
    """What every step of the filter takes, called sample by sample as the node calls it (N,) [ms]."""
    estimator, clock = Estimator(rig, TUNING["estimation"], joint), time.perf_counter_ns
    samples = zip(recording.stamp_ns.tolist(), recording.pressure.tolist(), recording.voltage.tolist(), strict=True)
    took = []
    for stamp, (p1, p2), (u1, u2) in samples:
        begin = clock()
        estimator.step(stamp, p1, p2, u1, u2)
        took.append(clock() - begin)
    return np.array(took) * 1e-6


def control(rig: VirtualRig, folder: Path, short: bool) -> dict[str, float]:
    """Steady-state performance of either mode, live."""
    out = {}
    for mode in PI_MODES:
        name = mode.name.lower()
        recording = controlled(rig, folder / f"control_{name}", mode, short)
        reference, measured = recording.reference, recording.angle if mode is Mode.ANGLE else recording.torque
        assert reference is not None and measured is not None  # the pipeline has both
        values = np.where(reference.mode == mode, reference.value, np.nan)
        wanted = held(recording.stamp_ns, reference.stamp_ns, values)
        found = tracking(recording.stamp_ns, wanted * SCALE[mode], measured * SCALE[mode])
        out[f"steady-state performance, {name}"] = found.performance
    return out
