"""Parameters of a joint whose muscles are sealed: from its motion, its pressures and the torque applied from outside.

No air flows, so what the staged identification of a valve-driven joint rests on is not there. Instead the
chambers are closed: each pressure follows the muscle's volume alone (equation (4) without flow), and at the measured
angle it tells how the volume changes. The torque that moves the joint from outside then tells what holds against it
(equations (8) to (10)), wherever the joint slides. The muscles' volume at ψ = 0, the polytropic index and the
force map stay as the rig file declares them: a sealed joint tells only their product, and nothing of how
the force grows with pressure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pam_antagonist.errors import BadInput
from pam_antagonist.model import dynamics, joint, rest
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_BLOCK_S = 0.02
_CLUSTER_S = 1.0
"""[s] Residuals closer than this are taken to depend on each other."""
_SLIDING = 0.02
"""[rad/s] A joint that moves faster slides; below, friction may be anything up to its bound."""
_LEAST_RANGE = np.radians(1.0)
_FEWEST_BLOCKS = 100


@dataclass(frozen=True, eq=False)
class SealedTrial:
    """Block means of a recording, K of them.

    Attributes:
        name: of the recording.
        time: (K,) [s].
        angle: (K,) [rad].
        velocity: (K,) [rad/s].
        acceleration: (K,) [rad/s²].
        pressure: (K, 2) [Pa].
        external: torque applied from outside (K,) [N m], None where it was not recorded.
    """

    name: str
    time: Floats
    angle: Floats
    velocity: Floats
    acceleration: Floats
    pressure: Floats
    external: Floats | None


@dataclass(frozen=True)
class SealedStage:
    """A step of the identification.

    Attributes:
        name: what it identifies.
        values: parameters found, by name.
        std: their standard deviations.
        residual: RMS of what is left, in ``unit``.
        unit: Pa or N m.
        note: what is to be known about it.
    """

    name: str
    values: dict[str, float]
    std: dict[str, float]
    residual: float
    unit: str
    note: str


def sealed_trial(recording: Recording, name: str, share: float = 1.0) -> SealedTrial:
    """Prepare the first ``share`` of a recording.

    Args:
        recording: of a sealed joint.
        name: for messages.
        share: of its duration, from 0 to 1.

    Raises:
        BadInput: no measured angle, an angle that hardly moves, or too few samples.
    """
    if recording.angle is None or not np.isfinite(recording.angle).any():
        raise BadInput(f"{name}: no measured angle; a sealed joint tells its volume only together with one")
    time = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9
    block = np.floor(time / _BLOCK_S).astype(np.int64)
    kept = time < share * time[-1] + 1e-9
    columns = [time, recording.angle, recording.pressure[:, 0], recording.pressure[:, 1]]
    if recording.external_torque is not None:
        columns.append(recording.external_torque)
    values = np.column_stack(columns)[kept]
    good = np.isfinite(values).all(axis=1)
    number, place = np.unique(block[kept][good], return_inverse=True)
    if len(number) < _FEWEST_BLOCKS:
        raise BadInput(f"{name}: {len(number) * _BLOCK_S:.1f} s with angle and pressures, expected at least "
                       f"{_FEWEST_BLOCKS * _BLOCK_S:g} s")  # fmt: skip
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

    The slope of the volume is moved about its value at ψ = 0, which stays as declared.

    Args:
        trials: recordings of one charge.
        rig: start values.
        muscle: 0 or 1.
    """
    volume = getattr(rig, f"muscle_{muscle + 1}").volume
    length = rig.geometry.length
    prefix = f"muscle_{muscle + 1}.volume"

    def named(theta: Floats) -> dict[str, float]:
        slope = volume.d2 * (1.0 + theta[0])
        return {
            f"{prefix}.d2": slope,
            f"{prefix}.d3": volume.d3 - (slope - volume.d2) * length,
            f"valves.charge_{muscle + 1}": measured_mean * (1.0 + theta[1]),
        }

    measured_mean = float(np.mean(np.concatenate([trial.pressure[:, muscle] for trial in trials])))

    def residual(theta: Floats) -> Floats:
        p = rig.parameters(changes=named(theta))
        parts = []
        for trial in trials:
            model = np.array([rest.closed_pressure(muscle, angle, p) for angle in trial.angle])
            parts.append(model - trial.pressure[:, muscle])
        return np.concatenate(parts)

    solution = least_squares(residual, np.zeros(2), x_scale=[0.1, 1e-3])
    std = _robust_std(solution.jac, solution.fun)
    values = named(solution.x)
    spread = {f"{prefix}.d2": abs(volume.d2) * std[0], f"valves.charge_{muscle + 1}": measured_mean * std[1]}
    return SealedStage(
        f"closed chamber of muscle {muscle + 1}",
        values,
        spread,
        float(np.sqrt(np.mean(solution.fun**2))),
        "Pa",
        "the volume at angle 0 and the polytropic index stay as declared: pressures tell only k_2 (dV/dl)/V",
    )


