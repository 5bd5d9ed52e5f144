"""Joint and muscles from measured pressures: no valve has to be known.

The measured pressures drive the joint (:mod:`pam_antagonist.model.drive`), and the simulated angle is
compared with the measured one. Where the torque was measured, the torque of the muscles at the measured angle is
compared as well. The simulation starts anew from the measurement after a horizon, which grows from a fraction of a
second to whole runs, so that no start runs away. A fit that begins far off may still end in a false minimum. So another
one begins where the torques are in balance along the measured motion: this needs no simulation, which could run away.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist._jit import kernel
from pam_antagonist.identification.runs import Run
from pam_antagonist.inference.fit import Fit, Residual, Values, deviations, fitted, refined, within_bounds
from pam_antagonist.inference.fit_errors import Rows, with_errors
from pam_antagonist.inference.free_parameters import EYE_STD, STOP, off_stop, shows_stop, stop_std
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.inference.unknown import Unknown, parameters
from pam_antagonist.model import dynamics
from pam_antagonist.model import parameters as par
from pam_antagonist.model.drive import TORQUE, Inputs
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.model.equilibrium import initial_state, rest_angle
from pam_antagonist.model.force_forms import FORMS
from pam_antagonist.recording.rows import curve
from pam_antagonist.rig import Rig
from pam_antagonist.rig.schema import limits

Floats = NDArray[np.float64]
_torque, _imbalance, _STATES = dynamics.torque, dynamics.imbalance, par.STATES

ZERO, DELAY = "calibration.encoder_zero", "calibration.delay_angle"
"""Names and signs are those of the rig file: the delay is negative where the angle is stamped too late."""
WEIGHT_COS, WEIGHT_SIN = "limb: torque at angle 0", "limb: torque that grows with the sine"
HORIZONS = (0.3, math.inf)
"""[s] Of the simulations, from short to long."""
_ALONG = 0.0
"""[s] Horizon without a simulation: the balance of torques along the measured motion counts."""
_INDEPENDENT = 10.0
"""[1/s] Errors of a model last; so many values a second count as independent."""
_ANGLE_SHARE = 0.01
"""Unit of the angle's residuals, as a share of the measured range."""
TORQUE_SHARE, _BALANCE_SHARE = 0.02, 0.1
"""Units of the torque and of the balance, as a share of one muscle's torque: derivatives of an encoder err by more than
a model. That of the balance was chosen of 0.02, 0.05 and 0.1 on four simulated joints, two of which had ended in a
false minimum."""
_LONGEST_STEP = 2e-3
"""[s] Of the integration."""
_ZERO_STD = math.radians(5.0)
"""[rad] Of the encoder's zero, where both muscles are alike."""
BY_EYE = 0.0, EYE_STD
"""[rad] The zero of such an encoder: most probable value, and standard deviation."""
_LARGEST_ZERO_STD = math.radians(30.0)
_UNLIKE = 0.35
"""Standard deviation of the difference of two muscles' forces, as a share of a force."""
_START_STD = 0.7
"""Scatter of further starts about the first one, in standard deviations of the prior."""
_HOPS, _HOP_STD = 6, 0.6
"""Most further starts around the best fit, and their scatter, in standard deviations of the prior. Chosen of 0.3, 0.6
and 1 on one simulated joint, on which two starts ended in a false minimum and one to three hops of 0.6 left it."""
_COMES_BACK, _SAME = 2, 0.05
"""So many hops that end at the same cost end the search, and how different such costs may be."""
_LOST = 9.0
"""A fit whose cost is so many times that of errors of one unit, 3 % of the range as RMS, has found nothing."""
_LEAST_NOISE = 1e-5
_LAST_EVALUATIONS = 8
"""The most derivatives of the last fit, which begins near its end."""
_MOVING = 0.05
"""[rad/s] A slower joint starts at rest."""


def torques(run: Run, p: Floats, zero: float = 0.0, delay: float = 0.0) -> Floats:
    """Torque of the muscles [N m] at the rows of a run whose angle is known. `p`: parameter vector (m,).

    `zero`: reading of the encoder at ψ = 0 [rad]. `delay`: by how much the reading is late [s].
    """
    return torques_each(run, [p], [(zero, delay)])[0]


