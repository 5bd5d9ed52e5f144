"""Statistics of residuals: how far above the sensors' noise, how white, and which signals precede them.

*Signals.* A residual is compared with each signal at *positive* lags: the signal first, the residual later. A
controller makes commands from what the sensors show. So at other lags a residual correlates with commands that it
caused itself.

*Whitening.* Residuals have a memory, and two slow series look alike by chance. So each residual is whitened by an
autoregression of its own (order by BIC), and the signal is filtered likewise. Correlations of a white series with an
unrelated one scatter by 1/√N (Box and Jenkins, Time Series Analysis, section 11.2). The p-value counts every lag and
every signal that was tried (Bonferroni).

*Equations.* A simulation accumulates all errors. An equation that starts from the measured state shows its own error
only. So the model is restarted every 0.2 s from the measured angle and pressures; states that are not measured come
from the simulation. The measured minus the predicted change of pressures and angle is the error of the flows and of the
motion. Measurement and model are averaged alike, so that smoothing cannot look like a lag. The torque's error is taken
at the measured state.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_toeplitz
from scipy.special import ndtr, ndtri

from pam_antagonist.diagnosis.thresholds import CHANCE
from pam_antagonist.estimation import metrics
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, TORQUE, Trial
from pam_antagonist.model import drive, dynamics, flow, muscle

Floats = NDArray[np.float64]

EQUATIONS = (
    Channel("mass flow 1", "mg/s", 1.0),
    Channel("mass flow 2", "mg/s", 1.0),
    Channel("contraction torque", "N m", 1.0),
    Channel("joint motion", "deg/s", 1.0),
)
_SPAN = 0.2
"""[s] How long the model runs from a measurement."""
_NEAR = 0.04
"""[s] Half of the interval over which the velocity is taken."""
_PROBES = 12
_REACH = 2.0
"""[s] Largest lag: pressures and joint have answered a command by then."""
_MOST_ORDER = 12
_LEAST = 40
"""Fewest values that are tested at all."""


@dataclass(frozen=True)
class Relation:
    """Correlation of a residual with a signal that comes before it."""

    lag_s: float  # by which the signal precedes the residual [s]: where the whitened series correlate most
    correlation: float
    z: float
    limit: float  # size of z that chance alone exceeds once in twenty times
    p: float  # probability of the largest of all lags and signals being chance

    @property
    def over_chance(self) -> float:
        """Size relative to the one that chance alone exceeds once in twenty times, with its sign."""
        return self.z / self.limit


@dataclass(frozen=True)
class ResidualRow:
    """A residual of a model on held-out data."""

    channel: str
    kind: str  # ``sensor``, ``equation`` or ``innovation``
    unit: str
    rms: float
    noise: float
    above_noise: float  # share of the mean square that the sensors' noise does not explain
    memory_s: float  # time between independent values [s]
    independent: float
    # probability of such an autocorrelation in white noise; NaN where there are too few values.
    whiteness_p: float | None
    relations: Mapping[str, Relation]

    @property
    def title(self) -> str:
        """The channel's name."""
        return self.channel.replace("_", " ")


def unit_of(channel: Channel) -> str:
    """Unit of a channel as ``report.json`` writes it."""
    return "deg" if channel.unit == "°" else channel.unit


