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


def named(name: str, value: float, muscle: int | None) -> dict[str, float]:
    """A number of the physics, by its name without the muscle's, for each muscle that is meant."""
    return {f"{name}_{i}": value for i in sides(muscle)}


def sign(rng: Random) -> float:
    """1 or −1."""
    return float(rng.choice([-1.0, 1.0]))


def plain(name: str, unit: float, **others: tuple[float, float]) -> Make:
    """A number of the physics: a unit times the amount; other numbers drawn between two bounds."""

    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        drawn = {key: float(rng.uniform(*bounds)) for key, bounds in others.items()}
        own = {name: amount * unit} if muscle is None else {f"{name}_{muscle}": amount * unit}
        return Deviation({**own, **drawn})

    return make


def signed(name: str, unit: float) -> Make:
    """A number of the physics in proportion to the amount, of either sign."""

    def make(amount: float, muscle: int | None, rng: Random) -> Deviation:
        key = name if muscle is None else f"{name}_{muscle}"
        return Deviation({key: sign(rng) * amount * unit})

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
