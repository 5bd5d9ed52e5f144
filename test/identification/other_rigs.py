"""A rig of another laboratory, as a ruler and data sheets tell it, and recordings of a joint that differs from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pam_antagonist import simulate
from pam_antagonist.identification.joint_stage import DELAY, WEIGHT_COS, WEIGHT_SIN, ZERO, model_values, unknowns
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.new import Facts, starting_point
from pam_antagonist.rig.parts import muscle_parts, regulator_parts, valve_parts

LATE_S = 0.012
"""By how much the readings of the angle are late."""
ZERO_ERROR = 0.04
"""[rad] By how much the encoder reads too high."""
WEIGHT, HANGING = 2.0, 0.9
"""Torque of the limb's weight [N m], and the angle at which it hangs [rad]."""


def described(period: float, regulators: bool = False) -> Rig:
    """The rig as configured: forces of braided muscles, valves with overlap or pressure regulators."""
    facts = Facts(
        name="arm", kind="pulley", radius=0.03, length=0.225, nominal_length=0.25, muscle=muscle_parts()["DMSP-20"],
        muscle_name="DMSP-20", supply=6e5, valve=valve_parts()["MPYE-5-M5"], valve_name="MPYE-5-M5",
        voltage=(0.0, 10.0), shaft_radius=0.01, mass=1.0, inertia=0.03, stop=None, pressure_range=1e6,
        pressure_bits=12, period=period, regulator=regulator_parts()["VPPM-0L10H"] if regulators else None,
        regulator_time=0.15,
    )  # fmt: skip
    return starting_point(facts)


def drawn(rig: Rig, seed: int) -> Rig:
    """A joint that the description may be of: its values are drawn from the priors of the identification."""
    rng = np.random.default_rng(seed)
    values = {}
    for item in unknowns(rig, []):
        values[item.name] = item.value(float(np.clip(rng.standard_normal(), -1.5, 1.5)))
    values |= {WEIGHT_COS: WEIGHT * np.sin(HANGING), WEIGHT_SIN: -WEIGHT * np.cos(HANGING), ZERO: 0.0, DELAY: 0.0}
    joint = model_values(unknowns(rig, []), values)
    known = {name: value for name, value in joint.items() if not name.startswith("calibration.")}
    out = moved(rig, known)
    if rig.drive == "valve":
        areas = {
            f"valve_{i}.{name}": rig.value(f"valve_{i}.{name}") * float(np.exp(0.2 * rng.standard_normal()))
            for i in (1, 2)
            for name in ("inflow_area", "outflow_area")
        }
        out = moved(out, {**areas, "valve_1.overlap": 0.52, "valve_2.overlap": 0.51})
    return out


def commands(rig: Rig, seconds: float, seed: int) -> np.ndarray:
    """Steps that fill and empty both muscles, a few in each second: voltages [V], or pressures [Pa]."""
    rng = np.random.default_rng(seed)
    count = round(seconds / rig.sample_period)
    out = np.empty((count, 2))
    for i in (0, 1):
        k = 0
        while k < count:
            size = max(round(rng.uniform(0.15, 0.7) / rig.sample_period), 1)
            level = rng.uniform(1.5e5, 5.5e5) if rig.drive == "regulator" else 5.0 + rng.uniform(-1.0, 1.0)
            out[k : k + size, i] = level
            k += size
    return out


def recorded(rig: Rig, seconds: float, seed: int, joint: str = "free", fine: int = 1, **kept: object) -> Recording:
    """What is logged of a joint with late readings and a zero error: every ``fine``-th sample of its simulation."""
    quick = rig.replaced(sample_period=rig.sample_period / fine)
    out = simulate(quick, commands(quick, seconds, seed), joint=joint, seed=seed, path=f"{joint}_{seed}")
    time = out.time_s
    late = np.interp(time - LATE_S, time, out.angle) + ZERO_ERROR
    rows = slice(fine - 1, None, fine)
    made = replace(
        out, stamp_ns=out.stamp_ns[rows], pressure=out.pressure[rows], voltage=out.voltage[rows], angle=late[rows],
        torque=out.torque[rows] if joint == "locked" else None, path=Path(f"{joint}_{seed}"),
    )  # fmt: skip
    return replace(made, **kept) if kept else made  # type: ignore[arg-type]