def torques_each(run: Run, vectors: Sequence[Floats], encoders: Sequence[tuple[float, float]]) -> list[Floats]:
    """:func:`torques` of several models side by side. `encoders`: zero and delay of each."""
    known = np.isfinite(run.angle)
    speed, pressure, out = run.velocity[known], run.pressure[known], dict[int, Floats]()
    # Models that run side by side have one motion.
    for zero, delay in dict.fromkeys(encoders):
        alike = [k for k, encoder in enumerate(encoders) if encoder == (zero, delay)]
        at, those = run.angle[known] - zero + delay * speed, [vectors[k] for k in alike]
        along = Inputs.at(run.time[known], _LONGEST_STEP, pressure=pressure, motion=np.column_stack([at, speed]))
        starts = [along.settled(at[:1], pressure[:1], p) for p in those]
        found = along.driven_each(starts, those, TORQUE)
        out |= {k: shown[0] for k, (_, shown) in zip(alike, found, strict=True)}
    return [out[k] for k in range(len(vectors))]


@kernel
def _imbalances(
    angle: Floats, velocity: Floats, acceleration: Floats, direction: Floats, pressure: Floats, p: Floats
) -> Floats:
    """Imbalance of all torques [N m] at measured angles (N,), their derivatives (N,) and pressures (N, 2)."""
    out = np.empty(angle.shape[0])
    x = np.zeros(int(p[_STATES]))
    for k in range(angle.shape[0]):
        x[0], x[1], x[2], x[3] = angle[k], velocity[k], pressure[k, 0], pressure[k, 1]
        out[k] = _imbalance(x, acceleration[k], direction[k], p)
    return out


def _unbalanced(run: Run, p: Floats, zero: float, delay: float, stop: float) -> Floats:
    """Imbalance of a model's torques [N m] along the motion that a run shows, where it is known and within the stops.

    `zero`: reading at ψ = 0 [rad]. `delay`: by how much the reading is late [s]. `stop`: angle of the stops [rad].
    """
    speed, acceleration = run.velocity, run.acceleration
    rows = np.isfinite(run.angle) & (acceleration != 0.0) & (np.abs(run.angle) < stop)
    speed, acceleration = speed[rows], acceleration[rows]
    angle = run.angle[rows] - zero + delay * speed
    speed = speed + delay * acceleration
    direction = np.where(np.abs(speed) > _MOVING, np.sign(speed), 0.0)
    return np.asarray(_imbalances(angle, speed, acceleration, direction, run.smoothed[rows], p))


AIR_HOOKS = frozenset({
    "spool_voltage", "voltage_shift", "open_rate", "open_rate_shift", "supply_change", "mass_loss", "cooling",
    "swelling", "valve_pressure_rate", "asked_pressure",
})  # fmt: skip
"""Where an effect acts on the air: pressures that drive a joint have it in them already."""
_AIR = ("valve_", "gas.", "supply.")
"""Beginnings of the names of parameters of the air."""
_EVERYWHERE = "learned"


def is_of_air(name: str) -> bool:
    """Whether a parameter is of chambers, valves or regulators, by its dotted path."""
    if not name.startswith("effects."):
        return name.startswith(_AIR)
    effect = name.split(".")[1]
    return effect != _EVERYWHERE and bool(AIR_HOOKS & set(CATALOGUE[effect].hooks))


def of_joint(rig: Rig, free: Sequence[Unknown]) -> list[Unknown]:
    """Free parameters of the joint; a linear force map is unknown by its values at the middle length and its slopes."""
    known, out = {item.name: item for item in free if not is_of_air(item.name)}, []
    for i in (1, 2):
        for kind in "vw":
            slope, intercept = f"muscle_{i}.force.{kind}1", f"muscle_{i}.force.{kind}2"
            if slope in known and intercept in known:
                out += _line(known.pop(slope), known.pop(intercept), rig.geometry.length, kind == "v")
    return [*out, *known.values()]


def _line(slope: Unknown, intercept: Unknown, middle: float, keeps_sign: bool) -> list[Unknown]:
    """A line by its value at the middle length and its slope, which does not change that value."""
    value = slope.start * middle + intercept.start
    std = math.hypot(slope.prior_std * middle, intercept.prior_std)
    keeps_sign = keeps_sign and value > 0.0
    name = f"{slope.name[:-1]}, value at the middle length"
    share = min(std / value, 0.5) if keeps_sign else std
    at_middle = Unknown(name, (), value, share, keeps_sign, adds={intercept.name: 1.0})
    return [at_middle, Unknown(slope.name, (slope.name,), slope.start, slope.prior_std, adds={intercept.name: -middle})]