def statistics(experiment: Experiment, point: Point) -> list[ResidualRow]:
    """Residuals of sensors and equations of a model on what was held out."""
    experiment, point = experiment.corrected(point)
    given = experiment.signals(point)
    first = -(-experiment.errors_from // experiment.trial.block)
    step = experiment.trial.block_s
    residual = experiment.residual(point, whole=True)[: len(experiment.measured)]
    out = []
    if experiment.runs_by_itself:
        equations = equation_errors(experiment, point)
        late = equations.begin >= first
        # A window's error is compared with the signals' means over the window.
        over = {
            name: np.array([values[b : b + equations.span].mean() for b in equations.begin[late]])
            for name, values in given.items()
        }
        for k in equations.known:
            name, unit = EQUATIONS[k].title, EQUATIONS[k].unit
            values, noise = equations.values[late, k], equations.noise[k]
            row = row_of((name, "equation", unit), values, noise, over, equations.span * step)
            out.append(row)
    behind = {name: values[first:] for name, values in given.items()}
    for k, channel in enumerate(experiment.titles):
        what = (channel.title.lower().replace(" ", "_"), "sensor", unit_of(channel))
        noise = channel.factor * experiment.noise[k]
        out.append(row_of(what, channel.factor * residual[first:, k], noise, behind, step))
    return out


def of_innovations(experiment: Experiment, point: Point, time: Floats, innovation: Floats) -> list[ResidualRow]:
    """Statistics of the estimator's innovations, in their own standard deviations.

    `time`: of each held-out sample since the recording's first (M,) [s]. `innovation`: of the pressures there, in
    standard deviations (M, 2).
    """
    experiment, point = experiment.corrected(point)
    given = experiment.signals(point)
    step = experiment.trial.block_s
    block = (time / step).astype(np.int64)
    first, count = -(-experiment.errors_from // experiment.trial.block), len(experiment.measured)
    behind = {name: values[first:] for name, values in given.items()}
    out = []
    for number in (0, 1):
        values = innovation[:, number]
        inside = np.isfinite(values) & (block >= first) & (block < count)
        count_of = np.bincount(block[inside] - first, minlength=count - first)
        total = np.bincount(block[inside] - first, values[inside], minlength=count - first)
        means = np.where(count_of > 0, total / np.maximum(count_of, 1), 0.0)
        what = (f"innovation {number + 1}", "innovation", "σ")
        row = row_of(what, means, 1.0 / np.sqrt(experiment.trial.block), behind, step)
        # Every sample counts for the whiteness, not means of them.
        out.append(replace(row, whiteness_p=metrics.whiteness_p(values[inside][:, None])))
    return out


def row_of(
    what: tuple[str, str, str], values: Floats, noise: float, given: Mapping[str, Floats], step: float
) -> ResidualRow:
    """Statistics of a residual.

    Args:
        values: the residual (N,), at a constant step.
        given: signals (N,) that it may go with, by name.
        step: between values [s].
    """
    rms = float(np.sqrt(np.mean(values**2)))
    length = metrics.correlation_length(values)
    enough = len(values) >= _LEAST and rms > 0.0
    lags = min(20, len(values) // 5)
    return ResidualRow(
        *what,
        rms=rms,
        noise=float(noise),
        above_noise=max(1.0 - (noise / rms) ** 2, 0.0) if rms > 0.0 else 0.0,
        memory_s=length * step,
        independent=len(values) / length,
        whiteness_p=metrics.whiteness_p(values[:, None], lags) if enough else float("nan"),
        relations=cross_correlations(values, given, step) if enough else {},
    )


def cross_correlations(residual: Floats, given: Mapping[str, Floats], step: float) -> dict[str, Relation]:
    """Correlations of a residual with signals before it.

    Args:
        residual: (N,), at a constant step.
        given: signals (N,) by name.
        step: between values [s].
    """
    most = max(1, min(round(_REACH / step), len(residual) // 4))
    filtered = whitener(residual)
    white = np.convolve(residual - residual.mean(), filtered, "valid")[1:]
    tried = most * len(given)
    limit = float(-ndtri(CHANCE / (2.0 * tried)))
    out = {}
    for name, signal in given.items():
        driving = np.convolve(signal - signal.mean(), filtered, "valid")[1:]
        scale = float(np.sqrt(np.sum(white**2) * np.sum(driving**2)))
        if scale <= 1e-9 * float(np.sqrt(np.sum(white**2))) * float(np.max(np.abs(signal)) or 1.0):
            continue
        rho = np.array([white[k:] @ driving[: len(driving) - k] for k in range(1, most + 1)]) / scale
        k = int(np.argmax(np.abs(rho)))
        z = float(rho[k] * np.sqrt(len(white)))
        chance = min(1.0, 2.0 * tried * float(ndtr(-abs(z))))
        out[name] = Relation((k + 1) * step, float(rho[k]), z, limit, chance)
    return out


def whitener(series: Floats) -> Floats:
    """Filter (1, −φ_1, ...) that makes a series white: an autoregression by Yule and Walker, its order by BIC.

    `series`: (N,).
    """
    e = series - series.mean()
    power = np.abs(np.fft.rfft(e, 2 * len(e))) ** 2
    gamma = np.fft.irfft(power)[: _MOST_ORDER + 1] / len(e)
    if gamma[0] <= 0.0:
        return np.ones(1)
    best, chosen = len(e) * np.log(gamma[0]), np.ones(1)
    for order in range(1, _MOST_ORDER + 1):
        # A trace of white noise keeps a nearly singular system solvable.
        column = gamma[:order] + np.eye(1, order)[0] * 1e-9 * gamma[0]
        phi = solve_toeplitz(column, gamma[1 : order + 1])
        left = float(gamma[0] - phi @ gamma[1 : order + 1])
        if left <= 0.0:
            break
        criterion = len(e) * np.log(left) + order * np.log(len(e))
        if criterion < best:
            best, chosen = criterion, np.concatenate([[1.0], -phi])
    return chosen


@dataclass(frozen=True, eq=False)
class EquationErrors:
    """Errors of the equations over all of a recording."""

    begin: NDArray[np.int64]  # the block from which each was taken (W,)
    values: Floats  # (W, 4) in the order and units of ``EQUATIONS``; 0 where something is missing
    noise: Floats  # what the sensors alone give (4,)
    known: tuple[int, ...]
    span: int


def equation_errors(experiment: Experiment, point: Point) -> EquationErrors:
    """Errors of each equation of a model."""
    trial, edges = experiment.trial, experiment.edges(point)
    # The parameter vector that holds in each block: effects may begin and end.
    vectors = [experiment.parameters(point, time) for time in (0.0, *edges)]
    phase = np.searchsorted(edges, np.arange(len(experiment.measured)) * trial.block_s, side="right")
    p_at = [vectors[k] for k in phase]
    states, _ = experiment.states(point)
    shown = np.full((len(experiment.measured), 4), np.nan)
    shown[:, list(experiment.channels)] = experiment.measured
    noise = np.zeros(4)
    noise[list(experiment.channels)] = experiment.noise
    known = [0, 1]
    moves = ANGLE in experiment.channels
    if TORQUE in experiment.channels and (moves or trial.joint == "locked"):
        known.append(2)
    if moves:
        known.append(3)
    span, near = trial.block_count(_SPAN), trial.block_count(_NEAR)
    begin = np.arange(near, len(shown) - span - 1, span)
    start = _measured_states(states, shown, trial, moves, p_at)
    factors = np.array([[_flow_of_rate(i, start[b], p_at[b]) for i in (0, 1)] for b in begin])
    seconds, size = span * trial.block_s, trial.block

    def ends_at(block: int, x: Floats) -> Floats:
        """Pressures' readings and angle at the end of a window (3,)."""
        first, p = block * size + size // 2, p_at[block]
        run, _ = drive.course(x, trial.given[first : first + (span + 1) * size], p, trial.dt, trial.substeps)
        end = run[span * size - size // 2 :][:size].mean(axis=0)
        return np.array([dynamics.reading(0, end[2], p), dynamics.reading(1, end[3], p), end[0]])

    values = np.full((len(begin), 4), np.nan)
    ends = np.array([ends_at(int(b), start[b]) for b in begin])
    rates = (shown[begin + span][:, [PRESSURE_1, PRESSURE_1 + 1, ANGLE]] - ends) / seconds
    values[:, :2] = rates[:, :2] * factors * 1e6
    torque = np.array([dynamics.torque(x, p) for x, p in zip(start, p_at, strict=True)])
    lacking = shown[:, TORQUE] - torque
    values[:, 2] = [lacking[b : b + span].mean() for b in begin]
    values[:, 3] = np.degrees(rates[:, 2])
    # What the sensors' noise does at the start and at the end of a window, for some of them.
    errors = np.zeros(4)
    velocity = noise[ANGLE] * np.sqrt(2.0) / (2 * near * trial.block_s)
    of_state = ((0, noise[ANGLE]), (1, velocity if moves else 0.0), (2, noise[PRESSURE_1]), (3, noise[PRESSURE_1 + 1]))
    probes = np.linspace(0, len(begin) - 1, min(_PROBES, len(begin))).astype(int)
    for w in probes:
        for state, std in of_state:
            if std == 0.0 or (state < 2 and not moves):
                continue
            x = start[begin[w]].copy()
            x[state] += std
            change = (ends_at(int(begin[w]), x) - ends[w]) / seconds
            turned = dynamics.torque(x, p_at[begin[w]]) - torque[begin[w]] if state != 1 else 0.0
            errors[:2] += (change[:2] * factors[w] * 1e6) ** 2
            errors[2] += turned**2 / span
            errors[3] += np.degrees(change[2]) ** 2
    errors /= len(probes)
    errors[:2] += (noise[PRESSURE_1:] / seconds * np.mean(factors, axis=0) * 1e6) ** 2
    errors[2] += noise[TORQUE] ** 2 / span
    errors[3] += np.degrees(noise[ANGLE] / seconds) ** 2
    return EquationErrors(begin, np.nan_to_num(values), np.sqrt(errors), tuple(known), span)


def _measured_states(states: Floats, shown: Floats, trial: Trial, moves: bool, p_at: Sequence[Floats]) -> Floats:
    """The simulation's states in the middle of each block (B, n), with the measurements in their places.

    The angle stays the simulation's where the joint does not move.
    """
    block = np.arange(len(shown))
    x = states[block * trial.block + trial.block // 2].copy()
    if moves:
        near = trial.block_count(_NEAR)
        low, high = np.maximum(block - near, 0), np.minimum(block + near, len(shown) - 1)
        x[:, 0] = shown[:, ANGLE]
        x[:, 1] = (shown[high, ANGLE] - shown[low, ANGLE]) / ((high - low) * trial.block_s)
    for i in (0, 1):
        readings = shown[:, PRESSURE_1 + i]
        x[:, 2 + i] = [dynamics.pressure_behind(i, value, p) for value, p in zip(readings, p_at, strict=True)]
    return x


def _flow_of_rate(i: int, x: Floats, p: Floats) -> float:
    """Mass flow [kg/s] that moves a pressure by 1 Pa/s, by equation (4)."""
    sine, _, _ = muscle.leverage(x[0], p)
    chamber, _ = muscle.volume(i, muscle.length(i, sine, p), p)
    still, moved = (flow.pressure_rate(x[2 + i], chamber, 0.0, m, p) for m in (0.0, 1.0))
    return float(1.0 / (moved - still))
