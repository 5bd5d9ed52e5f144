"""The parts of an effect.

An effect is a property that a real rig may have beside equations (1) to (11). One file holds all that the package knows
of it: its parameters, states and law, and what a report says of it. ``docs/effects.md`` shows a complete file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pam_antagonist._jit import inlined, kernel

__all__ = [
    "AddedState",
    "Effect",
    "EffectParameter",
    "Form",
    "Kernel",
    "Loop",
    "SealedJoint",
    "along_signals",
    "inlined",
    "kernel",
    "per_muscle",
    "per_signal",
    "state_per_muscle",
]

SIGNALS = 4
"""The most further signals that a model may depend on."""
COEFFICIENTS = 15
"""Coefficients of the weak laws, which go with everything that was measured (:mod:`weak_laws`)."""

Kernel = Any
"""A function that :func:`~pam_antagonist._jit.inlined` or :func:`~pam_antagonist._jit.kernel` compiles."""


class _Named:
    """What a muscle may have one of: its name then ends in ``_1`` or ``_2``."""

    name: str

    @property
    def muscle(self) -> int | None:
        """1 or 2 where it belongs to one muscle."""
        return int(self.name[-1]) if self.name.endswith(("_1", "_2")) else None

    @property
    def family(self) -> str:
        """Name without the muscle's number."""
        return self.name[:-2] if self.muscle else self.name


