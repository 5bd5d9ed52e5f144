"""The trials of ``control_laws``, each for one seed: steps, angle with stiffness, limits, yielding, and time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from pam_antagonist.cli.tried_gains import seen
from pam_antagonist.control.command import Mode
from pam_antagonist.control.governor import Limits
from pam_antagonist.control.laws import Reachable
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.control.tracking import SETTLED
from pam_antagonist.model import dynamics
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import Plant
from validation.control.loop import MISMATCH, Course, Floats, held, make_laws, run

STEP = {Mode.ANGLE: math.radians(20.0), Mode.TORQUE: 2.0}
"""Height of the steps, from minus to plus half of it and back [rad] or [N m]."""
HOLD_S = {("pi", Mode.ANGLE): 15.0, ("model", Mode.ANGLE): 5.0, ("pi", Mode.TORQUE): 8.0, ("model", Mode.TORQUE): 4.0}
"""How long each step is held [s]: the published PI takes long."""
STIFFNESS = 6.0  # of the steps [N m/rad]
GRID = ((-15.0, 5.0), (-10.0, 7.5), (0.0, 4.0), (0.0, 9.0), (10.0, 4.5), (10.0, 8.0), (15.0, 5.5))
"""Angles [°] and stiffness [N m/rad] that are held one after the other."""
GRID_S, STEADY_S = 4.0, 0.5
LIMITS = Limits(220e3, 640e3, math.radians(15.0), 0.8, 0.05, 0.05, 20.0)
"""Well within what the law would do by itself, so that the governor has work."""
LEVEL, PUSH = 0.999, 0.3
_LONGEST_S = 5.0
_EDGE_S = 0.15
"""[s] For so long after a push begins or ends, the velocity is its doing and not counted."""
TORQUES = ((0.25, 0.6), (0.5, 0.6), (1.0, 0.6), (2.0, 0.6), (2.0, 0.2))
"""Frequency [Hz] and amplitude [N m] of the torques from outside in the trial of yielding."""
YIELDING = (6.0, 0.5)
"""Stiffness [N m/rad] and damping [N m s/rad] of the trial of yielding."""


def settling(true: Floats, wanted: float, height: float, period: float) -> tuple[float, float]:
    """Time until a step settles [s], inf where it does not, and overshoot, in its unit.

    Args:
        true: course from the step on (N,) [rad] or [N m].
        wanted: value after the step.
        height: of the step, with its sign; it has settled where it stays within 5 % of that.
        period: of a sample [s].
    """
    outside = np.flatnonzero(np.abs(true - wanted) > SETTLED * abs(height))
    settled = 0 if not len(outside) else math.inf if outside[-1] == len(true) - 1 else (outside[-1] + 1) * period
    return float(settled), float(max(np.max(math.copysign(1.0, height) * (true - wanted)), 0.0))


def step_course(rig: Rig, law: str, quantity: Mode, seed: int) -> Course:
    """Steps of one quantity with one law: minus half of the step, then up, then down.

    Args:
        rig: as declared.
        law: of ``control.LAWS``.
        quantity: angle, of a free joint, or torque, of a locked one.
        seed: of the joint.
    """
    half, hold = STEP[quantity] / 2.0, HOLD_S[law, quantity]
    mode = quantity if law == "pi" else Mode.ANGLE_STIFFNESS if quantity is Mode.ANGLE else Mode.TORQUE_STIFFNESS
    stiffness = math.nan if law == "pi" else STIFFNESS
    parts = [(hold, value, stiffness) for value in (-half, half, -half)]
    joint = "free" if quantity is Mode.ANGLE else "locked"
    return run(rig, make_laws(rig, law), held(mode, parts, rig.sample_period), joint, seed)


def steps(rig: Rig, seed: int) -> dict[str, Any]:
    """Settling, overshoot and steady error of both laws, for angle and torque, and the least time that flow allows."""
    out: dict[str, Any] = {}
    for (law, quantity), hold in HOLD_S.items():
        course = step_course(rig, law, quantity, seed)
        true = course.angle if quantity is Mode.ANGLE else course.torque
        n = round(hold / rig.sample_period)
        found = []
        for k, way in ((1, 1.0), (2, -1.0)):
            part, value = true[k * n : (k + 1) * n], float(course.value[k * n])
            after, overshoot = settling(part, value, way * STEP[quantity], rig.sample_period)
            steady = float(np.mean(np.abs(part[-round(STEADY_S / rig.sample_period) :] - value)))
            found.append({"settling_s": after, "overshoot": overshoot, "steady_error": steady})
        out[f"{quantity.name.lower()}, {law}"] = found
    for quantity in STEP:
        out[f"{quantity.name.lower()}, least"] = least_time(rig, quantity, seed)
    return out


def least_time(rig: Rig, quantity: Mode, seed: int) -> float:
    """Time [s] that a step takes to within 5 % with both valves fully open or closed all the while: no law is quicker.

    Args:
        rig: as declared.
        quantity: angle, of a free joint, or torque, of a locked one.
        seed: of the joint, which rests at minus half of the step with the stiffness of the other trials.
    """
    joint, half = ("free" if quantity is Mode.ANGLE else "locked"), STEP[quantity] / 2.0
    p = Plant(rig, joint, seed=seed, mismatch=MISMATCH).parameters
    reach = Reachable(p, Box.of(p))
    given = (-half, STIFFNESS) if joint == "free" else (0.0, STIFFNESS, -half)
    first, second = reach.pressures(*given)
    start = -half if joint == "free" else 0.0
    plant = Plant(rig, joint, seed=seed, mismatch=MISMATCH, initial_pressure=(first, second), initial_angle=start)
    for k in range(round(_LONGEST_S / rig.sample_period)):
        x = plant.step((rig.valves.voltage_max, rig.valves.voltage_min)).truth
        value = float(x[0]) if joint == "free" else float(dynamics.torque(x, p))
        if value >= half - SETTLED * STEP[quantity]:
            return (k + 1) * rig.sample_period
    return math.inf


def grid(rig: Rig, seed: int) -> list[dict[str, float]]:
    """Steady errors of angle and stiffness held together, one entry a pair."""
    parts = [(GRID_S, math.radians(angle), stiffness) for angle, stiffness in GRID]
    course = run(rig, make_laws(rig, "model"), held(Mode.ANGLE_STIFFNESS, parts, rig.sample_period), seed=seed)
    n, last = round(GRID_S / rig.sample_period), round(STEADY_S / rig.sample_period)
    out = []
    for k, (angle, stiffness) in enumerate(GRID):
        steady = slice((k + 1) * n - last, (k + 1) * n)
        off = course.angle[steady] - math.radians(angle)
        out.append(
            {
                "angle_error_deg": math.degrees(float(np.mean(np.abs(off)))),
                "estimate_error_deg": math.degrees(
                    float(np.mean(np.abs(course.estimated_angle[steady] - math.radians(angle))))
                ),
                "stiffness_error": float(np.mean(np.abs(course.stiffness[steady] / stiffness - 1.0))),
            }
        )
    return out


def limits(rig: Rig, seed: int, count: int, governed: bool) -> dict[str, Any]:
    """References at random, with pushes, with or without the governor.

    Args:
        rig: as declared.
        seed: of the joint, the references and the pushes.
        count: references.
        governed: whether there is a governor.

    Returns:
        Samples beyond each limit as parts of all; references during which there were any; how well was followed.
    """
    rng = np.random.default_rng([seed, 7])
    period = rig.sample_period
    parts, pushes = [], []
    for seconds in rng.uniform(0.2, 0.6, count):
        parts.append((float(seconds), float(rng.uniform(-0.45, 0.45)), float(rng.uniform(1.0, 13.0))))
        push = np.zeros(math.ceil(float(seconds) / period - 1e-9))
        if rng.random() < 0.5:
            first = int(rng.integers(len(push)))
            push[first : first + round(rng.uniform(0.05, 0.5) / period)] = rng.uniform(-PUSH, PUSH)
        pushes.append(push)
    outside = np.concatenate(pushes)
    laws = make_laws(rig, "model", LIMITS if governed else None, LEVEL, PUSH)
    course = run(
        rig, laws, held(Mode.ANGLE_STIFFNESS, parts, period), seed=seed, push=lambda k: float(outside[k])
    )  # fmt: skip
    near_edge = np.zeros(len(outside), bool)
    for k in np.flatnonzero(np.diff(outside, prepend=0.0)):
        near_edge[k : k + round(_EDGE_S / period)] = True
    ratio = rig.geometry.radius * np.sin(np.abs(course.angle)) / rig.geometry.length
    beyond = {
        "pressure": (course.pressure < LIMITS.lowest_pressure) | (course.pressure > LIMITS.highest_pressure),
        "angle": np.abs(course.angle) > LIMITS.angle,
        "velocity": (np.abs(course.velocity) > LIMITS.velocity) & ~near_edge,
        "contraction": ratio > LIMITS.contraction,
        "force": course.force < LIMITS.force,
    }
    starts = np.cumsum([0, *(len(push) for push in pushes[:-1])])
    of_sample = {name: flags if flags.ndim == 1 else flags.any(axis=1) for name, flags in beyond.items()}
    inside = np.clip(course.value, -LIMITS.angle, LIMITS.angle)
    return {
        "samples": len(outside),
        "beyond": {name: float(np.mean(flags)) for name, flags in of_sample.items()},
        "references_beyond": {
            name: int(np.logical_or.reduceat(flags, starts).sum()) for name, flags in of_sample.items()
        },
        "references": count,
        "held_back": float(np.mean(course.held_back)),
        "rmse_deg": math.degrees(float(np.sqrt(np.mean((course.angle - inside) ** 2)))),
        "stiffness_rmse": float(np.sqrt(np.mean((course.stiffness - course.wanted_stiffness) ** 2))),
    }


def yielding(rig: Rig, seed: int) -> list[dict[str, float]]:
    """Transfer from a sinusoidal torque to the angle, over that of the spring and damper asked for.

    Returns:
        For each torque and for each way of knowing it: gain's ratio, and phase's difference [°].
    """
    stiffness, damping = YIELDING
    out = []
    for known in (False, True):
        for frequency, torque in TORQUES:
            cycles = 3 if frequency < 1.0 else 6
            start, seconds = 2.0, 2.0 + cycles / frequency
            turn = 2.0 * math.pi * frequency * rig.sample_period

            def push(
                k: int, turn: float = turn, size: float = torque, first: float = start / rig.sample_period
            ) -> float:
                return size * math.sin(turn * (k - first)) if k >= first else 0.0

            reference = Wanted(Mode.IMPEDANCE, 0.0, stiffness=stiffness, damping=damping)
            laws = make_laws(rig, "model")
            samples = round(seconds / rig.sample_period)
            course = run(rig, laws, [reference] * samples, seed=seed, push=push, push_is_known=known)
            skip = round((start + 1.0 / frequency) / rig.sample_period)  # the first cycle is a transient
            k = np.arange(skip, samples)
            carrier = np.exp(-1j * turn * (k - start / rig.sample_period))
            angle = np.mean((course.angle[skip:] - np.mean(course.angle[skip:])) * carrier)
            ratio = angle / np.mean(course.push[skip:] * carrier) * (stiffness + 2j * math.pi * frequency * damping)
            out.append(
                {
                    "known": float(known), "frequency_hz": frequency, "torque_nm": torque, "gain": float(np.abs(ratio)),
                    "phase_deg": math.degrees(float(np.angle(ratio))),
                }
            )  # fmt: skip
    return out


def call_times(rig_name: str) -> dict[str, float]:
    """Time of one call from Python [µs], the least of many batches: of both laws, and of the governor at its worst."""
    rig = load_rig(rig_name)
    laws = make_laws(rig, "model", LIMITS, LEVEL, PUSH)
    governor, model, pi = laws.governor, laws.model, laws.pi
    assert governor is not None and model is not None and pi is not None
    from pam_antagonist.estimation import Estimator

    estimator = Estimator(rig)
    row = estimator.step(1, 420e3, 420e3, 5.5, 5.5)
    for k in range(2, 50):
        row = estimator.step(k * 1_000_000, 420e3, 420e3, 5.5, 5.5)
    assert row is not None
    estimate = seen(row)
    model.step(Mode.ANGLE_STIFFNESS, 0.1, 6.0, estimate)

    def least(call: Callable[[], object], batches: int = 60, calls: int = 100) -> float:
        call()
        best = math.inf
        for _ in range(batches):
            began = time.perf_counter()
            for _ in range(calls):
                call()
            best = min(best, time.perf_counter() - began)
        return best / calls * 1e6

    return {
        "pi": least(lambda: pi.step(Mode.ANGLE, 0.1, estimate.angle)),
        "model": least(lambda: model.step(Mode.ANGLE_STIFFNESS, 0.1, 6.0, estimate)),
        "governor, reference allowed": least(lambda: governor._excess(
            Mode.ANGLE, 0.05, 6.0, estimate, 0.0, model.gains)),
        "governor, reference held back": least(lambda: governor.step(
            Mode.ANGLE_STIFFNESS, 0.4, 6.0, estimate, model)),
    }  # fmt: skip
