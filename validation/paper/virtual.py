"""The virtual rig of a seed: this package's plant with declared mismatches, and what estimator and model make of it.

Parameters are off by 2 %, which is what the rig file says of most of them. Valve curve and hysteresis were sized on
seeds 1000 to 1015 so that the model alone errs about as much as the paper's does, and left alone since.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import Estimator, metrics, simulate_model
from pam_antagonist.model import drive, dynamics, equilibrium
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.schema import Curve, Valve
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import SCATTER_GROUPS, Plant
from validation.sensors import recorded

Floats = NDArray[np.float64]
DECLARED, PROFILE = "shin2022", "paper"
START = (450e3, 450e3)
"""Pressures at the start of every run [Pa]."""
TUNINGS = ("published", "default")
METHODS = ("model", *TUNINGS, "told")
"""The model alone, the filter with either tuning, and with tuning default and the mismatches declared."""
UNITS = {"angle": "°", "torque": "N m"}
JOINT = {"angle": "free", "torque": "locked"}
"""What is judged, and the joint's condition for it (the paper's)."""
_SUBSTEPS = 4
_NOISE_STREAM = {"free": 1, "locked": 2}
_IDENTIFICATION_S, _IDENTIFICATION_SEED = 60.0, 10_000


@dataclass(frozen=True)
class Mismatch:
    """How far a virtual rig is from the declared one."""

    parameters: float = 0.02  # relative standard deviation of each group of parameters [-]
    valve_curve: float = 0.08  # of each knot's open rate [-]
    amplitude: float = 1.5  # mean half width of the hysteresis in force, which the declared rig lacks [N]
    spread: float = 0.25  # relative standard deviation of it from muscle to muscle [-]
    width: float = 2e-3  # length over which the force turns round [m]


EXACT = Mismatch(0.0, 0.0, 0.0, 0.0)
"""The plant is the declared rig, behind its noisy sensors."""


class Track(NamedTuple):
    """An estimate at the first N samples of a recording; a model alone has no variances and innovations."""

    angle: Floats  # [°]
    torque: Floats  # [N m]
    angle_variance: Floats | None = None
    torque_variance: Floats | None = None
    nis: Floats | None = None
    innovation: Floats | None = None


def filtered(rig: Rig, recording: Recording, tuning: str, joint: str, samples: int | None = None) -> Track:
    """The filter of a rig over the first samples of a recording."""
    part, degree = slice(samples), math.degrees(1.0)
    estimator = Estimator(rig, tuning, joint)
    rows = estimator.run(recording.stamp_ns[part], recording.pressure[part], recording.voltage[part]).rows
    variance = rows["covariance"][:, 0, 0] * degree**2, rows["covariance"][:, 2, 2]
    return Track(rows["angle"] * degree, rows["torque"], *variance, rows["nis"], rows["innovation"])


def modelled(rig: Rig, recording: Recording, joint: str) -> Track:
    """The model alone: it is given the voltages and the first pressures."""
    run = simulate_model(rig, recording.voltage, recording.pressure[0], joint)
    return Track(np.degrees(run.angle), run.torque)


def measured_of(recording: Recording, quantity: str) -> Floats:
    """The encoder's angle [°] or the torque meter's torque [N m] (N,)."""
    assert recording.angle is not None and recording.torque is not None  # virtual rigs have both
    return np.degrees(recording.angle) if quantity == "angle" else recording.torque


def judged(track: Track, recording: Recording, rig: Rig, quantity: str) -> dict[str, float]:
    """The paper's 𝕀, 𝕄 and ℚ of an estimate, and of a filter the share in its 95 % interval, and NIS."""
    value = getattr(track, quantity)
    measured = measured_of(recording, quantity)[: len(value)]
    error, variance = value - measured, getattr(track, f"{quantity}_variance")
    reading = rig.sensors.reading(quantity).scaled(math.degrees(1.0) if quantity == "angle" else 1.0)
    out = {"𝕀": metrics.rmse(error), "𝕄": metrics.max_error(error), "ℚ": metrics.estimation_ratio(error, measured)}
    if variance is not None:
        out["in 95 %"] = metrics.coverage(error, variance, reading)
    if track.nis is not None and track.innovation is not None:
        out["NIS"] = metrics.nis_consistency(track.nis, track.innovation).mean
    return out