@dataclass(frozen=True)
class EffectParameter(_Named):
    """A parameter of an effect.

    Attributes:
        name: as in a rig file; ends in ``_1`` or ``_2`` where each muscle has its own.
        unit: of the value.
        neutral: value in a rig that does not mention it: 0 for a *size*, a start value for a *shape* (a time, a width).
        low: least value that makes sense.
        high: largest value that makes sense.
        scale: a typical value, for searches.
        meaning: in words.
        symbol: as in the documentation's equation, in LaTeX.
        fixed: whether no fit moves it unless it is asked to.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    scale: float
    meaning: str
    symbol: str = ""
    fixed: bool = False

    @property
    def signal(self) -> int | None:
        """Number of the further signal that it goes with, from 1; None where it goes with none."""
        return int(self.name[-1]) if self.unit.endswith("/SI") else None

    @property
    def is_size(self) -> bool:
        """Whether the effect vanishes where this parameter is 0: sizes are neutral at 0, shapes are not."""
        return self.neutral == 0.0


@dataclass(frozen=True)
class AddedState(_Named):
    """A state that an effect adds to [ψ, ψ̇, P_1, P_2].

    Attributes:
        name: of the state.
        unit: of the state.
        switch: the parameter (of this effect) that adds the state when it is not 0.
        initial_std: standard deviation when a filter starts.
        noise: process noise of a filter, standard deviation a square root of a second; or the name of the parameter
            (of this effect) that holds it.
        further: other parameters (of this effect) that add the state when they are not 0.
        symbol: as in the documentation's equation, in LaTeX.
        rate: derivative by time; None for 0 (a random walk).
        steady_value: value after a long rest; None for 0.
        prior: the parameter (of this effect) that holds the standard deviation without observations, and at the start
            of a filter. At its neutral value there is no bound, and a filter starts with ``initial_std``.
        lag: time constant [s] for small changes, where it may be a few milliseconds. Its arguments are parameters
            only.
    """

    name: str
    unit: str
    switch: str
    initial_std: float
    noise: float | str
    further: tuple[str, ...] = ()
    symbol: str = ""
    rate: Kernel | None = None
    steady_value: Kernel | None = None
    lag: Kernel | None = None
    prior: str = ""


@dataclass(frozen=True)
class Form:
    """The parameters of an effect that a fit frees.

    Attributes:
        tied: whether both muscles have the same sizes.
        without: names of the parameters that stay at their neutral values.
        scale: scales that replace the parameters' own, by name without the muscle's number.
        low: least values that replace the parameters' own, likewise.
        shapes: values of the shapes with which a search starts; empty for the usual grid around their scales.
    """

    tied: bool = False
    without: tuple[str, ...] = ()
    scale: Mapping[str, float] = field(default_factory=dict)
    low: Mapping[str, float] = field(default_factory=dict)
    shapes: tuple[Mapping[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Loop:
    """How an effect reverses its torque when the joint reverses, to compare it with other effects that do so."""

    sizes: tuple[str, ...]
    torque: float  # start of a search [N m]; for a size in N, times the lever arm
    width: str = ""  # name of the parameter that holds the width of the reversal [m]; empty for a reversal at once
    widths_a_turn: float = 1.0
    widths: tuple[float, ...] = ()  # further starts of a search for the width [m]
    about: str = ""  # note on the comparison; ``{step}`` becomes the encoder's step


@dataclass(frozen=True, kw_only=True)
class SealedJoint:
    """What a sealed joint that is moved by a drive shows of an effect.

    Attributes:
        part: ``air`` if the pressures show it, ``balance`` if the torque that the motion needs does, else None.
        reason: why it does not show, where ``part`` is None.
        forms: forms that a diagnosis tries, the simplest first.
        sentence: what a report says if it was detected; default: the effect's own sentence.
        instead: what a report says if it explains the data as well as the detected effect.
        experiment: which recording distinguishes it from the others; default: the effect's own experiment.
        loop: how it reverses the torque; None if it does not. Effects with a loop are compared with each other.
        loss: ``steady`` or ``fading`` if the effect loses pressure at such a rate, else empty. Steady losses are
            compared with fading ones.
        loss_about: description of the loss, for that comparison.
    """

    part: Literal["air", "balance"] | None
    reason: str = ""
    forms: tuple[Form, ...] = (Form(),)
    sentence: str = ""
    instead: str = ""
    experiment: str = ""
    loop: Loop | None = None
    loss: Literal["", "steady", "fading"] = ""
    loss_about: str = ""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """An effect of the catalogue.

    Attributes:
        name: as in a rig file and in reports.
        meaning: what happens, in a sentence.
        law: its equation in words and symbols.
        source: where the law comes from.
        signature: which residual it changes, and how.
        parameters: its sizes and shapes.
        sentence: what a report says if it was detected. ``{muscle}`` and ``{valve}`` become "muscle 1" or "both
            valves", ``{s}`` the ending of a verb, the name of a parameter its value.
        experiment: which recording shows it best.
        distinguished_by: which recording distinguishes it from another effect, by the name of the other.
        sealed: what a sealed joint shows of it.
        states: the states that it adds.
        hooks: functions that change the model, by the names of :data:`~pam_antagonist.model.effects.hooks.HOOKS`.
        form: form that a diagnosis of a joint with valves tries.
        needs_motion: whether a locked joint does not show it.
        needs_angle: whether it hardly shows without a measured angle.
        deterministic: False for a disturbance that follows no law. A filter estimates it, and a diagnosis judges its
            course in time.
        tested_with: ways of driving a joint with which it is a candidate: ``valve`` by voltages, ``command`` by the
            pressures commanded to regulators, ``regulator`` by the measured pressures that these hold.
        of_tables: whether its laws are tables with named parts (:mod:`~pam_antagonist.model.effects.learned`). Its
            functions may ask for the whole parameter vector, and documents show no single numbers.
        module: its module; the registry fills it in.
        notes: text of its documentation beside the tables, in Markdown: the module's docstring without its first
            line; the registry fills it in.
    """

    name: str
    meaning: str
    law: str
    source: str
    signature: str
    parameters: tuple[EffectParameter, ...]
    sentence: str
    experiment: str
    sealed: SealedJoint
    distinguished_by: Mapping[str, str] = field(default_factory=dict)
    states: tuple[AddedState, ...] = ()
    hooks: Mapping[str, Kernel] = field(default_factory=dict)
    form: Form = Form()
    needs_motion: bool = False
    needs_angle: bool = False
    deterministic: bool = True
    tested_with: tuple[str, ...] = ("valve",)
    of_tables: bool = False
    module: str = ""
    notes: str = ""

    @property
    def title(self) -> str:
        """Name as words."""
        return self.name.replace("_", " ")

    def in_words(self, muscle: int | None, values: Mapping[str, float], sealed: bool = False) -> str:
        """Sentence of a report if the effect was detected.

        Args:
            muscle: 1 or 2, or None for both.
            values: of its parameters, by name; those that are missing count as 0.
            sealed: whether the joint is sealed.
        """
        which, valve = ("both muscles", "both valves") if muscle is None else (f"muscle {muscle}", f"valve {muscle}")
        text = (self.sealed.sentence if sealed else "") or self.sentence
        numbers = {item.name: f"{values.get(item.name, 0.0):.2g}" for item in self.parameters}
        return text.format(**numbers, muscle=which, valve=valve, s="" if muscle is None else "s")


def _numbered(symbol: str, number: int) -> str:
    """A symbol with the number of a muscle or signal: in the place of ``#``, or as an index."""
    return symbol.replace("#", str(number)) if "#" in symbol or not symbol else f"{symbol}_{number}"


