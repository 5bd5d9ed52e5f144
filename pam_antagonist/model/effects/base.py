"""What an effect is made of.

An effect is what a real rig may have beside equations (1) to (11). One file holds all that the package knows of it: its
numbers, its states, its law, and what a report says of it. ``docs/effects.md`` shows a complete file.
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

Kernel = Any
"""A function that :func:`~pam_antagonist._jit.inlined` or :func:`~pam_antagonist._jit.kernel` compiles."""


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect.

    Attributes:
        name: as in a rig file; ends in ``_1`` or ``_2`` where each muscle has its own.
        unit: of the value.
        neutral: value of a rig that does not mention it; a *size* is 0 there, a *shape* (a time, a width) has a start.
        low: least value that makes sense.
        high: largest value.
        scale: a value that is neither small nor large, for searches.
        meaning: in words.
        symbol: as in the documentation's equation, in LaTeX.
    """

    name: str
    unit: str
    neutral: float
    low: float
    high: float
    scale: float
    meaning: str
    symbol: str = ""

    @property
    def is_size(self) -> bool:
        """Whether the effect vanishes with this parameter: sizes are neutral at zero, shapes are not."""
        return self.neutral == 0.0

    @property
    def muscle(self) -> int | None:
        """1 or 2 where the parameter belongs to one muscle."""
        return int(self.name[-1]) if self.name.endswith(("_1", "_2")) else None

    @property
    def family(self) -> str:
        """Name without the muscle's number."""
        return self.name[:-2] if self.muscle else self.name


@dataclass(frozen=True)
class AddedState:
    """A state that an effect adds to [ψ, ψ̇, P_1, P_2].

    Attributes:
        name: of the state.
        unit: of the state.
        switch: the parameter (of this effect) whose value other than zero brings the state.
        initial_std: how well it is known when a filter starts.
        noise: process noise of a filter, standard deviation a square root of a second; or the name of the parameter
            (of this effect) that says it.
        further: other parameters (of this effect) that bring the state likewise.
        symbol: as in the documentation's equation, in LaTeX.
        rate: its derivative by time; None for a state that stays (a random walk).
        steady_value: its value in a joint that has stood for long; None for 0.
        prior: the parameter (of this effect) that says how well it is known where nothing is observed, when a filter
            starts as well; at its neutral value: without bound, and ``initial_std`` at a start.
        lag: time constant [s] with which it follows small changes, where that may be a few milliseconds. It may ask
            for parameters only.
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

    @property
    def muscle(self) -> int | None:
        """1 or 2 where the state belongs to one muscle."""
        return int(self.name[-1]) if self.name.endswith(("_1", "_2")) else None

    @property
    def family(self) -> str:
        """Name without the muscle's number."""
        return self.name[:-2] if self.muscle else self.name


