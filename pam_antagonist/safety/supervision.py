"""Supervision of pressures and estimates: implausible or dangerous values stop a joint.

Each supervision checks one sample after another. Once a problem has lasted long enough, it returns the reason in
words, and the caller stops the joint (:meth:`ValveGuard.stop`). Times are counted in the samples' stamps, so that a
recording gives the same result. Checks go on while the valves are stopped: :attr:`present` tells whether the cause is
still there.
"""

from __future__ import annotations

import math
from collections import deque

from pam_antagonist.errors import BadInput
from pam_antagonist.estimation.memory import MISSING_PRESSURE_1, MISSING_PRESSURE_2, OUTLIER
from pam_antagonist.estimation.stamps import PATIENCE, RESTART_AFTER_NS

_MISSING = MISSING_PRESSURE_1 | MISSING_PRESSURE_2
_CHANCE = 1e-15  # probability, for each sample, that a good sensor counts as frozen: once in 30,000 years at 1 kHz
_SHARE = 0.15  # of the samples; with innovations twice as large as expected, 18 % are out of bounds
_FEWEST = 3.0  # samples out of bounds, because a window may hold only a few after a stall
_SLOWEST = 30.0  # assumed low-pass of a sensor's amplifier, a sixth of what docs/how-to/hardware.md asks for [Hz]
_GAP = 20  # consecutive missing samples, after which the valves have become safe for lack of commands
_SETTLING = 2 * PATIENCE  # samples until the filter accepts the pressures after a gap
_NEVER = 3e9  # a century [s]
_LEAST_FROZEN = 0.02  # some converters repeat each result several times [s]
_LONGEST_FROZEN = 1.0  # a sensor that may stay constant for longer by chance cannot be checked [s]


def frozen_samples(noise: float, step: float, correlation: float = 0.0) -> float:
    """Number of equal consecutive readings that shows a frozen sensor; infinite for one with too little noise.

    At constant pressure a reading has the same code as the one before with a probability of at most
    p = erf(step / (2 sqrt(2) s)), where s = noise sqrt(1 - correlation^2) is the standard deviation given the reading
    before. So n equal readings have a probability of at most p^(n-1), which is below 1e-15.

    `noise`: standard deviation of the readings before the converter [Pa]. `step`: of the converter [Pa]; 0: none.
    `correlation`: between the noise of two consecutive readings, 0 to below 1 [-].
    """
    if noise <= 0.0:
        return math.inf
    chance = math.erf(step / (2.0 * math.sqrt(2.0) * noise * math.sqrt(1.0 - correlation**2)))
    if chance >= 1.0:
        return math.inf
    return 2.0 if chance <= 0.0 else 1.0 + math.ceil(math.log(_CHANCE) / math.log(chance))


def frozen_time(noise: float, step: float, period: float) -> float | None:
    """Time of equal readings after which a sensor counts as frozen [s]; None: the sensor cannot be checked.

    Filtering in an amplifier makes equal readings more likely. The noise is assumed to have passed a first-order
    low-pass of 30 Hz.

    `noise`, `step`: as for :func:`frozen_samples`. `period`: between two readings [s].
    """
    correlation = math.exp(-2.0 * math.pi * _SLOWEST * period)
    time = max(_LEAST_FROZEN, frozen_samples(noise, step, correlation) * period)
    return time if time <= _LONGEST_FROZEN else None


class Persistent:
    """Whether a condition has held without a break for a time.

    The time between two samples counts as two periods at most, because nothing was checked in between.

    `time`: required time [s]. `period`: between two samples [s].
    """

    __slots__ = ("_last", "_longest", "_so_far", "_time")

    def __init__(self, time: float, period: float) -> None:
        self._time = round(time * 1e9)
        self._longest = round(2e9 * period)
        self._last: int | None = None
        self._so_far = 0

    def seen(self, stamp_ns: int) -> bool:
        """The condition holds at this stamp [ns]; returns whether it has held for long enough."""
        if self._last is not None:
            self._so_far += min(max(stamp_ns - self._last, 0), self._longest)
        self._last = stamp_ns
        return self._so_far >= self._time

    def gone(self) -> None:
        """The condition does not hold."""
        self._last = None
        self._so_far = 0