def balance(trials: Sequence[SealedTrial], rig: Rig) -> SealedStage:
    """What holds against the torque from outside: stiffness, friction, and the difference of the muscles' forces.

    Args:
        trials: recordings; those without a torque from outside are left out.
        rig: with the volumes already found.

    Raises:
        BadInput: no recording has a torque from outside, or the joint slides too seldom.
    """
    used = [trial for trial in trials if trial.external is not None]
    sliding = [np.abs(trial.velocity) > _SLIDING for trial in used]
    count = int(sum(mask.sum() for mask in sliding))
    if count < _FEWEST_BLOCKS:
        raise BadInput(
            f"{count * _BLOCK_S:.1f} s of sliding under a known torque, expected at least "
            f"{_FEWEST_BLOCKS * _BLOCK_S:g} s: record measured/external_torque while the joint is driven to and fro"
        )
    names = ("joint.stiffness", "joint.viscous_friction", "friction.shaft")

    def named(theta: Floats) -> dict[str, float]:
        values = {name: rig.value(name) * (1.0 + theta[k]) for k, name in enumerate(names)}
        for number, way in ((1, 1.0), (2, -1.0)):
            path = f"muscle_{number}.force.w2"
            values[path] = rig.value(path) + way * theta[3]
        return values

    def residual(theta: Floats) -> Floats:
        p = rig.parameters(changes=named(theta))
        parts = []
        for trial, mask in zip(used, sliding, strict=True):
            assert trial.external is not None
            needed = np.array([_needed(trial, int(k), p) for k in np.flatnonzero(mask)])
            parts.append(needed - trial.external[mask])
        return np.concatenate(parts)

    start = [0.0, 0.0, 0.0, 0.0]
    solution = least_squares(
        residual, start, bounds=([-0.999, -0.999, -0.999, -np.inf], np.inf), x_scale=[0.3, 0.3, 0.3, 5.0]
    )
    std = _robust_std(solution.jac, solution.fun)
    values = named(solution.x)
    spread = {name: rig.value(name) * std[k] for k, name in enumerate(names)}
    spread |= {f"muscle_{number}.force.w2": std[3] for number in (1, 2)}
    return SealedStage(
        "balance of torques",
        values,
        spread,
        float(np.sqrt(np.mean(solution.fun**2))),
        "N m",
        f"over {count * _BLOCK_S:.1f} s in which the joint slides; where it sticks, friction may be anything up to its "
        "bound",
    )


def _needed(trial: SealedTrial, k: int, p: Floats) -> float:
    """Torque from outside [N m] that the motion needs: equation (8) solved for it."""
    x = np.array([trial.angle[k], trial.velocity[k], trial.pressure[k, 0], trial.pressure[k, 1]])
    force_1, force_2 = dynamics.forces(x, p)
    coulomb = joint.coulomb_torque(force_1, force_2, x[2], x[3], p)
    friction = coulomb * np.sign(trial.velocity[k]) + p[par.VISCOUS] * trial.velocity[k]
    inertial = p[par.INERTIA] * trial.acceleration[k]
    return float(inertial + p[par.STIFFNESS] * trial.angle[k] - dynamics.torque(x, p) + friction)


def _robust_std(jacobian: Floats, residual: Floats) -> Floats:
    """Standard deviations that allow for residuals which depend on each other over a cluster of time."""
    length = max(1, round(_CLUSTER_S / _BLOCK_S))
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    scores = [
        jacobian[first : first + length].T @ residual[first : first + length]
        for first in range(0, len(residual), length)
    ]
    clusters, size = len(scores), jacobian.shape[1]
    scatter = sum(np.outer(score, score) for score in scores) * clusters / max(clusters - size, 1)
    return np.asarray(np.sqrt(np.diag(inverse @ scatter @ inverse)))
