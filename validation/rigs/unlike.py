"""Rigs whose simulator shares nothing with the model of this package: other muscles, friction, valves and air.

* Muscles: Chou and Hannaford (1996) with an end correction that fades with the pressure, and a tube that gets stiff.
* Friction: Maxwell slip of four elements in the threads, LuGre in the bearing.
* Valves: ISO 6358 by a spool of second order with cubic opening; regulators: a spool with a discrete integral law.
* Air: mass and temperature of each chamber, heat to the wall.
* Joint: a moment arm that varies, a limb, stops of rubber.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from validation.rigs.fresh import Kind, Laboratory, Logged, described, sets

Floats = NDArray[np.float64]

_STEP = 2e-4
_ATMOSPHERE, _GAS, _ROOM = 101.3e3, 287.0, 293.0
_ELEMENTS = 4
_NUMBERS = (
    "radius", "cam", "length", "nominal", "area_1", "area_2", "weave", "end", "end_pressure", "rubber", "stiffening",
    "slip", "slip_pressure", "reach", "inertia", "viscous", "coulomb", "stiction", "weight", "hanging",
    "conductance_in", "conductance_out", "critical", "overlap", "spool", "damping", "wall", "supply", "droop",
    "tank", "volume",
    "regulator", "regulator_gain",
)  # fmt: skip
_AT = {name: k for k, name in enumerate(_NUMBERS)}
_ANGLE, _SPEED, _BRISTLE, _SUPPLY = 0, 1, 2, 3
_MUSCLES, _MUSCLE_SIZE = 4, 5 + _ELEMENTS
"""State of a muscle: mass, temperature, spool, its speed, integral; then the slipping elements."""


@njit(nogil=True)
def _flow(conductance, critical, up, down):
    """Mass flow by ISO 6358 [kg/s]."""
    if down >= up:
        return 0.0
    ratio = down / up
    choked = conductance * 1.185 * up
    return choked if ratio <= critical else choked * math.sqrt(1.0 - ((ratio - critical) / (1.0 - critical)) ** 2)


@njit(nogil=True)
def _step(x, u, q, at_middle, h):
    """One step of Euler's method, in place; readings of the pressures and the angle (3,)."""
    (radius, cam, length, nominal, area_1, area_2, weave, end, end_pressure, rubber, stiffening, slip, slip_pressure,
     reach, inertia, viscous, coulomb, stiction, weight, hanging, c_in, c_out, critical, overlap, spool, damping, wall,
     supply, droop, tank, volume, regulator, gain) = q  # fmt: skip
    out = np.empty(3)
    angle, speed = x[0], x[1]
    arm = radius * (1.0 + cam * math.cos(2.0 * angle + 0.4))
    travel = radius * (angle + 0.5 * cam * (math.sin(2.0 * angle + 0.4) - math.sin(0.4)))
    torque, taken = 0.0, 0.0
    for i in range(2):
        s, sign = 4 + 9 * i, 1.0 if i == 0 else -1.0
        own = length - sign * travel
        rate = -sign * arm * speed
        strain = 1.0 - own / nominal
        size = 1e-8 + volume * (own / nominal) * (3.0 - weave * (own / nominal) ** 2) / (3.0 - weave)
        size_rate = volume / nominal * (3.0 - 3.0 * weave * (own / nominal) ** 2) / (3.0 - weave) * rate
        mass, heat = x[s], x[s + 1]
        pressure = mass * 287.0 * heat / size
        gauge = max(pressure - 101.3e3, 0.0)
        out[i] = pressure
        # Chou and Hannaford's braid, whose ends are cones, with a tube.
        effective = strain * (1.0 + end * math.exp(-gauge / end_pressure))
        force = gauge * (area_1 if i == 0 else area_2) * (weave * (1.0 - effective) ** 2 - 1.0)
        force -= rubber * (math.exp(stiffening * strain) - 1.0)
        # Maxwell slip: elements of growing reach, each saturates at its share.
        whole = slip + slip_pressure * gauge
        for j in range(4):
            limit = reach * (j + 1)
            x[s + 5 + j] = min(max(x[s + 5 + j] + h * rate, -limit), limit)
            force += 0.25 * whole * x[s + 5 + j] / limit
        torque += sign * arm * max(force, 0.0)
        # Spool and flow.
        asked = u[i]
        if regulator > 0.0:
            apart = u[i] - pressure
            x[s + 4] = min(max(x[s + 4] + h * 2.0 * apart, -2e4), 2e4)
            asked = min(max(gain * (apart + x[s + 4]) / 1e5, -1.0), 1.0)
        else:
            asked = (u[i] - at_middle[i]) / 5.0
        x[s + 3] += h * (spool * spool * (asked - x[s + 2]) - 2.0 * damping * spool * x[s + 3])
        x[s + 2] += h * x[s + 3]
        opening = max(abs(x[s + 2]) - overlap, 0.0) / (1.0 - overlap)
        opening = min(opening, 1.0) * (0.7 + 0.3 * min(opening, 1.0) ** 2)
        flow = _flow(c_in * opening, critical, x[3], pressure) if x[s + 2] > 0.0 else -_flow(
            c_out * opening, critical, pressure, 101.3e3)  # fmt: skip
        taken += max(flow, 0.0)
        gas_in = 293.0 if flow > 0.0 else heat
        mass_new = max(mass + h * flow, 1e-9)
        energy = flow * (1005.0 * gas_in - 718.0 * heat) - pressure * size_rate - wall * size**0.667 * (heat - 293.0)
        x[s + 1] = min(max(heat + h * energy / (718.0 * mass), 150.0), 500.0)
        x[s] = mass_new
    if droop > 0.0:
        x[3] += h * ((supply - x[3]) / tank - droop * taken)
    # LuGre in the bearing.
    stribeck = coulomb + (stiction - coulomb) * math.exp(-((speed / 0.02) ** 2))
    stiffness = stribeck / 2e-3
    x[2] += (speed - abs(speed) * stiffness * x[2] / max(stribeck, 1e-9)) * h
    x[2] = min(max(x[2], -4e-3), 4e-3)
    torque -= stiffness * x[2] + viscous * speed + weight * math.sin(angle - hanging)
    torque -= 30.0 * coulomb / 0.01 * (angle - min(max(angle, -1.1), 1.1))
    x[1] = speed + h * torque / inertia
    x[0] = angle + h * x[1]
    out[2] = x[0]
    return out


