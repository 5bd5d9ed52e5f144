"""The remaining residual: where it is, what it depends on, and which form a sparse regression suggests.

Every residual above the sensors' noise is described: those of the sensors and, of a model that runs by itself, the
errors of its equations (:mod:`residual_statistics`). A description rests on the fitted part; the suggested form is
judged on the held-out part too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.change_point import Stretch, above_noise
from pam_antagonist.diagnosis.models import Model
from pam_antagonist.diagnosis.residual_statistics import EQUATIONS, equation_errors, unit_of
from pam_antagonist.estimation.metrics import correlation_length
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.strict_json import picked

Floats = NDArray[np.float64]

_SLOW = 0.02
"""[rad/s] A slower motion has no clear direction."""
_TERMS = 3
_BINS = 12
EDGES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""[Hz] Between the bands in which a residual's power is counted."""


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Pressures, voltages and motion at the time of each value of a residual: (N,) each."""

    pressure: Floats  # (N, 2) [Pa]
    voltage: Floats | None  # (N, 2) [V], None where no valve moved
    time: Floats  # [s]
    angle: Floats | None = None  # [rad], None where the joint was locked: then no length changed
    velocity: Floats | None = None  # [rad/s], None likewise

    def take(self, rows: NDArray[np.bool_]) -> Surroundings:
        """Some of the rows."""
        return self._each(lambda values: values[rows])

    def windows(self, begin: NDArray[np.int64], span: int) -> Surroundings:
        """Means over windows, by their first rows and their number of rows."""
        return self._each(lambda values: np.array([values[b : b + span].mean(axis=0) for b in begin]))

    def _each(self, what: Callable[[Floats], Floats]) -> Surroundings:
        columns = (self.pressure, self.voltage, self.time, self.angle, self.velocity)
        return Surroundings(*(None if values is None else what(values) for values in columns))  # type: ignore[arg-type]

    @property
    def direction(self) -> Floats | None:
        """Which way the joint moves (N,), −1 to 1; 0 where it stands."""
        return None if self.velocity is None else np.asarray(np.tanh(self.velocity / _SLOW))

    def groups(self) -> dict[str, Floats]:
        """Columns (N, k) of each kind of dependence: quadratics, so that no sign is taken for granted."""
        p, u = self.pressure / 1e5, self.voltage
        out = {"pressure": np.column_stack([p, p**2, p[:, 0] * p[:, 1]])}
        if u is not None:
            out["command"] = np.column_stack([u, u**2])
        out["time"] = np.column_stack([self.time, self.time**2])
        if self.angle is not None and self.direction is not None:
            out["length"] = np.column_stack([self.angle, self.angle**2])
            out["direction of motion"] = np.column_stack([self.direction, self.direction * self.angle])
        return out

    def library(self) -> dict[str, Floats]:
        """Terms (N,) of which a form may be made: P in 100 kPa, u in V, ψ in rad, t in s."""
        p1, p2 = self.pressure.T / 1e5
        out = {
            "P_1": p1, "P_2": p2, "(P_1 − P_2)": p1 - p2, "(P_1 + P_2)": p1 + p2, "P_1²": p1**2, "P_2²": p2**2,
            "P_1 P_2": p1 * p2,
        }  # fmt: skip
        if self.voltage is not None:
            u1, u2 = self.voltage.T
            out |= {"u_1": u1, "u_2": u2, "P_1 u_1": p1 * u1, "P_2 u_2": p2 * u2}
        out["t"] = self.time
        if self.angle is not None and self.velocity is not None and self.direction is not None:
            total = p1 + p2
            out |= {
                "ψ": self.angle, "ψ²": self.angle**2, "ψ (P_1 + P_2)": self.angle * total, "ψ̇": self.velocity,
                "sign ψ̇": self.direction, "sign ψ̇ (P_1 + P_2)": self.direction * total,
            }  # fmt: skip
        return out

    def axes(self) -> dict[str, Floats]:
        """What a residual is drawn over: title with unit, values (N,)."""
        out = {"Pressure 1 [kPa]": self.pressure[:, 0] / 1e3, "Pressure 2 [kPa]": self.pressure[:, 1] / 1e3}
        if self.voltage is not None:
            out |= {"Voltage 1 [V]": self.voltage[:, 0], "Voltage 2 [V]": self.voltage[:, 1]}
        out["Time [s]"] = self.time
        if self.angle is not None:
            out["Angle [°]"] = np.degrees(self.angle)
        return out


@dataclass(frozen=True)
class SumOfTerms:
    """A sum of few terms that approximates a residual."""

    terms: tuple[tuple[str, float], ...]
    share: float  # of the residual's variance that it explains where it was fitted
    held_out: float  # share of the residual's squares that it explains on held-out data, NaN where there are none

    @override
    def __str__(self) -> str:
        return " ".join(f"{value:+.2g}·{name}" for name, value in self.terms)

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        terms = [{"term": name, "coefficient": value} for name, value in self.terms]
        return {"terms": terms, "share": self.share, "share_held_out": self.held_out}


@dataclass(frozen=True, eq=False)
class RemainingResidual:
    """A residual that no effect explains, in one channel of one recording."""

    recording: str
    channel: str
    unit: str
    times_noise: float
    depends_on: dict[str, float]  # share of its variance that goes with each kind of dependence alone
    bands: dict[str, float]
    period: float  # about which its power lies [s]
    form: SumOfTerms
    values: Floats  # the residual (N,) that is described
    around: Surroundings
    begin_s: float = 0.0  # where it is above noise [s]
    end_s: float = 0.0  # likewise [s]

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``: the description without the residual itself."""
        described = picked(self, "recording", "channel", "unit", "times_noise", "begin_s", "end_s")
        return {**described, **picked(self, "depends_on", "bands"), "period_s": self.period, "form": self.form}

    @property
    def is_of_sensor(self) -> bool:
        """Whether it is the residual of a sensor, and not the error of an equation."""
        return all(self.channel != equation.title for equation in EQUATIONS)

    def in_short(self) -> str:
        """Channel, recording, size and time."""
        return (
            f"{self.channel} in {self.recording}, {self.times_noise:.2g} times its noise from {self.begin_s:.0f} to "
            f"{self.end_s:.0f} s"
        )

    def line(self) -> str:
        """The description as a line."""
        least = thresholds.LEAST_DEPENDENCE
        goes = ", ".join(f"{name} ({100 * v:.0f} %)" for name, v in strongest(self.depends_on, least)[:3])
        kinds = "pressure, length, direction, command, time"
        depends = f"depends on {goes}" if goes else f"depends on none of {kinds} alone"
        band = max(self.bands, key=lambda name: self.bands[name])
        text = (
            f"{self.recording}, {self.channel}: {self.times_noise:.2g} times the noise, from {self.begin_s:.0f} to "
            f"{self.end_s:.0f} s; {depends}; "
            f"{100 * self.bands[band]:.0f} % of its power lies {_between(band)}; typical period {self.period:.1f} s"
        )
        if self.form.terms and self.form.share >= least:
            held = "" if np.isnan(self.form.held_out) else f", {100 * max(self.form.held_out, 0.0):.0f} % held out"
            share = f"{100 * self.form.share:.0f} %"
            text += f"; it looks like {self.form} [{self.unit}], which explains {share} of it{held}"
        return text


