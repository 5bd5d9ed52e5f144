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
from collections.abc import Callable
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
    def command(self, time: float, pressure: Floats, angle: float) -> tuple[float, float] | None:
        """Commands for the next sample, from the time [s] and what is measured [Pa], [rad]; None at the end."""


class Planned(Program):
    """The voltages of a plan (N, 2) [V], one row for each `period` [s]."""

    confined = True

    def __init__(self, voltage: Floats, period: float) -> None:
        self._voltage, self._period, self.seconds = voltage, period, len(voltage) * period

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> tuple[float, float] | None:
        # A little later, so that rounding takes no sample for the one before it.
        first, second = self._voltage[min(int(time / self._period + 1e-6), len(self._voltage) - 1)]
        return first, second


@dataclass
class Pulse:
    """What :class:`FirstAir` saw of one valve."""

    rise: Floats  # of both sensors (2,) [Pa]
    turned: float  # by how much the joint turned [rad]
    lost: float  # part of the rise that was gone after the hold [-]; NaN where the valve's own pressure did not rise
    level: Floats  # both pressures before (2,) [Pa]


class FirstAir(Program):
    """Open one valve after the other, slowly, until a pressure rises."""

    def __init__(self, rig: Rig) -> None:
        self._low, self._high = rig.command_limits
        # A valve that is closed in the middle is shut there; another one is held where the pressure rose.
        shut = steady_voltage(rig, rig.supply.pressure) if rig.drive == "valve" else None
        closed = rig.drive == "valve" and min(rig.valve_1.overlap, rig.valve_2.overlap) >= 0.5
        self._shut = shut if closed else None
        self._phase, self._since, self._valve, self._held = "settle", 0.0, 0, 0.0
        self._before, self._angle = np.zeros(2), 0.0
        self._peak = np.zeros(2)
        self.pulses: list[Pulse] = []
        self.seconds = _SETTLE_S + 2.0 * (_RAMP_S + _HOLD_S + _VENT_S)

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> tuple[float, float] | None:
        out, elapsed, own = [self._low, self._low], time - self._since, self._valve
        if self._phase == "settle":
            if elapsed < _SETTLE_S:
                return self._low, self._low
            self._begin("ramp", time)
            self._before, self._angle, elapsed = pressure.copy(), angle, 0.0
        if self._phase == "ramp":
            out[own] = self._low + min(elapsed / _RAMP_S, 1.0) * (self._high - self._low)
            if np.max(pressure - self._before) > RISE or elapsed > _RAMP_S:
                self._held = out[own] if self._shut is None else self._shut[own]
                self._peak = pressure.copy()
                self._begin("hold", time)
        elif self._phase == "hold":
            out[own] = self._held
            self._peak = np.maximum(self._peak, pressure)
            # A curve that is shifted may let air in where the valve should be shut.
            if elapsed > _HOLD_S or self._peak[own] - self._before[own] > _MOST_RISES * RISE:
                rise = self._peak - self._before
                lost = (self._peak[own] - pressure[own]) / rise[own] if rise[own] > 0.5 * RISE else math.nan
                self.pulses.append(Pulse(rise, angle - self._angle, float(lost), self._before))
                self._begin("vent", time)
        elif self._phase == "vent" and elapsed > _VENT_S:
            if self._valve == 1:
                return None
            self._valve = 1
            self._begin("ramp", time)
            self._before, self._angle = pressure.copy(), angle
        return out[0], out[1]

    def _begin(self, phase: str, time: float) -> None:
        self._phase, self._since = phase, time


class _Confined(Program):
    """What slow and quick turns share: mean and half difference of the wanted pressures, and the encoder's rate."""

    def __init__(self, rig: Rig, limits: Limits, towards: Towards) -> None:
        self._towards, self._angle_limit, self._before = towards, limits.angle, 0.0
        self._period = rig.sample_period  # since the last look
        self._lowest, self._highest = pressure_range(rig, limits)
        self._range = self._highest - self._lowest
        self._mean, self._half = self._lowest, 0.0
        self._velocity, self._last, self.confined = 0.0, math.nan, False

    def _see(self, time: float, angle: float) -> None:
        self._period, self._before = max(time - self._before, 1e-6), time
        if math.isfinite(angle):
            if math.isfinite(self._last):
                share = min(self._period / _VELOCITY_S, 1.0)
                self._velocity += share * ((angle - self._last) / self._period - self._velocity)
            self._last = angle
        if not math.isfinite(self._last):
            raise BadInput("the encoder shows no angle; expected one, which a rig that was never identified needs")

    def _turn(self, angle: float, wanted: float) -> bool:
        """Move the difference towards an angle, slowly; whether it has arrived."""
        error = (wanted - angle) / self._angle_limit
        self._half += _TURN_RATE * self._range * self._period * min(max(error / 0.15, -1.0), 1.0)
        self._bound()
        return abs(error) < _NEAR

    def _bound(self) -> None:
        most = max(min(self._mean - self._lowest, self._highest - self._mean), 0.0)
        self._half = min(max(self._half, -most), most)

    def _commands(self, pressure: Floats) -> tuple[float, float]:
        first, second = self._mean + self._half, self._mean - self._half
        return self._towards(0, float(pressure[0]), first), self._towards(1, float(pressure[1]), second)


def pressure_range(rig: Rig, limits: Limits) -> tuple[float, float]:
    """Least and largest pressure that is asked for [Pa]: within the limits, and a little below the highest."""
    low, high = limits.pressure
    if rig.drive == "regulator":
        low, high = max(low, rig.command_limits[0]), min(high, rig.command_limits[1])
    return low, high - 0.08 * (high - low)


