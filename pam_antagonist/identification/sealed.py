"""Parameters and tuning of a joint whose muscles are sealed, from its motion, its pressures and the torque applied.

No air flows, so the stages of a valve-driven joint do not apply. In a closed chamber the pressure depends on the
muscle's volume alone (equation (4) without flow). With the measured angle it shows how the volume changes. The torque
that moves the joint from outside shows stiffness and friction (equations (8) to (10)), wherever the joint slides. The
muscles' volume at ψ = 0 and the polytropic index stay as declared in the rig file, since a sealed joint shows only
their product. Of the force maps only the difference of both muscles is fitted: nothing shows how the force grows with
pressure. Then the filter is tuned (:mod:`~pam_antagonist.identification.sealed_tuning`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.sealed_tuning import drift_size, tuned
from pam_antagonist.inference.angle_driven import SLIDING, chamber_directions
from pam_antagonist.inference.fit import Fit, Values, refined
from pam_antagonist.inference.fit_errors import with_errors
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.trial import BLOCK_S
from pam_antagonist.inference.unknown import Unknown, change_of, parameters, start_values
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

ASSUMED = (
    "The volume of each muscle at angle 0 and the polytropic index: closed chambers determine k_2 (dV/dl)/V only.",
    "The force map: a sealed joint determines the difference of the two muscles' forces only, not how a force grows "
    "with pressure.",
    "The inertia, and whatever else does not matter in slow motion.",
    "The charge: at angle 0 it stays the same while the muscles are closed. Pressures alone do not distinguish an "
    "angle from a difference in charge.",
)
"""What an identification of a sealed joint takes as given."""
DRIFT_TIME = "effects.pressure_sensor.drift_time"
_LEAST_PRESSURE, _LEAST_TORQUE = 1.0, 1e-4
"""[Pa], [N m] Least sizes of the errors."""
_EVALUATIONS = 20
_LEAST_RANGE = np.radians(1.0)
_FEWEST_BLOCKS = 100


@dataclass(frozen=True, eq=False)
class SealedTrial:
    """Block means of a recording, K of them."""

    name: str
    time: Floats  # (K,) [s]
    angle: Floats  # (K,) [rad]
    velocity: Floats  # (K,) [rad/s]
    acceleration: Floats  # (K,) [rad/s²]
    pressure: Floats  # (K, 2) [Pa]
    external: Floats | None  # torque applied from outside (K,) [N m], None where it was not recorded

    @property
    def states(self) -> Floats:
        """Angle, velocity and pressures (K, 4)."""
        return np.column_stack([self.angle, self.velocity, self.pressure])


@dataclass(frozen=True)
class SealedStage:
    """A step of the identification."""

    name: str
    values: dict[str, float]
    std: dict[str, float]
    residual: float  # RMS of what is left, in ``unit``
    unit: str
    note: str


def sealed_trial(recording: Recording, name: str, share: float = 1.0) -> SealedTrial:
    """Prepare the first ``share`` of a recording.

    Blocks follow the stamps. They need no even grid, as :class:`~pam_antagonist.inference.trial.Trial` has it, because
    nothing is simulated over time here. So gaps do no harm.

    `share`: of its duration, from 0 to 1.
    """
    if recording.angle is None or not np.isfinite(recording.angle).any():
        raise BadInput(
            f"{name}: no measured angle; without it, a recording of a sealed joint does not determine the volume"
        )
    time = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9
    block = np.floor(time / BLOCK_S).astype(np.int64)
    kept = time < share * time[-1] + 1e-9
    columns = [time, recording.angle, recording.pressure[:, 0], recording.pressure[:, 1]]
    if recording.external_torque is not None:
        columns.append(recording.external_torque)
    values = np.column_stack(columns)[kept]
    good = np.isfinite(values).all(axis=1)
    number, place = np.unique(block[kept][good], return_inverse=True)
    if len(number) < _FEWEST_BLOCKS:
        raise BadInput(f"{name}: {len(number) * BLOCK_S:.1f} s with angle and pressures, expected at least "
                       f"{_FEWEST_BLOCKS * BLOCK_S:g} s")  # fmt: skip
    means = np.zeros((len(number), values.shape[1]))
    np.add.at(means, place, values[good])
    means /= np.bincount(place)[:, None]
    if np.ptp(means[:, 1]) < _LEAST_RANGE:
        raise BadInput(f"{name}: the angle moves by {np.degrees(np.ptp(means[:, 1])):.2f} deg only, expected at least "
                       f"{np.degrees(_LEAST_RANGE):g} deg")  # fmt: skip
    velocity = np.gradient(means[:, 1], means[:, 0])
    return SealedTrial(
        name,
        means[:, 0],
        means[:, 1],
        velocity,
        np.gradient(velocity, means[:, 0]),
        means[:, 2:4],
        means[:, 4] if values.shape[1] > 4 else None,
    )


def closed_chambers(trials: Sequence[SealedTrial], rig: Rig, muscle: int) -> SealedStage:
    """How a muscle's volume changes with its length, and its pressure at ψ = 0.

    The slope of the volume is fitted. The volume at ψ = 0 stays as declared.

    `muscle`: 0 or 1.
    """
    number = muscle + 1
    angle = np.concatenate([trial.angle for trial in trials])
    shown = np.concatenate([trial.pressure[:, muscle] for trial in trials])
    mean = float(np.mean(shown))
    start = moved(rig, {f"valves.charge_{number}": mean})

    def errors(p: Floats) -> Floats:
        return np.array([equilibrium.closed_pressure(muscle, at, p) for at in angle]) - shown

    slope, charge = chamber_directions(start, number)
    free = (replace(slope, std=np.inf, unit=0.1), replace(charge, std=np.inf, unit=1e-3))
    values, std, residual = _fitted(start, free, errors, _LEAST_PRESSURE)
    volume = f"muscle_{number}.volume.d2"
    return SealedStage(
        f"closed chamber of muscle {number}",
        values,
        {volume: abs(rig.value(volume)) * std[0], f"valves.charge_{number}": mean * std[1]},
        residual,
        "Pa",
        "the volume at angle 0 and the polytropic index stay as declared: pressures determine only k_2 (dV/dl)/V",
    )


def balance(trials: Sequence[SealedTrial], rig: Rig) -> SealedStage:
    """What acts against the torque from outside: stiffness, friction, and the difference of the muscles' forces.

    `trials`: recordings; those without a torque from outside are left out.
    """
    used = [trial for trial in trials if trial.external is not None]
    sliding = [np.abs(trial.velocity) > SLIDING for trial in used]
    count = int(sum(mask.sum() for mask in sliding))
    if count < _FEWEST_BLOCKS:
        raise BadInput(
            f"{count * BLOCK_S:.1f} s of sliding under a known torque, expected at least "
            f"{_FEWEST_BLOCKS * BLOCK_S:g} s: record measured/external_torque while the joint is driven to and fro"
        )
    names = [name for name in ("joint.stiffness", "joint.viscous_friction", "friction.shaft") if rig.value(name)]
    forces = {f"muscle_{number}.force.w2": way for number, way in ((1, 1.0), (2, -1.0))}
    free = [replace(change_of(name, {name: rig.value(name)}), unit=0.3, low=-0.999) for name in names]
    free.append(replace(change_of("difference of the muscles' forces", forces), unit=5.0))

    def errors(p: Floats) -> Floats:
        parts = []
        for trial, mask in zip(used, sliding, strict=True):
            assert trial.external is not None
            rows = zip(trial.states[mask], trial.acceleration[mask], strict=True)
            needed = np.array([dynamics.torque_needed(x, acceleration, np.sign(x[1]), p) for x, acceleration in rows])
            parts.append(needed - trial.external[mask])
        return np.concatenate(parts)

    values, std, residual = _fitted(rig, free, errors, _LEAST_TORQUE)
    spread = {name: rig.value(name) * std[k] for k, name in enumerate(names)}
    spread |= {f"muscle_{number}.force.w2": std[-1] for number in (1, 2)}
    return SealedStage(
        "balance of torques",
        values,
        spread,
        residual,
        "N m",
        f"over {count * BLOCK_S:.1f} s in which the joint slides; where it sticks, friction may be anything up to its "
        "bound",
    )


def _fitted(
    rig: Rig, free: Sequence[Unknown], errors: Callable[[Floats], Floats], least: float
) -> tuple[dict[str, float], Floats, float]:
    """Values by dotted path, standard errors of the unknowns (D,), and the RMS of what is left.

    `least`: least size of an error.
    """
    known = start_values(rig, free)

    def along(values: Mapping[str, float]) -> dict[str, float]:
        return parameters(free, values, start=known)

    def left(each: Sequence[Values]) -> list[dict[str, Floats]]:
        return [{"error": errors(rig.parameters(changes=along(amounts)))} for amounts in each]

    start = Fit(tuple(free), np.zeros(len(free)), np.eye(len(free)), np.inf)
    fit = refined(start, (), left, {"error": least}, _EVALUATIONS)
    fit = with_errors(fit, lambda each: [fit.scale["error"] * one["error"] for one in left(each)])
    rms = float(np.sqrt(np.mean(left([fit.values])[0]["error"] ** 2)))
    return along(fit.values), np.array(list(fit.stds.values())), rms


_LEAST_MOVE = 0.05
"""[V] If a voltage moves more, the chambers are not sealed."""


@dataclass(frozen=True, eq=False)
class SealedIdentified:
    """What was found; less than :class:`~pam_antagonist.identification.result.FromPressures` has."""

    fits: ClassVar[tuple[Fit, ...]] = ()
    notes: ClassVar[tuple[str, ...]] = ()
    rejected: ClassVar[str] = ""

    start: Rig
    rig: Rig
    stages: tuple[SealedStage, ...]
    held_from: tuple[float, ...]  # for each recording, the time from which on it was held out [s]
    # mean logarithm of the likelihood of an angle's error, less the square of ln(NIS/2), with the start's tuning and
    # with the new one.
    likelihood: tuple[float, float]
    evaluations: int

    @cached_property
    def tuning(self) -> dict[str, Any]:
        """The filter's tuning before and after, in squared SI units of readings and states.

        The random walk is the noise of the external torque [N m/√s].
        """

        def both(what: Callable[[Rig], Any]) -> dict[str, Any]:
            return {"before": what(self.start), "after": what(self.rig)}

        def drift(rig: Rig) -> float:  # of the pressure readings, the larger of both
            noise = max(rig.value(f"effects.pressure_sensor.drift_{muscle}") for muscle in (1, 2))
            return drift_size(noise, rig.value(DRIFT_TIME))

        return {
            "measurement": both(lambda rig: tuple(rig.tuning("default").measurement)),
            "process": both(lambda rig: tuple(rig.tuning("default").process)),
            "drift_std_pa": both(drift),
            "drift_time_s": both(lambda rig: rig.value(DRIFT_TIME)),
            "random_walk": both(lambda rig: rig.value("effects.external_torque.noise")),
            "log_likelihood": dict(zip(("before", "after"), self.likelihood, strict=True)),
            "evaluations": self.evaluations,
        }


def identify_sealed(
    recordings: Sequence[tuple[Recording, str]],
    rig: Rig,
    holdout: float = 1.0 / 3.0,
    progress: Callable[[str], None] | None = None,
) -> SealedIdentified:
    """Identify a sealed joint. `rig`: start values; ``valves.sealed``."""
    progress = progress or (lambda text: None)
    refuse_moving_valves(recordings, rig)
    share = 1.0 - holdout
    trials = [sealed_trial(recording, name, share) for recording, name in recordings]
    stages: list[SealedStage] = []
    now = rig
    for muscle in (0, 1):
        progress(f"closed chamber of muscle {muscle + 1}")
        stages.append(closed_chambers(trials, now, muscle))
        now = moved(now, stages[-1].values)
    progress("balance of torques")
    stages.append(balance(trials, now))
    now = moved(now, stages[-1].values)
    best, likelihood, evaluations = tuned(now, recordings, share, progress)
    held = tuple(share * float(recording.stamp_ns[-1] - recording.stamp_ns[0]) * 1e-9 for recording, _ in recordings)
    return SealedIdentified(rig, best, tuple(stages), held, likelihood, evaluations)


def refuse_moving_valves(recordings: Sequence[tuple[Recording, str]], rig: Rig) -> None:
    """Refuse recordings whose valves moved."""
    for recording, name in recordings:
        swing = float(np.nanmax(np.nanmax(recording.voltage, axis=0) - np.nanmin(recording.voltage, axis=0)))
        if swing > _LEAST_MOVE:
            raise BadInput(f"{name}: a valve moves by {swing:.2f} V, but the chambers of rig {rig.name} are sealed")
