"""What a form is: one way to write an effect, and what it changes on a joint and around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Random = np.random.Generator
Change = Callable[[Floats, Floats], Floats]
"""Of times, and of what goes on at them."""


@dataclass(frozen=True)
class Deviation:
    """What a form changes on the joint and around it.

    Attributes:
        numbers: of ``physics.Q``.
        parameters: factors on parameters of the model, by dotted path.
        voltage: from times (K,) [s] and voltages (K, 2) [V] to those that the valves act on.
        pressure: from times (N,) [s] and pressures (N, 2) [Pa] to those that the sensors are given.
        angle: from angles (N,) [rad] to those that the encoder is given.
        push: from times (N,) [s] to a torque from outside (N,) [N m].
        supply: from times (N,) [s] to a deviation of the supply (N,) [Pa].
        substeps: of the simulation in a sample, at least.
    """

    numbers: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)
    voltage: Change | None = None
    pressure: Change | None = None
    angle: Callable[[Floats], Floats] | None = None
    push: Callable[[Floats], Floats] | None = None
    supply: Callable[[Floats], Floats] | None = None
    substeps: int = 4


Make = Callable[[float, "int | None", Random], Deviation]


@dataclass(frozen=True)
class Form:
    """One way to write an effect, or something that is in no catalogue.

    Attributes:
        name: of the form.
        effect: name in the catalogue; for what is in none, a name of its own.
        by_muscle: whether it belongs to one muscle.
        make: from amount (about the size in noises), muscle (1, 2 or None) and a source of randomness.
        source: where the mechanism is described.
        largest: amount up to which it makes sense.
        smallest: amount from which on it can be simulated.
    """

    name: str
    effect: str
    by_muscle: bool
    make: Make
    source: str
    largest: float = 30.0
    smallest: float = 1e-3


def sides(muscle: int | None) -> tuple[int, ...]:
    """The muscles that are meant."""
    return (1, 2) if muscle is None else (muscle,)


def named(name: str, value: float, muscle: int | None) -> dict[str, float]:
    """A number of the physics for each muscle that is meant.

    Args:
        name: of the number, without the muscle's.
        value: of it.
        muscle: 1, 2 or None for both.
    """
    return {f"{name}_{i}": value for i in sides(muscle)}


def sign(rng: Random) -> float:
    """1 or −1."""
    return float(rng.choice([-1.0, 1.0]))


def plain(name: str, unit: float, **others: tuple[float, float]) -> Make:
    """A number of the physics in proportion to the amount; other numbers drawn between two bounds.

    Args:
        name: of the number.
        unit: its value for an amount of 1.
        others: bounds of the others, by name.
    """

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


def played(values: Floats, half: float) -> Floats:
    """Play: the output stands until the input has moved by `half` either way."""
    out, held = np.empty(len(values)), float(values[0])
    for k, value in enumerate(values.tolist()):
        held = min(max(held, value - half), value + half)
        out[k] = held
    return out
