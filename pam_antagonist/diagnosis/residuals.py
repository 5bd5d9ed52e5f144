"""What residuals are like: how far beyond the sensors' noise, how white, and with what that was there before they go.

A residual is compared with each signal at *positive* lags: the signal first, the residual later. A controller makes
commands from what the sensors show, so that at other lags a residual goes with the commands that it has caused itself.

Residuals have a memory, and two slow series look alike by chance. So each residual is whitened by an autoregression of
its own (order by BIC) and the signal is filtered likewise; correlations of a white series with anything that has
nothing to do with it scatter by 1/√N (Box and Jenkins, Time Series Analysis, section 11.2). The p-value counts every
lag and every signal that was tried (Bonferroni).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.special import ndtr, ndtri

from pam_antagonist.diagnosis.equations import NAMES, SPAN, UNITS, equation_errors
from pam_antagonist.diagnosis.errors import FilterRun
from pam_antagonist.estimation import metrics
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.likelihood import correlation_length
from pam_antagonist.inference.trial import ANGLE, BLOCK, CHANNELS, PRESSURE_1, blocks

Floats = NDArray[np.float64]

_UNITS = ("deg", "N m", "kPa", "kPa")
_FACTORS = (float(np.degrees(1.0)), 1.0, 1e-3, 1e-3)
_REACH = 2.0
"""[s] Largest lag: pressures and joint have answered a command by then."""
_MOST_ORDER = 12
_LEAST = 40
"""Fewest values that are tested at all."""
_ONCE_IN = 0.05


def signals(experiment: Experiment, point: Point) -> dict[str, Floats]:
    """What a residual may go with, as block means over the whole recording (B,) each.

    Pressures and motion are the model's, which have no noise in common with a residual.
    """
    model = blocks(experiment.simulated(point, whole=True))
    voltage = blocks(experiment.trial.voltage)
    out = {
        "voltage 1": voltage[:, 0],
        "voltage 2": voltage[:, 1],
        "pressure 1": model[:, PRESSURE_1],
        "pressure 2": model[:, PRESSURE_1 + 1],
    }
    if experiment.trial.joint == "free":
        out["angle"] = model[:, ANGLE]
        out["velocity"] = np.gradient(model[:, ANGLE], BLOCK * experiment.trial.dt)
    return {name: np.asarray(values, dtype=np.float64) for name, values in out.items()}


def statistics(experiment: Experiment, point: Point) -> list[dict[str, Any]]:
    """Residuals of sensors and equations of a model on what was held out, with the keys of ``report.json``.

    Args:
        experiment: the recording.
        point: the model.
    """
    given = signals(experiment, point)
    first = -(-experiment.fitted // BLOCK)
    step = BLOCK * experiment.trial.dt
    residual = experiment.residual(point, whole=True)[: len(experiment.measured)]
    out = []
    equations = equation_errors(experiment, point)
    late = equations.begin >= first
    # A window's error is due to what was there while it lasted: the signals' means over it.
    over = {
        name: np.array([values[b : b + SPAN].mean() for b in equations.begin[late]]) for name, values in given.items()
    }
    for k in equations.known:
        row = row_of(equations.values[late, k], equations.noise[k], over, SPAN * step)
        out.append({"channel": NAMES[k], "kind": "equation", "unit": UNITS[k], **row})
    behind = {name: values[first:] for name, values in given.items()}
    for k, channel in enumerate(experiment.channels):
        factor = _FACTORS[channel]
        row = row_of(factor * residual[first:, k], factor * experiment.noise[k], behind, step)
        out.append({"channel": CHANNELS[channel], "kind": "sensor", "unit": _UNITS[channel], **row})
    return out


def of_innovations(experiment: Experiment, point: Point, run: FilterRun) -> list[dict[str, Any]]:
    """The same for the estimator's innovations, in their own standard deviations.

    Args:
        experiment: the recording.
        point: the model, for the signals.
        run: the estimator over it.
    """
    given = signals(experiment, point)
    step = BLOCK * experiment.trial.dt
    block = (run.time / step).astype(np.int64)
    first, count = -(-experiment.fitted // BLOCK), len(experiment.measured)
    behind = {name: values[first:] for name, values in given.items()}
    out = []
    for muscle in (0, 1):
        values = run.innovation[:, muscle]
        inside = np.isfinite(values) & (block >= first) & (block < count)
        number = np.bincount(block[inside] - first, minlength=count - first)
        total = np.bincount(block[inside] - first, values[inside], minlength=count - first)
        means = np.where(number > 0, total / np.maximum(number, 1), 0.0)
        row = row_of(means, 1.0 / np.sqrt(BLOCK), behind, step)
        # Every sample tells of the whiteness, not means of them.
        row["whiteness_p"] = metrics.whiteness_p(values[inside][:, None])
        out.append({"channel": f"innovation {muscle + 1}", "kind": "innovation", "unit": "σ", **row})
    return out


def row_of(values: Floats, noise: float, given: Mapping[str, Floats], step: float) -> dict[str, Any]:
    """Figures of a residual.

    Args:
        values: the residual (N,), at a constant step.
        noise: standard deviation that its sensor alone gives.
        given: signals (N,) that it may go with, by name.
        step: between values [s].
    """
    rms = float(np.sqrt(np.mean(values**2)))
    length = correlation_length(values)
    enough = len(values) >= _LEAST and rms > 0.0
    lags = min(20, len(values) // 5)
    return {
        "rms": rms,
        "noise": noise,
        "beyond_noise": max(1.0 - (noise / rms) ** 2, 0.0) if rms > 0.0 else 0.0,
        "memory_s": length * step,
        "independent": len(values) / length,
        "whiteness_p": metrics.whiteness_p(values[:, None], lags) if enough else float("nan"),
        "relations": cross_correlations(values, given, step) if enough else {},
    }


def cross_correlations(residual: Floats, given: Mapping[str, Floats], step: float) -> dict[str, dict[str, float]]:
    """How a residual goes with what was there before it.

    Args:
        residual: (N,), at a constant step.
        given: signals (N,) by name.
        step: between values [s].

    Returns:
        For each signal the ``lag_s`` > 0 [s] at which the whitened series go together best, their ``correlation``
        there, its size ``z`` in standard deviations, the ``limit`` that chance passes once in twenty, and ``p`` of the
        largest of all lags and signals being chance.
    """
    most = max(1, min(round(_REACH / step), len(residual) // 4))
    filtered = whitener(residual)
    white = lfilter(filtered, [1.0], residual - residual.mean())[len(filtered) :]
    tried = most * len(given)
    limit = float(-ndtri(_ONCE_IN / (2.0 * tried)))
    out = {}
    for name, signal in given.items():
        alike = lfilter(filtered, [1.0], signal - signal.mean())[len(filtered) :]
        scale = float(np.sqrt(np.sum(white**2) * np.sum(alike**2)))
        if scale <= 1e-9 * float(np.sqrt(np.sum(white**2))) * float(np.max(np.abs(signal)) or 1.0):
            continue
        rho = np.array([white[k:] @ alike[: len(alike) - k] for k in range(1, most + 1)]) / scale
        k = int(np.argmax(np.abs(rho)))
        z = float(rho[k] * np.sqrt(len(white)))
        out[name] = {
            "lag_s": (k + 1) * step,
            "correlation": float(rho[k]),
            "z": z,
            "limit": limit,
            "p": min(1.0, 2.0 * tried * float(ndtr(-abs(z)))),
        }
    return out


def whitener(series: Floats) -> Floats:
    """Filter (1, −φ_1, ...) that makes a series white: an autoregression by Yule and Walker, its order by BIC.

    Args:
        series: (N,).
    """
    e = series - series.mean()
    power = np.abs(np.fft.rfft(e, 2 * len(e))) ** 2
    gamma = np.fft.irfft(power)[: _MOST_ORDER + 1] / len(e)
    if gamma[0] <= 0.0:
        return np.ones(1)
    best, chosen = len(e) * np.log(gamma[0]), np.ones(1)
    for order in range(1, _MOST_ORDER + 1):
        # A trace of white noise keeps what is all but singular solvable.
        column = gamma[:order] + np.eye(1, order)[0] * 1e-9 * gamma[0]
        phi = solve_toeplitz(column, gamma[1 : order + 1])
        left = float(gamma[0] - phi @ gamma[1 : order + 1])
        if left <= 0.0:
            break
        criterion = len(e) * np.log(left) + order * np.log(len(e))
        if criterion < best:
            best, chosen = criterion, np.concatenate([[1.0], -phi])
    return chosen
