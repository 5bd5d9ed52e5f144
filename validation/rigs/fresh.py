"""Identify fresh virtual rigs from a few minutes of recordings, and judge the result on recordings of another day.

The rigs are of this package's own model, with values drawn from the priors of identify. Each line has the filter's
error, those of the rig file, the model alone and a linear map of the two pressures, the share of angles in their 95 %
intervals, and how many values that identify calls determined have their true value in their 95 % interval. Half of the
rigs have hysteresis that nobody declared (--declared: none).
It takes half a minute for each rig.

examples:
  {run} rigs --out fresh.json --declared
  {run} rigs --out fresh_20.json --first 700 --count 12 --seconds 20
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pam_antagonist import identify, replay
from pam_antagonist.api.given import calibration
from pam_antagonist.cli import common
from pam_antagonist.cli.common import real
from pam_antagonist.errors import BadInput
from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.identification.from_pressures import FromPressures
from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.identification.runs import Run
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.new import Facts, starting_point
from pam_antagonist.rig.parts import muscle_parts, regulator_parts, valve_parts
from pam_antagonist.rig.physical import unphysical
from pam_antagonist.simulation.plant import Plant
from validation.battery.scores import interval
from validation.sensors import FIRST_STAMP_NS

_NORMAL = 1.96
_COLUMNS = ("identified", "as_configured", "model_alone", "pressures_alone", "linear")
Floats = NDArray[np.float64]
_FAR = 2.0
"""The farthest draw, in standard deviations."""
_STOP = 1.3
"""Of the joint, as a share of its reach. The encoder is set by eye to the middle between the stops."""
_PLANT_STEP = 1e-3
"""[s] Largest step between the rows of a simulation."""


@dataclass(frozen=True, eq=False)
class Laboratory:
    """A rig of a laboratory."""

    name: str  # of the rig, with what it is
    typed: Rig  # the rig file, from ruler and data sheets
    true: Rig  # the joint itself
    fit: Sequence[Recording]  # recordings for the identification
    held: Sequence[Recording]  # recordings of another day
    truth: dict[str, float]  # true values by name of the unknown


@dataclass(frozen=True)
class Kind:
    """How a laboratory records: what is drawn besides the values of the joint."""

    regulators: bool  # in place of valves
    trials: bool  # short trials, each from rest, in place of a long recording
    period: float  # of the log [s]
    hysteresis: float  # that nobody declared, as a share of a muscle's force

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Kind:
        """A kind by chance."""
        regulators = bool(rng.random() < 0.4)
        period = float(rng.choice([0.02, 0.01, 0.005] if regulators else [0.02, 0.01, 0.005, 0.001]))
        return cls(regulators, bool(rng.random() < 0.5), period, float(rng.uniform(0.01, 0.05) * (rng.random() < 0.5)))

    @property
    def words(self) -> str:
        """In words."""
        return (
            f"{'regulators' if self.regulators else 'valves'}, {'trials' if self.trials else 'long'}, "
            f"{1.0 / self.period:g} Hz{', hysteresis' if self.hysteresis else ''}"
        )


def described(kind: Kind, rng: np.random.Generator, name: str) -> Rig:
    """What a laboratory types."""
    muscle_name = str(rng.choice(["DMSP-10", "DMSP-20", "DMSP-40"]))
    muscle = muscle_parts()[muscle_name]
    nominal = float(rng.uniform(9.0, 16.0) * muscle.diameter)
    length = nominal * float(rng.uniform(0.9, 0.94))
    reach = math.radians(float(rng.uniform(20.0, 45.0)))
    radius = 0.07 * nominal / reach
    valve = {"DMSP-10": "MPYE-5-M5", "DMSP-20": "MPYE-5-M5", "DMSP-40": "MPYE-5-1/8-LF"}[muscle_name]
    facts = Facts(
        name=name, kind="pulley", radius=radius, length=length, nominal_length=nominal, muscle=muscle,
        muscle_name=muscle_name, supply=float(rng.uniform(5.0, 7.0)) * 1e5, valve=valve_parts()[valve],
        valve_name=valve, voltage=(0.0, 10.0), shaft_radius=0.25 * radius, mass=float(rng.uniform(0.3, 3.0)),
        inertia=1.0, stop=_STOP * reach, pressure_range=1e6, pressure_bits=12, period=kind.period,
        regulator=regulator_parts()["ITV2050"] if kind.regulators else None, regulator_time=0.12,
    )  # fmt: skip
    # A natural frequency of some hertz against the muscles' stiffness.
    stiffness = (starting_point(facts).joint.viscous_friction / 0.1) ** 2
    inertia = stiffness / (2.0 * math.pi * float(rng.uniform(3.0, 8.0))) ** 2
    return starting_point(replace(facts, inertia=inertia))


def drawn(typed: Rig, kind: Kind, rng: np.random.Generator) -> tuple[Rig, dict[str, float]]:
    """A joint that the description may be of, and its values by name of the unknown."""
    # Whether a limb hangs on the joint does not depend on the recordings: a free run without a measured angle will do.
    nothing, pair = np.full(3, np.nan), np.full((3, 2), np.nan)
    blank = Run("", np.arange(3.0), pair, pair, nothing, nothing, np.zeros(3), False, ())
    free = [*joint_stage.unknowns(typed, [blank]), *air_stage.unknowns(typed)]
    while True:
        values = {item.name: item.value(float(np.clip(rng.standard_normal(), -_FAR, _FAR))) for item in free}
        values[ZERO] = math.radians(3.0) * float(rng.standard_normal())
        bounded = {item.name: float(np.clip(values[item.name], item.low, item.high)) for item in free}
        true = moved(typed, joint_stage.model_values(free, bounded))
        if not unphysical(true):
            break
    if kind.hysteresis:
        size = kind.hysteresis * joint_stage.torque_scale(true) / true.geometry.radius
        loop = {"amplitude_1": size, "amplitude_2": size, "width": 0.02 * true.geometry.length}
        true = true.replaced(effects={**true.effects, "hysteresis": loop})
    return true, bounded


def targets(rng: np.random.Generator, times: Floats, low: float, high: float) -> Floats:
    """Pressures that a laboratory asks for (N, 2) [Pa]: steps, ramps and slow waves, a few in each second."""
    out = np.empty((len(times), 2))
    for i in (0, 1):
        knots, levels = [float(times[0])], [0.5 * (low + high)]
        while knots[-1] < times[-1]:
            rest, level = float(rng.uniform(0.1, 1.0)), float(rng.uniform(low, high))
            knots += [knots[-1] + rest, knots[-1] + rest + float(rng.choice([0.01, 0.3, 1.0]))]
            levels += [levels[-1], level]
        out[:, i] = np.interp(times, knots, levels)
    return out


def laboratory(seed: int, declared: bool = False, seconds: float | None = None) -> Laboratory:
    """A fresh rig.

    `seconds`: of all that is fitted; shorter recordings are the begin of longer ones. Default: 60 s, or nine trials.
    """
    rng = np.random.default_rng(seed)
    kind = Kind.drawn(rng)
    kind = replace(kind, hysteresis=0.0) if declared else kind
    name = f"fresh_{seed}"
    typed = described(kind, rng, name)
    true, truth = drawn(typed, kind, rng)
    true = with_encoder(true, rng)

    def recorded(seconds: float, number: int) -> Recording:
        return record(typed, true, truth, kind, seed, seconds, number)

    return Laboratory(f"{name} ({kind.words})", typed, true, *sets(recorded, kind.trials, seconds), truth)


def with_encoder(true: Rig, rng: np.random.Generator) -> Rig:
    """A joint whose encoder has a resolution by chance."""
    return true.replaced(sensors=true.sensors.replaced(angle_step=math.radians(float(rng.choice([0.02, 0.05, 0.18])))))


def record(
    typed: Rig, true: Rig, truth: Mapping[str, float], kind: Kind, seed: int, seconds: float, number: int
) -> Recording:
    """What a laboratory records of a joint. `truth`: zero and delay of its encoder. `number`: of the recording."""
    every = max(round(kind.period / _PLANT_STEP), 1)
    quick = true.replaced(sample_period=kind.period / every)
    rest = None if kind.regulators else (2.5e5, 2.5e5)
    plant = Plant(quick, seed=1000 * seed + number, substeps=2, initial_pressure=rest)
    count = round(seconds / quick.sample_period / every) * every
    time: Floats = quick.sample_period * np.arange(1, count + 1, dtype=np.float64)
    low, high = typed.atmosphere.pressure + 0.4e5, typed.supply.pressure - 0.5e5
    asked = targets(np.random.default_rng((seed, number)), time, low, high)
    middle = 0.5 * (typed.valves.voltage_min + typed.valves.voltage_max)
    pressure, command, angle = np.empty((count, 2)), np.empty((count, 2)), np.empty(count)
    now, given = np.full(2, typed.atmosphere.pressure), asked[0]
    for k in range(count):
        if k % every == 0:
            given = asked[k]
            if typed.drive == "valve":
                # A loop that jumps over the closed middle, as such loops do.
                apart = asked[k] - now
                given = np.clip(middle + 8e-5 * apart + 0.4 * np.tanh(apart / 5e3), 0.0, 10.0)
        sample = plant.step(given)
        now, angle[k], command[k] = sample.pressure, sample.angle, given
        pressure[k] = now
    rows = slice(every - 1, None, every)
    return Recording(
        path=Path(f"{typed.name}_{number}"), stamp_ns=np.rint(time[rows] * 1e9).astype(np.int64) + FIRST_STAMP_NS,
        pressure=pressure[rows], voltage=command[rows],
        angle=(np.interp(time + truth[DELAY], time, angle) + truth[ZERO])[rows], torque=None, drive=typed.drive,
    )  # fmt: skip


def sets(
    recorded: Callable[[float, int], Recording], trials: bool, seconds: float | None = None
) -> tuple[list[Recording], list[Recording]]:
    """Recordings to fit, and of another day: trials of 10 s, or a long one. `seconds`: of all that is fitted."""
    if trials:
        count = round((seconds or 90.0) / 10.0)
        return [recorded(10.0, k) for k in range(count)], [recorded(10.0, k) for k in range(100, 103)]
    return [recorded(seconds or 60.0, 0)], [recorded(30.0, 100)]


def judged(lab: Laboratory) -> dict[str, Any]:
    """What ``identify`` makes of a laboratory's recordings, on those of another day."""
    begin = time.monotonic()
    result = identify(lab.fit, lab.typed)
    found = result.found
    assert isinstance(found, FromPressures)
    if found.rejected:
        return {"refused": found.rejected}
    out: dict[str, Any] = {"seconds": time.monotonic() - begin}
    out["own"] = {name: found.pooled(name) for name in _COLUMNS} | {"coverage": found.coverage}
    parts = []
    for recording in lab.held:
        now, before = (replay(calibration(rig).applied(recording), rig).report for rig in (result.rig, lab.typed))
        assert now.ukf.angle is not None and before.ukf.angle is not None and now.model_alone.angle is not None
        parts.append({
            "identified": now.ukf.angle.rmse,
            "as_configured": before.ukf.angle.rmse,
            "model_alone": now.model_alone.angle.rmse,
            "linear": linear(lab.fit, recording),
            "coverage": now.ukf.angle.coverage95 or math.nan,
        })  # fmt: skip
    shares = np.array([len(one) for one in lab.held]) / sum(len(one) for one in lab.held)
    means = (pd.DataFrame(parts) ** 2).mul(shares, axis=0).sum() ** 0.5
    out["held"] = {**means, "coverage": float(shares @ [one["coverage"] for one in parts])}
    out["range_deg"] = math.degrees(max(float(np.ptp(one.angle)) for one in lab.held if one.angle is not None))
    out["values"] = {name: z for fit in found.fits for name, z in compared(fit, lab.truth).items()}
    out["notes"] = list(found.notes)
    return out