def unknowns(rig: Rig, runs: Sequence[Run]) -> list[Unknown]:
    """The numbers of joint and muscles that no data sheet tells, with their priors.

    `rig`: as configured, with forces of a data sheet.
    """
    out = []
    for i in (1, 2):
        force = f"muscle_{i}.force."
        for name, share in (("c1", 0.25), ("c2", 0.15), ("c3", 0.4)):
            out.append(_positive(rig, force + name, share))
        out.append(_positive(rig, force + "c6", 0.03))
    both = ("muscle_1.force.c4", "muscle_2.force.c4")
    out.append(Unknown(both[0], both, rig.value(both[0]), 0.3, True))
    out.append(_positive(rig, "geometry.radius", 0.06))
    out.append(_positive(rig, "joint.inertia", 0.2))
    out.append(replace(_positive(rig, "joint.viscous_friction", 1.0), may_vanish=True))
    out.append(replace(_positive(rig, "friction.shaft", 0.5), may_vanish=True))
    scale = torque_scale(rig)
    slopes = tuple(f"effects.friction_by_pressure.slope_{i}" for i in (1, 2))
    coulomb = "effects.friction.coulomb"
    out.append(Unknown(coulomb, (coulomb,), 0.005 * scale, 1.0, True, may_vanish=True))
    slope = 0.005 * scale / (0.5 * rig.supply.pressure)
    out.append(Unknown(slopes[0], slopes, slope, 1.0, True, high=1e-2, may_vanish=True))
    free = [run for run in runs if not run.locked]
    if free:
        weight = unknown_weight(rig)
        torque, hanging = (rig.value(f"effects.limb_weight.{name}") for name in ("torque", "hanging"))
        # −G sin(ψ − ψ_h) = G sin ψ_h cos ψ − G cos ψ_h sin ψ.
        out.append(Unknown(WEIGHT_COS, (), torque * math.sin(hanging), weight))
        out.append(Unknown(WEIGHT_SIN, (), -torque * math.cos(hanging), weight))
    # The angles of a file with a stop count from the middle between its stops.
    return [*out, *encoder(middle(runs, rig) if rig.joint.stop is None else BY_EYE)]


def encoder(zero: tuple[float, float]) -> list[Unknown]:
    """Zero and delay of the encoder. `zero`: most probable value, and its standard deviation [rad]."""
    return [Unknown(ZERO, (), *zero), Unknown(DELAY, (), 0.0, 0.01, low=-0.1, high=0.1)]


def stops(rig: Rig, runs: Sequence[Run]) -> list[Unknown]:
    """The angle of the stops, where a free joint comes near one."""
    if not any(run.moves and shows_stop(rig, run.angle) for run in runs):
        return []
    return [Unknown(STOP, (STOP,), rig.value(STOP), stop_std(rig), True, high=limits(STOP)[1])]


def torque_scale(rig: Rig) -> float:
    """Torque [N m] of one muscle at half the supply's pressure and the middle length."""
    return abs(float(_torque(*_at_rest(rig, rig.atmosphere.pressure))))


def _at_rest(rig: Rig, second: float) -> tuple[Floats, Floats]:
    """State (n,) of a joint at ψ = 0, muscle 1 at half the supply's pressure, and parameters (m,).

    `second`: pressure of muscle 2 [Pa].
    """
    p = rig.parameters()
    return initial_state(0.0, 0.5 * (rig.supply.pressure + rig.atmosphere.pressure), second, np.zeros(2), p), p


def unknown_weight(rig: Rig) -> float:
    """Standard deviation of the torque [N m] of a limb that nobody told."""
    return max(rig.joint.mass * rig.joint.gravity * 0.1, 0.005 * torque_scale(rig))


def middle(runs: Sequence[Run], rig: Rig) -> tuple[float, float]:
    """Angle [rad] at which both pressures are equal, by a straight line through all readings, and its distance from 0.

    The distance is a standard deviation: two muscles differ in force, and a limb has a weight. So equal pressures move
    the joint off ψ = 0.
    """
    moving = [run for run in runs if run.moves]
    if not moving:
        return 0.0, _ZERO_STD
    angle = np.concatenate([run.angle for run in moving])
    apart = np.concatenate([run.pressure[:, 0] - run.pressure[:, 1] for run in moving])
    known = np.isfinite(angle)
    slope, at_equal = np.polyfit(apart[known], angle[known], 1)
    mean = np.mean(np.concatenate([run.pressure.mean(axis=1) for run in moving])) - rig.atmosphere.pressure
    # The difference of the pressures that carries the weight.
    carried = unknown_weight(rig) / torque_scale(rig) * 0.5 * (rig.supply.pressure - rig.atmosphere.pressure)
    std = math.hypot(_ZERO_STD, _UNLIKE * float(slope * mean), float(slope * carried))
    return float(at_equal), min(std, _LARGEST_ZERO_STD)


