"""Peers that use the model: an extended Kalman filter, filterpy's UKF, and ours before and after close_loop."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_antagonist import BadInput, Recording, Rig, diagnose, load_rig, replay
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model.effects import ADDED_STATES
from pam_antagonist.recording.corrections import Corrections
from validation.peers.joints import Floats, Joint


@dataclass(frozen=True)
class Errors:
    """Errors of an angle on held-out samples."""

    rmse_deg: float  # of all samples together
    coverage: float | None  # share of the samples in their 95 % interval; None where there is none
    alone_deg: float | None = None  # of the model alone, from its inputs only; None where it was not run


def errors(pieces: Sequence[tuple[Floats, Floats, Floats | None]]) -> Errors:
    """Errors of several recordings together: measured, estimated, and its standard deviation where there is one."""
    apart = np.concatenate([estimated - measured for measured, estimated, _ in pieces])
    stds = [std for _, _, std in pieces if std is not None]
    inside = float(np.mean(np.abs(apart) <= 1.96 * np.concatenate(stds))) if stds else None
    return Errors(float(np.degrees(np.sqrt(np.mean(apart**2)))), inside)


def corrected(recording: Recording, rig: Rig) -> Recording:
    """A recording with the calibration of its rig file."""
    return Corrections(**dict(rig.calibration)).applied(recording) if rig.calibration else recording


def ours(joint: Joint, rig: Rig) -> Errors:
    """Our filter with a rig, and the model alone."""
    pieces, alone = [], []
    for recording, begin in joint.held:
        done = replay(corrected(recording, rig), rig, begin_s=begin)
        assert done.recording.angle is not None
        measured = done.recording.angle[done.run.index]
        known = np.isfinite(measured)
        std = np.sqrt(done.run.rows["covariance"][:, 0, 0])
        pieces.append((measured[known], done.run.rows["angle"][known], std[known]))
        angle = done.report.model_alone.angle
        alone.append((len(measured), np.nan if angle is None else angle.rmse))
    found = errors(pieces)
    squares = sum(count * rmse**2 for count, rmse in alone) / sum(count for count, _ in alone)
    return Errors(found.rmse_deg, found.coverage, float(np.sqrt(squares)) if np.isfinite(squares) else None)


def extended(joint: Joint) -> tuple[Rig, str, int]:
    """The rig that close_loop proposes, the verdict in a word, and how many numbers it changed."""
    found: Any = diagnose(joint.fit, joint.rig, jobs=1, profiles=False, estimator=False)
    names = [found.verdict, *dict.fromkeys(effect.name for effect in found.effects)]
    rig = joint.rig
    if found.next_rig is not None:
        with tempfile.TemporaryDirectory() as folder:
            found.save(Path(folder) / "found", figures=False)
            rig = load_rig(Path(folder) / "found" / found.next_rig, regulators=True)
    changed = int(np.sum(rig.parameters() != joint.rig.parameters()))
    return rig, ", ".join(names), changed


def arm(joint: Joint) -> tuple[float, float, int, str]:
    """Ours on held-out episodes, from their pressures: errors [deg] as configured and extended, numbers, effects."""
    found: Any = diagnose(joint.fit[0], joint.rig, held_out=joint.held[0][0], also=joint.also, jobs=1)
    first, *_, last = (float(row.forecast.value) for row in found.found.rows)
    return first, last, len(found.found.values), ", ".join(found.effects)


Filter = Callable[["Model", Recording], tuple[Floats, Floats]]


class Model:
    """The model of a rig as other filters need it: a step of a sample, start, and covariances."""

    def __init__(self, rig: Rig, recording: Recording) -> None:
        self._p, tuning, dt = rig.parameters(), rig.tuning("default"), rig.sample_period
        self._parts = integration.substeps_of(dt)
        self._step = dt / self._parts
        run = Estimator(rig).run(recording.stamp_ns[:2], recording.pressure[:2], recording.voltage[:2])
        added = {state.name: (effect, state) for effect, state in ADDED_STATES}
        states = [added[name] for name in run.added]
        if any(effect == "external_torque" for effect, _ in states):
            raise BadInput(f"{rig.name}: expected a rig without a torque from outside")
        first = recording.pressure[0]
        angle = equilibrium.rest_angle(first[0], first[1], self._p)
        self.start = equilibrium.initial_state(angle, first[0], first[1], recording.voltage[0], self._p)
        self.initial = np.diag([*tuning.initial, *(state.initial_std**2 for _, state in states)])
        noise = (float(state.noise) ** 2 * dt for _, state in states)
        self.process = np.diag([*tuning.process, *(max(value, 1e-18) for value in noise)])
        self.measurement = np.diag(tuning.measurement)
        self.kappa, self.period = tuning.kappa, dt

    def advance(self, x: Floats, u: Floats) -> Floats:
        """The state after a sample."""
        out = x.copy()
        for _ in range(self._parts):
            integration.rk4_step(out, u, self._p, self._step, out)
        return out


def extended_kalman(model: Model, recording: Recording) -> tuple[Floats, Floats]:
    """An extended Kalman filter; derivatives by differences."""
    x, covariance = model.start.copy(), model.initial.copy()
    pick = np.eye(2, len(x), 2)
    small = np.maximum(1e-6 * np.abs(x), np.array([1e-7, 1e-6, 1.0, 1.0, *([1e-6] * (len(x) - 4))]))
    out = np.empty((len(recording), 2))
    for k, (y, u) in enumerate(zip(recording.pressure, recording.voltage, strict=True)):
        if k:
            after = model.advance(x, u)
            slope = np.column_stack([(model.advance(x + small * row, u) - after) / h
                                     for row, h in zip(np.eye(len(x)), small, strict=True)])  # fmt: skip
            x, covariance = after, slope @ covariance @ slope.T + model.process
        if np.isfinite(y).all():
            gain = np.linalg.solve(covariance[2:4, 2:4] + model.measurement, covariance[2:4]).T
            x, keep = x + gain @ (y - x[2:4]), np.eye(len(x)) - gain @ pick
            covariance = keep @ covariance @ keep.T + gain @ model.measurement @ gain.T
        out[k] = x[0], np.sqrt(covariance[0, 0])
    return out[:, 0], out[:, 1]


def filterpy_ukf(model: Model, recording: Recording) -> tuple[Floats, Floats]:
    """The unscented Kalman filter of filterpy."""
    from filterpy.kalman import JulierSigmaPoints, UnscentedKalmanFilter

    n = len(model.start)
    ukf = UnscentedKalmanFilter(n, 2, model.period, hx=lambda x: x[2:4], fx=lambda x, _dt, u: model.advance(x, u),
                                points=JulierSigmaPoints(n, kappa=model.kappa))  # fmt: skip
    ukf.x, ukf.P, ukf.Q, ukf.R = model.start.copy(), model.initial.copy(), model.process, model.measurement
    out = np.empty((len(recording), 2))
    for k, (y, u) in enumerate(zip(recording.pressure, recording.voltage, strict=True)):
        if k:
            ukf.predict(u=u)
            if np.isfinite(y).all():
                ukf.update(y)
        out[k] = ukf.x[0], np.sqrt(max(ukf.P[0, 0], 0.0))
    return out[:, 0], out[:, 1]


def filtered(joint: Joint, rig: Rig, how: Filter) -> Errors:
    """Errors of another filter with a rig."""
    pieces = []
    for recording, begin in joint.held:
        given = corrected(recording, rig)
        assert given.angle is not None
        angle, std = how(Model(rig, given), given)
        counts = (given.stamp_ns - given.stamp_ns[0] >= begin * 1e9) & np.isfinite(given.angle)
        pieces.append((given.angle[counts], angle[counts], std[counts]))
    return errors(pieces)