@njit(nogil=True)
def _rest(x, u, q, at_middle, h, count):
    for _ in range(count):
        out = _step(x, u, q, at_middle, h)
    return out


def laboratory(seed: int) -> Laboratory:
    """A rig of the other simulator.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng((seed, 7))
    kind = Kind.drawn(rng)
    name = f"unlike_{seed}"
    typed = described(kind, rng, name)
    numbers = _numbers(typed, kind, rng)
    q = np.array([numbers[item] for item in _NUMBERS])
    middle = np.array([5.0 + 0.05 * rng.standard_normal(), 5.0 + 0.05 * rng.standard_normal()])
    every = max(round(kind.period / 1e-3), 1)
    row = kind.period / every
    steps = round(row / _STEP)
    zero, late = math.radians(3.0) * float(rng.standard_normal()), float(rng.choice([0.0, 0.006]))
    shown = math.radians(float(rng.choice([0.02, 0.05, 0.18])))
    log = Logged(typed, row, every, zero, late)

    def recorded(seconds: float, number: int) -> Recording:
        noise = np.random.default_rng((seed, number, 1))
        x = np.zeros(_MUSCLES + 2 * _MUSCLE_SIZE)
        x[_SUPPLY] = numbers["supply"]
        for i in (0, 1):
            x[_MUSCLES + _MUSCLE_SIZE * i : _MUSCLES + _MUSCLE_SIZE * i + 2] = (
                2e5 * numbers["volume"] / _GAS / _ROOM,
                _ROOM,
            )
        _rest(x, np.full(2, 2.5e5) if kind.regulators else middle.copy(), q, middle, _STEP, 10_000)
        delayed = [np.full(2, 2.5e5) if kind.regulators else middle.copy()] * 2

        def step(command: Floats) -> tuple[Floats, float]:
            delayed.append(np.array(command))
            out = _rest(x, delayed.pop(0) if kind.regulators else delayed[-1], q, middle, _STEP, steps)
            pressure = out[:2] + 400.0 * noise.standard_normal(2)
            return np.round(pressure / 244.0) * 244.0, round(out[2] / shown) * shown

        return log.recording(step, seconds, np.random.default_rng((seed, number)), f"{name}_{number}")

    return Laboratory(f"{name} ({kind.words})", typed, *sets(recorded, kind.trials), {})


def _numbers(typed: Rig, kind: Kind, rng: np.random.Generator) -> dict[str, float]:
    """The numbers of a joint that a rig file may be of."""

    def off(share: float) -> float:
        return float(np.exp(share * rng.standard_normal()))

    radius, nominal = typed.geometry.radius * off(0.05), typed.geometry.length / 0.905 * off(0.04)
    length = typed.geometry.length * off(0.02)
    pull = typed.muscle_1.force.v2 + typed.muscle_1.force.v1 * typed.geometry.length / 0.905
    weave = 3.0 * math.cos(math.radians(float(rng.uniform(19.0, 29.0)))) ** 2
    area = pull / (weave - 1.0)
    usual = 2.5e5 * pull
    volume = typed.muscle_1.volume
    size = volume.d1 * nominal**2 + volume.d2 * nominal + volume.d3
    flow = typed.valve_1.inflow_area * 2e-3
    torque = usual * radius
    return {
        "radius": radius, "cam": 0.06 * float(rng.standard_normal()), "length": length,
        "nominal": max(nominal, 1.03 * length),
        "area_1": area * off(0.08), "area_2": area * off(0.08), "weave": weave, "end": float(rng.uniform(0.1, 0.6)),
        "end_pressure": 0.6e5, "rubber": 0.05 * usual, "stiffening": 10.0, "slip": 0.01 * usual,
        "slip_pressure": float(rng.uniform(0.0, 0.04)) * pull, "reach": 1e-3, "inertia": typed.joint.inertia * off(0.2),
        "viscous": 2.0 * typed.joint.viscous_friction * off(0.5), "coulomb": 0.004 * torque * off(0.5),
        "stiction": 0.006 * torque, "weight": 0.1 * torque * float(rng.uniform(0.0, 1.0)),
        "hanging": float(rng.uniform(-1.5, 1.5)), "conductance_in": flow * off(0.2),
        "conductance_out": flow * off(0.2), "critical": float(rng.uniform(0.2, 0.45)),
        "overlap": 0.0 if kind.regulators else float(rng.uniform(0.01, 0.06)),
        "spool": float(rng.uniform(150.0, 500.0)), "damping": 0.8, "wall": float(rng.uniform(2.0, 30.0)),
        "supply": typed.supply.pressure * off(0.02), "droop": 1e7 * float(rng.random() < 0.4), "tank": 0.5,
        "volume": size, "regulator": float(kind.regulators), "regulator_gain": float(rng.uniform(1.0, 4.0)),
    }  # fmt: skip
