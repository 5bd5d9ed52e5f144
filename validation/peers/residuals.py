"""Laws fitted to residual equations: what a step of the identified model leaves, by PySINDy or a Gaussian process.

The corrected model then runs freely from the voltages over what is held out, as the model alone of ours does.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import savgol_filter

from pam_antagonist import BadInput, Recording, Rig, identify
from pam_antagonist.model.parameters import BASE_STATES
from validation.peers.joints import Floats, Joint
from validation.peers.soft_sensors import Process
from validation.peers.with_model import Errors, Model, corrected, errors

_STEP = 0.01
_SMOOTH_S = 0.05
_GP_POINTS = 300
_SCALE = np.array([0.1, 0.5, 1e5, 1e5])
Law = Callable[[Floats], Floats]
"""From features (N, 6) to rates of velocity and pressures beside the model's (N, 3), in their scales."""


def base(joint: Joint) -> Rig:
    """The rig that identify finds: no effects are looked for."""
    if joint.rig.drive != "valve":
        raise BadInput("residual equations: expected a joint with valves")
    return identify(joint.fit, joint.rig, jobs=1).rig


def _states(recording: Recording, every: int, period: float) -> tuple[Floats, Floats, Floats]:
    """States, voltages and stamps at the steps' ends; the velocity by a smoothing derivative."""
    assert recording.angle is not None
    signals = np.column_stack([recording.angle, recording.pressure, recording.voltage])
    # A value that is missing is the one before.
    signals = signals[np.maximum.accumulate(np.where(np.isfinite(signals).all(axis=1), np.arange(len(signals)), 0))]
    window = max(5, 2 * round(_SMOOTH_S / period / 2) + 1)
    angle = savgol_filter(signals[:, 0], window, 2)
    velocity = savgol_filter(signals[:, 0], window, 2, deriv=1, delta=period)
    pressure = savgol_filter(signals[:, 1:3], window, 2, axis=0)
    x = np.column_stack([angle, velocity, pressure])[every - 1 :: every]
    return x, signals[every - 1 :: every, 3:], (recording.stamp_ns - recording.stamp_ns[0])[every - 1 :: every]


class _Stepper:
    """The base model over a step of several samples with its voltage held."""

    def __init__(self, rig: Rig, recording: Recording) -> None:
        self.model = Model(rig, recording)
        self.size = len(self.model.start)
        if self.size != BASE_STATES:
            raise BadInput("residual equations: expected a model without states of effects")
        self.every = max(1, round(_STEP / rig.sample_period))
        self.step = self.every * rig.sample_period

    def __call__(self, x: Floats, u: Floats) -> Floats:
        for _ in range(self.every):
            x = self.model.advance(x, u)
        return x


def free_run(joint: Joint, rig: Rig, fitted: Callable[[Floats, Floats], tuple[Law, int]]) -> tuple[Errors, int]:
    """Error of the angle in free runs with a law that was fitted, and how many numbers the law has."""
    xs, ys = [], []
    for recording in joint.fit:
        given = corrected(recording, rig)
        stepper = _Stepper(rig, given)
        x, u, _ = _states(given, stepper.every, rig.sample_period)
        after = np.array([stepper(one, drive) for one, drive in zip(x[:-1], u[1:], strict=True)])
        xs.append(_features(x[:-1], u[1:]))
        ys.append(((x[1:] - after) / stepper.step / _SCALE)[:, 1:])
    law, numbers = fitted(np.vstack(xs), np.vstack(ys))
    pieces: list[tuple[Floats, Floats, Floats | None]] = []
    for recording, begin in joint.held:
        given = corrected(recording, rig)
        stepper = _Stepper(rig, given)
        x, u, stamps = _states(given, stepper.every, rig.sample_period)
        run = np.empty_like(x)
        run[0] = x[0]
        for k in range(1, len(x)):
            extra = np.clip(law(_features(run[k - 1 : k], u[k : k + 1]))[0], -1e3, 1e3)
            run[k] = stepper(run[k - 1], u[k]) + np.concatenate([[0.0], extra]) * stepper.step * _SCALE
            run[k, 0] = np.clip(run[k, 0], -np.pi, np.pi)
            run[k, 1] = np.clip(run[k, 1], -50.0, 50.0)
            run[k, 2:] = np.clip(run[k, 2:], 5e4, 1.5e6)
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
