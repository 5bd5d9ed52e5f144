"""The model alone, driven by recorded inputs, without a filter."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.divergence import diverged_from
from pam_antagonist.model import drive, dynamics, equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig


@dataclass(frozen=True)
class ModelRun:
    """The model alone, driven by recorded voltages; infinite from where it diverges on.

    Attributes:
        angle: (N,) [rad].
        velocity: (N,) [rad/s].
        pressure: simulated readings of the sensors (N, 2) [Pa].
        torque: (N,) [N m].
        subsystem: number σ of the active subsystem (N,).
    """

    angle: np.ndarray
    velocity: np.ndarray
    pressure: np.ndarray
    torque: np.ndarray
    subsystem: np.ndarray


def simulate_model(
    rig: Rig,
    voltage: np.ndarray,
    pressure0: np.ndarray,
    joint: str = "free",
    lock_angle: float = 0.0,
    angle0: float | None = None,
    substeps: int | None = None,
    external_torque: np.ndarray | None = None,
    period: float | None = None,
    further: np.ndarray | None = None,
) -> ModelRun:
    """The model alone: it starts at the first pressures and uses no later measurement, but for its further inputs.

    Args:
        rig: the rig.
        voltage: (N, 2) [V]; row k is held over the step that ends at sample k. A missing row (NaN) holds
            the one before it.
        pressure0: pressures (2,) [Pa] at the first sample.
        joint: ``free`` or ``locked``.
        lock_angle: angle [rad] of a locked joint.
        angle0: angle [rad] of a free joint at the first sample; default: the angle at which a filter would start.
        substeps: Runge-Kutta steps a sample; default: as many as keep each step within 1 ms.
        external_torque: torque from outside (N,) [N m] where it is known.
        period: time from row to row [s]; default: the rig's sample period.
        further: signals and coefficients of weak laws (N, 4 + 15), as of
            :class:`~pam_antagonist.estimation.further.FurtherInputs`; None: the signals' values in the rig file.

    Raises:
        BadInput: the first pressures or voltages are not finite.
    """
    p = rig.parameters(joint, lock_angle)
    every = rig.sample_period if period is None else period
    if substeps is None:
        substeps = integration.substeps_of(every)
        p[par.FRICTION_STEP] = every / substeps
    held = _hold_last(np.array(voltage, dtype=np.float64, order="C"))
    shown = np.asarray(pressure0, dtype=np.float64)
    if not (np.all(np.isfinite(shown)) and np.all(np.isfinite(held))):
        raise BadInput("the model alone needs two finite pressures and voltages to start from")
    if external_torque is not None:
        held = np.column_stack([held, np.nan_to_num(external_torque)])
    if further is not None:
        p[par.SIGNAL : par.SIGNAL + further.shape[1]] = further[0]
    pressures = [dynamics.pressure_behind(i, shown[i], p) for i in (0, 1)]
    if joint == "locked":
        angle = lock_angle
    else:
        angle = equilibrium.start_angle(pressures[0], pressures[1], p) if angle0 is None else angle0
    start = equilibrium.initial_state(angle, pressures[0], pressures[1], held[0], p)
    states, torques, sigma = drive.simulate(start, held, p, every, substeps, further)
    readings = dynamics.readings(states[:, 2:4], p)
    lost = slice(diverged_from(np.column_stack([states[:, :2], torques, readings])), None)
    for column in (states, torques, readings):
        column[lost] = math.inf
    return ModelRun(states[:, 0], states[:, 1], readings, torques, sigma)


def _hold_last(voltage: np.ndarray) -> np.ndarray:
    missing = ~np.all(np.isfinite(voltage), axis=1)
    if missing.any() and not missing.all():
        known = np.where(missing, 0, np.arange(len(voltage)))
        voltage = voltage[np.maximum.accumulate(known)]
    return voltage
