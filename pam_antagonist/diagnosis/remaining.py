"""What is not explained: where it is, on what it depends, and what form a sparse regression suggests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import dependence
from pam_antagonist.diagnosis.dependence import Form, Surroundings
from pam_antagonist.diagnosis.equations import NAMES, SPAN, UNITS, equation_errors
from pam_antagonist.diagnosis.select import Model
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import AT_NOISE
from pam_antagonist.inference.trial import ANGLE, BLOCK, PRESSURE_1, blocks

Floats = NDArray[np.float64]

_TITLES = ("joint angle", "torque", "pressure 1", "pressure 2")
_UNITS = ("deg", "N m", "kPa", "kPa")
_FACTORS = (float(np.degrees(1.0)), 1.0, 1e-3, 1e-3)
_LEAST_SHARE = 0.05
_CLEAR = 1.3
"""An equation's error is described where it is so many times the sensors': its noise is known less well."""


@dataclass(frozen=True, eq=False)
class Left:
    """A residual that no effect explains, in one channel of one recording.

    Attributes:
        recording: its name.
        channel: a sensor, or the error of an equation.
        unit: of the residual.
        times_noise: its root mean square over what the sensors alone give.
        depends_on: share of its variance that goes with each kind of dependence alone.
        bands: share of its power in each band of frequency.
        period: about which its power lies [s].
        form: what a sparse regression suggests.
        values: the residual (N,) where it was fitted.
        around: what was there.
    """

    recording: str
    channel: str
    unit: str
    times_noise: float
    depends_on: dict[str, float]
    bands: dict[str, float]
    period: float
    form: Form
    values: Floats
    around: Surroundings

    def line(self) -> str:
        """The description as a line."""
        goes = ", ".join(f"{n} ({100 * v:.0f} %)" for n, v in dependence.strongest(self.depends_on, _LEAST_SHARE)[:3])
        with_it = (
            f"depends on {goes}" if goes else "depends on none of pressure, length, direction, command, time alone"
        )
        band = max(self.bands, key=lambda name: self.bands[name])
        said = (
            f"{self.recording}, {self.channel}: {self.times_noise:.1f} times the noise; {with_it}; "
            f"{100 * self.bands[band]:.0f} % of its power {band}, typical period {self.period:.1f} s"
        )
        if self.form.terms and self.form.share >= _LEAST_SHARE:
            held = "" if np.isnan(self.form.held_out) else f", {100 * max(self.form.held_out, 0.0):.0f} % held out"
            said += (
                f"; it looks like {self.form} [{self.unit}], which explains {100 * self.form.share:.0f} % of it{held}"
            )
        return said


def describe(experiments: Sequence[Experiment], model: Model) -> list[Left]:
    """What is beyond the noise: of the equations of each recording, then of its sensors."""
    out = []
    for experiment, fitted in zip(experiments, model.fits, strict=True):
        over = experiment.times_noise(fitted.residual)
        if np.max(over) < AT_NOISE:
            continue
        out += _of_equations(experiment, fitted.point)
        around = _around(experiment, fitted.point)
        first = -(-experiment.fitted // BLOCK)
        whole = experiment.residual(fitted.point, whole=True)[: len(experiment.measured)]
        for k, channel in enumerate(experiment.channels):
            if over[k] >= AT_NOISE:
                values = whole[:, k] * _FACTORS[channel]
                late = np.arange(len(values)) >= first
                titled = _TITLES[channel], _UNITS[channel]
                out.append(_left(experiment, titled, float(over[k]), values, late, around, BLOCK * experiment.trial.dt))
    return out


def _of_equations(experiment: Experiment, point: Point) -> list[Left]:
    errors = equation_errors(experiment, point)
    around = _around(experiment, point)
    windows = _means(around, errors.begin)
    late = errors.begin + SPAN > experiment.fitted // BLOCK
    out = []
    for k in errors.known:
        over = float(np.sqrt(np.mean(errors.values[~late, k] ** 2))) / errors.noise[k]
        if over >= _CLEAR:
            titled, step = (NAMES[k], UNITS[k]), SPAN * BLOCK * experiment.trial.dt
            out.append(_left(experiment, titled, over, errors.values[:, k], late, windows, step))
    return out


def _left(
    experiment: Experiment,
    titled: tuple[str, str],
    over: float,
    values: Floats,
    late: NDArray[np.bool_],
    around: Surroundings,
    step: float,
) -> Left:
    early, then = values[~late], around.take(~late)
    return Left(
        recording=experiment.trial.name,
        channel=titled[0],
        unit=titled[1],
        times_noise=over,
        depends_on=dependence.shares(early, then),
        bands=dependence.bands(early, step),
        period=dependence.period(early, step),
        form=dependence.form(early, then, (values[late], around.take(late)) if late.any() else None),
        values=early,
        around=then,
    )


def _around(experiment: Experiment, point: Point) -> Surroundings:
    """What was there in each block; pressures and motion are the model's, which have no noise."""
    model = blocks(experiment.simulated(point, whole=True))
    step = BLOCK * experiment.trial.dt
    free = experiment.trial.joint == "free"
    return Surroundings(
        model[:, PRESSURE_1:],
        blocks(experiment.trial.voltage),
        np.asarray(np.arange(len(model)) * step),
        model[:, ANGLE] if free else None,
        np.gradient(model[:, ANGLE], step) if free else None,
    )


def _means(around: Surroundings, begin: NDArray[np.int64]) -> Surroundings:
    """The same in windows."""

    def mean(values: Floats) -> Floats:
        return np.array([values[b : b + SPAN].mean(axis=0) for b in begin])

    return Surroundings(
        mean(around.pressure),
        mean(around.voltage),
        mean(around.time),
        None if around.angle is None else mean(around.angle),
        None if around.velocity is None else mean(around.velocity),
    )
