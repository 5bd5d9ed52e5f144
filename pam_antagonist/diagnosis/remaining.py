"""What is not explained: where it is, what it goes with, and what form a sparse regression suggests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.experiment import Experiment
from pam_antagonist.diagnosis.refit import AT_NOISE, Fitted, excess
from pam_antagonist.diagnosis.select import Model
from pam_antagonist.diagnosis.simulation import BLOCK, blocks
from pam_antagonist.identification.trial import ANGLE, PRESSURE_1
from pam_antagonist.model import dynamics

Floats = NDArray[np.float64]

_TITLES = ("joint angle", "torque", "pressure 1", "pressure 2")
_HORIZON = 10
"""Blocks over which the flow's residual is taken: the model starts from the measurement and runs so long."""
_TERMS = 3
_LEAST_SHARE = 0.05


def describe(experiments: Sequence[Experiment], model: Model) -> list[str]:
    """One line for each channel of each recording that is beyond its noise, and one for each muscle's flow."""
    lines = []
    for experiment, fitted in zip(experiments, model.fits, strict=True):
        over = excess(experiment, fitted.residual)
        signals = _signals(experiment, fitted)
        for k, channel in enumerate(experiment.channels):
            if over[k] < AT_NOISE:
                continue
            residual = fitted.residual[:, k]
            said = ", ".join(f"{name} ({100 * share:.0f} %)" for name, share in _related(residual, signals)[:2])
            with_it = f"; goes with {said}" if said else "; goes with none of the signals alone"
            lines.append(
                f"{experiment.trial.name}, {_TITLES[channel]}: {over[k]:.1f} times the noise{with_it}; "
                f"typical period {_period(residual, BLOCK * experiment.trial.dt):.1f} s"
            )
        for muscle in (0, 1):
            if over[list(experiment.channels).index(PRESSURE_1 + muscle)] >= AT_NOISE:
                lines += _flow_line(experiment, fitted, muscle)
    return lines


def _signals(experiment: Experiment, fitted: Fitted) -> dict[str, Floats]:
    """What a residual may go with, as block means over the fitted part."""
    model = blocks(experiment.simulated(fitted.point))
    count = len(fitted.residual)
    voltage = blocks(experiment.trial.voltage)[:count]
    angle = model[:, ANGLE]
    step = BLOCK * experiment.trial.dt
    velocity = np.gradient(angle, step)
    signals = {
        "pressure 1": model[:, PRESSURE_1],
        "pressure 2": model[:, PRESSURE_1 + 1],
        "the difference of the pressures": model[:, PRESSURE_1] - model[:, PRESSURE_1 + 1],
        "the sum of the pressures": model[:, PRESSURE_1] + model[:, PRESSURE_1 + 1],
        "voltage 1": voltage[:, 0],
        "voltage 2": voltage[:, 1],
        "the rate of pressure 1": np.gradient(model[:, PRESSURE_1], step),
        "the rate of pressure 2": np.gradient(model[:, PRESSURE_1 + 1], step),
        "time": np.arange(count) * step,
    }
    if experiment.trial.joint == "free":
        signals["muscle length (the angle)"] = angle
        signals["the direction of motion"] = np.tanh(velocity / 0.02)
        signals["velocity"] = velocity
    return {name: np.asarray(signal, dtype=np.float64) for name, signal in signals.items()}


def _related(residual: Floats, signals: Mapping[str, Floats]) -> list[tuple[str, float]]:
    """Share of the residual's variance that each signal explains as a quadratic, the largest first."""
    shares = []
    total = float(np.var(residual)) or 1.0
    for name, signal in signals.items():
        scaled = (signal - signal.mean()) / (signal.std() or 1.0)
        design = np.column_stack([np.ones_like(scaled), scaled, scaled**2])
        left = residual - design @ np.linalg.lstsq(design, residual, rcond=None)[0]
        shares.append((name, 1.0 - float(np.var(left)) / total))
    return sorted((item for item in shares if item[1] > _LEAST_SHARE), key=lambda item: -item[1])


