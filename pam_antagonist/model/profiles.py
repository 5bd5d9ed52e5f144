"""Voltages that make a joint show what it can do: built-in profiles for simulated recordings, and real rigs.

A profile is written as a drive between −1 and 1 for each valve: 0 is the voltage at rest, −1 and 1 the lowest and the highest
one. With the default voltages and the valve curve of rig ``shin2022`` these are steady pressures of about 200, 450 and 700 kPa,
the range of Shin, Ibayashi and Kogiso (2022), who show their own input as a picture only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Span:
    """Voltages of drive −1, 0 and 1 [V]."""

    lowest: float = 4.2
    rest: float = 5.5
    highest: float = 7.5

    def voltage(self, drive: FloatArray) -> FloatArray:
        """Voltages [V] of a drive (N, 2), linear between the three."""
        return np.interp(drive, [-1.0, 0.0, 1.0], [self.lowest, self.rest, self.highest])


# Drives of (valve 1, valve 2), each held for 5 s: differences of both signs and growing size, then both valves together (the
# joint stiffens), then one at a time.
_PAPER_HOLD = 5.0
_PAPER_LEVELS = (
    (0.0, 0.0), (0.3, -0.3), (0.0, 0.0), (-0.3, 0.3), (0.6, -0.6), (-0.6, 0.6), (1.0, -1.0), (-1.0, 1.0), (0.0, 0.0),
    (0.8, 0.8), (1.0, 0.5), (0.5, 1.0), (-0.5, -0.5), (-0.9, -0.4), (-0.4, -0.9), (0.0, 0.0), (1.0, 0.0), (0.0, 1.0),
    (-1.0, 0.0), (0.0, -1.0), (0.7, -0.2), (-0.2, 0.7), (1.0, -0.6), (-0.6, 1.0), (0.3, -0.9), (0.0, 0.0),
)  # fmt: skip


def paper(time: FloatArray, seed: int) -> FloatArray:
    """Steps over the pressure range of the paper; 130 s long, then again from the start.

    Args:
        time: (N,) [s].
        seed: not used.

    Returns:
        Drive (N, 2).
    """
    level = (time // _PAPER_HOLD).astype(np.int64) % len(_PAPER_LEVELS)
    return np.array(_PAPER_LEVELS)[level]


def steps(time: FloatArray, seed: int) -> FloatArray:
    """Random levels, each held for a random 0.5 to 3 s, for both valves at the same times.

    Args:
        time: (N,) [s].
        seed: of the levels and the times.

    Returns:
        Drive (N, 2); it begins with 1 s at rest.
    """
    rng = np.random.default_rng(seed)
    end = float(time[-1]) if len(time) else 0.0
    edges, levels = [0.0], [(0.0, 0.0)]
    at = 1.0
    while at <= end:
        common, difference = rng.uniform(-0.4, 0.4), rng.uniform(-0.8, 0.8)
        edges.append(at)
        levels.append((common + difference, common - difference))
        at += rng.uniform(0.5, 3.0)
    held = np.searchsorted(np.array(edges), time, side="right") - 1
    return np.clip(np.array(levels)[held], -1.0, 1.0)


def multisine(time: FloatArray, seed: int) -> FloatArray:
    """Sums of sines from 0.05 to 5 Hz with random phases: the difference of the valves at some, their sum at others.

    Args:
        time: (N,) [s].
        seed: of the phases.

    Returns:
        Drive (N, 2); it fades in over the first second.
    """
    rng = np.random.default_rng(seed)
    frequency = np.geomspace(0.05, 5.0, 16)
    # Falling amplitudes keep the fast lines from being all that the valves do.
    amplitude = frequency**-0.4
    wave = amplitude[:, None] * np.sin(2.0 * np.pi * frequency[:, None] * time + rng.uniform(0.0, 2.0 * np.pi, (16, 1)))
    difference, common = wave[::2].sum(axis=0), wave[1::2].sum(axis=0)
    drive = 0.7 * np.column_stack((difference + 0.5 * common, -difference + 0.5 * common)) / amplitude[::2].sum()
    return np.clip(drive * np.minimum(time, 1.0)[:, None], -1.0, 1.0)


PROFILES: dict[str, Callable[[FloatArray, int], FloatArray]] = {"paper": paper, "steps": steps, "multisine": multisine}
"""Built-in profiles by name."""
PAPER_DURATION = _PAPER_HOLD * len(_PAPER_LEVELS)
"""Length of the profile ``paper`` [s]."""


def profile(name: str, duration: float, period: float, seed: int = 0, span: Span | None = None) -> FloatArray:
    """Voltages of a built-in profile.

    Args:
        name: one of ``PROFILES``.
        duration: [s].
        period: sample period [s].
        seed: of what is random in it.
        span: voltages; default: 4.2, 5.5, 7.5 V.

    Returns:
        (N, 2) [V], N = duration / period; row k is held over sample period k.

    Raises:
        BadInput: no such profile.
    """
    if name not in PROFILES:
        raise BadInput(f"profile {name!r}: expected one of {', '.join(PROFILES)}, or a CSV file")
    time = np.arange(round(duration / period)) * period
    return (span or Span()).voltage(PROFILES[name](time, seed))


def held(time: FloatArray, voltage: FloatArray, duration: float, period: float) -> FloatArray:
    """Voltages at a constant period from a table, each row held until the next.

    Args:
        time: of the rows, (K,) [s], increasing.
        voltage: (K, 2) [V].
        duration: [s], counted from the first row.
        period: sample period [s].

    Returns:
        (N, 2) [V].
    """
    # Half a period of grace: a row at 0.003 belongs to sample 3, whatever 3 * 0.001 is in binary.
    at = time[0] + (np.arange(round(duration / period)) + 0.5) * period
    return np.asarray(voltage[np.searchsorted(time, at, side="right") - 1])