def linear(fit: Sequence[Recording], held: Recording) -> float:
    """Error of a linear map of the two pressures, RMS [deg]."""
    pressure, angle = (np.concatenate([getattr(one, name) for one in fit]) for name in ("pressure", "angle"))
    found, *_ = np.linalg.lstsq(np.column_stack([pressure, np.ones(len(angle))]), angle, rcond=None)
    left = np.column_stack([held.pressure, np.ones(len(held))]) @ found - held.angle
    return math.degrees(math.sqrt(float(np.mean(left**2))))


def compared(fit: Fit, truth: dict[str, float]) -> dict[str, float]:
    """How far the determined values are from the true ones, in standard errors, by name."""
    stds, reasons = np.sqrt(np.diag(fit.covariance)), fit.reasons
    return {
        item.name: float((item.coordinate(truth[item.name]) - amount) / std)
        for item, amount, std in zip(fit.unknowns, fit.amounts, stds, strict=True)
        if item.name in truth and not reasons[item.name]
    }


def parser() -> common.Parser:
    """The arguments."""
    out = common.Parser("rigs", __doc__)
    out.add_argument("--out", type=Path, required=True, metavar="FILE", help="file of the results (JSON)")
    out.add_argument("--first", type=int, default=0, metavar="SEED", help="first seed (default: 0)")
    out.add_argument("--count", type=int, default=20, metavar="N", help="number of rigs (default: 20)")
    seconds = "of all that is fitted of each rig, from 20 on (default: 60, or nine trials of 10 s)"
    out.option("--seconds", seconds, real(20.0, 600.0, "a time"), None, "S")
    out.flag("--declared", "rigs without effects that nobody declared")
    return out


