"""Whether a running joint still is its rig file: the filter, the hypotheses beside it, and their evidence.

Samples are averaged to 100 Hz. The estimator's filter runs on them with the rig's noise for that rate, without consider
parameters. Its process noise Q is moved until the innovations are white within a block: a response depends on the
estimate, and so on earlier innovations, and only then is it uncorrelated with the present one.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis.monitor_blocks import Blocks, MonitorFinding, alike
from pam_antagonist.diagnosis.monitor_responses import READINGS, hypotheses, make_responses, respond
from pam_antagonist.estimation import Estimator
from pam_antagonist.estimation.memory import GAP
from pam_antagonist.model import equilibrium
from pam_antagonist.model import parameters as par
from pam_antagonist.model.dynamics import ANGLE, PRESSURE_1, VELOCITY
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

RATE = 100.0
"""[Hz] of the averaged samples."""
BLOCK_NS = 1_000_000_000
THRESHOLD = 25.0
"""Evidence of an alarm."""
_LONGEST_STEP = 5.5e-3
"""[s] Longest step of the model for a response: an error of the integration is the same with and without its cause."""
_GATE = 1e3
"""Of the filter: what a fault does to the pressures must not be left out."""
_SETTLED_NS, _WHITENING = 3 * BLOCK_NS, 30
"""What does not count: time after a start of the filter, and blocks in which Q is found."""
_EVERY, _PULL, _LEAST_Q, _LARGEST_Q = 2, 6.0, 1e-6, 1e2
"""Blocks between two changes of Q, their gain, and bounds of Q by the rig's."""
_CALM = 8.0
"""Evidence above which Q is not moved."""
_MOTION, _PRESSURES = slice(ANGLE, VELOCITY + 1), slice(PRESSURE_1, PRESSURE_1 + 2)


