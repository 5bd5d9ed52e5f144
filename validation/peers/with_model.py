"""Peers that use the model: other filters, laws fitted to what a step of it leaves, and ours."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import savgol_filter

from pam_antagonist import BadInput, Recording, Rig, diagnose, identify, load_rig, replay
from pam_antagonist.estimation import Estimator
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model.effects import ADDED_STATES
from pam_antagonist.model.parameters import BASE_STATES
from pam_antagonist.recording.corrections import Corrections
from validation.peers.joints import Floats, Joint, held_on
from validation.peers.soft_sensors import Process

_STEP, _SMOOTH_S, _GP_POINTS = 0.01, 0.05, 300
_SCALE = np.array([0.1, 0.5, 1e5, 1e5])
Errors = dict[str, "float | None"]
Law = Callable[[Floats], Floats]
"""From features (N, 6) to rates of velocity and pressures beside the model's (N, 3), in their scales."""


def errors(pieces: Sequence[tuple[Floats, Floats, Floats | None]]) -> Errors:
    """Errors of several recordings together: measured, estimated, and its standard deviation where there is one.

    Returns the RMS error of the angle [deg], and the share of the samples in their 95 % interval.
    """
    apart = np.concatenate([estimated - measured for measured, estimated, _ in pieces])
    stds = [std for _, _, std in pieces if std is not None]
    inside = float(np.mean(np.abs(apart) <= 1.96 * np.concatenate(stds))) if stds else None
    return {"rmse_deg": float(np.degrees(np.sqrt(np.mean(apart**2)))), "coverage": inside}


def corrected(recording: Recording, rig: Rig) -> Recording:
    """A recording with the calibration of its rig file."""
    return Corrections(**dict(rig.calibration)).applied(recording) if rig.calibration else recording


def ours(joint: Joint, rig: Rig) -> Errors:
    """Our filter with a rig, and the model alone (``alone_deg``)."""
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
    squares = sum(count * rmse**2 for count, rmse in alone) / sum(count for count, _ in alone)
    return {**errors(pieces), "alone_deg": float(np.sqrt(squares)) if np.isfinite(squares) else None}


def extended(joint: Joint) -> tuple[Rig, str, int]:
    """The rig that close_loop proposes, the verdict in a word, and how many numbers it changed."""
    found: Any = diagnose(joint.fit, joint.rig, jobs=1, profiles=False, estimator=False)
    names = [found.verdict, *dict.fromkeys(effect.name for effect in found.effects)]
    rig = joint.rig
    if found.next_rig is not None:
        with tempfile.TemporaryDirectory() as folder:
            found.save(Path(folder) / "found", figures=False)
            rig = load_rig(Path(folder) / "found" / found.next_rig, regulators=True)
    return rig, ", ".join(names), int(np.sum(rig.parameters() != joint.rig.parameters()))


def arm(joint: Joint) -> tuple[float, float, int, str]:
    """Ours on held-out episodes, from their pressures: errors [deg] as configured and extended, numbers, effects."""
    found: Any = diagnose(joint.fit[0], joint.rig, held_out=joint.held[0][0], also=joint.also, jobs=1)
    first, *_, last = (float(row.forecast.value) for row in found.found.rows)
    return first, last, len(found.found.values), ", ".join(found.effects)


class Model:
    """The model of a rig as others need it: a step of a sample, start, and covariances."""

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

    def advance(self, x: Floats, u: Floats, samples: int = 1) -> Floats:
        """The state after some samples."""
        out = x.copy()
        for _ in range(samples * self._parts):
            integration.rk4_step(out, u, self._p, self._step, out)
        return out


Filter = Callable[[Model, Recording], tuple[Floats, Floats]]
"""From a recording to angles (N,) and their standard deviations (N,) [rad]."""


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


# Laws fitted to residual equations. The corrected model runs freely from the voltages, as the model alone of ours does.


def base(joint: Joint) -> Rig:
    """The rig that identify finds: no effects are looked for."""
    if joint.rig.drive != "valve":
        raise BadInput("residual equations: expected a joint with valves")
    return identify(joint.fit, joint.rig, jobs=1).rig