def _positive(rig: Rig, path: str, share: float) -> Unknown:
    return Unknown(path, (path,), rig.value(path), share, True)


def model_values(unknown: Sequence[Unknown], values: Mapping[str, float], recording: str = "") -> dict[str, float]:
    """Parameters by dotted path, the weight of the limb included; without zero and delay."""
    out = parameters(unknown, values, recording)
    if WEIGHT_COS in values:
        cosine, sine = values[WEIGHT_COS], values[WEIGHT_SIN]
        out["effects.limb_weight.torque"] = math.hypot(cosine, sine)
        out["effects.limb_weight.hanging"] = math.atan2(cosine, -sine)
    return out


def simulated(
    run: Run, p: Floats, zero: float, delay: float, horizon: float = math.inf, longest: float = _LONGEST_STEP
) -> Floats:
    """Readings of the encoder (N,) [rad] that a model gives for the measured pressures of a run.

    `zero`: reading at ψ = 0 [rad]. `delay`: by how much the reading is late [s]. `horizon`: time after which the
    simulation starts anew from the measurement [s]. `longest`: step of the integration [s].
    """
    return simulated_each(run, [p], [(zero, delay)], horizon, longest)[0]


def simulated_each(
    run: Run, vectors: Sequence[Floats], encoders: Sequence[tuple[float, float]], horizon: float = math.inf,
    longest: float = _LONGEST_STEP,
) -> list[Floats]:  # fmt: skip
    """:func:`simulated` of several models side by side. `encoders`: zero and delay of each."""
    known = np.isfinite(run.angle)
    angle = np.interp(run.time, run.time[known], run.angle[known])
    size = max(round(horizon / run.period), 3) if math.isfinite(horizon) else len(run)
    first = np.append(np.arange(0, max(len(run) - size // 2, 1), size), len(run))
    begin = first[:-1]
    # What the reading shows with a delay has moved on meanwhile.
    speed = np.where(np.abs(run.velocity[begin]) < _MOVING, 0.0, run.velocity[begin])
    along = Inputs.at(run.time, longest, first, pressure=run.pressure)
    starts = [along.settled(angle[begin] - zero + delay * speed, run.pressure[begin], p, speed)
              for p, (zero, delay) in zip(vectors, encoders, strict=True)]  # fmt: skip
    out = []
    for (zero, delay), (states, _) in zip(encoders, along.driven_each(starts, vectors), strict=True):
        turned = states[:, 0]
        late = np.clip(run.time - delay, run.time[0], run.time[-1])
        out.append(zero + (turned if delay == 0.0 else curve(late, run.time, turned, states[:, 1])))
    return out


def by_the_model(run: Run, p: Floats) -> Run:
    """A run of a free joint without a measured angle, with the angle that the measured pressures give.

    `p`: parameter vector (m,).
    """
    p = par.changed(p, NO_REGULATORS)
    along = Inputs.at(run.time, _LONGEST_STEP, pressure=run.pressure)
    rest = np.array([rest_angle(run.pressure[0, 0], run.pressure[0, 1], p)])
    angle = along.driven(along.settled(rest, run.pressure[:1], p), p)[0][:, 0].copy()
    return replace(run, angle=angle, velocity=np.gradient(angle, run.time))


def muscle_torque(run: Run, stop: float) -> Floats:
    """Measured torque (N,) [N m] where it is the muscles', NaN elsewhere: on its stop a joint shares it with the stop.

    `stop`: angle from which on a free joint may lean on its stop [rad].
    """
    return run.torque if run.locked else np.where(np.abs(run.angle) < stop, run.torque, np.nan)


def errors_of(
    rig: Rig, runs: Sequence[Run], unknown: Sequence[Unknown], each: Sequence[Values], horizon: float = math.inf,
    longest: float = _LONGEST_STEP,
) -> list[list[tuple[str, Run, Floats]]]:  # fmt: skip
    """What a model leaves of the runs, for each of several values: kind, run, and the known errors [rad or N m].

    `horizon`: of the simulations [s].
    """
    vector, stop, out = rig.parameters(), off_stop(rig), [[] for _ in each]  # type: ignore[var-annotated]
    encoders = [(values.get(ZERO, 0.0), -values.get(DELAY, 0.0)) for values in each]
    for name in dict.fromkeys(run.name for run in runs):
        vectors = [par.changed(vector, {**model_values(unknown, values, name), **NO_REGULATORS}) for values in each]
        models = list(zip(vectors, encoders, strict=True))
        for run in (run for run in runs if run.name == name):
            seen, found = np.isfinite(run.angle), []
            if run.moves and horizon == _ALONG:
                found.append(("balance", [_unbalanced(run, p, *encoder, stop) for p, encoder in models]))
            elif run.moves:
                shown = simulated_each(run, vectors, encoders, horizon, longest)
                found.append(("angle", [(run.angle - one)[seen] for one in shown]))
            known = np.isfinite(muscle_torque(run, stop)[seen])
            if known.any():
                made = torques_each(run, vectors, encoders)
                found.append(("torque", [(run.torque[seen] - one)[known] for one in made]))
            for kind, lefts in found:
                for one, left in zip(out, lefts, strict=True):
                    one.append((kind, run, left))
    return out


def joined(errors: Iterable[tuple[str, Run, Floats]]) -> dict[str, Floats]:
    """Errors of each kind, of all runs one behind the other."""
    out: dict[str, list[Floats]] = {}
    for kind, _, values in errors:
        out.setdefault(kind, []).append(values)
    return {kind: np.concatenate(parts) for kind, parts in out.items()}


def residual_of(
    rig: Rig, runs: Sequence[Run], unknown: Sequence[Unknown], horizon: float, finer: bool = False
) -> Residual:
    """The residuals of all runs, in their units.

    `horizon`: of the simulations [s]. `finer`: whether pressures are ahead of straight lines between the rows, and the
    steps are half as long.
    """
    simulations = [run.finer() for run in runs] if finer else runs
    longest, share = (0.5 * _LONGEST_STEP, 2.0) if finer else (_LONGEST_STEP, 1.0)
    weight = _weights(rig, runs, share)

    def residual(each: Sequence[Values]) -> list[Floats]:
        every = errors_of(rig, simulations, unknown, each, horizon, longest)
        return [
            np.concatenate([np.zeros(0), *(weight(kind, run) * left for kind, run, left in errors)]) for errors in every
        ]

    return residual


def _weights(rig: Rig, runs: Sequence[Run], share: float = 1.0) -> Callable[[str, Run], float]:
    """What turns an error [rad, N m] of a kind and a run into a residual in its unit.

    A model's torque is the difference of two muscles', and errs by a share of one of them, however small it is. A unit
    by the measured range would be large where a locked joint was recorded too, and small for a free joint alone.

    `share`: rows of a run for each row that is known.
    """
    scale = torque_scale(rig)
    angle = _ANGLE_SHARE * _range([run.angle for run in runs if not run.locked])
    units = {"angle": angle, "torque": TORQUE_SHARE * scale, "balance": _BALANCE_SHARE * scale}

    def weight(kind: str, run: Run) -> float:
        return math.sqrt(min(_INDEPENDENT * share * run.period, 1.0)) / units[kind]

    return weight


def with_joint_errors(fit: Fit, rig: Rig, runs: Sequence[Run], jobs: int) -> Fit:
    """A fit over whole runs with the standard errors of its values, those of integration and encoder included.

    A joint that rests, such as at its stop, shows the same error of the encoder all the time.
    """
    residual, zero = residual_of(rig, runs, fit.unknowns, math.inf), rig.sensors.error("angle")
    finer = residual_of(rig, runs, fit.unknowns, math.inf, finer=True)

    def shifted(each: Sequence[Values]) -> Sequence[Floats]:
        return residual([{**values, ZERO: values.get(ZERO, 0.0) + zero} for values in each])

    lost = fit.cost > _LOST * _cost_of_units(runs)
    weight = _weights(rig, runs)
    rows = Rows.of(
        (run.name, len(left), weight(kind, run) * rig.sensors.error(kind))
        for kind, run, left in errors_of(rig, runs, fit.unknowns, [fit.values])[0]
    )
    return replace(with_errors(fit, residual, jobs, [finer, shifted], rows), lost=lost)


def _cost_of_units(runs: Sequence[Run]) -> float:
    """The cost of errors that are one unit, as RMS."""
    return 0.5 * sum(min(_INDEPENDENT * run.period, 1.0) * len(run) for run in runs)


def _range(columns: Sequence[Floats]) -> float:
    values = np.concatenate([np.zeros(1), *columns])
    known = values[1:][np.isfinite(values[1:])]
    return max(float(np.ptp(np.quantile(known, [0.01, 0.99]))), 1e-6) if len(known) else 1.0


def fit_joint(
    rig: Rig,
    runs: Sequence[Run],
    evaluations: int = 20,
    starts: int = 2,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
    free: Sequence[Unknown] | None = None,
    refine: bool = False,
) -> Fit:
    """Fit joint and muscles, with growing horizons. Short horizons have several starts, of which the best goes on.

    Where that one errs by more than the unit of the residuals over whole runs, the next one goes on as well.

    `starts`: number of starts: the first is the rig file, the second what balances the torques along the measured
    motion, the others are drawn from the priors. `refine`: whether
    errors are weighed by their size at last, and each recording may deviate a little. A rig that only data sheets tell
    of errs by more than its sensors, and its priors are wide.
    """
    progress = progress or (lambda text: None)
    free = unknowns(rig, runs) if free is None else list(free)
    rng = np.random.default_rng(seed)
    short, whole = (residual_of(rig, runs, free, horizon) for horizon in HORIZONS)
    tried = []
    for number in range(starts):
        progress(f"joint and muscles from measured pressures, start {number + 1} of {starts}")
        begin = _START_STD * rng.standard_normal(len(free)) if number else None
        if number == 1 and any(run.moves for run in runs):
            begin = fitted(free, residual_of(rig, runs, free, _ALONG), None, evaluations, jobs).amounts
        tried.append(fitted(free, short, begin, evaluations, jobs))
    found: Fit | None = None
    for one in sorted(tried, key=lambda one: one.cost):
        progress("joint and muscles from measured pressures, whole runs")
        again = fitted(free, whole, one.amounts, evaluations, jobs)
        found = again if found is None or again.cost < found.cost else found
        if found.cost < _cost_of_units(runs):
            break
    assert found is not None
    if not refine:
        found = _hopped(found, short, whole, _cost_of_units(runs), rng, evaluations, jobs, progress)
        return with_joint_errors(within_bounds(found, whole, evaluations, jobs), rig, runs, jobs)
    names = list(dict.fromkeys(run.name for run in runs))
    extra = deviations(_ways(rig), free, names)
    noise = {kind: max(rig.sensors.error(kind), _LEAST_NOISE) for kind in ("angle", "torque")}
    progress("joint and muscles, errors weighed by their size")
    return refined(
        found, extra, lambda each: [joined(one) for one in errors_of(rig, runs, [*free, *extra], each)], noise,
        _LAST_EVALUATIONS, jobs,
    )  # fmt: skip


def _hopped(
    found: Fit, short: Residual, whole: Residual, enough: float, rng: np.random.Generator, evaluations: int, jobs: int,
    progress: Callable[[str], None],
) -> Fit:  # fmt: skip
    """The best of a fit and of fits that begin around it: data that few starts explain have many minima.

    `enough`: cost at which none is looked for. Where hops come back to the same fit, there is no better one nearby.
    """
    back = 0
    for number in range(1, _HOPS + 1):
        if found.cost < enough or back == _COMES_BACK:
            break
        progress(f"joint and muscles from measured pressures, near the best fit, {number} of at most {_HOPS}")
        begin = found.amounts + _HOP_STD * rng.standard_normal(len(found.amounts))
        near = fitted(found.unknowns, short, begin, evaluations, jobs)
        again = fitted(found.unknowns, whole, near.amounts, evaluations, jobs)
        back += abs(again.cost - found.cost) < _SAME * found.cost
        found = again if again.cost < found.cost else found
    return found


def force_gains(rig: Rig) -> dict[str, float]:
    """The parameters to which the forces of both muscles are in proportion, by dotted path, with their values."""
    names = FORMS[rig.model.force].gains
    return {path: rig.value(path) for i in (1, 2) for name in names for path in [f"muscle_{i}.force.{name}"]}


def _ways(rig: Rig) -> dict[str, dict[str, float]]:
    """How the muscles of a rig may differ from recording to recording, see :func:`unknowns.deviations`."""
    out = {}
    middle = 0.5 * (rig.supply.pressure + rig.atmosphere.pressure)
    forces = dynamics.forces(*_at_rest(rig, middle))
    form = FORMS[rig.model.force]
    for i, force in enumerate(forces, 1):
        path = f"muscle_{i}.force."
        out[f"force of muscle {i}, gain"] = {
            path + name: rig.value(path + name) for name in form.gains if rig.value(path + name)
        }
        out[f"force of muscle {i}, offset"] = {path + form.offset: float(force)}
    return out