def _period(residual: Floats, step: float) -> float:
    """Period [s] about which the residual's power lies: the power's mean frequency."""
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    frequency = np.fft.rfftfreq(len(residual), step)
    mean = float(power[1:] @ frequency[1:] / max(power[1:].sum(), 1e-300))
    return 1.0 / mean if mean > 0.0 else float("inf")


def _flow_line(experiment: Experiment, fitted: Fitted, muscle: int) -> list[str]:
    """The pressure's rate that the model lacks, and a sparse regression for its form."""
    rate, at = _rate_residual(experiment, fitted, muscle)
    pressures = experiment.measured[at][:, [list(experiment.channels).index(PRESSURE_1 + i) for i in (0, 1)]] / 1e5
    voltage = blocks(experiment.trial.voltage)[at]
    p1, p2 = pressures.T
    library = {
        "P_1": p1, "P_2": p2, "P_1 − P_2": p1 - p2, "P_1²": p1**2, "P_2²": p2**2, "P_1 P_2": p1 * p2,
        "u_1": voltage[:, 0], "u_2": voltage[:, 1], "P_1 u_1": p1 * voltage[:, 0], "P_2 u_2": p2 * voltage[:, 1],
    }  # fmt: skip
    chosen, share = _sparse(rate, library)
    if share < _LEAST_SHARE:
        return []
    form = " ".join(f"{value:+.2g}·{name}" for name, value in chosen)
    return [
        f"{experiment.trial.name}, rate of pressure {muscle + 1} that the model lacks [kPa/s; P in 100 kPa, u in V]: "
        f"{form} explains {100 * share:.0f} % of it"
    ]


def _rate_residual(experiment: Experiment, fitted: Fitted, muscle: int) -> tuple[Floats, NDArray[np.int64]]:
    """Rate [kPa/s] by which the pressure moved more than the model does that starts from the measurement."""
    trial, p = experiment.trial, experiment.parameters(fitted.point)
    whole = experiment.simulated(fitted.point)
    samples = _HORIZON * BLOCK
    begins = np.arange(samples, len(whole) - 2 * samples, samples)
    measured = trial.measured
    out = np.empty(len(begins))
    for k, begin in enumerate(begins):
        window = slice(begin - BLOCK // 2, begin + BLOCK // 2)
        start = np.nanmean(measured[window, PRESSURE_1:], axis=0)
        angle = whole[begin, ANGLE] if ANGLE not in experiment.channels else float(np.nanmean(measured[window, ANGLE]))
        x0 = dynamics.initial_state(angle, start[0], start[1], trial.voltage[begin], p)
        states, _, _ = dynamics.simulate(x0, trial.voltage[begin : begin + samples + BLOCK], p, trial.dt, 1)
        end = slice(begin + samples - BLOCK // 2, begin + samples + BLOCK // 2)
        seen = np.nanmean(measured[end, PRESSURE_1 + muscle])
        said = states[samples - BLOCK // 2 : samples + BLOCK // 2, 2 + muscle].mean()
        out[k] = (seen - said) / (samples * trial.dt) / 1e3
    return np.nan_to_num(out), (begins + samples // 2) // BLOCK


def _sparse(target: Floats, library: Mapping[str, Floats]) -> tuple[list[tuple[str, float]], float]:
    """Few terms that explain a target: forward, each kept only while it pays by the Bayesian criterion."""
    ones = np.ones_like(target)
    chosen: list[str] = []
    left = target - target.mean()
    total = float(left @ left) or 1.0
    coefficients: Floats = np.zeros(1)
    for _ in range(_TERMS):
        best = None
        for name in library:
            if name in chosen:
                continue
            design = np.column_stack([ones, *(library[n] for n in (*chosen, name))])
            solution = np.linalg.lstsq(design, target, rcond=None)[0]
            rest = target - design @ solution
            if best is None or float(rest @ rest) < best[0]:
                best = float(rest @ rest), name, solution, rest
        if best is None or len(target) * np.log(float(left @ left) / best[0]) < np.log(len(target)) + 6.0:
            break
        chosen.append(best[1])
        coefficients, left = np.asarray(best[2], dtype=np.float64), best[3]
    return list(zip(chosen, coefficients[1:].tolist(), strict=True)), 1.0 - float(left @ left) / total
