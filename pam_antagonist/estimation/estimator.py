"""The estimator: angle and torque with their covariance from two pressures, live or over a recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from typing_extensions import override

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import encoder, possible, push, stamps, ukf
from pam_antagonist.estimation import filter as kernels
from pam_antagonist.estimation import memory as memories
from pam_antagonist.estimation.further import FurtherInputs
from pam_antagonist.estimation.memory import (
    ESTIMATE_DTYPE,
    Checkpoint,
    Counts,
    FilterIdentity,
    FilterSettings,
    make_memory,
)
from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import ADDED_STATES, parameter_path
from pam_antagonist.model.effects.external_torque import UNBOUNDED
from pam_antagonist.rig import NO_ENCODER, Rig, Tuning, fingerprint, load_rig
from pam_antagonist.rig.physical import varied
from pam_antagonist.shown import Shown

_FASTEST = 100.0
"""[rad/s] Limit of set_state."""

ANGLE_SENSORS = ("none", "encoder")
"""Choices of the sensor that measures the angle for a filter."""


@dataclass(frozen=True, repr=False)
class EstimateRun(Shown):
    """Estimates over a recording.

    Attributes:
        rows: estimates (M,) of ``ESTIMATE_DTYPE``.
        added: states that effects add (M,), by name, in their own units.
        stamp_ns: stamps of the estimates (M,) [ns].
        index: index of each estimate's sample in the recording (M,).
        started_ns: stamp at which the filter of each estimate was started (M,) [ns].
        counts: of the samples, by outcome.
    """

    rows: np.ndarray
    added: dict[str, np.ndarray]
    stamp_ns: np.ndarray
    index: np.ndarray
    started_ns: np.ndarray
    counts: Counts


def parameter_sets(rig: Rig, tuning: Tuning, joint: str = "free", lock_angle: float = 0.0) -> np.ndarray:
    """Parameter vectors of the sigma points: the nominal one, then a pair for each consider parameter.

    `tuning`: its κ sets the distance of the pairs, its ``consider`` whether there are any. `lock_angle`: angle [rad] of
    a locked joint.
    """
    nominal = rig.parameters(joint, lock_angle)
    steps = considered(rig) if tuning.consider else []
    reach = math.sqrt(nominal[par.STATES] + len(steps) + tuning.kappa)
    sets = [nominal]
    for step in steps:
        for way in (reach, -reach):
            moved = {name: varied(name, rig.value(name), way * step[name]) for name in step}
            sets.append(rig.parameters(joint, lock_angle, moved))
    return np.array(sets)


def considered(rig: Rig) -> list[dict[str, float]]:
    """Consider parameters of a rig, each as independent changes of one standard deviation.

    `rig`: its ``uncertainty`` names single parameters, its ``directions`` several that change together.
    """
    return [{name: std} for name, std in rig.uncertainty.items()] + list(rig.directions.values())


def _of_states(p: np.ndarray, tuning: Tuning, period: float, locked: bool) -> tuple[np.ndarray, np.ndarray]:
    """Initial and process variances of all states; for added states they come from the catalogue or the tuning."""
    initial, process = list(tuning.initial), list(tuning.process)
    if locked:
        # A locked joint's angle and velocity are known.
        initial[:2] = process[:2] = [0.0, 0.0]
    present = par.added_states(p)
    for effect, state in ADDED_STATES:
        if state.name not in present:
            continue

        def number(name: str, effect: str = effect) -> float:
            return float(p[par.INDEX[parameter_path(effect, name)]])

        noise = number(state.noise) if isinstance(state.noise, str) else state.noise
        prior = number(state.prior) if state.prior else math.inf
        if prior < UNBOUNDED:
            # Gauss–Markov process: the factor of a step is exp(−period/T), T = 2 s²/σ², and the variance stays s².
            own = (prior**2, -(prior**2) * math.expm1(-((noise / prior) ** 2) * period))
        else:
            own = (state.initial_std**2, noise**2 * period)
        own = tuning.states.get(state.name, own)
        initial.append(own[0])
        process.append(own[1])
    return np.array(initial), np.array(process)


def _angle_sensor(rig: Rig, name: str) -> dict[str, float]:
    """Settings of a filter for its angle sensor."""
    if name not in ANGLE_SENSORS:
        raise BadInput(f"angle_sensor {name!r}: expected one of {', '.join(ANGLE_SENSORS)}")
    if name == "none":
        return {}
    if rig.encoder is None:
        raise BadInput(f"angle_sensor encoder: {NO_ENCODER.format(rig=rig.name)}")
    if rig.encoder.variance <= 0.0:
        raise BadInput(f"encoder of rig {rig.name}: neither noise nor a step, expected std or step above 0 rad")
    return {
        "angle_noise": rig.encoder.variance, "angle_offset": rig.encoder.offset, "angle_step": rig.encoder.step
    }  # fmt: skip


def _results(samples: int, states: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Results of :func:`filter.process_all`: estimates, states, indices of the samples, stamps of the starts."""
    indices = np.zeros((2, samples), dtype=np.int64)
    return np.zeros(samples, ESTIMATE_DTYPE), np.zeros((samples, states)), indices[0], indices[1]