def _above_0(what: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise BadInput(f"{what.format(repr(value))}: expected a finite number above 0")


def _pair(time: float, period: float) -> tuple[Persistent, Persistent]:
    return Persistent(time, period), Persistent(time, period)


class PressureSupervision:
    """Checks the two measured pressures, in the node that measures them.

    Args:
        highest: pressure limit of each muscle (2,) absolute [Pa].
        over_time: how long a pressure may exceed the limit [s]; a single reading may be a spike of the sensor.
        missing_time: how long a pressure may be missing (NaN or infinite) [s].
        frozen_time: how long a pressure may keep exactly the same value [s]; None: no limit.
        period: between two samples [s].

    Attributes:
        present: problem of the last sample that has lasted long enough, in words; empty if there is none.
    """

    def __init__(
        self,
        highest: tuple[float, float],
        over_time: float,
        missing_time: float,
        frozen_time: float | None,
        period: float = 1e-3,
    ) -> None:
        for limit in highest:
            _above_0("pressure limit {} Pa", limit)
        for time in (over_time, missing_time, *(() if frozen_time is None else (frozen_time,))):
            _above_0("time {} s until a pressure stops the valves", time)
        self.present = ""
        self._highest = highest
        self._frozen_time = frozen_time
        self._over = _pair(over_time, period)
        self._missing = _pair(missing_time, period)
        self._frozen = _pair(frozen_time or 1.0, period)
        self._last = [math.nan, math.nan]

    def reset(self) -> None:
        """Forget all samples."""
        self.present = ""
        self._last = [math.nan, math.nan]
        for group in (self._over, self._missing, self._frozen):
            for item in group:
                item.gone()

    def check(self, stamp_ns: int, pressure_1: float, pressure_2: float) -> str:
        """Check one sample.

        Args:
            stamp_ns: stamp of the sample [ns].
            pressure_1: measured, absolute [Pa], NaN where missing.
            pressure_2: likewise.

        Returns:
            The problem that has lasted long enough, in words; empty if there is none.
        """
        first, second = self._one(0, stamp_ns, pressure_1), self._one(1, stamp_ns, pressure_2)
        self.present = first or second
        return self.present

    def _one(self, index: int, stamp_ns: int, pressure: float) -> str:
        last, self._last[index] = self._last[index], pressure
        if not math.isfinite(pressure):
            self._over[index].gone()
            self._frozen[index].gone()
            if self._missing[index].seen(stamp_ns):
                return f"pressure {index + 1} is missing or not finite"
            return ""
        self._missing[index].gone()
        words = ""
        if pressure <= self._highest[index]:
            self._over[index].gone()
        elif self._over[index].seen(stamp_ns):
            words = f"pressure {index + 1} is {pressure * 1e-3:.1f} kPa, above {self._highest[index] * 1e-3:.1f} kPa"
        if pressure != last:
            self._frozen[index].gone()
        elif self._frozen_time is not None and self._frozen[index].seen(stamp_ns) and not words:
            words = f"pressure {index + 1} is frozen at {pressure:.1f} Pa"
        return words


class EstimateSupervision:
    """Checks the estimates, in the node that uses them.

    A sample is out of bounds if its normalised innovation squared exceeds ``nis_limit``, or if a pressure was refused
    as an outlier: measured and expected pressures disagree. A single such sample may be chance or a spike. 15 % of the
    samples within ``nis_time`` mean a wrong sensor, or a joint that no longer fits the model. With 100 samples this is
    noticed in time: after 20 refused samples in a row the filter accepts the wrong pressures. Small innovations are no
    reason to stop, because a tuning may be cautious.

    After a gap of 20 samples or more, the next 40 samples are not counted. The filter does not know the voltages during
    the gap, and refuses pressures until it accepts the new ones. These estimates should not be used.

    Args:
        highest_angle: largest magnitude of the angle [rad].
        angle_time: how long the angle may exceed it [s].
        nis_limit: bound of the normalised innovation squared of two pressures [-].
        nis_time: time over which samples out of bounds are counted [s].
        blind_time: how long the filter may be without a pressure of either muscle [s]; None: no limit, for a joint
            whose pressures are not measured.
        period: between two samples [s].

    Attributes:
        present: problem of the last estimate that has lasted long enough, in words; empty if there is none.
        settling: whether the last estimate follows a gap, so that it should not be used.
    """

    def __init__(
        self,
        highest_angle: float,
        angle_time: float,
        nis_limit: float,
        nis_time: float,
        blind_time: float | None,
        period: float = 1e-3,
    ) -> None:
        for value in (highest_angle, angle_time, nis_limit, nis_time, 1.0 if blind_time is None else blind_time):
            _above_0("limit {} of the estimates", value)
        self.present = ""
        self.settling = False
        self._highest = highest_angle
        self._limit = nis_limit
        self._window = round(nis_time * 1e9)
        self._enough = max(_FEWEST, _SHARE * nis_time / period)
        self._angle = Persistent(angle_time, period)
        self._blind = _pair(_NEVER if blind_time is None else blind_time, period)
        self._samples: deque[tuple[int, bool]] = deque()
        self._outside = 0
        self._gap, self._settle = round(_GAP * period * 1e9), round(_SETTLING * period * 1e9)
        self._last_ns: int | None = None
        self._settled_ns = 0

    def reset(self) -> None:
        """Forget all estimates."""
        self.present = ""
        self._angle.gone()
        for item in self._blind:
            item.gone()
        self._samples.clear()
        self._outside = 0
        self.settling, self._last_ns, self._settled_ns = False, None, 0

    def check(self, stamp_ns: int, angle: float, nis: float, flags: int) -> str:
        """Check one estimate.

        Args:
            stamp_ns: stamp of the estimate [ns].
            angle: estimated [rad].
            nis: normalised innovation squared, NaN where no pressure was used.
            flags: of the estimate.

        Returns:
            The problem that has lasted long enough, in words; empty if there is none.
        """
        self.settling = self._after_a_gap(stamp_ns)
        if self.settling:
            self._samples.clear()
            self._outside = 0
            words = ""
        else:
            words = self._consistency(stamp_ns, nis > self._limit or bool(flags & OUTLIER))
        if flags & _MISSING:
            for index, bit in enumerate((MISSING_PRESSURE_1, MISSING_PRESSURE_2)):
                if not flags & bit:
                    self._blind[index].gone()
                elif self._blind[index].seen(stamp_ns):
                    words = words or f"the estimate has been without pressure {index + 1} for too long"
        else:
            self._blind[0].gone()
            self._blind[1].gone()
        if abs(angle) <= self._highest:
            self._angle.gone()
        elif math.isfinite(angle) and self._angle.seen(stamp_ns):  # an angle that is not finite is not used anyway
            degrees, limit = math.degrees(angle), math.degrees(self._highest)
            words = (
                f"the estimated angle is {angle:+.3f} rad, beyond {self._highest:g} rad "
                f"({degrees:+.1f} deg; the limit is {limit:.1f} deg)"
            )
        self.present = words
        return words

    def _after_a_gap(self, stamp_ns: int) -> bool:
        last = self._last_ns
        if last is None or not 0 <= last - stamp_ns <= RESTART_AFTER_NS:  # a late estimate is ignored
            self._last_ns = stamp_ns
        if last is not None and stamp_ns - last > self._gap:
            self._settled_ns = stamp_ns + self._settle
        # An end that is too far ahead is invalid: the clock was set back.
        return 0 < self._settled_ns - stamp_ns <= self._settle

    def _consistency(self, stamp_ns: int, outside: bool) -> str:
        samples = self._samples
        if samples and stamp_ns <= samples[-1][0]:  # the clock was set back
            samples.clear()
            self._outside = 0
        samples.append((stamp_ns, outside))
        self._outside += outside
        while stamp_ns - samples[0][0] >= self._window:
            self._outside -= samples.popleft()[1]
        if self._outside >= self._enough:
            return (
                f"measured and expected pressures disagree: {self._outside} of the last {len(samples)} estimates have "
                f"a refused pressure or a normalised innovation squared above {self._limit:g}"
            )
        return ""


_PATIENCE = 0.06  # longer than the latency of a command, and than slewing over the whole range [s]
_SAMPLES = 5  # of the rig; the longer of both times counts
_LOOK = 0.025  # longest time between two checks that count as consecutive [s]
_OLD = 0.05  # age at which the last known voltages are no longer used [s]


class Following:
    """Compares commands with the voltages on the valves.

    The node that owns the valves may have stopped them, or may obey another commander. A controller that does not
    notice would go on integrating, and would jerk the joint when it is obeyed again.

    Args:
        start: initial voltages of the valves (2,) [V]; for pressure regulators the commanded pressures [Pa].
        tolerance: largest normal difference between command and valve [V] or [Pa].
        period: between two samples [s]; the valves follow a sample or two behind.

    Attributes:
        astray_count: how often the valves did not follow.
    """

    def __init__(self, start: tuple[float, float], tolerance: float = 0.25, period: float = 1e-3) -> None:
        self.astray_count = 0
        self._tolerance = tolerance
        self._voltage = start
        self._old = 1e9 * max(_OLD, _SAMPLES * period)
        self._seen_ns: int | None = None
        self._apart = Persistent(max(_PATIENCE, _SAMPLES * period), max(_LOOK, period) / 2.0)

    def saw(self, voltage: tuple[float, float], now_ns: int) -> None:
        """Store the voltages on the valves (2,) [V] at a steady time [ns]."""
        self._voltage, self._seen_ns = voltage, now_ns

    def on_valves(self, now_ns: int) -> tuple[float, float] | None:
        """The voltages on the valves (2,) [V] now [ns]; None where not known."""
        if self._seen_ns is None or now_ns - self._seen_ns > self._old:
            return None
        return self._voltage

    def astray(self, command: tuple[float, float], now_ns: int) -> bool:
        """Whether the valves have differed from the command for too long; the time then starts anew.

        Args:
            command: the last one (2,) [V].
            now_ns: steady time [ns]; calls come often.
        """
        valves = self.on_valves(now_ns)
        if valves is None or max(abs(valves[0] - command[0]), abs(valves[1] - command[1])) <= self._tolerance:
            self._apart.gone()
            return False
        if not self._apart.seen(now_ns):
            return False
        self._apart.gone()
        self.astray_count += 1
        return True


TICK = 0.004
"""[s] Time between two checks."""
RETREAT = 1.0
"""[s] Duration of the resting voltages after a limit was exceeded."""
_TIMES = 3
"""Number of consecutive checks that must find a limit exceeded; a single one may be noise."""


class Lookout:
    """Counts consecutive checks of an experiment that found a limit exceeded."""

    def __init__(self) -> None:
        self._times = 0

    def ends(self, broken: str) -> str:
        """Reason to end the experiment, in words; empty while it goes on.

        `broken`: the limit that this check found exceeded, in words; empty for none.
        """
        self._times = self._times + 1 if broken else 0
        return broken if self._times >= _TIMES else ""