def _between(band: str) -> str:
    """Where a band of frequency lies: ``0.3 to 1 Hz`` as a place."""
    return f"between {band.replace(' to ', ' and ')}" if " to " in band else band


def describe(model: Model, clearest: bool = False) -> list[RemainingResidual]:
    """All residuals above the noise: of the equations of each recording, then of its sensors.

    `clearest`: whether the largest residual is described where none is above the noise.
    """
    runs = [(judged.free_run, fitted, judged) for judged, fitted in model.pairs]
    over = [
        recorded.times_noise(fitted.residual if recorded is judged else recorded.residual(fitted.point))
        for recorded, fitted, judged in runs
    ]
    least = thresholds.AT_NOISE
    if clearest and over:
        least = min(least, float(max(map(np.max, over))))
    out = []
    for (recorded, fitted, _), times in zip(runs, over, strict=True):
        if np.max(times) < least:
            continue
        experiment, point = recorded.corrected(fitted.point)
        around = surroundings(experiment, point)
        if experiment.runs_by_itself:
            out += _of_equations(experiment, point, around)
        whole = experiment.residual(point, whole=True)[: len(experiment.measured)]
        late = experiment.held_samples[:: experiment.trial.block][: len(whole)]
        for k, channel in enumerate(experiment.titles):
            if times[k] >= least:
                scaled = whole[:, k] * channel.factor, float(experiment.noise[k] * channel.factor)
                step = experiment.trial.block_s
                out.append(described(experiment.trial.name, channel, float(times[k]), scaled, late, around, step))
    return out


