"""Sensor-less control: steps of angle and torque on the estimate, with the paper's PI gains."""

from __future__ import annotations

import math

import numpy as np

from pam_antagonist.control.command import PI_MODES, Mode
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.tracking import tracking
from pam_antagonist.estimation import Estimator
from validation.paper.virtual import TUNINGS, Floats, VirtualRig

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
