"""One recording of a rig as arrays, independent of its file format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self, override

from ..errors import BadInput, number
from ..optional import needs
from ..shown import Shown
from .notes import Issue

if TYPE_CHECKING:
    from pandas import DataFrame

    from ..estimation.memory import Checkpoint

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

_SAME_PERIOD = 0.02
"""Largest relative difference of two sample periods that clocks or jitter may cause."""
_GAP = 1.5
"""Samples are missing between stamps that are more than this many median periods apart."""


class Arrival(NamedTuple):
    """Stamps and times of reception of a topic's messages, in stamp order.

    Attributes:
        log_ns: Recorder's clock at reception (K,) [ns].
        stamp_ns: Header stamp (K,) [ns].
    """

    log_ns: Stamps
    stamp_ns: Stamps


class FurtherSignal(NamedTuple):
    """A further signal."""

    values: Floats  # at the samples (N,), NaN where missing
    unit: str


def _frozen(value: Any, dtype: Any, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """A read-only array of the given type and shape; None in the shape means any length."""
    try:
        given = np.array(value)
        array = given.astype(dtype)
    except (TypeError, ValueError):
        raise BadInput(f"{name}: expected numbers") from None
    if dtype is np.int64 and not np.array_equal(array, given):
        raise BadInput(f"{name}: expected whole numbers of ns; of seconds, give np.rint(1e9 * seconds)")
    if array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True)):
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise BadInput(f"{name} has shape {array.shape}, expected ({expected})")
    array.setflags(write=False)
    return array


def _check_increasing(stamp_ns: Stamps, name: str) -> None:
    if np.any(np.diff(stamp_ns) <= 0):
        index = int(np.argmax(np.diff(stamp_ns) <= 0)) + 1
        raise BadInput(f"{name} is not strictly increasing at index {index}")


ESTIMATE_SHAPES: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "angle": (), "velocity": (), "torque": (), "covariance": (3, 3), "pressure": (2,), "force": (2,),
        "stiffness": (), "innovation": (2,), "innovation_covariance": (2, 2), "nis": (), "subsystem": (), "flags": (),
        "external_torque": (), "external_torque_covariance": (4,),
    }
)  # fmt: skip
"""Fields of JointEstimate beside its times -> shape of one sample."""


_COLUMNS = ("stamp_ns", "pressure", "voltage", "angle", "torque", "external_torque", "angle_sensor")
"""What a recording has for each sample."""
_ROUNDING = 1.0
"""[Pa] Largest difference between a pressure and a command that was logged in its place."""
_WHOLE = dict.fromkeys(("subsystem", "flags", "mode"), np.uint8)


@dataclass(frozen=True, eq=False, repr=False)
class _Messages(Shown):
    """Messages as columns, with a row for each."""

    _NAME: ClassVar[str]
    stamp_ns: Stamps

    def __post_init__(self) -> None:
        for item in fields(self):
            name, shape = item.name, (len(self.stamp_ns), *ESTIMATE_SHAPES.get(item.name, ()))
            dtype = np.int64 if name.endswith("_ns") else _WHOLE.get(name, np.float64)
            object.__setattr__(self, name, _frozen(getattr(self, name), dtype, shape, f"{self._NAME}.{name}"))

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def take(self, index: Any) -> Self:
        """The messages chosen by a slice, mask or index array."""
        return type(self)(**{item.name: getattr(self, item.name)[index] for item in fields(self)})


@dataclass(frozen=True, eq=False, repr=False)
class RecordedEstimate(_Messages):
    """The estimator's output (M samples), named as in ``pam_antagonist_msgs/msg/JointEstimate``.

    Attributes:
        stamp_ns: Stamps (M,) [ns], strictly increasing.
        started_ns: Stamp of the first sample since the filter was last started (M,) [ns].
        angle: (M,) [rad].
        velocity: (M,) [rad/s].
        torque: (M,) [N m].
        covariance: Of angle, velocity and torque (M, 3, 3).
        pressure: (M, 2) [Pa absolute].
        force: (M, 2) [N].
        stiffness: -dτ/dψ (M,) [N m/rad].
        innovation: (M, 2) [Pa].
        innovation_covariance: (M, 2, 2) [Pa^2].
        nis: (M,).
        subsystem: 1 to 18 (M,) uint8.
        flags: (M,) uint8.
        external_torque: (M,) [N m]; NaN where the rig has no such state, or the bag's message definition no such field.
        external_torque_covariance: With angle, velocity, torque and itself (M, 4); NaN likewise.
    """

    _NAME = "estimate"
    started_ns: Stamps
    angle: Floats
    velocity: Floats
    torque: Floats
    covariance: Floats
    pressure: Floats
    force: Floats
    stiffness: Floats
    innovation: Floats
    innovation_covariance: Floats
    nis: Floats
    subsystem: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    external_torque: Floats
    external_torque_covariance: Floats

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        _check_increasing(self.stamp_ns, "estimate.stamp_ns")

    @classmethod
    def from_rows(cls, stamp_ns: Stamps, started_ns: Stamps, rows: NDArray[Any]) -> RecordedEstimate:
        """Make one from a structured array.

        Args:
            stamp_ns: header stamps (M,) [ns].
            started_ns: stamp at which the filter was last started (M,) [ns].
            rows: estimates (M,); the fields are named like the attributes.
        """
        return cls(stamp_ns, started_ns, **{name: rows[name] for name in ESTIMATE_SHAPES})


@dataclass(frozen=True, eq=False, repr=False)
class RecordedReference(_Messages):
    """References of the joint (K messages, in the order of reception).

    Attributes:
        stamp_ns: Header stamps (K,) [ns]; the time of reception where a message carried none.
        mode: JointReference.ANGLE = 0, TORQUE = 1 and so on (K,) uint8.
        value: (K,) [rad] or [N m].
        stiffness: (K,) [N m/rad]; NaN where the bag's message definition has no such field.
        damping: (K,) [N m s/rad]; NaN likewise.
    """

    _NAME = "reference"
    mode: NDArray[np.uint8]
    value: Floats
    stiffness: Floats
    damping: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Shown):
    """A recording of one rig: N samples, one stamp each, NaN where a value is missing.

    Attributes:
        path: Where it was read from.
        stamp_ns: Stamps (N,) [ns], strictly increasing.
        pressure: Muscle pressures (N, 2) [Pa absolute].
        voltage: Voltages on the valves over the sample that ends at the stamp (N, 2) [V]; for a joint with pressure
            regulators the pressure commands (N, 2) [Pa absolute].
        angle: Measured joint angle (N,) [rad], or None where none was recorded.
        torque: Measured joint torque (N,) [N m], or None.
        external_torque: Torque applied from outside (N,) [N m], or None.
        angle_sensor: Encoder angle that is an input of the estimator (N,) [rad], as published, or None.
        estimate: Recorded estimator output, or None.
        reference: Recorded references, or None.
        received_ns: Logical topic name -> :class:`Arrival`, for latencies and losses.
        topics: Logical topic name -> name in the bag, for the topics that were used.
        issues: Sentences about repaired, dropped or doubtful data, the most serious kind first.
        rigs: Texts in which the nodes named their rigs, oldest first, for :meth:`pam_antagonist.rig.RigIdentity.read`.
        checkpoints: Checkpoints of the live filter, in the order of their stamps.
        namespace: Of the joint, where the bag holds several; otherwise empty.
        signals: Further signals, by name.
        episode_ns: Stamps of the first samples of episodes (E,) [ns]; None for a recording in one piece. The joint's
            motion between two episodes is not known.
        drive: What drove the joint: "valve" or "regulator".
        corrected: Whether its values were corrected (:class:`~pam_antagonist.recording.corrections.Corrections`). Of
            one that was not, the functions of the API remove the rig file's calibration, as of a bag.
    """

    path: Path
    stamp_ns: Stamps
    pressure: Floats
    voltage: Floats
    angle: Floats | None = None
    torque: Floats | None = None
    external_torque: Floats | None = None
    angle_sensor: Floats | None = None
    estimate: RecordedEstimate | None = None
    reference: RecordedReference | None = None
    received_ns: Mapping[str, Arrival] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    issues: tuple[Issue, ...] = ()
    rigs: tuple[str, ...] = ()
    checkpoints: tuple[Checkpoint, ...] = ()
    namespace: str = ""
    signals: Mapping[str, FurtherSignal] = field(default_factory=dict)
    episode_ns: Stamps | None = None
    drive: str = "valve"
    corrected: bool = False

    def __post_init__(self) -> None:
        size = np.size(self.stamp_ns)
        if size == 0:
            raise BadInput("a recording needs a sample at least")
        fixed: dict[str, Any] = {"path": Path(self.path), "rigs": tuple(self.rigs), "issues": Issue.sorted(self.issues)}
        for name in (*_COLUMNS, "episode_ns"):
            if (values := getattr(self, name)) is not None:
                shape = (None,) if name == "episode_ns" else (size, 2) if name in ("pressure", "voltage") else (size,)
                fixed[name] = _frozen(values, np.int64 if name.endswith("_ns") else np.float64, shape, name)
        _check_increasing(fixed["stamp_ns"], "stamp_ns")
        arrivals = {}
        for name, (log_ns, stamp_ns) in self.received_ns.items():
            log = _frozen(log_ns, np.int64, (None,), f"received_ns[{name!r}].log_ns")
            arrivals[name] = Arrival(log, _frozen(stamp_ns, np.int64, (len(log),), f"received_ns[{name!r}].stamp_ns"))
        signals = {
            name: FurtherSignal(_frozen(values, np.float64, (size,), f"signals[{name!r}]"), unit)
            for name, (values, unit) in self.signals.items()
        }
        checkpoints = tuple(sorted(self.checkpoints, key=lambda item: item.stamp_ns))
        fixed |= {"received_ns": MappingProxyType(arrivals), "topics": MappingProxyType(dict(self.topics))}
        fixed |= {"signals": MappingProxyType(signals), "checkpoints": checkpoints}
        for name, value in fixed.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @override
    def _brief(self) -> str:
        named = {"angle": self.angle, "torque": self.torque, "encoder": self.angle_sensor, "estimate": self.estimate}
        also = ", ".join(["pressures", f"{self.drive} commands", *(name for name in named if named[name] is not None)])
        rate = f" at {1.0 / self.sample_period_s:.4g} Hz" if len(self) > 1 else ""
        return f"{self.path}, {len(self)} samples{rate}, {self.duration_s:.3f} s: {also}"

    @property
    def logged_commands(self) -> tuple[int, ...]:
        """Columns of the pressures that repeat the regulators' commands, sample by sample, and are no measurement."""
        if self.drive == "valve":
            return ()
        apart = np.abs(self.pressure - self.voltage)
        moves = np.ptp(self.voltage, axis=0) > 0.0
        return tuple(k for k in (0, 1) if moves[k] and np.fmax.reduce(apart[:, k]) <= _ROUNDING)

    def driven_by(self, drive: str) -> Recording:
        """This recording, if it has the given drive.

        Args:
            drive: of the rig: "valve" or "regulator".

        Raises:
            BadInput: The recording has the other drive.
        """
        if self.drive == drive:
            return self
        if drive == "regulator":
            raise BadInput(
                f"{self.path}: holds no pressure_state, which a rig with pressure regulators (drive: regulator) needs; "
                "name it by --topic pressure_state=/NAME, or give command_1 and command_2 in the map of import_csv"
            )
        raise BadInput(f"{self.path}: of a joint with pressure regulators; expected a rig with drive: regulator")

    def in_one_piece(self) -> Recording:
        """This recording, if it is in one piece.

        Raises:
            BadInput: The recording holds episodes.
        """
        if self.episode_ns is None:
            return self
        raise BadInput(
            f"{self.path}: holds {len(self.episode_ns)} episodes; expected a recording in one piece. Episodes are "
            "taken by replay, check and identify, and with a rig of new_rig or one of pressure regulators (drive: "
            "regulator) by close_loop"
        )

    @property
    def time_s(self) -> Floats:
        """Time since the first sample (N,) [s]."""
        return np.asarray((self.stamp_ns - self.stamp_ns[0]) * 1e-9)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.stamp_ns[-1] - self.stamp_ns[0]) * 1e-9

    @property
    def sample_period_s(self) -> float:
        """Median time between samples [s]; NaN for a single one."""
        return float(np.median(np.diff(self.stamp_ns))) * 1e-9 if len(self) > 1 else float("nan")

    @property
    def episodes(self) -> tuple[slice, ...]:
        """The samples of each episode, in order; all of them where the recording is in one piece."""
        first = [0] if self.episode_ns is None else np.searchsorted(self.stamp_ns, self.episode_ns).tolist()
        return tuple(slice(begin, end) for begin, end in zip(first, [*first[1:], len(self)], strict=True))

    def even_grid(self, nominal_s: float) -> tuple[float, Stamps]:
        """An even grid with this recording's period, and the grid point of each sample.

        Uneven stamps go to the nearest grid point. Gaps leave grid points without a sample.

        Args:
            nominal_s: the rig's sample period [s]; it is used unless the recording's period differs by more than 2 %.

        Returns:
            Period [s], and the grid point of each sample (N,), the first at 0.
        """
        period = nominal_s
        if len(self) > 1:
            apart = np.diff(self.stamp_ns)
            usual = float(np.mean(apart[apart <= _GAP * np.median(apart)])) / 1e9
            if abs(usual / nominal_s - 1.0) > _SAME_PERIOD:
                period = usual
        return period, np.rint((self.stamp_ns - self.stamp_ns[0]) / (period * 1e9)).astype(np.int64)

    def to_dataframe(self) -> DataFrame:
        """A data frame with a row for each sample, in SI units, and columns for measured signals (needs pandas)."""
        with needs("import", "a data frame"):
            import pandas as pd
        columns: dict[str, Any] = {"stamp_ns": self.stamp_ns, "time_s": self.time_s}
        for muscle in (0, 1):
            columns[f"pressure_{muscle + 1}_Pa"] = self.pressure[:, muscle]
            name = f"valve_{muscle + 1}_V" if self.drive == "valve" else f"pressure_command_{muscle + 1}_Pa"
            columns[name] = self.voltage[:, muscle]
        measured = {"angle_rad": self.angle, "torque_Nm": self.torque, "external_torque_Nm": self.external_torque}
        return pd.DataFrame(columns | {name: values for name, values in measured.items() if values is not None})

    def slice(self, start_s: float, stop_s: float) -> Recording:
        """The samples of ``start_s <= time < stop_s``, counted in seconds from the first sample.

        Raises:
            BadInput: No sample lies in this time.
        """
        start_s, stop_s = number("start_s", start_s), number("stop_s", stop_s)
        first = int(self.stamp_ns[0])
        low, high = (first + round(t * 1e9) if np.isfinite(t) else t for t in (start_s, stop_s))

        def inside(stamp_ns: Stamps) -> NDArray[np.bool_]:
            return np.asarray((stamp_ns >= low) & (stamp_ns < high))

        mask = inside(self.stamp_ns)
        if not np.any(mask):
            raise BadInput(f"no sample between {start_s} and {stop_s} s of {self.duration_s:.3f} s in {self.path}")
        episode_ns = self.episode_ns
        if episode_ns is not None:
            episode_ns = np.union1d(self.stamp_ns[mask][:1], episode_ns[inside(episode_ns)])
        return replace(
            self.take(np.flatnonzero(mask)),
            estimate=None if self.estimate is None else self.estimate.take(inside(self.estimate.stamp_ns)),
            reference=None if self.reference is None else self.reference.take(inside(self.reference.stamp_ns)),
            episode_ns=episode_ns,
            checkpoints=tuple(item for item in self.checkpoints if low <= item.stamp_ns < high),
            received_ns={
                name: Arrival(log[inside(stamp)], stamp[inside(stamp)])
                for name, (log, stamp) in self.received_ns.items()
            },
        )

    def take(self, rows: NDArray[np.intp]) -> Recording:
        """The samples of some rows (K,); estimates, references and times of reception stay as they are."""
        arrays: dict[str, Any] = {
            name: None if getattr(self, name) is None else getattr(self, name)[rows] for name in _COLUMNS
        }
        signals = {name: FurtherSignal(values[rows], unit) for name, (values, unit) in self.signals.items()}
        return replace(self, **arrays, signals=signals)