def of_stretch(experiment: Experiment, point: Point, stretch: Stretch) -> RemainingResidual:
    """A residual that is above noise in one stretch only, described there. `point`: the model of the recording."""
    experiment, point = experiment.corrected(point)
    block = experiment.trial.block_s
    rows = np.zeros(len(experiment.measured), dtype=bool)
    rows[round(stretch.begin_s / block) : round(stretch.end_s / block)] = True
    k = [channel.title for channel in experiment.titles].index(stretch.channel)
    channel = experiment.titles[k]
    values = replace(experiment, judged=()).residual(point, whole=True)[:, k] * channel.factor
    scaled = values, float(experiment.noise[k] * channel.factor)
    around = surroundings(experiment, point)
    found = described(experiment.trial.name, channel, stretch.times_noise, scaled, ~rows, around, block)
    return replace(
        found, begin_s=stretch.begin_s, end_s=stretch.end_s,
        form=replace(found.form, held_out=float("nan")),
    )  # fmt: skip


def surroundings(experiment: Experiment, point: Point) -> Surroundings:
    """Surroundings of each block. Pressures and motion are the model's, which have no noise."""
    given = experiment.signals(point)
    pressure = np.column_stack([given["pressure 1"], given["pressure 2"]])
    voltage = np.column_stack([given["voltage 1"], given["voltage 2"]]) if "voltage 1" in given else None
    time = np.asarray(np.arange(len(pressure)) * (experiment.trial.block_s))
    return Surroundings(pressure, voltage, time, given.get("angle"), given.get("velocity"))


def _of_equations(experiment: Experiment, point: Point, around: Surroundings) -> list[RemainingResidual]:
    errors = equation_errors(experiment, point)
    windows = around.windows(errors.begin, errors.span)
    late = experiment.held_samples[(errors.begin + errors.span - 1) * experiment.trial.block]
    out = []
    for k in errors.known:
        over = float(np.sqrt(np.mean(errors.values[~late, k] ** 2))) / errors.noise[k]
        if over >= thresholds.CLEAR_EQUATION_ERROR:
            scaled = errors.values[:, k], float(errors.noise[k])
            step = errors.span * experiment.trial.block_s  # a value covers several blocks
            out.append(described(experiment.trial.name, EQUATIONS[k], over, scaled, late, windows, step))
    return out


def described(
    recording: str,
    channel: Channel,
    over: float,
    scaled: tuple[Floats, float],
    late: NDArray[np.bool_],
    around: Surroundings,
    step: float,
) -> RemainingResidual:
    """A residual in words.

    Args:
        over: times its noise.
        scaled: the residual (N,) of the whole recording and the standard deviation of its noise, in the channel's unit.
        late: which of its values are not described (N,).
        step: time between two of its values [s].
    """
    values, noise = scaled
    begin, end = above_noise(values[:, None], np.array([noise]))
    early, then = values[~late], around.take(~late)
    return RemainingResidual(
        recording=recording,
        channel=channel.title[0].lower() + channel.title[1:],
        unit=unit_of(channel),
        times_noise=over,
        depends_on=shares(early, then),
        bands=bands(early, step),
        period=period(early, step),
        form=form(early, then, (values[late], around.take(late)) if late.any() else None),
        values=early,
        around=then,
        begin_s=begin * step,
        end_s=end * step,
    )


def shares(residual: Floats, around: Surroundings) -> dict[str, float]:
    """Share of a residual's variance that each kind of dependence explains alone, less what chance would, 0 to 1.

    By chance, each column explains a share of 1/n of n independent values.

    `residual`: (N,).
    """
    count = len(residual) / correlation_length(residual - residual.mean())
    total = float(np.sum((residual - residual.mean()) ** 2)) or 1.0
    out = {}
    for name, columns in around.groups().items():
        rank, left = _regression_residual(residual, columns)
        chance = rank / max(count - 1.0, rank + 1.0)
        share = 1.0 - float(left @ left) / total
        out[name] = float(np.clip((share - chance) / (1.0 - chance), 0.0, 1.0)) if chance < 1.0 else 0.0
    return out


