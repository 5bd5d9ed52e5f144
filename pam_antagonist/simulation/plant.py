"""A simulated joint: the physics at a finer step, with parameters off their declared values and noisy sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.further import FurtherInputs
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model import parameters as par
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import rest_pressure

# A muscle that is a percent weaker is so in its whole force map, for instance.
SCATTER_GROUPS: tuple[tuple[str, ...], ...] = (
    *(
        tuple(f"muscle_{i}.{quantity}.{name}" for name in names)
        for i in (1, 2)
        for quantity, names in (("volume", ("d1", "d2", "d3")), ("force", ("v1", "v2", "w1", "w2", "c1", "c3")))
    ),
    ("valve_1.inflow_area",),
    ("valve_1.outflow_area",),
    ("valve_2.inflow_area",),
    ("valve_2.outflow_area",),
    ("gas.polytropic_flow",),
    ("gas.polytropic_volume",),
    ("supply.pressure",),
    ("joint.inertia",),
    ("joint.viscous_friction",),
    ("friction.shaft",),
    ("friction.muscle",),
)
"""Groups of parameters that scatter together: each group by a factor of its own."""
REGULATORS: tuple[tuple[str, ...], ...] = tuple(
    (f"effects.regulator_lag.{name}",) for name in ("frequency_1", "frequency_2", "damping")
)
"""Further groups of a rig with pressure regulators."""


class PlantSample(NamedTuple):
    """Readings of a joint's sensors at the end of a step."""

    pressure: np.ndarray  # measured pressures (2,) [Pa]
    voltage: np.ndarray  # voltages (2,) that were on the valves over the step [V]
    angle: float  # reading of the validation encoder [rad]
    torque: float  # reading of the torque meter [N m]
    encoder: float  # reading of the rig's ``encoder``, an input of a filter [rad]; NaN where the rig has none
    truth: np.ndarray  # the true state (n,)


def scattered(p: np.ndarray, spread: float, rng: np.random.Generator) -> np.ndarray:
    """Parameters of a joint that differs a little from the declared one.

    `p`: parameter vector (parameters.SIZE,). `spread`: relative standard deviation of each independent factor [-].
    """
    groups = SCATTER_GROUPS
    if p[par.INDEX[REGULATORS[0][0]]] > 0.0:
        groups = (*SCATTER_GROUPS, *REGULATORS)
    factors = rng.normal(1.0, spread, len(groups))
    changes = {
        name: p[par.INDEX[name]] * factor for group, factor in zip(groups, factors, strict=True) for name in group
    }
    return par.changed(p, changes)


