"""Drive a joint whose rig file is a guess: by its measured pressures and its encoder, cautiously.

Voltages of a plan say little about a joint that was never identified: its muscles' forces are known to 15 %, and a
valve that is closed in the middle sums up the errors of its curve. So nothing is predicted here. Each sample the wanted
pressures follow from what was measured, and a loop of pressures brings them about, whatever drives the joint:

1. :class:`FirstAir`: one valve after the other opens slowly until a pressure rises, then it is shut.
2. :class:`Slow`: the pressures rise together while their difference holds the joint in the middle. Then the difference
   turns the joint, slowly, to small angles first, at low pressures first. A turn ends at its angle, which the encoder
   shows, so that no limit is met.
3. :class:`Quick`: the slow recording says which difference holds which angle. So the joint can be moved quickly, from
   move to move a little faster. A move that swings too far is slowed down, and so are those that follow.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.design.optimal import Limits
from pam_antagonist.errors import BadInput
from pam_antagonist.recording import Recording
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import steady_voltage

Floats = NDArray[np.float64]
Commands = tuple[float, float]
"""Of both valves [V], or of both regulators [Pa]."""
Towards = Callable[[int, float, float], float]
"""Muscle (0 or 1), its pressure and the wanted one [Pa] -> command: voltage [V], or pressure of a regulator [Pa]."""

RISE = 40e3
"""[Pa] By so much a pressure rises in :class:`FirstAir`, until its valve is shut."""
_MOST_RISES = 2.5
"""After so many of these, the valve is opened to the air at once."""
_RAMP_S, _SETTLE_S, _HOLD_S, _VENT_S = 6.0, 2.0, 1.5, 3.0
_COMMON = (0.3, 0.45, 0.6)
"""Mean pressures, as shares of the range."""
_TURNS = ((0.3, -0.3, 0.0), (0.6, -0.6, 0.0), (0.8, -0.8, 0.0))
"""Angles, as shares of the limit, of each mean pressure."""
_FILL_RATE, _TURN_RATE = 0.06, 0.05
"""Rates of the mean pressure and of the difference, as shares of the pressures' range [1/s]."""
_NEAR = 0.05
"""A turn has arrived so near its angle, as a share of the limit."""
_LONGEST_TURN_S, _DWELL_S, _CENTRE_S = 15.0, 0.4, 40.0
_VELOCITY_S = 0.03
"""[s] Time constant that smooths the encoder's rate."""
_AHEAD_S = 0.12
"""[s] A joint that would be too far after this time is turned back."""
_REACH = 0.75
"""Largest angle of a quick move, as a share of the limit."""
_GUARD = 0.9
"""Share of the limit at which the difference is turned back."""
_GUARD_RATE = 1.0
"""Rate at which it is, as a share of the pressures' range [1/s]."""
_MOVES_S = (1.5, 0.1)
"""[s] Duration of the first moves, and the shortest."""
_FASTER, _SLOWER, _SMALLER, _LEAST = 0.85, 1.6, 0.9, 0.3
_SWING = 0.12
"""Largest swing beyond the angle at rest, as a share of the limit, for the next move to be faster."""


class Program(ABC):
    """What drives a joint, sample by sample, by what was measured.

    `confined`: whether the angle has to be within its limit by now; a joint without air hangs as it likes. `seconds`:
    length at most [s].
    """

    confined = False
    seconds = math.inf

    @abstractmethod
    def command(self, time: float, pressure: Floats, angle: float) -> Commands | None:
        """Commands for the next sample, from the time [s] and what is measured [Pa], [rad]; None at the end."""


class Planned(Program):
    """The voltages of a plan (N, 2) [V], one row for each `period` [s]."""

    confined = True

    def __init__(self, voltage: Floats, period: float) -> None:
        self._voltage, self._period, self.seconds = voltage, period, len(voltage) * period

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> Commands | None:
        # A little later, so that rounding takes no sample for the one before it.
        first, second = self._voltage[min(int(time / self._period + 1e-6), len(self._voltage) - 1)]
        return first, second


class _Motion(Program):
    """A program that reads like its course: a generator of commands, which finds what is measured in ``self``."""

    def __init__(self) -> None:
        self._time, self._pressure, self._angle = 0.0, np.full(2, math.nan), math.nan
        self._commands = self._course()

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> Commands | None:
        self._time, self._pressure, self._angle = time, pressure, angle
        return next(self._commands, None)

    @abstractmethod
    def _course(self) -> Iterator[Commands]:
        """The commands, one a sample."""


@dataclass
class Pulse:
    """What was seen of one valve that let a little air in."""

    rise: Floats  # of both sensors (2,) [Pa]
    turned: float  # by how much the joint turned [rad]
    level: Floats  # both pressures before (2,) [Pa]


