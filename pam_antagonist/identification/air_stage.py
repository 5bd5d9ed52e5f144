"""Chambers and valves, or regulators, from the measured motion: the joint's mechanics need not be known.

Commands and the measured angle drive the chambers (:mod:`pam_antagonist.model.drive`), and the simulated
pressures are compared with the measured ones. The simulation starts anew from the measured pressures after a horizon of
a second at most: a valve that is shut leaves a pressure to an integrator, whose free run says nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.runs import Run
from pam_antagonist.inference.fit import Fit, Residual, Values, deviations, fitted, refined, within_bounds
from pam_antagonist.inference.fit_errors import Rows, with_errors
from pam_antagonist.inference.unknown import Unknown, parameters
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import Inputs
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import limits

Floats = NDArray[np.float64]

HORIZONS = (0.1, 1.0)
"""[s] Of the simulations, from short to long."""
_INDEPENDENT = 10.0
"""[1/s] Errors of a model last; so many values a second count as independent."""
SUPPLY = "supply.pressure"
_SUPPLY_REACH = 10.0
"""How far a fit may move it, in standard deviations of its prior: by 18 %. Chosen with one rig in view whose supply
droops by more. Without a bound, the model alone erred by 1.31 in place of 1.47 deg there, but the filter's intervals
were too wide."""
_UNIT = 5e3
"""[Pa] Unit of the residuals: the error of a good model of valve and chamber."""
_LONGEST_STEP = 2e-3
"""[s] Of the integration."""
_FEWEST_ROWS = 2
_OPENED = 2.0
"""By so many standard deviations of its prior an overlap is smaller at the beginning of a further fit."""
_WELL = 0.05
"""A fit whose cost is below this share of that of errors of one unit, 1 kPa as RMS, needs no further start."""
_LAST_EVALUATIONS = 4
"""The most derivatives of the last fit, which begins near its end."""


def unknowns(rig: Rig, runs: Sequence[Run] = ()) -> list[Unknown]:
    """The numbers of chambers and valves, or regulators, that no data sheet tells.

    `runs`: whose pressures the supply has filled.
    """
    if rig.drive == "regulator":
        # A regulator holds its pressure while the volume changes: the exponent of what is seen may vanish.
        out = [replace(_positive("gas.polytropic_volume", rig, 0.7, 0.0, 1.9), may_vanish=True)]
        for name in ("frequency_1", "frequency_2", "damping"):
            out.append(_positive(f"effects.regulator_lag.{name}", rig, 0.5))
        return out
    out = [_positive("gas.polytropic_volume", rig, 0.3, 0.25, 1.9)]
    for i in (1, 2):
        for name in ("inflow_area", "outflow_area"):
            out.append(_positive(f"valve_{i}.{name}", rig, 0.35))
        overlap, shift = f"valve_{i}.overlap", f"effects.valve_offset.voltage_{i}"
        if rig.value(overlap) > 0.0:
            low, high = rig.bounds.get(overlap, (0.0, 0.9))
            out.append(Unknown(overlap, (overlap,), rig.value(overlap), 0.05, low=low, high=high))
        width = 0.03 * (rig.valves.voltage_max - rig.valves.voltage_min)
        out.append(Unknown(shift, (shift,), rig.value(shift), width, low=-2.0, high=2.0))
    # A gauge tells it, but a supply that droops is lower. No supply has filled a muscle beyond its own pressure.
    highest = max((float(run.pressure.max()) for run in runs), default=0.0)
    out.append(replace(_positive(SUPPLY, rig, 0.02, highest), reach=_SUPPLY_REACH))
    return out


def _positive(path: str, rig: Rig, share: float, low: float = 0.0, high: float = math.inf) -> Unknown:
    least, most = limits(path)
    return Unknown(path, (path,), rig.value(path), share, True, max(low, least), min(high, most))


def simulated(run: Run, p: Floats, zero: float, horizon: float) -> tuple[Floats, NDArray[np.bool_]]:
    """Pressures (N, 2) [Pa] that a model gives for commands and measured motion, and the rows that are a start (N,).

    `p`: parameter vector of a locked joint (m,). `zero`: reading of the encoder at ψ = 0 [rad]. `horizon`: time after
    which the simulation starts anew from the measurement [s].
    """
    (shown,), starts = simulated_each(run, [p], zero, horizon)
    return shown, starts


def simulated_each(
    run: Run, vectors: Sequence[Floats], zero: float, horizon: float
) -> tuple[list[Floats], NDArray[np.bool_]]:
    """:func:`simulated` of several models side by side."""
    known = np.flatnonzero(np.isfinite(run.angle))
    angle = np.interp(run.time, run.time[known], run.angle[known]) - zero
    size = max(round(horizon / run.period), _FEWEST_ROWS)
    # Where the angle is not known yet, or no longer, nothing is simulated.
    begin, end = known[0], known[-1] + 1
    first = np.append(np.arange(begin, max(end - size // 2, begin + 1), size), end)
    starts = np.zeros(len(run), bool)
    starts[first[:-1]] = True
    along = Inputs.at(run.time, _LONGEST_STEP, first, command=run.command, motion=angle[:, None])
    settled = [along.settled(angle[first[:-1]], run.pressure[first[:-1]], p) for p in vectors]
    # What droops or lags goes on over a restart.
    found = [states[:, 2:4].copy() for states, _ in along.driven_each(settled, vectors, keeps=first[:-1] > begin)]
    for shown in found:
        shown[:begin], shown[end:] = run.pressure[:begin], run.pressure[end:]
    return found, starts


def usable(runs: Sequence[Run]) -> list[Run]:
    """Stretches with commands throughout and a measured angle."""
    return [part for run in runs for part in run.commanded() if np.isfinite(part.angle).any()]


def errors(rig: Rig, runs: Sequence[Run]) -> tuple[float, float]:
    """Errors of the pressures over the longest horizon, RMS [Pa]: of the model, and of pressures that do not change.

    `runs`: corrected by the found calibration; :func:`usable` ones count.
    """
    p, of_model, of_rest = rig.parameters("locked"), [np.zeros(1)], [np.zeros(1)]
    for run in usable(runs):
        shown, starts = simulated(run, p, 0.0, HORIZONS[-1])
        last = np.maximum.accumulate(np.where(starts, np.arange(len(run)), 0))
        of_model.append((run.pressure - shown)[~starts].ravel())
        of_rest.append((run.pressure - run.pressure[last])[~starts].ravel())
    first, second = (math.sqrt(float(np.mean(np.concatenate(parts) ** 2))) for parts in (of_model, of_rest))
    return first, second


def residual_of(
    rig: Rig, runs: Sequence[Run], zero: float, horizon: float, unknown: Sequence[Unknown] = (), raw: bool = False
) -> Residual:
    """The residuals of all runs, in their units, or in Pa where they are ``raw``.

    `zero`: reading of the encoder at ψ = 0 [rad]. `horizon`: of the simulations [s].
    """

    def residual(each: Sequence[Values]) -> list[Floats]:
        every = errors_of(rig, runs, zero, horizon, unknown, each)
        return [
            np.concatenate([np.zeros(0), *((1.0 if raw else _weight(run)) * left for run, left in errors)])
            for errors in every
        ]

    return residual


def errors_of(
    rig: Rig, runs: Sequence[Run], zero: float, horizon: float, unknown: Sequence[Unknown], each: Sequence[Values]
) -> list[list[tuple[Run, Floats]]]:
    """What a model leaves of the runs, for each of several values: the errors of pressure 1, then of pressure 2 [Pa].

    The starts of the simulations are left out.
    """
    vector, out = rig.parameters("locked"), [[] for _ in each]  # type: ignore[var-annotated]
    for name in dict.fromkeys(run.name for run in runs):
        vectors = [par.changed(vector, parameters(unknown, one, name) if unknown else one) for one in each]
        for run in (run for run in runs if run.name == name):
            shown, starts = simulated_each(run, vectors, zero, horizon)
            for one, pressures in zip(out, shown, strict=True):
                one.append((run, (run.pressure - pressures)[~starts].T.ravel()))
    return out


def _weight(run: Run) -> float:
    """What turns an error [Pa] of a run into a residual in its unit."""
    return math.sqrt(min(_INDEPENDENT * run.period, 1.0)) / _UNIT


def fit_air(
    rig: Rig,
    runs: Sequence[Run],
    zero: float,
    evaluations: int = 12,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
    free: Sequence[Unknown] | None = None,
    refine: bool = False,
) -> Fit | None:
    """Fit chambers and valves, or regulators, with growing horizons; None without commands.

    `zero`: reading of the encoder at ψ = 0 [rad]. `refine`: whether errors are weighed by their size at last, and each
    recording may deviate a little.
    """
    free, given = unknowns(rig) if free is None else list(free), usable(runs)
    if not given:
        return None
    found: Fit | None = None
    for begin in _starts(free):
        again, amounts = None, begin
        for horizon in HORIZONS:
            if progress:
                progress(f"{'regulators' if rig.drive == 'regulator' else 'valves'}, horizons of {horizon:g} s")
            again = fitted(free, residual_of(rig, given, zero, horizon, free), amounts, evaluations, jobs)
            amounts = again.amounts
        assert again is not None
        found = again if found is None or again.cost < found.cost else found
        if found.cost < _WELL * _cost_of_units(given):
            break
    assert found is not None
    if not refine:
        return within_bounds(found, residual_of(rig, given, zero, HORIZONS[-1], free), evaluations, jobs)
    names = list(dict.fromkeys(run.name for run in given))
    areas = [f"valve_{i}.{way}flow_area" for i in (1, 2) for way in ("in", "out")]
    extra = deviations({path: {path: rig.value(path)} for path in areas}, free, names)
    averaged = max(given[0].period / rig.sample_period, 1.0)
    left = residual_of(rig, given, zero, HORIZONS[-1], [*free, *extra], raw=True)
    return refined(
        found, extra, lambda each: [{"pressure": one} for one in left(each)],
        {"pressure": rig.sensors.error("pressure") / math.sqrt(averaged)}, _LAST_EVALUATIONS, jobs,
    )  # fmt: skip


def _starts(free: Sequence[Unknown]) -> list[Floats]:
    """First amounts of the fits: an orifice that a guess keeps shut shows nothing, so others open one or both."""
    ways = [(0.0, -_OPENED) if item.name.endswith(".overlap") else (0.0,) for item in free]
    return [np.array(amounts) for amounts in product(*ways)]


def _cost_of_units(runs: Sequence[Run]) -> float:
    """The cost of errors that are one unit, as RMS, of both pressures."""
    return sum(min(_INDEPENDENT * run.period, 1.0) * len(run) for run in runs)


def with_air_errors(
    fit: Fit, rig: Rig, runs: Sequence[Run], jobs: int, elsewhere: Sequence[tuple[Rig, Sequence[Run]]] = ()
) -> Fit:
    """A fit over the longest horizon, with the standard errors of its values.

    `elsewhere`: rig and runs, each with one independent change of the joint by its standard error.
    """
    one, *others = (residual_of(this, usable(parts), 0.0, HORIZONS[-1], fit.unknowns)
                    for this, parts in ((rig, runs), *elsewhere))  # fmt: skip
    (left,) = errors_of(rig, usable(runs), 0.0, HORIZONS[-1], fit.unknowns, [fit.values])
    noise = rig.sensors.error("pressure")
    return with_errors(fit, one, jobs, others, Rows.of((run.name, len(e), _weight(run) * noise) for run, e in left))