class Slow(_Confined):
    """Fill the muscles, and turn the joint slowly: small angles first, low pressures first."""

    def __init__(self, rig: Rig, limits: Limits, towards: Towards) -> None:
        super().__init__(rig, limits, towards)
        self._turns = [(share, turn) for share, turns in zip(_COMMON, _TURNS, strict=True) for turn in (0.0, *turns)]
        self._k, self._since, self._arrived = 0, 0.0, -1.0
        self.seconds = _CENTRE_S + (_LONGEST_TURN_S + _DWELL_S) * len(self._turns)

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> tuple[float, float] | None:
        self._see(time, angle)
        if self._k == len(self._turns):
            return None
        share, turn = self._turns[self._k]
        wanted_mean = self._lowest + share * self._range
        step = _FILL_RATE * self._range * self._period
        self._mean += min(max(wanted_mean - self._mean, -step), step)
        near = self._turn(self._last, turn * self._angle_limit) and abs(wanted_mean - self._mean) < step
        if near and abs(self._last) < _REACH * self._angle_limit:
            self.confined = True
        if near and self._arrived < 0.0:
            self._arrived = time
        longest = _LONGEST_TURN_S if self._k else _CENTRE_S
        if (self._arrived >= 0.0 and time - self._arrived > _DWELL_S) or time - self._since > longest:
            self._k, self._since, self._arrived = self._k + 1, time, -1.0
        return self._commands(pressure)


class Quick(_Confined):
    """Move the joint to random angles under random mean pressures, from move to move a little faster.

    `slow`: recording of :class:`Slow`, which says which difference holds which angle. `seconds`: length [s].
    """

    def __init__(
        self, rig: Rig, limits: Limits, towards: Towards, slow: Recording, seconds: float, seed: int = 0
    ) -> None:
        super().__init__(rig, limits, towards)
        self._length, self._rng = seconds, np.random.default_rng(seed)
        self.seconds = seconds + _CENTRE_S
        self._map, self._reach = _held_by(slow, self._angle_limit)
        self._move_s, self._size, self._turned_back = _MOVES_S[0], 0.5, False
        self._from = self._to = (self._mean, 0.0)
        self._start = self._least = self._most = 0.0
        self._begun, self._next, self._end, self._ready = 0.0, math.inf, math.inf, False

    @property
    def fastest(self) -> float:
        """Duration of the last moves [s]."""
        return self._move_s

    @override
    def command(self, time: float, pressure: Floats, angle: float) -> tuple[float, float] | None:
        self._see(time, angle)
        if not self._ready:
            # Fill the muscles, with the joint in the middle, as in the beginning.
            middle, step = self._lowest + _COMMON[1] * self._range, _FILL_RATE * self._range * self._period
            self._mean += min(max(middle - self._mean, -step), step)
            near = self._turn(self._last, 0.0)
            self.confined = self.confined or (near and self._mean == middle)
            if self.confined or time > _CENTRE_S:
                self.confined = self._ready = True
                self._begun = self._next = time
                self._start = self._least = self._most = self._last
                self._end = time + self._length
                self._to = self._mean, self._half
            return self._commands(pressure)
        if time >= self._end:
            return None
        if time >= self._next:
            self._choose(time)
        share = min((time - self._begun) / self._move_s, 1.0)
        self._mean = self._from[0] + share * (self._to[0] - self._from[0])
        self._half = self._from[1] + share * (self._to[1] - self._from[1])
        ahead = self._last + _AHEAD_S * self._velocity
        side = math.copysign(1.0, ahead)
        self._least, self._most = min(self._least, self._last), max(self._most, self._last)
        if abs(ahead) > _GUARD * self._angle_limit:
            # Turned back from here: the move is given up.
            self._half -= side * _GUARD_RATE * self._range * self._period
            self._from = self._to = self._mean, self._half
            self._turned_back = True
        self._bound()
        return self._commands(pressure)

    def _choose(self, time: float) -> None:
        """The next move: faster where the last one kept to its angle, slower and smaller where it did not."""
        # How far the joint swung beyond where it came from and where it came to rest.
        low, high = sorted((self._start, self._last))
        swing = max(self._most - high, low - self._least)
        if self._turned_back:
            self._move_s, self._size = min(self._move_s * _FASTER**-2, _MOVES_S[0]), max(self._size * _SMALLER, _LEAST)
        elif swing < _SWING * self._angle_limit:
            self._move_s = max(self._move_s * _FASTER, _MOVES_S[1])
            self._size = min(self._size + 0.1, 1.0)
        else:
            self._move_s = min(self._move_s * _SLOWER, _MOVES_S[0])
        low, high = self._reach
        middle, width = 0.5 * (low + high), 0.5 * (high - low)
        at = middle + self._size * width * float(self._rng.uniform(-1.0, 1.0))
        mean = self._lowest + self._range * float(self._rng.uniform(_COMMON[0], _COMMON[-1]))
        half = float(self._map @ [1.0, at, mean, at * mean, at * at])
        self._from = self._mean, self._half
        self._mean, self._half = mean, half
        self._bound()
        self._to = self._mean, self._half
        self._mean, self._half = self._from
        self._begun, self._turned_back = time, False
        self._start = self._least = self._most = self._last
        self._next = time + self._move_s + float(self._rng.uniform(0.3, 1.2))


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