class Plant:
    """Ground truth for trials without hardware.

    It runs the model's physics with ``substeps`` a sample, friction and the rig's effects included. Its parameters are
    scattered by ``mismatch``, their relative standard deviation, and its sensors are noisy and quantised, so that it
    differs from an estimator's model. It is a simulator of this project: agreement with it says nothing about a real
    joint.

    `joint`: ``free``, or ``locked`` at `lock_angle` [rad]. It begins with `initial_pressure` in both muscles (2,) [Pa],
    by default that at rest, and at `initial_angle` [rad], by default at rest under these pressures.
    """

    def __init__(
        self,
        rig: Rig,
        joint: str = "free",
        lock_angle: float = 0.0,
        seed: int = 0,
        substeps: int = 4,
        mismatch: float = 0.0,
        noise: bool = True,
        initial_pressure: tuple[float, float] | None = None,
        initial_angle: float | None = None,
    ) -> None:
        if substeps < 1:
            raise BadInput(f"plant: {substeps} substeps, expected 1 or more")
        if not 0.0 <= mismatch < 0.3:
            raise BadInput(f"plant: mismatch {mismatch:g}, expected a relative scatter from 0 to 0.3")
        lowest, highest = rig.atmosphere.pressure, rig.supply.pressure
        initial_pressure = initial_pressure or (rest_pressure(rig),) * 2
        if not all(lowest <= value <= highest for value in initial_pressure):
            raise BadInput(
                f"plant: initial pressures {initial_pressure} Pa, expected absolute ones from {lowest:g} to {highest:g}"
            )
        if seed < 0:
            raise BadInput(f"plant: seed {seed}, expected 0 or more")
        bound = np.pi / 2 if rig.joint.stop is None else rig.joint.stop
        if initial_angle is not None and not abs(initial_angle) <= bound:
            raise BadInput(f"plant: initial angle {initial_angle:g} rad, expected within ±{bound:g} rad")
        self._rng = np.random.default_rng(seed)
        p = scattered(rig.parameters(joint, lock_angle), mismatch, self._rng)
        self._dt = rig.sample_period / substeps
        p[par.FRICTION_STEP] = self._dt
        self._p = p
        self._substeps = substeps
        self._sensors = rig.sensors
        self._noise = noise
        self._encoder, self._encoder_rng = rig.encoder, np.random.default_rng((seed, 1))
        if joint == "locked":
            angle = lock_angle
        else:
            angle = equilibrium.rest_angle(*initial_pressure, p) if initial_angle is None else initial_angle
        self._further, self._stamp = FurtherInputs.of(rig), 0
        self._period = round(rig.sample_period * 1e9)
        self._u = np.zeros(3)
        self._x = equilibrium.initial_state(angle, *initial_pressure, self._u, p)
        self._begun = False
        self._scratch = np.empty((integration.STAGES + 1, len(self._x)))
        self._shown = np.empty(3)  # pressures [Pa] and torque [N m], without noise

    @property
    def parameters(self) -> np.ndarray:
        """The true parameter vector (a copy)."""
        return self._p.copy()

    def named(self, names: Sequence[str]) -> dict[str, float]:
        """True values of parameters, by dotted path."""
        return {name: float(self._p[par.INDEX[name]]) for name in names}

    def change(self, values: Mapping[str, float]) -> None:
        """Change true parameters from now on; not those that add a state."""
        self._p = par.changed(self._p, values)

    def _measured(self, value: float, std: float, step: float, rng: np.random.Generator) -> float:
        if not self._noise:
            return value
        value += std * rng.standard_normal()
        return round(value / step) * step if step > 0.0 else value

    def _encoded(self) -> float:
        """Reading of the rig's encoder; its noise has a random generator of its own."""
        if self._encoder is None:
            return math.nan
        value = float(self._x[0]) + self._encoder.offset
        return self._measured(value, self._encoder.std, self._encoder.step, self._encoder_rng)

    def _take(self, signals: Sequence[float]) -> None:
        """Set what the model goes by beside its state: further signals [SI], and sums of weak laws."""
        if self._further is None:
            return
        self._stamp += self._period
        self._further.step(self._stamp, self._x[None, 2:4], signals)
        now = self._further.now[0]
        self._p[par.SIGNAL : par.SIGNAL + len(now)] = now

    def step(
        self, voltage: tuple[float, float] | np.ndarray, external_torque: float = 0.0, signals: Sequence[float] = ()
    ) -> PlantSample:
        """Advance one sample period.

        `voltage`: on the valves over the period (2,) [V], or commanded to the regulators [Pa]. `external_torque`: from
        outside, over the period [N m]. `signals`: further signals of the rig, in the order of its file [SI]; what is
        NaN or not given is as the file says.
        """
        self._take(signals)
        self._u[:2] = voltage
        self._u[2] = external_torque
        if not math.isfinite(self._u[0] + self._u[1] + self._u[2]):
            raise BadInput(f"plant: valve voltages and torque {tuple(self._u)}, expected finite ones")
        if not self._begun:
            # The plant starts as if its valves had had the first voltage for a long time.
            self._x = equilibrium.initial_state(self._x[0], self._x[2], self._x[3], self._u, self._p)
            self._begun = True
        integration.sample(self._x, self._u, self._p, self._dt, self._substeps, self._scratch, self._shown)
        sensors, rng = self._sensors, self._rng
        *pressures, torque = self._shown.tolist()
        return PlantSample(
            pressure=np.array(
                [self._measured(value, sensors.pressure_std, sensors.pressure_step, rng) for value in pressures]
            ),
            voltage=self._u[:2].copy(),
            angle=self._measured(float(self._x[0]), sensors.angle_std, sensors.angle_step, rng),
            torque=self._measured(torque, sensors.torque_std, sensors.torque_step, rng),
            encoder=self._encoded(),
            truth=self._x.copy(),
        )
