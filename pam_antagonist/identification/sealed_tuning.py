"""The tuning of a sealed joint's filter: noise and drift of its pressures, Q, and the walk of the torque from outside.

The pressures deviate from the model by a slow drift of the readings, which white noise does not describe. So the drift
is a state of its own (effect ``pressure_sensor``). R is the white noise of the recorded pressures. The drift, Q and the
random walk of the unknown torque are tuned on the fitted part. The errors of the measured angle become most likely,
while the innovations are as large as the filter expects.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import minimize

from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.ukf import OUTPUTS
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

EVALUATIONS = 60
"""Most tunings that are tried, beginning with the rig file's: 25 of five numbers were often far from the best."""
_BOUNDS = ((0.0, 3.5), (-1.7, 1.5), (-2.0, 1.0), (-10.0, 1.0), (-3.0, 4.0))
"""Of the logarithms of the drift's standard deviation [Pa] and time constant [s], of the torque's random walk
[N m/s^0.5], and of Q of velocity [rad²/s²] and of a pressure [Pa²]."""
_DIFFERENCE, _GAIN = 6, 924.0
"""The sixth difference of white noise has 924 times its variance; of a motion of a few hertz it keeps nothing."""
_LEAST_NOISE = 0.1
"""[Pa] Least noise of a pressure: below it the filter's rounding errors would matter."""
_BEGINS = (0.0, 0.5)
"""Shares of the fitted part at which the filter is started. Small details decide when the joint slips. A second start
distinguishes a good tuning from a lucky one."""
_DRIFT = 100.0
"""[Pa] Where the search for the size of a drift begins."""


def tuned(
    rig: Rig,
    recordings: Sequence[tuple[Recording, str]],
    share: float,
    progress: Callable[[str], None],
) -> tuple[Rig, tuple[float, float], int]:
    """The tuning under which the errors of the measured angle are most likely, innovations as large as expected."""
    ends = [(recording, share * _duration(recording)) for recording, _ in recordings]
    parts = [recording.slice(begin * end, end) for recording, end in ends for begin in _BEGINS]
    std = pressure_noise(parts)
    step = rig.sensors.pressure_step
    rig = rig.replaced(sensors=rig.sensors.replaced(pressure_std=std))
    tuning = rig.tuning("default").replaced(measurement=(std**2 + step**2 / 12.0,) * 2)
    walk = rig.value("effects.external_torque.noise")
    drift = rig.effects.get("pressure_sensor", {})
    time = rig.value("effects.pressure_sensor.drift_time")

    def with_values(logarithm: np.ndarray) -> Rig:
        size, time_constant, noise, velocity, pressure = (
            10.0 ** float(np.clip(v, *bound)) for v, bound in zip(logarithm, _BOUNDS, strict=True)
        )
        driven = drift_noise(size, time_constant)
        now = {"pressure_sensor": {**drift, "drift_1": driven, "drift_2": driven, "drift_time": time_constant}}
        if walk:
            now["external_torque"] = {"noise": noise}
        new = tuning.replaced(process=(tuning.process[0], velocity, pressure, pressure))
        return rig.replaced(tunings={**rig.tunings, "default": new}, effects={**rig.effects, **now})

    tried = itertools.count(1)

    def against(logarithm: np.ndarray) -> float:
        progress(f"tuning, {min(next(tried), EVALUATIONS)} of at most {EVALUATIONS}")
        return -_likelihood(with_values(logarithm), parts)

    largest = max(drift.get("drift_1", 0.0), drift.get("drift_2", 0.0))
    known = [drift_size(largest, time) if largest else _DRIFT, time, walk or 1.0, *tuning.process[1:3]]
    start = np.array([np.clip(np.log10(max(v, 1e-12)), *bound) for v, bound in zip(known, _BOUNDS, strict=True)])
    found = minimize(
        against,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": start + np.vstack([np.zeros(5), 0.5 * np.eye(5)]),
            "maxfev": EVALUATIONS,
            "xatol": 0.05,
            "fatol": 1e-3,
        },
    )
    return with_values(found.x), (-against(start), -float(found.fun)), int(found.nfev) + 1


def drift_noise(size: float, time: float) -> float:
    """Noise that drives a drift, ``drift_1`` and ``drift_2`` of the effect ``pressure_sensor`` [Pa/s^1.5].

    `size`: standard deviation of the drift [Pa]. `time`: its time constant [s].
    """
    return 2.0 * size / time**1.5


def drift_size(noise: float, time: float) -> float:
    """Standard deviation of a drift [Pa], the inverse of :func:`drift_noise`."""
    return 0.5 * noise * time**1.5


def pressure_noise(recordings: Sequence[Recording]) -> float:
    """White noise of the recorded pressures, one standard deviation [Pa], without slow changes."""
    squares = [np.diff(recording.pressure, _DIFFERENCE, axis=0) ** 2 / _GAIN for recording in recordings]
    return max(float(np.sqrt(np.nanmean(np.concatenate(squares)))), _LEAST_NOISE)


def _duration(recording: Recording) -> float:
    return float(recording.stamp_ns[-1] - recording.stamp_ns[0]) * 1e-9


def _likelihood(rig: Rig, recordings: Sequence[Recording]) -> float:
    """Mean logarithm of the likelihood of an angle's error [rad], less the square of ln(NIS/2); without constants.

    The angle alone would accept innovations of any size. The innovations alone would choose too small a drift, as it is
    while the joint sticks, and too small an interval of the angle.
    """
    noise = rig.sensors.error("angle") ** 2
    total, count, nis = 0.0, 0, []
    for recording in recordings:
        run = Estimator(rig).run(recording.stamp_ns, recording.pressure, recording.voltage)
        assert recording.angle is not None  # sealed_trial has refused a recording without
        error = run.rows["angle"] - recording.angle[run.index]
        variance = run.rows["covariance"][:, 0, 0] + noise
        good = np.isfinite(error)
        total -= 0.5 * float(np.sum(error[good] ** 2 / variance[good] + np.log(variance[good])))
        count += int(good.sum())
        nis.append(run.rows["nis"])
    known = np.concatenate(nis)
    known = known[np.isfinite(known)]
    if not (count and len(known)):
        return math.nan  # the filter has followed nothing
    return total / count - math.log(float(np.mean(known)) / OUTPUTS) ** 2