@dataclass(frozen=True)
class Form:
    """The numbers of an effect that a fit frees.

    Attributes:
        tied: whether both muscles have the same sizes.
        without: parameters that stay at their neutral values, by name.
        scale: other scales than the parameters' own, by name without the muscle's number.
        low: other least values, likewise.
        shapes: values of the shapes that a search starts from; empty for the usual grid about their scales.
    """

    tied: bool = False
    without: tuple[str, ...] = ()
    scale: Mapping[str, float] = field(default_factory=dict)
    low: Mapping[str, float] = field(default_factory=dict)
    shapes: tuple[Mapping[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Loop:
    """How an effect turns the torque round where a joint turns round, to compare it with others that do.

    Attributes:
        sizes: parameters that have one value together, by name.
        torque: where a search for it starts [N m]; of a size in N, on the lever arm.
        width: parameter over which it turns round [m]; empty where it does so at once.
        widths_a_turn: so many widths until it has turned round.
        widths: where a search for it starts as well [m].
        about: what to know where it is compared; ``{step}`` becomes the encoder's step.
    """

    sizes: tuple[str, ...]
    torque: float
    width: str = ""
    widths_a_turn: float = 1.0
    widths: tuple[float, ...] = ()
    about: str = ""


@dataclass(frozen=True, kw_only=True)
class SealedJoint:
    """What a sealed joint that is moved by a drive can show of an effect.

    Attributes:
        part: what shows it: ``air`` (the pressures), ``balance`` (the torque that the motion needs), None for neither.
        reason: why it does not show, where ``part`` is None.
        forms: in which it is tried, the simplest first.
        sentence: what a report says where it was found; default: the effect's own sentence.
        instead: what a report says where it would explain as much as the one that was found.
        experiment: which recording distinguishes it from the others; default: the effect's own experiment.
        loop: how it turns the torque round; None where it does not. Effects with a loop are compared with each other.
        loss: whether it takes pressure at a ``steady`` rate or at one that is ``fading``; empty for neither. Those that
            are steady are compared with those that fade.
        loss_about: what such a loss is, for that comparison.
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
        signature: which residual it moves, and how.
        parameters: its numbers.
        sentence: what a report says where it was found. ``{muscle}`` and ``{valve}`` become "muscle 1" or "both
            muscles", ``{s}`` the ending of a verb, the name of a parameter its value.
        experiment: which recording shows it best.
        distinguished_by: which recording distinguishes it from another effect, by the name of the other.
        sealed: what a sealed joint can show of it.
        states: the states that it adds.
        hooks: what it does to the model: functions by the names of :data:`~pam_antagonist.model.effects.hooks.HOOKS`.
        form: in which a joint with valves is tried for it.
        needs_motion: whether a locked joint does not show it.
        needs_angle: whether it hardly shows without a measured angle.
        deterministic: False for a disturbance that no law gives. A filter estimates it, and a diagnosis judges it by
            its course.
        tested_with: ways of driving a joint with which it is a candidate: ``valve`` by voltages, ``command`` by what
            pressure regulators are asked for, ``regulator`` by the pressures that these hold, as measured.
        module: where it is written; the registry fills it in.
        notes: what its documentation says beside the tables, in Markdown: the module's docstring without its first
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
    module: str = ""
    notes: str = ""

    @property
    def title(self) -> str:
        """Name as words."""
        return self.name.replace("_", " ")

    def in_words(self, muscle: int | None, values: Mapping[str, float], sealed: bool = False) -> str:
        """What a report says where the effect was found.

        Args:
            muscle: 1 or 2, or None for both.
            values: of its parameters, by name; those that are not there count as 0.
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
        scale: a size that matters, in that unit.
        meaning: without the muscle.
        symbol: without the muscle's number; it goes in the place of ``#``, or becomes an index.
    """
    items = [(f"{name}_{i}", f"{meaning} of muscle {i}", _numbered(symbol, i)) for i in (1, 2)]
    return _sizes(items, unit, low, high, scale)


@inlined
def along_signals(slope1, slope2, slope3, slope4, signal1, signal2, signal3, signal4):
    """What goes with the further signals, for hooks of effects with :func:`per_signal` parameters: their weighted sum.

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
    """Rate of what a command takes along at either end of a play: the play operator, for rates of added states.

    Args:
        width: of the play, in the unit of the command.
        held: what stays within the play, likewise.
        command: what moves it, likewise.
        quickest_lag: shortest time constant that a step of the integration follows [s].
    """
    taken_along = min(max(held, command - 0.5 * width), command + 0.5 * width)
    return (taken_along - held) / quickest_lag


def per_signal(
    name: str, unit: str, low: float, high: float, scale: float, meaning: str, symbol: str = ""
) -> tuple[EffectParameter, ...]:
    """A size that each further signal has.

    Args:
        name: without the signal's number.
        unit: SI.
        low: smallest value, in that unit.
        high: largest value, in that unit.
        scale: a size that matters, in that unit.
        meaning: without the signal.
        symbol: without the signal's number, which becomes an index.
    """
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
        switch: the size that brings it about, without the muscle's number.
        initial_std: at the start, in that unit.
        noise: as of :class:`AddedState`; the name of a parameter without the muscle's number.
        *further: as of :class:`AddedState`.
        symbol: without the muscle's number; it goes in the place of ``#``, or becomes an index.
        rate: its derivative.
        steady_value: in a joint that has stood for long.
        lag: its time constant.
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
