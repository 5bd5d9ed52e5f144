"""Gains of the law through the model, tried on simulated joints: of a few, those that hold the angles best.

A joint that is hardly damped swings where the integral is quick, a regulator with a lag hunts where the torque against
friction changes its side at once, and a closed valve lets the pressures ripple. No linear model shows all of that. So
the loop is run: the law and the filter of the rig that was found, on joints that differ from it a little.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np

from pam_antagonist.cli.demo_steps import MODEL, task
from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.laws import Laws, Reachable
from pam_antagonist.control.model_law import ModelController, ModelGains, Seen
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.estimation import Estimator
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import angle_range, rest_pressure, rest_voltage
from pam_antagonist.simulation.plant import Plant

_HOLD_S, _LAST_S = 5.0, 1.0
"""[s] Of each step, and of its end, where the joint should rest."""
_SAMPLES = 0.4
"""Largest rate at which a pressure's error is corrected, in a sample."""
_INTEGRALS = (3.0, 1.0, 0.3)
"""[1/s] That are tried."""
_APPROACHES = (0.3, 0.1, 0.03)
"""[rad] Distances within which the torque against friction fades, that are tried with each integral."""
_SEEDS, _MISMATCH = (1, 2), 0.01
"""Of the simulated joints."""
_GOOD = 0.25
"""Gains with an error below this share of what is allowed are taken at once."""
_ALLOWED, _ALLOWED_SHARE = math.radians(1.0), 0.03
"""Largest error of the controlled joint at rest [rad], or as a share of its range."""


class Held(NamedTuple):
    """How a joint held the angles that were asked for."""

    error: float  # largest RMS of the last second of a step [rad]
    allowed: float  # [rad]
    largest: float  # largest angle that was asked for [rad]

    def in_words(self) -> str:
        """How the simulated joints did."""
        if self.error <= self.allowed:
            return f"simulated joints hold their angles within {math.degrees(self.error):.2g} deg"
        how = f"err by {math.degrees(self.error):.2g} deg" if math.isfinite(self.error) else "run away"
        return f"with the best gains simulated joints {how}, expected {math.degrees(self.allowed):.2g} deg at most"


def seen(row: np.void) -> Seen:
    """What a law goes by, of an estimate (an ``ESTIMATE_DTYPE``)."""
    covariance, innovation = row["covariance"], row["innovation_covariance"]
    first, second = row["pressure"].tolist()
    return Seen(
        float(row["angle"]), float(row["velocity"]), float(row["torque"]), first, second,
        float(row["external_torque"]), float(row["external_torque_covariance"][3]),
        float(covariance[0, 0]), float(covariance[1, 1]), float(covariance[2, 2]),
        float(innovation[0, 0]), float(innovation[1, 1]),
    )  # fmt: skip


def held_angles(rig: Rig, plant: Plant, gains: ModelGains, zero: float = 0.0) -> Held:
    """Steps of the angle, as a demo asks for them, on a simulated joint, with filter and law of a rig.

    `zero`: the joint's angle at the rig's angle 0 [rad].
    """
    p, period = rig.parameters(), rig.sample_period
    box = Box.of(p)
    command = (rest_pressure(rig),) * 2 if rig.drive == "regulator" else rest_voltage(rig)
    limits = VoltageLimits(*rig.command_limits)
    law = ModelController(p, box, gains, sample_period=period, limits=limits, safe_voltage=command)
    laws, estimator, angles = Laws(None, law, Reachable(p, box), MODEL), Estimator(rig, "default", "free"), []
    largest = max(value for _, value, _ in task(rig, Mode.ANGLE, MODEL, 20.0).references)
    allowed = max(_ALLOWED, _ALLOWED_SHARE * 2.0 * angle_range(rig))
    values = np.array([0.0, largest, -largest, 0.5 * largest])
    size, last = math.ceil(_HOLD_S / period - 1e-9), round(_LAST_S / period)
    for k in range(size * len(values)):
        sample = plant.step(command)
        row = estimator.step((k + 1) * round(period * 1e9), *sample.pressure, *sample.voltage)
        assert row is not None  # every sample is newer than the one before
        if abs(sample.truth[0]) > 0.5 * math.pi:
            return Held(math.inf, allowed, largest)  # it has run away
        command = laws.step(Wanted(Mode.ANGLE, float(values[k // size])), seen(row)).voltage
        angles.append(float(sample.truth[0]) - zero)
    ends = np.reshape(angles, (len(values), size))[:, -last:] - values[:, None]
    error = float(np.max(np.sqrt(np.mean(ends**2, axis=1))))
    return Held(error, allowed, largest)


def tried_gains(rig: Rig) -> tuple[ModelGains, Held]:
    """The gains with which simulated joints hold their angles best, and how they do."""
    bandwidth, found = min(ModelGains().bandwidth, _SAMPLES / rig.sample_period), []
    for integral, approach in product(_INTEGRALS, _APPROACHES):
        gains = ModelGains(bandwidth, integral, approach)
        joints = (Plant(rig, seed=seed, mismatch=_MISMATCH) for seed in _SEEDS)
        held = max((held_angles(rig, joint, gains) for joint in joints), key=lambda one: one.error)
        found.append((gains, held))
        if held.error < _GOOD * held.allowed:
            break
    return min(found, key=lambda one: one[1].error)
