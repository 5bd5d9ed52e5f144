"""What experiments share of one virtual rig: its recordings and what estimator and model make of them, made once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.estimation import Estimator, metrics, simulate_model
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Reading, Rig
from pam_antagonist.simulation import excitation
from validation.paper.scenario import Scenario, Truth, VirtualRig, drive, told, virtual_rig

Floats = NDArray[np.float64]
TUNINGS = ("published", "default")
"""Tunings of the filter that every table shows."""
IDENTIFICATION_S = 60.0
_IDENTIFICATION_SEED = 10_000


@dataclass(frozen=True)
class Errors:
    """The paper's three figures of an error, and how often the filter's 95 % interval held.

    Attributes:
        rmse: 𝕀 [° or N m].
        largest: 𝕄 in the same unit.
        ratio: ℚ [-].
        coverage: share of the samples within the interval; NaN without a covariance.
    """

    rmse: float
    largest: float
    ratio: float
    coverage: float = math.nan


@dataclass(frozen=True, eq=False)
class Track:
    """An estimate at all N samples of a recording.

    Attributes:
        angle: [°].
        torque: [N m].
        pressure: (N, 2) [Pa].
        angle_variance: [°²], None for a model alone.
        torque_variance: [(N m)²], None for a model alone.
        nis: normalised innovation squared, None for a model alone.
        innovation: (N, 2) [Pa], None for a model alone.
        subsystem: σ.
    """

    angle: Floats
    torque: Floats
    pressure: Floats
    angle_variance: Floats | None
    torque_variance: Floats | None
    nis: Floats | None
    innovation: Floats | None
    subsystem: NDArray[np.int64]

    def first(self, samples: int) -> Track:
        """Its first samples; a filter knows nothing of those that come after."""
        parts: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        cut: dict[str, Any] = {name: None if part is None else part[:samples] for name, part in parts.items()}
        return Track(**cut)


def filtered(rig: Rig, recording: Recording, tuning: str, joint: str, samples: int | None = None) -> Track:
    """The filter of a rig over the first samples of a recording.

    Args:
        rig: of the filter.
        recording: what it is given.
        tuning: name of the tuning.
        joint: ``free`` or ``locked``.
        samples: how many; default: all.
    """
    part = slice(samples)
    estimator = Estimator(rig, tuning, joint)
    run = estimator.run(recording.stamp_ns[part], recording.pressure[part], recording.voltage[part])
    rows, degree = run.rows, math.degrees(1.0)
    return Track(
        angle=rows["angle"] * degree,
        torque=rows["torque"],
        pressure=rows["pressure"],
        angle_variance=rows["covariance"][:, 0, 0] * degree**2,
        torque_variance=rows["covariance"][:, 2, 2],
        nis=rows["nis"],
        innovation=rows["innovation"],
        subsystem=rows["subsystem"].astype(np.int64),
    )


def modelled(rig: Rig, recording: Recording, joint: str, samples: int | None = None) -> Track:
    """The model alone over the first samples of a recording.

    Args:
        rig: of the model.
        recording: whose voltages and first pressures it is given.
        joint: ``free`` or ``locked``.
        samples: how many; default: all.
    """
    run = simulate_model(rig, recording.voltage[slice(samples)], recording.pressure[0], joint)
    return Track(np.degrees(run.angle), run.torque, run.pressure, None, None, None, None, run.subsystem)


def judged(track: Track, recording: Recording, rig: Rig, quantity: str) -> Errors:
    """Errors of the ``angle`` [°] or the ``torque`` [N m] over the samples of the track.

    Args:
        track: the estimate, of the recording's first samples.
        recording: what was measured.
        rig: whose reference sensors' noise widens the interval.
        quantity: ``angle`` or ``torque``.
    """
    measured = measured_of(recording, quantity)[: len(track.angle)]
    if quantity == "angle":
        value, variance = track.angle, track.angle_variance
        reading = rig.sensors.reading("angle").scaled(math.degrees(1.0))
    else:
        value, variance = track.torque, track.torque_variance
        reading = rig.sensors.reading("torque")
    return figures_of(value, measured, variance, reading)


def figures_of(
    value: Floats, measured: Floats, variance: Floats | None = None, reading: Reading = metrics.EXACT
) -> Errors:
    """Errors of a value against its measurement.

    Args:
        value: (N,).
        measured: (N,).
        variance: of the value (N,), None of a model without one.
        reading: the reference sensor's noise.
    """
    error = value - measured
    held = math.nan if variance is None else metrics.coverage(error, variance, reading)
    return Errors(metrics.rmse(error), metrics.max_error(error), metrics.estimation_ratio(error, measured), held)


def measured_of(recording: Recording, quantity: str) -> Floats:
    """The encoder's angle [°] or the torque meter's torque [N m] (N,)."""
    assert recording.angle is not None and recording.torque is not None  # virtual rigs have both
    return np.degrees(recording.angle) if quantity == "angle" else recording.torque


class SeedWork:
    """The virtual rig of a seed with its recordings; what is asked for twice is computed once.

    Args:
        scenario: the scenario.
        seed: of the virtual rig.
        seconds: how much of the profile; default: all.
    """

    def __init__(self, scenario: Scenario, seed: int, seconds: float | None = None) -> None:
        self.scenario = scenario
        self._seconds = seconds
        self.seed = seed
        self._tracks: dict[tuple[str, str], Track] = {}
        self._numbers: dict[str, float] = {}

    @cached_property
    def rig(self) -> VirtualRig:
        """The virtual rig."""
        return virtual_rig(self.scenario, self.seed)

    @cached_property
    def voltage(self) -> Floats:
        """The input profile (N, 2) [V]."""
        return drive(self.scenario, self._seconds)

    @cached_property
    def truth(self) -> Truth:
        """What the plant itself does under the profile with the joint free."""
        return self.rig.run(self.voltage, "free")

    @cached_property
    def free(self) -> Recording:
        """The profile with the joint free."""
        return self.rig.record(self.voltage, "free", self.truth)

    @cached_property
    def locked(self) -> Recording:
        """The profile with the joint locked at 0."""
        return self.rig.record(self.voltage, "locked")

    @cached_property
    def identification(self) -> Recording:
        """Another recording of the free joint, for what is identified from data: random steps."""
        period = self.rig.declared.sample_period
        voltage = excitation.profile("steps", IDENTIFICATION_S, period, _IDENTIFICATION_SEED + self.seed)
        return self.rig.record(voltage, "free")

    def recording(self, joint: str) -> Recording:
        """The profile with the joint ``free`` or ``locked``."""
        return self.free if joint == "free" else self.locked

    def track(self, joint: str, method: str) -> Track:
        """The declared rig's model over the profile.

        Args:
            joint: ``free`` or ``locked``.
            method: ``model`` alone, the filter with a tuning of that name, or ``told``: with tuning default and the
                mismatches declared.
        """
        key = joint, method
        if key not in self._tracks:
            rig, recording = self.rig.declared, self.recording(joint)
            if method == "model":
                self._tracks[key] = modelled(rig, recording, joint)
            elif method == "told":
                self._tracks[key] = filtered(told(rig, self.scenario.mismatch), recording, "default", joint)
            else:
                self._tracks[key] = filtered(rig, recording, method, joint)
        return self._tracks[key]

    def once(self, name: str, compute: Callable[[], float]) -> float:
        """A number that is computed when it is asked for first."""
        if name not in self._numbers:
            self._numbers[name] = compute()
        return self._numbers[name]
