"""Sensor-less control in one process, and the live nodes around a virtual rig at 1 kHz: recorded and judged."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from pam_antagonist.control.command import PI_MODES, Mode
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.tracking import held, tracking
from pam_antagonist.design.exploration import Planned
from pam_antagonist.estimation import Estimator
from pam_antagonist.nodes.processes import Processes
from pam_antagonist.recording import Recording, read_bag
from pam_antagonist.replays.accounting import STAGES
from pam_antagonist.replays.live import compare_with_live
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import write_rig
from pam_antagonist.simulation.excitation import PAPER_DURATION
from validation.paper.estimates import COMPARED_S
from validation.paper.virtual import JOINT, TUNINGS, Floats, VirtualRig, filtered, judged
from validation.pipeline import running

SCALE = {Mode.ANGLE: math.degrees(1.0), Mode.TORQUE: 1.0}
CONDITION = {Mode.ANGLE: "free", Mode.TORQUE: "locked"}
_REST_S = 2.0
_STEP_S = {Mode.ANGLE: 9.0, Mode.TORQUE: 4.5}
_VALUES = {Mode.ANGLE: (20.0, -20.0, 0.0, 10.0), Mode.TORQUE: (2.0, -2.0, 0.0, 1.0)}
"""Within ±20° and ±2 N m, as in the paper."""


def references(mode: Mode, short: bool = False) -> tuple[list[tuple[float, float]], float]:
    """Steps: time [s] and value [rad or N m]; and the length of the experiment [s]."""
    values = _VALUES[mode][:2] if short else _VALUES[mode]
    steps = [(_REST_S + k * _STEP_S[mode], value / SCALE[mode]) for k, value in enumerate(values)]
    return [(0.0, 0.0), *steps], _REST_S + len(values) * _STEP_S[mode]


def closed_loop(rig: VirtualRig, mode: Mode, tuning: str) -> tuple[Floats, Floats, Floats]:
    """The loop in one process: the classes that the nodes run. Reference, measurement, estimate (N,), in ° or N m."""
    declared, joint = rig.declared, CONDITION[mode]
    steps, seconds = references(mode)
    plant, estimator = rig.plant(joint), Estimator(declared, tuning, joint)
    controller = PiController(sample_period=declared.sample_period)
    at = np.arange(round(seconds / declared.sample_period)) * declared.sample_period
    times, values = np.array(steps).T
    wanted = values[np.searchsorted(times, at, side="right") - 1]
    shown = np.empty((len(at), 2))
    voltage, name = controller.safe_voltage, mode.name.lower()
    period_ns = round(declared.sample_period * 1e9)
    for k, reference in enumerate(wanted.tolist()):
        sample = plant.step(voltage)
        row = estimator.step((k + 1) * period_ns, *sample.pressure, *sample.voltage)
        assert row is not None  # every sample is newer than the one before
        shown[k] = sample.angle if mode is Mode.ANGLE else sample.torque, row[name]
        voltage, _ = controller.step(mode, reference, float(row[name]))
    return wanted * SCALE[mode], *(shown * SCALE[mode]).T


def control(rig: VirtualRig) -> dict[str, float]:
    """Steady-state performance of either mode with both tunings."""
    out = {}
    for mode in PI_MODES:
        for tuning in TUNINGS:
            wanted, measured, _ = closed_loop(rig, mode, tuning)
            stamps = np.arange(len(wanted), dtype=np.int64) * round(rig.declared.sample_period * 1e9)
            found = tracking(stamps, wanted, measured)
            out[f"steady-state performance, {mode.name.lower()}, tuning {tuning}"] = found.performance
    return out


TUNING = {"estimation": "published", "control": "default"}
SECONDS = {"angle": PAPER_DURATION, "torque": COMPARED_S}
"""Lengths of live runs [s]: the whole profile, and the part of it with its extremes."""
_SHORT_S, _LOOP, _COMMAND_TIMEOUT = 30.0, 0.05, 0.5


@contextmanager
def _pipeline(rig: VirtualRig, folder: Path, joint: str, tuning: str, controlled: bool) -> Iterator[Processes]:
    """Everything but who gives commands or references; the bag is in ``folder/bag`` afterwards."""
    folder.mkdir(parents=True)
    about = ["What the plant was; its parameters are scattered in addition."]
    write_rig(rig.actual, folder / "virtual_rig.yaml", about)
    write_rig(rig.declared, folder / "declared_rig.yaml", ["What the estimator was given."])
    declared = {"rig": str((folder / "declared_rig.yaml").resolve())}
    condition: dict[str, object] = {"joint": "free"} if joint == "free" else {"joint": "locked", "lock_angle": 0.0}
    plant: dict[str, object] = {
        **condition, "rig": str((folder / "virtual_rig.yaml").resolve()), "seed": rig.seed,
        "mismatch": rig.size.parameters, "wait_for_subscribers": 2,
    }  # fmt: skip
    if not controlled:
        # A driver that stalls with the machine must not put the safe voltages on the valves in the middle of a step.
        plant["command_timeout"] = _COMMAND_TIMEOUT
    nodes: dict[str, Mapping[str, object]] = {"estimator": {**declared, **condition, "tuning": tuning}}
    nodes |= {"controller": declared} if controlled else {}
    with running(folder, {**nodes, "plant": plant}) as processes:
        yield processes


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
    complete = part.take(np.flatnonzero(np.isfinite(signals).all(axis=1)))
    live = judged(filtered(rig, complete, TUNING["estimation"], joint), complete, rig, quantity)
    return {"samples": float(len(complete)),
            "estimates that a replay repeats bit by bit": compared.equal / compared.compared,
            "samples lost": float(_lost(recording)),
            "time of a filter's step, mean": float(step_times(rig, complete, joint).mean()),
            **{f"live, {key}": value for key, value in live.items()}}  # fmt: skip


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


def control_live(rig: VirtualRig, folder: Path, short: bool) -> dict[str, float]:
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
