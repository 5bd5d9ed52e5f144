"""A pressure regulator from what it was asked for and what it held: a lag of second order behind a dead time.

```
p'' = w² (g u(t − T) + o − p) − 2 d w p'
```

u is the setpoint, p the pressure, w the natural frequency, d the damping ratio, T the dead time, g and o gain and
offset between the two scales. Each episode starts with the pressure that was measured, at rest. Rate limit, dead zone
and threshold are not part of it: what they do is in the error that is left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_START = (30.0, 0.7, 0.01)
"""[rad/s], [-], [s]"""
_LOW, _HIGH = (2.0, 0.05, 0.0), (400.0, 3.0, 0.1)


class Regulator(NamedTuple):
    """A regulator's numbers.

    Attributes:
        frequency: natural frequency [rad/s].
        damping: damping ratio [-].
        dead_time: [s].
        gain: of the pressure over the setpoint [-].
        offset: [Pa].
    """

    frequency: float
    damping: float
    dead_time: float
    gain: float
    offset: float

    @property
    def resonance(self) -> float:
        """Highest gain over the gain at rest [-]; 1 for a regulator that does not resonate."""
        d = self.damping
        return 1.0 / (2.0 * d * np.sqrt(1.0 - d * d)) if d < np.sqrt(0.5) else 1.0


def simulated(regulator: Regulator, first: Indices, time: Floats, setpoint: Floats, start: Floats) -> Floats:
    """Pressure of each row (N,) [Pa].

    Args:
        regulator: its numbers.
        first: index of the first row of each episode, and behind the last one (E + 1,).
        time: of the rows (N,) [s], even within all episodes.
        setpoint: held from a row to the next one (N,) [Pa].
        start: pressure with which each episode begins (E,) [Pa].
    """
    lengths = np.diff(first)
    period = float(np.median(np.diff(time)))
    rows = np.minimum(first[:-1, None] + np.arange(lengths.max()), first[1:, None] - 1)
    wanted = regulator.gain * setpoint[rows] + regulator.offset
    # What is held arrives later by whole rows and a part of one: the part of a row before it is the value before.
    whole, part = divmod(regulator.dead_time / period, 1.0)
    shift = int(whole)
    late = wanted[:, np.maximum(np.arange(lengths.max()) - shift, 0)]
    later = wanted[:, np.maximum(np.arange(lengths.max()) - shift - 1, 0)]
    arrived = (1.0 - part) * late + part * later
    w, d = regulator.frequency, regulator.damping
    step = expm(np.array([[0.0, 1.0], [-w * w, -2.0 * d * w]]) * period)
    state = np.stack([start, np.zeros(len(start))])
    out = np.empty(rows.shape)
    out[:, 0] = start
    for k in range(1, lengths.max()):
        goal = np.stack([arrived[:, k - 1], np.zeros(len(start))])
        state = goal + step @ (state - goal)
        out[:, k] = state[0]
    return np.concatenate([row[:length] for row, length in zip(out, lengths, strict=True)])


def fit(first: Indices, time: Floats, setpoint: Floats, pressure: Floats) -> Regulator:
    """The regulator with the least squared error of free runs of whole episodes.

    Args:
        first: index of the first row of each episode, and behind the last one (E + 1,).
        time: of the rows (N,) [s].
        setpoint: (N,) [Pa].
        pressure: measured (N,) [Pa].
    """
    span = max(float(np.ptp(setpoint)), 1.0)

    def of(values: Floats) -> Regulator:
        frequency, damping, dead_time, gain, offset = (float(value) for value in values)
        return Regulator(frequency, damping, dead_time, gain, offset * span)

    def left(values: Floats) -> Floats:
        return np.asarray((simulated(of(values), first, time, setpoint, pressure[first[:-1]]) - pressure) / span)

    low, high = (np.array([*_LOW, 0.1, -5.0]), np.array([*_HIGH, 10.0, 5.0]))
    found = least_squares(left, np.array([*_START, 1.0, 0.0]), bounds=(low, high), x_scale=[10.0, 0.3, 5e-3, 0.1, 0.1])
    return of(found.x)