def _samples(name: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    """An array for the kernel: a copy, because numba would compile the filter once more for a read-only one."""
    try:
        out = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError):
        raise BadInput(f"{name}: expected numbers of shape {shape}") from None
    if out.shape != shape:
        raise BadInput(f"{name} has shape {out.shape}, expected {shape}")
    return out


class Estimator:
    """The unscented Kalman filter of a rig, on pressures and valve voltages.

    For a rig with pressure regulators, commanded pressures [Pa] take the place of the voltages.

    Args:
        rig: the rig, its name or its file.
        tuning: name of one of its tunings.
        joint: ``free``, or ``locked`` where the joint is held.
        lock_angle: angle [rad] at which a locked joint is held.
        angle_sensor: ``none``, or ``encoder`` where each sample may have a measured angle beside the pressures.

    Raises:
        BadInput: a rig, tuning, joint condition or angle sensor that does not exist, or an encoder that the rig file
            does not declare.
    """

    def __init__(
        self,
        rig: Rig | str | Path,
        tuning: str = "default",
        joint: str = "free",
        lock_angle: float = 0.0,
        angle_sensor: str = "none",
    ) -> None:
        rig = rig if isinstance(rig, Rig) else load_rig(rig, regulators=True)
        chosen = rig.tuning(tuning)
        sets = parameter_sets(rig, chosen, joint, lock_angle)
        n, m = int(sets[0, par.STATES]), (len(sets) - 1) // 2
        initial, process = _of_states(sets[0], chosen, rig.sample_period, joint == "locked")
        measurement = np.array(chosen.measurement)
        self._settings = FilterSettings(
            parameter_sets=sets,
            initial=initial,
            process_noise=process,
            measurement_noise=measurement,
            gain_noise=measurement * (2.0 if chosen.gain == "printed" else 1.0),
            period=rig.sample_period,
            step=min(rig.sample_period, par.LONGEST_STEP),
            kappa=chosen.kappa,
            gate=chosen.gate,
            lock_angle=lock_angle,
            possible=possible.bounds(rig),
            commands=np.array([rig.command_limits] * 2),
            change_noise=chosen.change**2,
            **_angle_sensor(rig, angle_sensor),
        )
        held = f" at {lock_angle:g} rad" if joint == "locked" else ""
        self._shown = f"rig {rig.name}, tuning {tuning}, joint {joint}{held}, angle sensor {angle_sensor}"
        self._added = par.added_states(sets[0])
        self._memory = make_memory(n, m)
        self._identity = FilterIdentity(
            rig.name, fingerprint(rig), tuning, joint, lock_angle, tuple(self._added),
            memories.settings_hash(self._settings),
        )  # fmt: skip
        # Plain tuples for the kernel, see filter.process_all.
        self._fields = tuple(self._memory), tuple(self._settings), tuple(ukf.make_work(n, sets))
        self._stamp, self._pressure, self._voltage = np.zeros(1, np.int64), np.zeros((1, 2)), np.zeros((1, 2))
        self._angle = np.full(1, np.nan)
        self._effects = None if np.all(sets[:, par.PLAIN] != 0.0) else dynamics.WITH_EFFECTS
        self._further = FurtherInputs.of(rig)
        self._live = (
            self._stamp, self._pressure, self._voltage, self._used(self._angle),
            None if self._further is None else self._further.now, self._effects, *self._fields, *_results(1, n),
        )  # fmt: skip
        rows = self._live[-4]
        self._row = rows[0]
        # numpy copies a record field by field, which takes longer than the filter's step.
        self._bytes = rows.view(f"V{ESTIMATE_DTYPE.itemsize}")
        self._drive = rig.drive
        self._compile(4e5 if rig.drive == "regulator" else 5.0)

    @override
    def __repr__(self) -> str:
        return f"Estimator: {self._shown}"

    def _compile(self, command: float) -> None:
        """Compile, or load from the cache, everything that a sample needs, so that the loop compiles nothing."""
        for stamp in (1, 1_000_001):
            self.step_in_place(stamp, 4e5, 4e5, command, command)
        self.reset()
        self._pressure[:] = self._voltage[:] = np.nan
        self._memory.counts[:] = 0

    def _used(self, angles: np.ndarray) -> np.ndarray | None:
        """Measured angles as the kernel takes them: None for a filter that uses none."""
        return angles if self._settings.angle_noise > 0.0 else None

    def reset(self) -> None:
        """Forget the estimate; the next sample with both pressures and voltages starts the filter."""
        self._memory.clock[:] = 0
        self._memory.encoder[:] = encoder.new()
        self._memory.readings[:] = stamps.new_readings(2)
        if self._further is not None:
            self._further.reset()

    @property
    def estimates_external_torque(self) -> bool:
        """Whether the rig has the external torque as a state."""
        return push.EXTERNAL_TORQUE in self._added

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the further signals that the rig's model goes by."""
        return () if self._further is None else self._further.names

    @property
    def encoder_complaint(self) -> str:
        """Why the encoder is refused, and what to do; empty where it is not."""
        return encoder.complaint(self._memory.encoder)

    @property
    def complaint(self) -> str:
        """What is not possible of the last sample, and what was expected; empty if nothing is.

        The filter takes such a value for missing and flags it as ``OUTLIER`` as well.
        """
        return possible.complaint(self.possible, self._drive, self._pressure, self._voltage)

    @property
    def possible(self) -> np.ndarray:
        """Least and largest possible value of both pressures [Pa] and both voltages [V] (4, 2)."""
        return self._settings.possible

    def set_state(
        self, stamp_ns: int, angle: float, velocity: float, pressure: tuple[float, float], voltage: tuple[float, float]
    ) -> None:
        """Put the filter into a state, with the covariance of a start. The next sample is predicted from there.

        States that effects add are as at a start. The filter counts as started at the stamp. A replay does not know
        the state, and starts from the measured pressures there.

        Args:
            stamp_ns: time of that state [ns]; later samples are predicted from it.
            angle: [rad].
            velocity: [rad/s].
            pressure: of the muscles (2,), absolute [Pa].
            voltage: on the valves (2,) [V].

        Raises:
            BadInput: a value that is not finite or not physical, or another angle than that of a locked joint.
        """
        p = self._settings.parameter_sets[0]
        locked = p[par.LOCKED] != 0.0
        bound = min(float(p[par.INDEX["joint.stop"]]), 0.5 * math.pi)
        at = self._settings.lock_angle
        if locked and not (angle == at and velocity == 0.0):
            raise BadInput(
                f"angle {angle:g} rad, velocity {velocity:g} rad/s: expected {at:g} and 0, the joint is locked"
            )
        if not abs(angle) <= bound:
            raise BadInput(f"angle {angle:g} rad: expected within ±{bound:g} rad")
        if not abs(velocity) <= _FASTEST:
            raise BadInput(f"velocity {velocity:g} rad/s: expected within ±{_FASTEST:g} rad/s")
        for value, (low, high) in zip(pressure, self._settings.possible[:2], strict=True):
            if not low <= value <= high:
                raise BadInput(f"pressure {value:g} Pa: expected {low:g} to {high:g} Pa, absolute")
        if not all(math.isfinite(value) for value in voltage):
            raise BadInput(f"voltage {list(voltage)}: expected two finite numbers")
        memory = self._memory
        inputs = np.array(voltage, dtype=np.float64)
        memory.x[:] = equilibrium.initial_state(angle, pressure[0], pressure[1], inputs, p)
        memory.x[dynamics.VELOCITY] = velocity
        memory.covariance[:] = np.diag(self._settings.initial)
        memory.cross[:] = 0.0
        memory.held[:] = inputs
        stamps.start(memory.clock, stamp_ns)

    def checkpoint(self) -> Checkpoint | None:
        """The filter's whole memory after the last sample; None if it is not started."""
        return memories.take(self._memory, self._identity) if self.started_ns is not None else None

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint: later samples give the same bits as in the filter of the checkpoint.

        Args:
            checkpoint: of a filter with the same rig, tuning and joint condition.

        Raises:
            BadInput: it is of another filter, or damaged; the filter stays unchanged.
        """
        memories.put(checkpoint, self._memory, self._identity)

    @property
    def counts(self) -> Counts:
        """Counts of the samples so far, by outcome."""
        return Counts(*(int(value) for value in self._memory.counts))

    @property
    def state(self) -> np.ndarray:
        """The present estimate of the whole state (n,), and its :attr:`covariance` (n, n): views, for fast loops."""
        return self._memory.x

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of :attr:`state` (n, n)."""
        return self._memory.covariance

    @property
    def process_noise(self) -> np.ndarray:
        """Variances Q of the states a sample (n,), which may be changed in place."""
        return self._settings.process_noise

    @property
    def started_ns(self) -> int | None:
        """Stamp [ns] of the sample that started the running filter, None before that."""
        return stamps.started_ns(self._memory.clock)

    def step(
        self, stamp_ns: int, p1: float, p2: float, u1: float, u2: float, angle: float = math.nan,
        signals: Sequence[float] = (),
    ) -> np.void | None:  # fmt: skip
        """Process one sample.

        Args:
            stamp_ns: its stamp [ns].
            p1: pressure of muscle 1, absolute [Pa], NaN where missing.
            p2: pressure of muscle 2, absolute [Pa], NaN where missing.
            u1: voltage on valve 1 over the step that ends at the stamp [V], NaN where missing.
            u2: voltage on valve 2, likewise.
            angle: reading of the encoder [rad], NaN where missing.
            signals: further signals [SI], in the order of the rig file, NaN where missing. A missing one is taken for
                its value in the rig file; without any, all are.

        A value that is not possible on the rig (kPa in place of Pa, a pressure far above the supply's, percent in place
        of volts) counts as missing; :attr:`complaint` says what was expected.

        Returns:
            The estimate (an ``ESTIMATE_DTYPE``), or None: the sample was not newer than the last one, or the filter is
            not started yet. ``flags`` are those of ``JointEstimate.msg``; ``stiffness`` is that of the muscles,
            −∂τ/∂ψ, positive where they pull the joint back.

        Raises:
            BadInput: no numbers, or stamps that are not in ns.

        Example:
            >>> from pam_antagonist import Estimator, load_rig
            >>> estimator = Estimator(load_rig("shin2022"))
            >>> row = estimator.step(1_000_000, 450e3, 450e3, 5.5, 5.5)  # ns, absolute Pa, V
            >>> abs(float(row["angle"])) < 0.01, row["covariance"].shape
            (True, (3, 3))
        """
        stamp = stamps.whole_ns(stamp_ns)
        try:
            row = self.step_in_place(stamp, p1, p2, u1, u2, angle, signals)
        except (TypeError, ValueError, OverflowError):
            raise BadInput(f"sample {stamp}, {p1}, {p2}, {u1}, {u2}, {angle}: expected numbers") from None
        if self.started_ns is not None:
            stamps.refuse_other_units(self._memory.clock)
        if row is None:
            return None
        return self._bytes.copy().view(ESTIMATE_DTYPE)[0]

    def step_in_place(
        self, stamp_ns: int, p1: float, p2: float, u1: float, u2: float, angle: float = math.nan,
        signals: Sequence[float] = (),
    ) -> np.void | None:  # fmt: skip
        """:meth:`step` without a copy, for fast loops: the next call overwrites the row.

        Args:
            stamp_ns: as for :meth:`step`.
            p1: likewise.
            p2: likewise.
            u1: likewise.
            u2: likewise.
            angle: likewise.
            signals: likewise.

        Returns:
            The estimate, valid until the next call, or None.
        """
        self._stamp[0], self._angle[0] = stamp_ns, angle
        pressure, voltage = self._pressure, self._voltage
        pressure[0, 0], pressure[0, 1], voltage[0, 0], voltage[0, 1] = p1, p2, u1, u2
        if self._further is not None:
            self._further.step(stamp_ns, pressure, signals)
        return self._row if kernels.process_all(*self._live) else None

    def run(
        self, stamp_ns: np.ndarray, pressure: np.ndarray, voltage: np.ndarray, angle: np.ndarray | None = None,
        signals: Mapping[str, np.ndarray] | None = None,
    ) -> EstimateRun:  # fmt: skip
        """Process a recording, sample by sample, with the same results as :meth:`step`.

        Args:
            stamp_ns: stamps (N,) [ns].
            pressure: pressures (N, 2) [Pa], NaN where missing.
            voltage: voltages (N, 2) [V], NaN where missing.
            angle: readings of the encoder (N,) [rad], NaN where missing; None: no readings.
            signals: further signals (N,) [SI] by the names of the rig file, NaN where missing. One that is not there
                is taken for its value in the rig file.

        Raises:
            BadInput: stamps that are not in ns, no numbers, or arrays of other shapes.
        """
        own = stamps.all_ns(stamp_ns)
        size = len(own)
        rows, states, index, started = _results(size, len(self._memory.x))
        pressures, further = _samples("pressure", pressure, (size, 2)), None
        if self._further is not None:
            columns = {name: _samples(f"signals[{name!r}]", one, (size,)) for name, one in (signals or {}).items()}
            further = self._further.follow(own, pressures, self._further.columns(columns, size))
        count = kernels.process_all(
            own,
            pressures,
            _samples("voltage", voltage, (size, 2)),
            self._used(np.full(size, np.nan) if angle is None else _samples("angle", angle, (size,))),
            further,
            self._effects,
            *self._fields,
            rows,
            states,
            index,
            started,
        )
        return EstimateRun(
            rows=rows[:count],
            added={name: states[:count, par.BASE_STATES + k] for k, name in enumerate(self._added)},
            stamp_ns=own[index[:count]],
            index=index[:count],
            started_ns=started[:count],
            counts=self.counts,
        )
