"""What a form is: one way to write an effect, and what it changes on a joint and around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Random = np.random.Generator
Change = Callable[[Floats, Floats], Floats]
"""Of times, and of what goes on at them."""


@dataclass(frozen=True)
class Deviation:
    """What a form changes on the joint and around it."""

    numbers: Mapping[str, float] = field(default_factory=dict)  # of ``physics.NUMBERS``
    parameters: Mapping[str, float] = field(default_factory=dict)  # factors on the model's, by dotted path
    voltage: Change | None = None  # from times (K,) [s] and voltages (K, 2) [V] to those that the valves act on
    pressure: Change | None = None  # from times (N,) [s] and pressures (N, 2) [Pa] to those that the sensors are given
    angle: Callable[[Floats], Floats] | None = None  # from angles (N,) [rad] to those that the encoder is given
    push: Callable[[Floats], Floats] | None = None  # from times (N,) [s] to a torque from outside (N,) [N m]
    supply: Callable[[Floats], Floats] | None = None  # from times (N,) [s] to a deviation of the supply (N,) [Pa]
    substeps: int = 4  # of the simulation in a sample, at least
    torque: Callable[[Floats], Floats] | None = None  # from torques (N,) [N m] to those that the meter is given


EITHER_WAY = [-1.0, 1.0]
Make = Callable[[float, "int | None", Random], Deviation]


@dataclass(frozen=True)
class Form:
    """One way to write an effect, or something that is in no catalogue."""

    name: str
    effect: str  # name in the catalogue; for what is in none, a name of its own
    by_muscle: bool  # whether it belongs to one muscle
    make: Make  # from amount (about the size in noises), muscle (1, 2 or None) and a source of randomness
    source: str  # where the mechanism is described
    largest: float = 30.0  # amount up to which it makes sense
    smallest: float = 1e-3  # amount from which on it can be simulated


def sides(muscle: int | None) -> tuple[int, ...]:
    """The muscles that are meant."""
    return (1, 2) if muscle is None else (muscle,)


def named(name: str, muscle: int | None) -> str:
    """A number of the physics by its name without the muscle's: of the muscle that is meant, or of both."""
    return name if muscle is None else f"{name}_{muscle}"


def sign(rng: Random) -> float:
    """1 or −1."""
    return float(rng.choice(EITHER_WAY))


def plain(name: str, unit: float, both_ways: bool = False, **others: float | list[float] | tuple[float, float]) -> Make:
    """A number of the physics: a unit times the amount, of either sign if it goes both ways.

    `others`: numbers beside it, drawn between two bounds (a tuple), one of several (a list), or as they are.
    """

    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        numbers = {named(name, muscle): (sign(rng) if both_ways else 1.0) * amount * unit}
        for key, value in others.items():
            if isinstance(value, tuple):
                numbers[key] = float(rng.uniform(*value))
            else:
                numbers[key] = float(rng.choice(value)) if isinstance(value, list) else value
        return Deviation(numbers)

    return make


def each(muscle: int | None, change: Change) -> Change:
    """What replaces the columns of a muscle, or of both, by a function of the time and of one column."""

    def changed(time: Floats, columns: Floats) -> Floats:
        out = columns.copy()
        for i in sides(muscle):
            out[:, i - 1] = change(time, columns[:, i - 1])
        return out

    return changed


def remembered(values: Floats, rule: Callable[[float, float], float]) -> Floats:
    """A signal with a memory: what it held and each value in turn give what it holds then."""
    return np.array(list(accumulate(values.tolist(), rule)))


def played(values: Floats, half: float) -> Floats:
    """Play: the output stands until the input has moved by `half` either way."""
    return remembered(values, lambda held, value: min(max(held, value - half), value + half))
