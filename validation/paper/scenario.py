"""The virtual rig: the plant with declared mismatches, one for each seed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from pam_antagonist.model import equilibrium, integration, sensor
from pam_antagonist.paths import config_dir
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.rig.schema import Curve, Valve
from pam_antagonist.simulation import excitation
from pam_antagonist.simulation.plant import SCATTER_GROUPS, Plant
from pam_antagonist.strict_yaml import Strict, read_mapping, validated

Floats = NDArray[np.float64]
START = (450e3, 450e3)
"""Pressures at the start of every run [Pa]."""
_FIRST_STAMP_NS = 10**18
_SUBSTEPS = 4
_NOISE_STREAM = {"free": 1, "locked": 2}


class Hysteresis(Strict):
    """The effect ``hysteresis`` that the virtual rig has and the declared one has not."""

    amplitude: float = Field(ge=0.0, le=20.0, description="mean half width of the loop in force [N]")
    spread: float = Field(ge=0.0, lt=1.0, description="relative standard deviation of it from muscle to muscle [-]")
    width: float = Field(ge=2e-4, le=2e-2, description="length over which the force turns round [m]")


class Mismatch(Strict):
    """How far a virtual rig is from the declared one."""

    parameters: float = Field(ge=0.0, lt=0.3, description="relative standard deviation of each parameter group [-]")
    valve_curve: float = Field(ge=0.0, lt=0.3, description="relative standard deviation of each knot's open rate [-]")
    hysteresis: Hysteresis


class StaticTest(Strict):
    """How forces are measured at lengths and pressures."""

    lengths: int = Field(ge=3, le=50, description="lengths within the joint's range [-]")
    pressures: int = Field(ge=3, le=100, description="pressures at each [-]")
    lowest: float = Field(gt=50e3, lt=2e6, description="lowest pressure [Pa]")
    highest: float = Field(gt=50e3, lt=2e6, description="highest pressure [Pa]")
    force_std: float = Field(ge=0.0, lt=50.0, description="noise of the force sensor [N]")


class Scenario(Strict):
    """A scenario file."""

    name: str
    rig: str = Field(description="the declared rig, which estimators and models are given")
    profile: str = Field(description="built-in profile of valve voltages")
    mismatch: Mismatch
    static: StaticTest


def load_scenario(name: str = "paper") -> Scenario:
    """Read a scenario of ``config/scenarios``.

    Args:
        name: of the file, without suffix.

    Raises:
        BadInput: no such file, unknown or missing keys, values out of bounds.
    """
    path = config_dir() / "scenarios" / f"{name}.yaml"
    return validated(Scenario, read_mapping(path, "scenario", "config/scenarios/paper.yaml"), str(path))


class Truth(NamedTuple):
    """What a plant did.

    Attributes:
        states: (N, n).
        torque: (N,) [N m].
        subsystem: σ (N,).
    """

    states: Floats
    torque: Floats
    subsystem: NDArray[np.int64]


@dataclass(frozen=True)
class VirtualRig:
    """One virtual rig.

    Attributes:
        declared: what estimators and models are given.
        actual: what the plant is built from; its parameters are scattered by ``spread`` in addition.
        seed: of everything random in it.
        spread: relative standard deviation of the plant's parameters [-].
    """

    declared: Rig
    actual: Rig
    seed: int
    spread: float

    def plant(self, joint: str = "free") -> Plant:
        """The joint itself, at rest at 450 kPa in both muscles."""
        return Plant(self.actual, joint, seed=self.seed, substeps=_SUBSTEPS, mismatch=self.spread)

    def run(self, voltage: Floats, joint: str = "free") -> Truth:
        """What really happens: the plant's own physics and parameters in one compiled loop, as :class:`Plant` steps it.

        Args:
            voltage: (N, 2) [V]; row k is held over the step that ends at sample k.
            joint: ``free`` or ``locked`` at 0.
        """
        p = self.plant(joint).parameters
        angle = 0.0 if joint == "locked" else float(equilibrium.rest_angle(*START, p))
        x = equilibrium.initial_state(angle, *START, np.zeros(3), p)
        # `simulate` takes its first row for the state at the first sample.
        held = np.vstack([voltage[:1], voltage])
        states, torque, sigma = integration.simulate(x, held, p, self.actual.sample_period, _SUBSTEPS)
        return Truth(states[1:], torque[1:], sigma[1:])

    def record(self, voltage: Floats, joint: str = "free", truth: Truth | None = None) -> Recording:
        """What the sensors of this rig show.

        Args:
            voltage: (N, 2) [V]; row k is held over the step that ends at sample k.
            joint: ``free`` or ``locked`` at 0.
            truth: what :meth:`run` gave for them, where it is there already.

        Returns:
            N samples: pressures, voltages, encoder, torque meter.
        """
        states, torque, _ = truth or self.run(voltage, joint)
        p, period = self.plant(joint).parameters, self.actual.sample_period
        rng = np.random.default_rng([self.seed, _NOISE_STREAM[joint]])
        sensors = self.actual.sensors

        def shown(values: Floats, std: float, step: float) -> Floats:
            noisy = values + std * rng.standard_normal(values.shape)
            return np.round(noisy / step) * step if step > 0.0 else noisy

        readings = sensor.readings(states[:, 2:4], p)
        stamps = _FIRST_STAMP_NS + np.rint(np.arange(1, len(voltage) + 1) * period * 1e9).astype(np.int64)
        return Recording(
            path=Path("virtual_rig") / f"seed_{self.seed}_{joint}",
            stamp_ns=stamps,
            pressure=shown(readings, sensors.pressure_std, sensors.pressure_step),
            voltage=voltage,
            angle=shown(states[:, 0], sensors.angle_std, sensors.angle_step),
            torque=shown(torque, sensors.torque_std, sensors.torque_step),
        )


def virtual_rig(scenario: Scenario, seed: int) -> VirtualRig:
    """The virtual rig of a seed: valve curves, hysteresis and parameters off the declared rig's.

    Args:
        scenario: sizes of the mismatches.
        seed: 0 or more.
    """
    declared = load_rig(scenario.rig)
    size = scenario.mismatch
    rng = np.random.default_rng([seed, 0])
    amplitudes = size.hysteresis.amplitude * (1.0 + size.hysteresis.spread * rng.standard_normal(2))
    valves = {name: _off(getattr(declared, name), size.valve_curve, rng) for name in ("valve_1", "valve_2")}
    hysteresis = {
        "amplitude_1": float(max(amplitudes[0], 0.0)),
        "amplitude_2": float(max(amplitudes[1], 0.0)),
        "width": size.hysteresis.width,
    }
    source = f"virtual rig of scenario {scenario.name}, seed {seed}: {declared.name} with declared mismatches"
    actual = declared.replaced(
        name=f"virtual_{seed}", source=source, effects={**declared.effects, "hysteresis": hysteresis}, **valves
    )
    return VirtualRig(declared, actual, seed, size.parameters)


def told(declared: Rig, size: Mismatch) -> Rig:
    """The declared rig with the mismatches declared: what the filter is told is how far its virtual rigs are off.

    The hysteresis stands in it at its mean size. Each group of parameters is a direction, as uncertain as it is
    scattered, and so is each muscle's hysteresis. Valve curves are left out: a rig file has no uncertainty for them.

    Args:
        declared: the rig as estimators know it otherwise.
        size: of the mismatches.
    """
    loop = size.hysteresis
    groups = enumerate(SCATTER_GROUPS, 1)
    return declared.replaced(
        name=f"{declared.name}_told",
        effects={
            **declared.effects,
            "hysteresis": {"amplitude_1": loop.amplitude, "amplitude_2": loop.amplitude, "width": loop.width},
        },
        uncertainty={f"effects.hysteresis.amplitude_{i}": loop.spread * loop.amplitude for i in (1, 2)},
        directions={
            f"group_{k}": {name: size.parameters * declared.value(name) for name in group} for k, group in groups
        },
    )


def _off(valve: Valve, spread: float, rng: np.random.Generator) -> Valve:
    """A valve whose curve goes through other open rates; closed stays closed, open stays open."""
    rate = np.array(valve.curve.open_rate)
    inner = (rate > 0.0) & (rate < 1.0)
    moved = np.where(inner, rate * (1.0 + spread * rng.standard_normal(len(rate))), rate)
    moved = np.maximum.accumulate(np.clip(moved, 0.0, 1.0))
    curve = Curve(voltage=valve.curve.voltage, open_rate=tuple(float(value) for value in moved))
    return valve.replaced(curve=curve)


def drive(scenario: Scenario, seconds: float | None = None) -> Floats:
    """Voltages of the scenario's profile (N, 2) [V], read-only.

    Args:
        scenario: names the profile.
        seconds: how much of it; default: all of the paper's 130 s.
    """
    period = load_rig(scenario.rig).sample_period
    voltage = excitation.profile(scenario.profile, seconds or excitation.PAPER_DURATION, period)
    voltage.setflags(write=False)
    return voltage