class FirstAir(_Motion):
    """Open one valve after the other, slowly, until a pressure rises."""

    def __init__(self, rig: Rig) -> None:
        super().__init__()
        self._low, self._high = rig.command_limits
        # A valve that is closed in the middle is shut there; another one is held where the pressure rose.
        closed = rig.drive == "valve" and min(rig.valve_1.overlap, rig.valve_2.overlap) >= 0.5
        self._shut = steady_voltage(rig, rig.supply.pressure) if closed else None
        self.pulses: list[Pulse] = []
        self.seconds = _SETTLE_S + 2.0 * (_RAMP_S + _HOLD_S + _VENT_S)

    @override
    def _course(self) -> Iterator[Commands]:
        yield from self._vented(_SETTLE_S)
        for valve in (0, 1):
            level, angle, begun, opened = self._pressure.copy(), self._angle, self._time, self._low
            while not np.max(self._pressure - level) > RISE and self._time - begun <= _RAMP_S:
                opened = self._low + (self._time - begun) / _RAMP_S * (self._high - self._low)
                yield self._with(valve, opened)
            rise, begun = self._pressure - level, self._time
            # A curve that is shifted may let air in where the valve should be shut.
            while self._time - begun <= _HOLD_S and not rise[valve] > _MOST_RISES * RISE:
                yield self._with(valve, opened if self._shut is None else self._shut[valve])
                rise = np.maximum(rise, self._pressure - level)
            self.pulses.append(Pulse(rise, self._angle - angle, level))
            yield from self._vented(_VENT_S)

    def _vented(self, seconds: float) -> Iterator[Commands]:
        begun = self._time
        while self._time - begun < seconds:
            yield self._low, self._low

    def _with(self, valve: int, command: float) -> Commands:
        """A command of one valve, while the other one lets the air out."""
        return (self._low, command) if valve else (command, self._low)


class _Confined(_Motion):
    """What slow and quick turns share: mean and half difference of the wanted pressures, and the encoder's rate."""

    def __init__(self, rig: Rig, limits: Limits, towards: Towards) -> None:
        super().__init__()
        self._towards, self._limit = towards, limits.angle
        self._period = rig.sample_period  # since the last sample
        self._lowest, self._highest = pressure_range(rig, limits)
        self._range = self._highest - self._lowest
        self._mean, self._half = self._lowest, 0.0
        self._velocity, self.confined = 0.0, False

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> Commands | None:
        self._period, before = max(time - self._time, 1e-6), self._angle
        if math.isfinite(angle) and math.isfinite(before):
            share = min(self._period / _VELOCITY_S, 1.0)
            self._velocity += share * ((angle - before) / self._period - self._velocity)
        seen = angle if math.isfinite(angle) else before
        if not math.isfinite(seen):
            raise BadInput("the encoder shows no angle; expected one, which a rig that was never identified needs")
        return super().command(time, pressure, seen)

    def _fill(self, share: float) -> float:
        """Move the mean pressure towards a share of the range, slowly; what is left, in steps of a sample."""
        wanted, step = self._lowest + share * self._range, _FILL_RATE * self._range * self._period
        self._mean += min(max(wanted - self._mean, -step), step)
        return abs(wanted - self._mean) / step

    def _turn(self, wanted: float) -> bool:
        """Move the difference towards an angle [rad], slowly; whether it has arrived."""
        error = (wanted - self._angle) / self._limit
        self._half += _TURN_RATE * self._range * self._period * min(max(error / 0.15, -1.0), 1.0)
        self._half = self._possible(self._mean, self._half)
        return abs(error) < _NEAR

    def _possible(self, mean: float, half: float) -> float:
        """The half difference of the pressures that is possible with a mean [Pa]."""
        most = max(min(mean - self._lowest, self._highest - mean), 0.0)
        return min(max(half, -most), most)

    def _now(self) -> Commands:
        first, second = self._mean + self._half, self._mean - self._half
        return self._towards(0, float(self._pressure[0]), first), self._towards(1, float(self._pressure[1]), second)


def pressure_range(rig: Rig, limits: Limits) -> tuple[float, float]:
    """Least and largest pressure that is asked for [Pa]: within the limits, and a little below the highest."""
    low, high = limits.pressure
    if rig.drive == "regulator":
        low, high = max(low, rig.command_limits[0]), min(high, rig.command_limits[1])
    return low, high - 0.08 * (high - low)


class Slow(_Confined):
    """Fill the muscles, and turn the joint slowly: small angles first, low pressures first."""

    seconds = _CENTRE_S + (_LONGEST_TURN_S + _DWELL_S) * sum(1 + len(turns) for turns in _TURNS)

    @override
    def _course(self) -> Iterator[Commands]:
        begun, longest = 0.0, _CENTRE_S
        for share, turns in zip(_COMMON, _TURNS, strict=True):
            for turn in (0.0, *turns):
                arrived, over = math.inf, False
                while not over:
                    left = self._fill(share)
                    if self._turn(turn * self._limit) and left < 1.0:
                        arrived = min(arrived, self._time)
                        self.confined = self.confined or abs(self._angle) < _REACH * self._limit
                    now = self._time
                    over = now - arrived > _DWELL_S or now - begun > longest
                    yield self._now()
                begun, longest = now, _LONGEST_TURN_S