def free_run(joint: Joint, rig: Rig, fitted: Callable[[Floats, Floats], tuple[Law, int]]) -> tuple[Errors, int]:
    """Error of the angle in free runs with a law that was fitted, and how many numbers the law has."""
    every = max(1, round(_STEP / rig.sample_period))
    seconds = every * rig.sample_period

    def prepared(recording: Recording) -> tuple[Model, Floats, Floats, Floats]:
        """The base model; states, voltages and stamps at the steps' ends; the velocity by a smoothing derivative."""
        given = corrected(recording, rig)
        model = Model(rig, given)
        if len(model.start) != BASE_STATES:
            raise BadInput("residual equations: expected a model without states of effects")
        assert given.angle is not None
        signals = held_on(np.column_stack([given.angle, given.pressure, given.voltage]))
        window = max(5, 2 * round(_SMOOTH_S / rig.sample_period / 2) + 1)
        velocity = savgol_filter(signals[:, 0], window, 2, deriv=1, delta=rig.sample_period)
        smooth = savgol_filter(signals[:, :3], window, 2, axis=0)
        x, rows = np.column_stack([smooth[:, 0], velocity, smooth[:, 1:]]), slice(every - 1, None, every)
        return model, x[rows], signals[rows, 3:], (given.stamp_ns - given.stamp_ns[0])[rows]

    xs, ys = [], []
    for recording in joint.fit:
        model, x, u, _ = prepared(recording)
        after = np.array([model.advance(one, drive, every) for one, drive in zip(x[:-1], u[1:], strict=True)])
        xs.append(_features(x[:-1], u[1:]))
        ys.append(((x[1:] - after) / seconds / _SCALE)[:, 1:])
    law, numbers = fitted(np.vstack(xs), np.vstack(ys))
    pieces: list[tuple[Floats, Floats, Floats | None]] = []
    low, high = np.array([-np.pi, -50.0, 5e4, 5e4]), np.array([np.pi, 50.0, 1.5e6, 1.5e6])
    for recording, begin in joint.held:
        model, x, u, stamps = prepared(recording)
        run = np.empty_like(x)
        run[0] = x[0]
        for k in range(1, len(x)):
            extra = np.clip(law(_features(run[k - 1 : k], u[k : k + 1]))[0], -1e3, 1e3)
            after = model.advance(run[k - 1], u[k], every) + np.concatenate([[0.0], extra]) * seconds * _SCALE
            run[k] = np.clip(after, low, high)
        counts = stamps >= begin * 1e9
        pieces.append((x[counts, 0], run[counts, 0], None))
    return errors(pieces), numbers


def _features(x: Floats, u: Floats) -> Floats:
    return np.column_stack([x / _SCALE, u])


def sindy(x: Floats, y: Floats) -> tuple[Law, int]:
    """PySINDy: polynomials of second degree, sequentially thresholded least squares."""
    import pysindy

    library = pysindy.PolynomialLibrary(degree=2)
    columns = np.asarray(library.fit_transform(pysindy.AxesArray(x, {"ax_sample": 0, "ax_coord": 1})))
    size = columns.std(axis=0) + 1e-9
    optimizer = pysindy.STLSQ(threshold=0.05 * float(y.std(axis=0).max()), alpha=1e-3)
    optimizer.fit(columns / size, y)
    weights = np.asarray(optimizer.coef_).T / size[:, None]
    powers = np.asarray(library.powers_)
    return lambda z: np.prod(z[:, None, :] ** powers, axis=2) @ weights, int(np.count_nonzero(weights))


def gaussian(x: Floats, y: Floats) -> tuple[Law, int]:
    """A Gaussian process for each rate."""
    parts = [Process(x, y[:, k], _GP_POINTS) for k in range(y.shape[1])]
    return lambda z: np.column_stack([part.mean(z) for part in parts]), min(len(x), _GP_POINTS) * (x.shape[1] + 3)