class VirtualRig:
    """The virtual rig of a seed with its recordings; what is asked for twice is computed once.

    Estimators and models are given the rig `declared`. The plant is built from `actual`; its parameters are scattered
    in addition.
    """

    def __init__(self, seed: int, size: Mismatch | None = None, seconds: float | None = None) -> None:
        self.seed, self.size, self._seconds = seed, size or Mismatch(), seconds
        self.declared = load_rig(DECLARED)
        rng = np.random.default_rng([seed, 0])
        amplitudes = np.maximum(self.size.amplitude * (1.0 + self.size.spread * rng.standard_normal(2)), 0.0)
        spread = self.size.valve_curve
        valves = {name: _off(getattr(self.declared, name), spread, rng) for name in ("valve_1", "valve_2")}
        loop = {"amplitude_1": float(amplitudes[0]), "amplitude_2": float(amplitudes[1]), "width": self.size.width}
        self.actual = self.declared.replaced(
            name=f"virtual_{seed}", source=f"virtual rig of seed {seed}: {self.declared.name} with declared mismatches",
            effects={**self.declared.effects, "hysteresis": loop}, **valves,
        )  # fmt: skip
        self._tracks: dict[tuple[str, str], Track] = {}

    def plant(self, joint: str = "free", noise: bool = True) -> Plant:
        """The joint itself, at rest at 450 kPa in both muscles."""
        spread = self.size.parameters
        return Plant(self.actual, joint, seed=self.seed, substeps=_SUBSTEPS, mismatch=spread, noise=noise)

    def run(self, voltage: Floats, joint: str = "free") -> tuple[Floats, Floats, NDArray[np.int64]]:
        """States (N, n), torque (N,) and σ (N,): the plant in one compiled loop, a row of voltages a sample."""
        p = self.plant(joint).parameters
        angle = 0.0 if joint == "locked" else float(equilibrium.rest_angle(*START, p))
        x = equilibrium.initial_state(angle, *START, np.zeros(3), p)
        # `simulate` takes its first row for the state at the first sample.
        held = np.vstack([voltage[:1], voltage])
        states, torque, sigma = drive.simulate(x, held, p, self.actual.sample_period, _SUBSTEPS)
        return states[1:], torque[1:], sigma[1:]

    def record(self, voltage: Floats, joint: str = "free") -> Recording:
        """What the sensors of this rig show."""
        states, torque, _ = self.run(voltage, joint)
        pressure = dynamics.readings(states[:, 2:4], self.plant(joint).parameters)
        rng = np.random.default_rng([self.seed, _NOISE_STREAM[joint]])
        name = f"virtual_rig/seed_{self.seed}_{joint}"
        return recorded(name, self.actual, voltage, states[:, 0], pressure, torque, rng)

    @cached_property
    def told(self) -> Rig:
        """The declared rig with the mismatches declared: the filter is told how far its virtual rigs are off.

        The hysteresis stands in it at its mean size; each group of parameters is as uncertain as it is scattered. Valve
        curves are left out: a rig file has no uncertainty for them.
        """
        size, mean, declared = self.size, self.size.amplitude, self.declared
        loop = {"amplitude_1": mean, "amplitude_2": mean, "width": size.width}
        directions = {f"group_{k}": {name: size.parameters * declared.value(name) for name in group}
                      for k, group in enumerate(SCATTER_GROUPS, 1)}  # fmt: skip
        return declared.replaced(
            name=f"{declared.name}_told", effects={**declared.effects, "hysteresis": loop}, directions=directions,
            uncertainty={f"effects.hysteresis.amplitude_{i}": size.spread * mean for i in (1, 2)},
        )  # fmt: skip

    @property
    def voltage(self) -> Floats:
        """The input profile (N, 2) [V]."""
        return _profile(self._seconds)

    @cached_property
    def free(self) -> Recording:
        """The profile with the joint free."""
        return self.record(self.voltage, "free")

    @cached_property
    def locked(self) -> Recording:
        """The profile with the joint locked at 0."""
        return self.record(self.voltage, "locked")

    @cached_property
    def identification(self) -> Recording:
        """Another recording of the free joint, for what is identified from data: random steps."""
        seed = _IDENTIFICATION_SEED + self.seed
        return self.record(excitation.profile("steps", _IDENTIFICATION_S, self.declared.sample_period, seed), "free")

    def track(self, joint: str, method: str) -> Track:
        """One of ``METHODS`` over the profile."""
        if (joint, method) not in self._tracks:
            recording: Recording = getattr(self, joint)
            rig, tuning = (self.told, "default") if method == "told" else (self.declared, method)
            self._tracks[joint, method] = (
                modelled(rig, recording, joint) if method == "model" else filtered(rig, recording, tuning, joint)
            )
        return self._tracks[joint, method]


def _off(valve: Valve, spread: float, rng: np.random.Generator) -> Valve:
    """A valve whose curve goes through other open rates; closed stays closed, open stays open."""
    rate = np.array(valve.curve.open_rate)
    inner = (rate > 0.0) & (rate < 1.0)
    moved = np.where(inner, rate * (1.0 + spread * rng.standard_normal(len(rate))), rate)
    moved = np.maximum.accumulate(np.clip(moved, 0.0, 1.0))
    return valve.replaced(curve=Curve(voltage=valve.curve.voltage, open_rate=tuple(float(value) for value in moved)))


@lru_cache(maxsize=4)
def _profile(seconds: float | None) -> Floats:
    voltage = excitation.profile(PROFILE, seconds or excitation.PAPER_DURATION, load_rig(DECLARED).sample_period)
    voltage.setflags(write=False)
    return voltage