def _sizes(
    items: list[tuple[str, str, str]], unit: str, low: float, high: float, scale: float
) -> tuple[EffectParameter, ...]:
    """Sizes of one kind, each with its name, meaning and symbol."""
    return tuple(EffectParameter(name, unit, 0.0, low, high, scale, text, symbol) for name, text, symbol in items)


def per_muscle(
    name: str, unit: str, low: float, high: float, scale: float, meaning: str, symbol: str = ""
) -> tuple[EffectParameter, ...]:
    """A size that each muscle has.

    Args:
        name: without the muscle's number.
        unit: SI.
        low: smallest value, in that unit.
        high: largest value, in that unit.
        scale: a typical size, in that unit.
        meaning: without the muscle.
        symbol: without the muscle's number; it goes in the place of ``#``, or becomes an index.
    """
    items = [(f"{name}_{i}", f"{meaning} of muscle {i}", _numbered(symbol, i)) for i in (1, 2)]
    return _sizes(items, unit, low, high, scale)


@inlined
def along_signals(slope1, slope2, slope3, slope4, signal1, signal2, signal3, signal4):
    """Weighted sum of the further signals, for hooks of effects with :func:`per_signal` parameters.

    Args:
        slope1: of signal 1 [unit of the hook by SI].
        slope2: of signal 2, likewise.
        slope3: of signal 3, likewise.
        slope4: of signal 4, likewise.
        signal1: s_1 − s̄_1 [SI].
        signal2: s_2 − s̄_2 [SI].
        signal3: s_3 − s̄_3 [SI].
        signal4: s_4 − s̄_4 [SI].
    """
    return slope1 * signal1 + slope2 * signal2 + slope3 * signal3 + slope4 * signal4


@inlined
def played(width, held, command, quickest_lag):
    """Rate of an added state that follows a command through play: the play operator.

    `held`: value of the state, which stays while the command moves within the play; likewise. `quickest_lag`: shortest
    time constant that a step of the integration follows [s].
    """
    taken_along = min(max(held, command - 0.5 * width), command + 0.5 * width)
    return (taken_along - held) / quickest_lag


def per_signal(
    name: str, unit: str, low: float, high: float, scale: float, meaning: str, symbol: str = ""
) -> tuple[EffectParameter, ...]:
    """A size that each further signal has."""
    items = [(f"{name}{k}", f"{meaning} {k}", _numbered(symbol, k)) for k in range(1, SIGNALS + 1)]
    return _sizes(items, unit, low, high, scale)


def state_per_muscle(
    name: str,
    unit: str,
    switch: str,
    initial_std: float,
    noise: float | str,
    *further: str,
    symbol: str = "",
    rate: Kernel | None = None,
    steady_value: Kernel | None = None,
    lag: Kernel | None = None,
) -> tuple[AddedState, ...]:
    """A state that each muscle has.

    Args:
        name: without the muscle's number.
        unit: SI.
        switch: the size that adds it when it is not 0, without the muscle's number.
        initial_std: at the start, in that unit.
        noise: as of :class:`AddedState`; the name of a parameter without the muscle's number.
        *further: as of :class:`AddedState`.
        symbol: without the muscle's number; it goes in the place of ``#``, or becomes an index.
        rate: as of :class:`AddedState`.
        steady_value: as of :class:`AddedState`.
        lag: as of :class:`AddedState`.
    """
    return tuple(
        AddedState(
            f"{name}_{i}",
            unit,
            f"{switch}_{i}",
            initial_std,
            f"{noise}_{i}" if isinstance(noise, str) else noise,
            further,
            _numbered(symbol, i),
            rate,
            steady_value,
            lag,
        )
        for i in (1, 2)
    )
