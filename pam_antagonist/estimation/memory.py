"""Settings of a filter, its memory from sample to sample, and the type of its estimates.

A checkpoint is the whole memory of a running filter, so that another filter goes on from there bit for bit. Only a
filter with the same rig, tuning and joint condition can use it. So it holds the identity of its filter, and any other
filter refuses it and says why.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import encoder
from pam_antagonist.estimation.stamps import CLOCK_SIZE, LAST, PRESSURES, REJECTED, RUNNING, STARTED, new_readings
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.model.effects.external_torque import NEVER, UNBOUNDED

MISSING_PRESSURE_1, MISSING_PRESSURE_2, MISSING_VALVE, OUTLIER, GAP, REPAIRED, LATE, NO_ANGLE = (
    1, 2, 4, 8, 16, 32, 64, 128,
)  # fmt: skip
"""Flags of an estimate, as in ``JointEstimate.msg``."""


@dataclass(frozen=True)
class Counts:
    """Counts of the samples that an estimator was given, by outcome.

    Attributes:
        processed: samples with an estimate.
        predicted_only: of the processed ones, those without a usable pressure.
        missing: samples with a missing value.
        outliers: samples with a pressure beyond the gate.
        late: samples older than the last one, dropped.
        duplicates: samples with the same stamp as the last one, dropped.
        gaps: samples that came after missing ones.
        repaired: samples at which the covariance was repaired.
        restarts: how often the filter began again.
        angles_used: samples whose measured angle was used.
        angles_refused: samples whose measured angle was not used: outliers, and all readings of a refused encoder.
        repeated: samples whose pressures repeat the last reading of sensors that are slower: prediction only.
    """

    processed: int
    predicted_only: int
    missing: int
    outliers: int
    late: int
    duplicates: int
    gaps: int
    repaired: int
    restarts: int
    angles_used: int = 0
    angles_refused: int = 0
    repeated: int = 0


COUNTERS = tuple(item.name for item in fields(Counts))
"""Outcomes of samples, in the order of the counters."""

ESTIMATE_DTYPE = np.dtype(
    [
        ("angle", "f8"),
        ("velocity", "f8"),
        ("torque", "f8"),
        ("covariance", "f8", (3, 3)),
        ("pressure", "f8", (2,)),
        ("force", "f8", (2,)),
        ("stiffness", "f8"),
        ("innovation", "f8", (2,)),
        ("innovation_covariance", "f8", (2, 2)),
        ("nis", "f8"),
        ("subsystem", "f8"),
        ("flags", "f8"),
        ("external_torque", "f8"),
        ("external_torque_covariance", "f8", (4,)),
    ]
)
"""One estimate: rad, rad/s, N m, their covariance, Pa, N, N m/rad, Pa, Pa², then NIS, subsystem and flags. The external
torque [N m] and its covariance with angle, velocity, torque and itself are NaN if the rig has no such state."""


class FilterSettings(NamedTuple):
    """Settings of a filter; n states, m consider parameters."""

    # parameter vectors of the sigma points (1 + 2 m, parameters.SIZE), the nominal one first.
    parameter_sets: np.ndarray
    initial: np.ndarray  # diagonal of P(0) (n,)
    process_noise: np.ndarray  # diagonal of Q for a nominal sample period (n,)
    measurement_noise: np.ndarray  # diagonal of R (2,) [Pa²]
    gain_noise: np.ndarray  # value of R in the gain (2,) [Pa²], see :func:`pam_antagonist.estimation.ukf.update`
    period: float  # nominal sample period [s]
    step: float  # approximate step of the model [s]
    kappa: float  # κ, the scaling of the sigma points [-]
    gate: float  # largest Mahalanobis distance of a pressure that is used [-]
    lock_angle: float  # angle of a locked joint [rad]
    # bounds of both pressures [Pa] and both voltages [V] (4, 2), see :func:`pam_antagonist.estimation.possible.bounds`.
    possible: np.ndarray
    commands: np.ndarray  # least and largest command of each muscle (2, 2) [V], of regulators [Pa]
    # variance of the error of a predicted change of pressure over a sample, relative to its square [-].
    change_noise: float = 0.0
    angle_noise: float = 0.0  # variance of a measured angle [rad²]; 0: no angle is used
    angle_offset: float = 0.0  # of the measured angle [rad], positive if it reads too high
    angle_step: float = 0.0  # of the angle's converter [rad]; 0: none


class Memory(NamedTuple):
    """Memory of a filter from sample to sample, changed in place."""

    x: np.ndarray  # estimate of the state (n,) [rad, rad/s, Pa, Pa, added states]
    covariance: np.ndarray  # P (n, n)
    cross: np.ndarray  # covariance with the consider parameters C (n, m)
    held: np.ndarray  # last known voltages (2,) [V]
    clock: np.ndarray  # memory of the stream's stamps (stamps.CLOCK_SIZE,)
    counts: np.ndarray
    innovation: np.ndarray  # of the last sample (2,) [Pa], NaN where a pressure was not used
    innovation_covariance: np.ndarray  # (2, 2) [Pa²]
    torque_moments: np.ndarray  # mean of the torque [N m], its variance, its covariance with each state (2 + n,)
    noise: np.ndarray  # diagonal of Q for the present step (n,)
    encoder: np.ndarray  # memory of the encoder (encoder.MEMORY,)
    readings: np.ndarray  # memory of the pressures' own rate (stamps.PRESSURES,)


def make_memory(states: int, considered: int) -> Memory:
    """The memory of a filter that has not started."""
    n = states
    return Memory(
        x=np.zeros(n),
        covariance=np.zeros((n, n)),
        cross=np.zeros((n, considered)),
        held=np.zeros(2),
        clock=np.zeros(CLOCK_SIZE, dtype=np.int64),
        counts=np.zeros(len(COUNTERS), dtype=np.int64),
        innovation=np.zeros(2),
        innovation_covariance=np.zeros((2, 2)),
        torque_moments=np.zeros(2 + n),
        noise=np.zeros(n),
        encoder=encoder.new(),
        readings=new_readings(2),
    )


_DIGITS = 16
_LAST_OLD_EFFECT = "slack"
"""The last effect of the catalogue when checkpoints were introduced; newer effects follow it."""
_NEW_EFFECTS = tuple(CATALOGUE)[tuple(CATALOGUE).index(_LAST_OLD_EFFECT) + 1 :]
_NEW_PARAMETERS = {
    par.INDEX["effects.external_torque.prior"]: UNBOUNDED,
    par.INDEX["effects.external_torque.onset"]: NEVER,
    **{
        par.INDEX[parameter_path(name, item.name)]: item.neutral
        for name in _NEW_EFFECTS
        for item in CATALOGUE[name].parameters
    },
    **{par.SLOT_OF[state.name]: 0.0 for name in _NEW_EFFECTS for state in CATALOGUE[name].states},
    **dict.fromkeys((*range(par.SIGNAL, par.SLOT), *range(par.LAWS_PRESENT, par.CURVE)), 0.0),
    **{par.INDEX[name]: 0.0 for name in ("geometry.cam_1", "geometry.cam_2", "valve_1.overlap", "valve_2.overlap")},
}
"""Entries of the parameter vector that are newer than the first checkpoints: index, and value while unused."""


@dataclass(frozen=True)
class FilterIdentity:
    """What a filter was made with."""

    rig: str
    fingerprint: str
    tuning: str
    joint: str  # ``free`` or ``locked``
    lock_angle: float  # angle of a locked joint [rad]
    added: tuple[str, ...]
    settings: str

    def difference(self, other: FilterIdentity) -> str:
        """In words, how another filter differs from this one; empty if it does not."""
        if other.fingerprint != self.fingerprint:
            return f"rig {other.rig} ({other.fingerprint}) rather than {self.rig} ({self.fingerprint})"
        if other.added != self.added:
            return f"the added states {_listed(other.added)} rather than {_listed(self.added)}"
        if other.tuning != self.tuning:
            return f"tuning {other.tuning} rather than {self.tuning}"
        if (other.joint, other.lock_angle) != (self.joint, self.lock_angle):
            return f"{_condition(other)} rather than {_condition(self)}"
        if other.settings != self.settings:
            return f"other values of tuning {other.tuning} or of the rig's uncertainty"
        return ""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """The whole memory of a filter after a sample; n states, m consider parameters."""

    stamp_ns: int  # stamp of that sample [ns]
    started_ns: int  # stamp of the sample that started the filter [ns]
    identity: FilterIdentity
    state: NDArray[np.float64]  # (n,)
    covariance: NDArray[np.float64]  # (n, n)
    cross: NDArray[np.float64]  # covariance with the consider parameters (n, m)
    voltage: NDArray[np.float64]  # last known ones (2,) [V]
    rejected: int
    # number of intervals between stamps since the start, then the last intervals [ns], a ring buffer.
    distances: NDArray[np.int64]
    # memory of the encoder (encoder.MEMORY,), left out where none was read; then that of the pressures' own rate
    # (PRESSURES,), which old checkpoints lack.
    angle_sensor: NDArray[np.float64]


def settings_hash(settings: FilterSettings) -> str:
    """Hash of all settings of a filter, sixteen hex digits."""
    content = settings._asdict()
    del content["possible"], content["commands"]  # follow from the rig; checkpoints older than them remain valid
    sets = settings.parameter_sets
    # Unused newer entries are left out of the hash, so that old checkpoints remain valid.
    unused = [index for index, value in _NEW_PARAMETERS.items() if np.all(sets[:, index] == value)]
    # The polynomial of the subsonic flow follows from the heat ratio. Old hashes have the flow's exponent in its place.
    k = sets[:, par.HEAT_RATIO]
    dropped = [*unused, *range(par.SUBSONIC, par.SUBSONIC + par.TERMS)]
    place = par.PULLEY - sum(index < par.PULLEY for index in dropped)
    content["parameter_sets"] = np.insert(np.delete(sets, dropped, axis=1), place, (k - 1.0) / k, axis=1)
    if settings.change_noise == 0.0:
        del content["change_noise"]
    if settings.angle_noise == 0.0:
        for name in ("angle_noise", "angle_offset", "angle_step"):
            del content[name]
    digest = hashlib.sha256()
    for value in content.values():
        digest.update(np.ascontiguousarray(value, dtype=np.float64).tobytes())
    return digest.hexdigest()[:_DIGITS]


def take(memory: Memory, identity: FilterIdentity) -> Checkpoint:
    """A checkpoint of a running filter, as a copy."""
    clock = memory.clock
    return Checkpoint(
        int(clock[LAST]),
        int(clock[STARTED]),
        identity,
        memory.x.copy(),
        memory.covariance.copy(),
        memory.cross.copy(),
        memory.held.copy(),
        int(clock[REJECTED]),
        clock[REJECTED + 1 :].copy(),
        np.concatenate([memory.encoder if encoder.was_read(memory.encoder) else np.empty(0), memory.readings]),
    )


def read_angle(checkpoint: Checkpoint) -> bool:
    """Whether the filter of a checkpoint has read a measured angle."""
    return len(checkpoint.angle_sensor) >= encoder.MEMORY


def put(checkpoint: Checkpoint, memory: Memory, identity: FilterIdentity) -> None:
    """Load a checkpoint into a filter's memory. A filter that refuses it stays unchanged."""
    other = identity.difference(checkpoint.identity)
    if other:
        raise BadInput(f"the checkpoint was made with {other}")
    here = {"state": memory.x, "covariance": memory.covariance, "cross": memory.cross, "voltage": memory.held}
    for name, own in here.items():
        values = getattr(checkpoint, name)
        if values.shape != own.shape:
            raise BadInput(f"the checkpoint is damaged: {name} has the shape {values.shape}, expected {own.shape}")
        if not np.isfinite(values).all():
            raise BadInput(f"the checkpoint is damaged: {name} holds a value that is not finite")
    if (np.diag(checkpoint.covariance) < 0.0).any():
        raise BadInput("the checkpoint is damaged: covariance has a negative variance")
    clock, distances = memory.clock, checkpoint.distances
    if not (
        checkpoint.started_ns <= checkpoint.stamp_ns
        and checkpoint.rejected >= 0
        and distances.shape == clock[REJECTED + 1 :].shape
        and distances[0] >= 0
        and (distances[1:][: distances[0]] > 0).all()
    ):
        raise BadInput("the checkpoint is damaged: its stamps and counts cannot be those of a filter")
    sensors = checkpoint.angle_sensor
    if len(sensors) not in (0, encoder.MEMORY, PRESSURES, encoder.MEMORY + PRESSURES):
        raise BadInput(f"the checkpoint is damaged: angle_sensor has {len(sensors)} numbers")
    of_encoder, of_pressures = np.split(sensors, [encoder.MEMORY if read_angle(checkpoint) else 0])
    for name, own in here.items():
        own[:] = getattr(checkpoint, name)
    memory.encoder[:] = of_encoder if len(of_encoder) else encoder.new()
    memory.readings[:] = of_pressures if len(of_pressures) else new_readings(2)
    clock[RUNNING], clock[LAST], clock[STARTED] = 1, checkpoint.stamp_ns, checkpoint.started_ns
    clock[REJECTED], clock[REJECTED + 1 :] = checkpoint.rejected, distances


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "none"


def _condition(identity: FilterIdentity) -> str:
    return "a free joint" if identity.joint == "free" else f"a joint locked at {identity.lock_angle:g} rad"