class Monitor:
    """Tests a stream of samples. Feed it by :meth:`add`; :attr:`findings` are those after the last whole block.

    `rig`: as the joint is believed to be. `joint`: ``free`` or ``locked``, at `lock_angle` [rad]. `encoder`: whether
    samples have a measured angle, as the rig's encoder reads it.
    """

    def __init__(self, rig: Rig, joint: str = "free", lock_angle: float = 0.0, encoder: bool = False) -> None:
        slow = slower(rig)
        self._every, self._dt = round(slow.sample_period / rig.sample_period), slow.sample_period
        self._period_ns = rig.sample_period * 1e9
        self._filter = Estimator(slow, "default", joint, lock_angle, "encoder" if encoder else "none")
        self._encoder = rig.encoder if encoder else None
        angle_variance = 1.0 if self._encoder is None else self._encoder.variance
        self._variance = np.array([*slow.tuning("default").measurement, angle_variance])
        self._noise = self._filter.process_noise.copy()
        self._steps = max(1, math.ceil(self._dt / _LONGEST_STEP))
        self._p = slow.parameters(joint, lock_angle)
        self._p[par.FRICTION_STEP] = self._dt / self._steps
        self.watched = hypotheses(rig, encoder)
        self._work = make_responses(rig, self._p, self.watched, self._dt / self._steps)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._filter.reset()
        self._filter.process_noise[:] = self._noise
        self.blocks = Blocks(self.watched, len(self._work.sets))
        self.findings: list[MonitorFinding] = []
        self._stamps, self._rows = np.zeros(0, dtype=np.int64), np.zeros((0, 5))
        self._innovations: list[tuple[float, float]] = []
        self._products = np.zeros((2, 2))
        self._whitened = self._end = self._quiet_until = 0
        self._used, self._y = np.zeros(READINGS, dtype=np.bool_), np.zeros(READINGS)
        self._started: int | None = None

    def add(self, stamp_ns: NDArray[np.int64], pressure: Floats, voltage: Floats, angle: Floats | None = None) -> int:
        """Add samples in the order of their stamps; returns how many blocks were finished.

        `stamp_ns`: (N,) [ns]. `pressure`: (N, 2) [Pa], `voltage`: (N, 2) [V], `angle`: (N,) [rad]; NaN where missing.
        """
        done = self.blocks.count
        rows = np.column_stack([pressure, voltage, np.full(len(stamp_ns), np.nan) if angle is None else angle])
        # The grid of averages begins anew where stamps jump.
        stamps = np.append(self._stamps, stamp_ns)
        rows = np.concatenate([self._rows, rows])
        apart = np.diff(stamps)
        for part in np.split(np.arange(len(stamps)), np.flatnonzero((apart <= 0) | (apart > BLOCK_NS)) + 1):
            self._average(stamps[part], rows[part])
        return self.blocks.count - done

    def _average(self, stamps: NDArray[np.int64], rows: Floats) -> None:
        """Pressures are means over a bin; voltages over the time between the middles of two bins."""
        if not len(stamps):
            return
        every = self._every
        at = np.rint((stamps - stamps[0]) / self._period_ns).astype(np.int64)
        grid = np.full((int(at[-1]) + 1, 5), np.nan)
        grid[at] = rows
        count = (len(grid) - every // 2 - 1) // every
        if count < 2:
            self._stamps, self._rows = stamps, rows
            return
        means = _means(grid[: count * every].reshape(count, every, 5))
        voltage = means[1:, 2:4]
        if every > 1:
            # The interval that ends at a sample is two halves; the middle of a bin lies between two of them.
            halves = np.repeat(grid[: count * every, 2:4], 2, axis=0)
            first = every + 1
            voltage = _means(halves[first : first + 2 * every * (count - 1)].reshape(count - 1, 2 * every, 2))
        since = np.rint((np.arange(count) + 0.5) * every * self._period_ns - 0.5 * self._period_ns)
        middles = stamps[0] + since.astype(np.int64)  # as a float a stamp is off by 128 ns
        for k in range(1, count):
            self._sample(int(middles[k]), means[k, :2], voltage[k - 1], float(means[k, 4]))
        left = at >= (count - 1) * every
        self._stamps, self._rows = stamps[left], rows[left]

    def _sample(self, stamp: int, pressure: Floats, voltage: Floats, angle: float) -> None:
        estimator, encoder = self._filter, self._encoder
        before, angles = estimator.state.copy(), estimator.counts.angles_used if encoder else 0
        row = estimator.step_in_place(stamp, pressure[0], pressure[1], voltage[0], voltage[1], angle)
        if row is None:
            return
        if estimator.started_ns != self._started or int(row["flags"]) & GAP or math.isnan(voltage[0] + voltage[1]):
            self._started = estimator.started_ns
            self._restart(stamp, voltage)
            return
        innovation, used, y = row["innovation"], self._used, self._y
        used[0], used[1] = innovation[0] == innovation[0], innovation[1] == innovation[1]
        used[2] = encoder is not None and estimator.counts.angles_used > angles
        y[0], y[1], y[2] = pressure[0], pressure[1], angle - (encoder.offset if encoder else 0.0)
        respond(
            before, estimator.state, estimator.covariance, voltage, y, self._variance, used, self._p, self._dt,
            self._steps, self._work,
        )  # fmt: skip
        self._innovations.append((float(innovation[0]), float(innovation[1])))
        if stamp >= self._end:
            self._close(stamp)

    def _restart(self, stamp: int, voltage: Floats) -> None:
        """The filter has started, or what happened since the last sample is not known."""
        work, x = self._work, self._filter.state
        work.apart[:], work.score[:], work.information[:] = 0.0, 0.0, 0.0
        u = np.where(np.isfinite(voltage), voltage, 0.0)
        for k, q in enumerate(work.sets):
            state = equilibrium.initial_state(x[0], x[2], x[3], u, q)
            work.states[k, : len(state)] = state
        self._innovations = []
        self._quiet_until, self._end = stamp + _SETTLED_NS, stamp + BLOCK_NS

    def _close(self, stamp: int) -> None:
        """End a block."""
        work = self._work
        if not (np.isfinite(work.score).all() and np.isfinite(work.information).all()):
            self._restart(stamp, np.zeros(2))
            return
        self._whiten()
        if stamp >= self._quiet_until and self._whitened >= _WHITENING:
            self.blocks.add(stamp - BLOCK_NS, work.score, work.information)
            self.findings = self.blocks.findings()
        work.score[:], work.information[:] = 0.0, 0.0
        self._end = stamp + BLOCK_NS

    def _whiten(self) -> None:
        values = np.array(self._innovations)
        self._innovations = []
        known = np.isfinite(values)
        values = np.where(known, values, 0.0)
        values = np.where(known, values - values.sum(axis=0) / np.maximum(known.sum(axis=0), 1), 0.0)
        self._products += [(values[1:] * values[:-1]).sum(axis=0), (values**2).sum(axis=0)]
        self._whitened += 1
        calm = all(one.evidence < _CALM for one in self.findings)
        if self._whitened % _EVERY or not calm:
            return
        share = np.clip(self._products[0] / np.maximum(self._products[1], 1e-300), -0.5, 0.5)
        noise, given = self._filter.process_noise, self._noise
        moved = noise[_PRESSURES] * np.exp(_PULL * share)
        noise[_PRESSURES] = np.clip(moved, _LEAST_Q * given[_PRESSURES], _LARGEST_Q * given[_PRESSURES])
        factor = math.sqrt(float(np.prod(noise[_PRESSURES] / given[_PRESSURES])))
        noise[_MOTION] = given[_MOTION] * min(factor, 1.0)
        self._products[:] = 0.0


def slower(rig: Rig) -> Rig:
    """The rig for means of samples at 100 Hz, or nearly: the noise of its filter, which considers nothing."""
    every = max(1, round(1.0 / (RATE * rig.sample_period)))
    tuning = rig.tuning("default")
    noise = tuning.replaced(
        process=tuple(value * every for value in tuning.process),
        states={name: (a, b * every) for name, (a, b) in tuning.states.items()},
        measurement=tuple(value / every for value in tuning.measurement),
        consider=False, gate=_GATE,
    )  # fmt: skip
    return rig.unchecked(sample_period=every * rig.sample_period, tunings={**rig.tunings, "default": noise})


def _means(values: Floats) -> Floats:
    """Means over the second axis (K, w, C), NaN where less than half of the values are there."""
    there = np.isfinite(values)
    count = there.sum(axis=1)
    total = np.where(there, values, 0.0).sum(axis=1)
    return np.where(2 * count >= values.shape[1], total / np.maximum(count, 1), np.nan)


_SINCE = 30.0
"""[s] that a joint has to be another one before it is searched."""
_REST = (120.0, 3600.0)
"""[s] without a search after one, at first and at most; doubled where it names nothing."""
_STRONGER = 2.0
"""A search that named nothing does not hold up one with so many times its evidence."""


@dataclass(frozen=True)
class Conclusion:
    """What is said of a joint."""

    finding: MonitorFinding
    size: float
    std: float
    ambiguous_with: tuple[str, ...] = ()
    doubt: str = ""  # why it is no more than suspected; empty: the search found it

    @property
    def confirmed(self) -> bool:
        """Whether the search found it."""
        return not self.doubt

    @property
    def sentence(self) -> str:
        """It in words."""
        item, size, std, unit = self.finding.watched, self.size, self.std, self.finding.watched.unit
        since = datetime.datetime.fromtimestamp(self.finding.onset_ns * 1e-9).strftime("%H:%M:%S")
        what = "the encoder's zero is wrong"
        if item.name in CATALOGUE:
            what = CATALOGUE[item.name].in_words(item.muscle, {item.parameter: self.finding.size})
        if unit == "m2":
            size, std, unit = size * 1e6, std * 1e6, "mm2"
        text = f"{what} since {since} ± {self.finding.onset_std:.0f} s, {size:.2g} ± {std:.1g} {unit}"
        text += f"; it cannot be told from {', '.join(self.ambiguous_with)}" if self.ambiguous_with else ""
        return f"{text}; only a suspicion: {self.doubt}" if self.doubt else text


def searches(rig: Rig, encoder: bool) -> bool:
    """Whether the search of ``close_loop`` is possible: a rig of a data sheet needs a measured angle."""
    return encoder or not rig.is_from_data_sheets


def limits(rig: Rig, encoder: bool) -> str:
    """What a monitor cannot do, in words; empty with an encoder."""
    if encoder:
        return ""
    without = "without an encoder (angle_sensor: none) "
    if not searches(rig, encoder):
        without += "no search is possible, since the rig's muscles are known from a data sheet only. All findings"
    else:
        without += "a search confirms little. Most findings"
    return f"{without} stay suspicions: the log and /diagnostics name them, topic health does not"


class Alarms:
    """Decides when to search, and what is said. Times are those of one clock [s], which may be any.

    `encoder`: whether the angle is measured.
    """

    def __init__(self, encoder: bool = False) -> None:
        self._encoder = encoder
        self._rest, self._in_vain = _REST[0], 0.0
        self._none_until = self._few_until = -math.inf

    def due(self, findings: Sequence[MonitorFinding], newest_ns: int, now: float) -> bool:
        """Whether a search begins.

        `newest_ns`: stamp of the newest sample.
        """
        if not findings or findings[0].evidence < THRESHOLD or now < self._none_until:
            return False
        if now < self._few_until and findings[0].evidence < _STRONGER * self._in_vain:
            return False
        return newest_ns - findings[0].onset_ns >= _SINCE * 1e9

    def concluded(
        self, suspect: Sequence[MonitorFinding], found: Mapping[str, Any] | None, now: float
    ) -> Conclusion | None:
        """What is said after a search; None where it found nothing.

        `suspect`: the hypotheses when it began. `found`: parts of report.json; None: it could not be searched for.
        """
        said = None if found is None else _named(suspect, found)
        if found is None:
            said = _suspected(suspect, "no search was possible")
        elif said is not None and not self._encoder and not _is_likely(said.finding, suspect):
            # From pressures alone the search gave a leak another name; none that it gave so was right.
            said = _suspected(suspect, f"the search says {said.finding.watched.name}, the evidence does not")
        elif said is None and found["verdict"] != "none":
            said = _suspected(suspect, f"the search says {found['verdict']}")
        in_vain = found is not None and (said is None or not said.confirmed)
        self._rest = min(2.0 * self._rest, _REST[1]) if in_vain else _REST[0]
        self._in_vain = suspect[0].evidence if in_vain else 0.0
        self._none_until, self._few_until = now + _REST[0], now + self._rest
        return said


def _named(suspect: Sequence[MonitorFinding], found: Mapping[str, Any]) -> Conclusion | None:
    for effect in found["effects"] or ():
        of_it = [one for one in suspect if one.watched.name == effect["name"]]
        same = [one for one in of_it if effect["muscle"] in (None, one.watched.muscle)] or of_it
        if not same:
            continue
        item, size, std = same[0].watched, same[0].size, same[0].std
        for name, value in effect["parameters"].items():
            if name in (item.parameter, f"{item.parameter}_{item.muscle}"):
                size, std = value["value"], value["std"] or std
        return Conclusion(same[0], float(size), float(std), tuple(found["ambiguous_with"] or ()))
    first = suspect[0]
    for zero in found["calibration"] or ():
        if zero["name"] == first.watched.name:
            return Conclusion(first, float(zero["value"]), float(zero["std"] or first.std), tuple(alike(suspect)))
    return None


def _is_likely(finding: MonitorFinding, suspect: Sequence[MonitorFinding]) -> bool:
    """Whether a finding is the hypothesis with the most evidence, or cannot be told from it."""
    item, likely = finding.watched, [suspect[0].watched.name, *alike(suspect)]
    return item.name in likely or f"{item.name} {item.muscle}" in likely


def _suspected(suspect: Sequence[MonitorFinding], doubt: str) -> Conclusion:
    first = suspect[0]
    return Conclusion(first, first.size, first.std, tuple(alike(suspect)), doubt)