def _run(arguments: argparse.Namespace) -> int:
    results = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        lab = laboratory(seed, arguments.declared, arguments.seconds)
        try:
            results.append({"name": lab.name, **judged(lab)})
        except BadInput as error:
            results.append({"name": lab.name, "refused": str(error)})
        print(_line(results[-1]), flush=True)
        arguments.out.write_text(json.dumps(results, indent=1))
    print(_total(results))
    return common.DONE


def _line(one: dict[str, Any]) -> str:
    if "refused" in one:
        return f"{one['name']}: refused: {one['refused']}"
    held, own = one["held"], one["own"]
    far = sorted(one["values"].items(), key=lambda item: -abs(item[1]))
    worst = ", ".join(f"{name} {z:.1f}" for name, z in far[:2])
    return (
        f"{one['name']}: {held['identified']:.3f} deg of {one['range_deg']:.0f} (before {held['as_configured']:.2f}, "
        f"alone {held['model_alone']:.2f}, linear {held['linear']:.2f}, pressures {own['pressures_alone']:.3f}, "
        f"own {own['identified']:.3f}) covered {held['coverage']:.2f}; true {_inside([one])}/{len(far)} {worst}; "
        f"{one['seconds']:.0f} s"
    )


def _inside(results: Sequence[dict[str, Any]]) -> int:
    return sum(abs(z) <= _NORMAL for one in results for z in one["values"].values())


def _total(results: Sequence[dict[str, Any]]) -> str:
    done = [one for one in results if "held" in one]
    if not done:
        return f"0 rigs of {len(results)}"
    held, ranges = pd.DataFrame([one["held"] for one in done]), pd.Series([one["range_deg"] for one in done])
    median = (held.identified / ranges).median()
    inside, count = _inside(done), sum(len(one["values"]) for one in done)
    low, high = interval(inside, count) or (0.0, 1.0)
    others = {"linear": "linear map", "model_alone": "model alone", "as_configured": "file of new_rig"}
    counts = {"covered 85 to 99 %": held.coverage.between(0.85, 0.99)}
    counts |= {f"not worse than the {words}": held.identified <= held[other] for other, words in others.items()}
    return "\n".join([
        f"{len(done)} rigs of {len(results)}; median error {100 * median:.2f} % of the range",
        *(f"{name}: {int(which.sum())}" for name, which in counts.items()),
        f"true values in their 95 % intervals: {inside} of {count} "
        f"(share {inside / max(count, 1):.3f}, {low:.3f} to {high:.3f})",
    ])  # fmt: skip


main = common.command(parser, _run)
