"""One simulated joint that is driven and pushed, and what the filter makes of it with either angle sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.estimator import ANGLE_SENSORS
from pam_antagonist.estimation.metrics import delay
from pam_antagonist.rig import Rig
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import Plant

Floats = NDArray[np.float64]

MISMATCH = 0.01
"""Relative standard deviation of the joint's parameters from the rig's."""
SIZES, LENGTHS, PAUSES = (0.1, 1.5), (0.1, 2.0), (0.5, 1.5)
"""Of the pushes: [N m], log-uniform [s], and between two of them [s]."""
SETTLED = 0.5
"""[s] After the start, before which nothing is judged."""
SMALL = 0.3
"""[N m] The push whose detection is judged."""
QUIET_SEED = 1000
"""Seed of the first joint that nobody pushes: none of those that are pushed."""


class Run(NamedTuple):
    """Estimate of one joint, after the start (N,).

    Attributes:
        applied: torque from outside [N m].
        estimate: of the filter [N m].
        std: that it claims [N m].
        period: of the samples [s].
    """

    applied: Floats
    estimate: Floats
    std: Floats
    period: float


def pushes(count: int, period: float, rng: np.random.Generator) -> Floats:
    """Pushes of either sign, set in and let go at once (N,) [N m].

    Args:
        count: samples N.
        period: [s].
        rng: source of sizes, lengths and pauses.
    """
    out = np.zeros(count)
    at = rng.uniform(*PAUSES) + SETTLED
    while at < count * period:
        end = at + np.exp(rng.uniform(*np.log(LENGTHS)))
        out[round(at / period) : round(end / period)] = rng.choice((-1.0, 1.0)) * rng.uniform(*SIZES)
        at = end + rng.uniform(*PAUSES)
    return out


def small_pushes(count: int, period: float, rng: np.random.Generator) -> Floats:
    """Pushes of ``SMALL`` N m, a second long, with pauses of a second and a bit (N,) [N m].

    Args:
        count: samples N.
        period: [s].
        rng: source of sides and pauses.
    """
    out = np.zeros(count)
    at = SETTLED + 1.0
    while at + 1.0 < count * period:
        out[round(at / period) : round((at + 1.0) / period)] = rng.choice((-SMALL, SMALL))
        at += 2.0 + rng.uniform(0.0, 0.5)
    return out


def largest(run: Run) -> Floats:
    """Largest magnitude of the estimate in each second of a run (seconds,) [N m].

    Args:
        run: of a joint.
    """
    second = round(1.0 / run.period)
    whole = len(run.estimate) // second * second
    return np.abs(run.estimate[:whole]).reshape(-1, second).max(axis=1)


def quiet(rig: Rig, seed: int, seconds: float) -> dict[str, Floats]:
    """:func:`largest` of a joint that nobody pushes, by angle sensor.

    Args:
        rig: as for :func:`run`.
        seed: likewise.
        seconds: likewise.
    """
    return {sensor: largest(one) for sensor, one in run(rig, seed, seconds, "quiet").items()}


def run(rig: Rig, seed: int, seconds: float, kind: str) -> dict[str, Run]:
    """Drive a joint by the voltage steps of ``simulate``, push it, and estimate with each angle sensor.

    Args:
        rig: as declared, with the state ``external_torque`` and an encoder.
        seed: of the joint, its voltages, its noise and the pushes.
        seconds: how long.
        kind: ``pushed``, ``small`` pushes, or ``quiet``.

    Returns:
        By angle sensor.
    """
    period = rig.sample_period
    limits = rig.valves
    voltage = np.clip(excitation.profile("steps", seconds, period, seed), limits.voltage_min, limits.voltage_max)
    rng = np.random.default_rng((seed, 7))
    count = len(voltage)
    applied = (
        {"pushed": pushes, "small": small_pushes}[kind](count, period, rng) if kind != "quiet" else np.zeros(count)
    )
    plant = Plant(rig, seed=seed, mismatch=MISMATCH)
    samples = [plant.step(u, d) for u, d in zip(voltage, applied, strict=True)]
    stamps = np.rint(np.arange(1, count + 1) * period * 1e9).astype(np.int64)
    pressure, angle = np.array([one.pressure for one in samples]), np.array([one.encoder for one in samples])
    out, first = {}, round(SETTLED / period)
    for name in ANGLE_SENSORS:
        rows = Estimator(rig, angle_sensor=name).run(stamps, pressure, voltage, angle).rows[first:]
        std = np.sqrt(rows["external_torque_covariance"][:, 3])
        out[name] = Run(applied[first:], rows["external_torque"].copy(), std, period)
    return out


def errors(runs: list[Run]) -> dict[str, float]:
    """Root mean square error [N m], coverage of the 95 % interval [-], claimed standard deviation [N m], delay [s].

    The delay is the median of the joints'.

    Args:
        runs: of several joints.
    """
    error = np.concatenate([one.estimate - one.applied for one in runs])
    std = np.concatenate([one.std for one in runs])
    return {
        "rmse_nm": float(np.sqrt(np.mean(error**2))),
        "coverage95": float(np.mean(np.abs(error) <= 1.96 * std)),
        "std_nm": float(np.sqrt(np.mean(std**2))),
        "delay_s": float(np.median([delay(one.applied, one.estimate, one.period) for one in runs])),
    }


def detection(small: list[Run], quiet: list[Floats]) -> dict[str, float]:
    """How soon a small push is seen, by a threshold that quiet joints exceed in one second of an hour.

    Args:
        small: joints with small pushes.
        quiet: of joints that nobody pushes, the largest estimate of each second (seconds,) [N m].

    Returns:
        ``threshold_nm``; ``quiet_s``, the time without a push; ``alarms``, seconds of it with an estimate beyond the
        threshold, one an hour or none; ``seen``, the share of pushes that are beyond the threshold, on their side,
        within 0.1 s; ``median_s`` until then, infinite where half of them never are.
    """
    every = np.sort(np.concatenate(quiet))
    alarms = int(len(every) // 3600)
    threshold = float(every[-1 - alarms])
    delays = []
    for one in small:
        for start in np.flatnonzero((np.diff(one.applied) != 0.0) & (one.applied[1:] != 0.0)) + 1:
            length = round(1.0 / one.period)
            beyond = one.estimate[start : start + length] * np.sign(one.applied[start]) > threshold
            delays.append(float(np.argmax(beyond)) * one.period if beyond.any() else np.inf)
    return {
        "threshold_nm": threshold,
        "quiet_s": float(len(every)),
        "alarms": float(alarms),
        "pushes": float(len(delays)),
        "seen": float(np.mean(np.array(delays) <= 0.1)),
        "median_s": float(np.quantile(delays, 0.5, method="nearest")),
    }