def _regression_residual(residual: Floats, columns: Floats) -> tuple[int, Floats]:
    spread = columns.std(axis=0)
    varying = columns[:, spread > 1e-9 * (np.abs(columns).max() or 1.0)]
    scaled = (varying - varying.mean(axis=0)) / varying.std(axis=0)
    design = np.column_stack([np.ones(len(residual)), scaled])
    solution, _, rank, _ = np.linalg.lstsq(design, residual, rcond=1e-9)
    return int(rank) - 1, np.asarray(residual - design @ solution)


def bands(residual: Floats, step: float) -> dict[str, float]:
    """Share of a residual's power in each band of frequency. `residual`: (N,), at a constant step."""
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    frequency = np.fft.rfftfreq(len(residual), step)
    total = float(power[1:].sum()) or 1.0
    edges = (0.0, *(edge for edge in EDGES if edge < 0.5 / step), np.inf)
    out = {}
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        name = f"below {high:g} Hz" if low == 0.0 else f"{low:g} to {high:g} Hz"
        name = f"above {low:g} Hz" if high == np.inf else name
        inside = (frequency > low) & (frequency <= high)
        out[name] = float(power[inside].sum()) / total
    return out


def period(residual: Floats, step: float) -> float:
    """Period [s] about which the residual's power lies: that of the power's mean frequency."""
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    frequency = np.fft.rfftfreq(len(residual), step)
    mean = float(power[1:] @ frequency[1:] / max(power[1:].sum(), 1e-300))
    return 1.0 / mean if mean > 0.0 else float("inf")


def form(residual: Floats, around: Surroundings, later: tuple[Floats, Surroundings] | None = None) -> SumOfTerms:
    """Few terms that explain a residual: forward, each kept only while the Bayesian criterion falls.

    `residual`: (N,). `later`: residual (M,) and surroundings of what was held out, for judging.
    """
    library = around.library()
    ones = np.ones_like(residual)
    memory = correlation_length(residual - residual.mean())
    chosen: list[str] = []
    left = residual - residual.mean()
    total = float(left @ left) or 1.0
    coefficients: Floats = np.array([residual.mean()])
    for _ in range(_TERMS):
        best = None
        for name in library:
            if name in chosen or np.ptp(library[name]) == 0.0:
                continue
            design = np.column_stack([ones, *(library[n] for n in (*chosen, name))])
            solution = np.linalg.lstsq(design, residual, rcond=None)[0]
            rest = residual - design @ solution
            if best is None or float(rest @ rest) < best[0]:
                best = float(rest @ rest), name, solution, rest
        count = len(residual) / memory
        if (
            best is None
            or count * np.log(float(left @ left) / max(best[0], 1e-300)) < np.log(count) + thresholds.STRONG
        ):
            break
        chosen.append(best[1])
        coefficients, left = np.asarray(best[2], dtype=np.float64), np.asarray(best[3], dtype=np.float64)
        # What is left has a shorter memory than what the terms have explained.
        memory = correlation_length(left - left.mean())
    held = float("nan")
    if later is not None and len(later[0]):
        terms = later[1].library()
        predicted = coefficients[0] + sum(
            (value * terms[name] for name, value in zip(chosen, coefficients[1:], strict=True)), np.zeros(len(later[0]))
        )
        held = 1.0 - float(np.sum((later[0] - predicted) ** 2)) / max(float(np.sum(later[0] ** 2)), 1e-300)
    pairs = tuple(zip(chosen, coefficients[1:].tolist(), strict=True))
    return SumOfTerms(pairs, 1.0 - float(left @ left) / total, held)


def means(residual: Floats, over: Floats, which: Sequence[bool] | NDArray[np.bool_] | None = None) -> Floats:
    """Means over bins of equal counts (b, 2): of the quantity that defines the bins, and of a residual.

    Args:
        residual: (N,).
        over: (N,).
        which: only these (N,); default: all.
    """
    kept = np.ones(len(residual), dtype=bool) if which is None else np.asarray(which)
    order = np.argsort(over[kept], kind="stable")
    x, y = over[kept][order], residual[kept][order]
    count = min(_BINS, len(x) // 5)
    if count < 2:
        return np.zeros((0, 2))
    return np.array(
        [[a.mean(), b.mean()] for a, b in zip(np.array_split(x, count), np.array_split(y, count), strict=True)]
    )


def strongest(shares: Mapping[str, float], least: float) -> list[tuple[str, float]]:
    """Dependences of at least a share, the largest first."""
    return sorted(((n, v) for n, v in shares.items() if v >= least), key=lambda item: -item[1])