class Quick(_Confined):
    """Move the joint to random angles under random mean pressures, from move to move a little faster.

    `slow`: recording of :class:`Slow`, which says which difference holds which angle. `seconds`: length [s]. `fastest`:
    duration of the last moves [s].
    """

    def __init__(
        self, rig: Rig, limits: Limits, towards: Towards, slow: Recording, seconds: float, seed: int = 0
    ) -> None:
        super().__init__(rig, limits, towards)
        self._length, self._rng = seconds, np.random.default_rng(seed)
        self.seconds = seconds + _CENTRE_S
        self._map, self._reach = _held_by(slow, self._limit)
        self.fastest, self._size = _MOVES_S[0], 0.5

    @override
    def _course(self) -> Iterator[Commands]:
        # Fill the muscles, with the joint in the middle, as in the beginning.
        while not self.confined:
            left, near, begun = self._fill(_COMMON[1]), self._turn(0.0), self._time
            self.confined = (near and left == 0.0) or begun > _CENTRE_S
            yield self._now()
        end, swing, turned_back = begun + self._length, 0.0, False
        while self._time < end:
            self._pace(swing, turned_back)
            begun, start = self._time, self._angle
            (mean, half), (to_mean, to_half) = (self._mean, self._half), self._chosen()
            pause = float(self._rng.uniform(0.3, 1.2))
            least, most, turned_back = start, start, False
            while self._time < min(begun + self.fastest + pause, end):
                share = min((self._time - begun) / self.fastest, 1.0)
                self._mean, self._half = mean + share * (to_mean - mean), half + share * (to_half - half)
                least, most = min(least, self._angle), max(most, self._angle)
                ahead = self._angle + _AHEAD_S * self._velocity
                if abs(ahead) > _GUARD * self._limit:
                    # Turned back from here: the move is given up.
                    self._half -= math.copysign(_GUARD_RATE * self._range * self._period, ahead)
                    mean, half = to_mean, to_half = self._mean, self._half
                    turned_back = True
                self._half = self._possible(self._mean, self._half)
                yield self._now()
            # How far the joint swung beyond where it came from and where it came to rest.
            low, high = sorted((start, self._angle))
            swing = max(most - high, low - least)

    def _pace(self, swing: float, turned_back: bool) -> None:
        """Faster where the last move kept to its angle, slower and smaller where it did not. `swing` [rad]."""
        longest, shortest = _MOVES_S
        if turned_back:
            self.fastest, self._size = min(self.fastest * _FASTER**-2, longest), max(self._size * _SMALLER, _LEAST)
        elif swing < _SWING * self._limit:
            self.fastest, self._size = max(self.fastest * _FASTER, shortest), min(self._size + 0.1, 1.0)
        else:
            self.fastest = min(self.fastest * _SLOWER, longest)

    def _chosen(self) -> tuple[float, float]:
        """Mean and half difference of the pressures [Pa] that hold a random angle."""
        low, high = self._reach
        at = 0.5 * (low + high) + self._size * 0.5 * (high - low) * float(self._rng.uniform(-1.0, 1.0))
        mean = self._lowest + self._range * float(self._rng.uniform(_COMMON[0], _COMMON[-1]))
        return mean, self._possible(mean, float(self._map @ [1.0, at, mean, at * mean, at * at]))


def _held_by(slow: Recording, limit: float) -> tuple[Floats, tuple[float, float]]:
    """What a slow recording says of the joint.

    Returns half the difference of the pressures that holds an angle [Pa], as coefficients of 1, ψ, mean, ψ mean and ψ²,
    and the range of angles that was reached [rad].
    """
    assert slow.angle is not None
    known = np.isfinite(slow.angle) & (np.abs(slow.angle) < limit)
    angle, pressure = slow.angle[known], slow.pressure[known]
    mean, half = pressure.mean(axis=1), 0.5 * (pressure[:, 0] - pressure[:, 1])
    columns = np.column_stack([np.ones(len(angle)), angle, mean, angle * mean, angle * angle])
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-12)
    # A little ridge: where the joint hardly moved, the columns are alike.
    found = np.linalg.lstsq(
        np.vstack([columns / scale, 1e-3 * math.sqrt(len(angle)) * np.eye(5)]), np.append(half, np.zeros(5)), rcond=None
    )[0]
    low, high = (float(value) for value in np.quantile(angle, [0.02, 0.98]))
    return found / scale, (max(low, -_REACH * limit), min(high, _REACH * limit))
