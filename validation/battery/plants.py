"""Which joints a battery holds, and their recordings: a free and a locked minute, with effects of the seed's choice.

Every joint has base parameters scattered by a percent, drawn anew for each recording, effects in another form than the
catalogue's (:mod:`forms`), and sensors with noise and converter as the rig declares them. It is a simulator of
this project, though: agreement with it says nothing about a real joint.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording
from pam_antagonist.recording.corrections import Corrections
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import scattered
from validation.battery import physics
from validation.battery.form import Deviation, Form
from validation.battery.forms import FOREIGN, FORMS, SINGLE, UNCATALOGUED, is_other
from validation.sensors import recorded

Floats = NDArray[np.float64]
KINDS = ("single", "pair", "none", "foreign", "calibration")
JOINTS = ("free", "locked")
CHANNELS = ("angle", "torque", "pressure_1", "pressure_2")
RIG = "shin2022"
SPREAD = 0.01
"""Relative standard deviation of the base parameters [-]."""
DURATION = 60.0
_SUBSTEPS = Deviation().substeps
_START_PRESSURE = 450e3
_LOWEST, _HIGHEST, _REST = 4.15, 8.0, 5.5
_VOLTAGE_STEP = 10.0 / 4096
_CLOSE = 1.1
"""A size is right to this factor."""
_ROUNDS = 8

LEVELS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Sizes of single effects: multiples of the noise of a sample (root mean square over a minute)."""
LARGE = 4.0
"""Sizes from which on the figures of a battery count; pairs and what is in no catalogue have no smaller ones."""
NOTHING_FROM, CALIBRATIONS_FROM, UNCATALOGUED_FROM = 1000, 3000, 5000
"""Numbers of the first of further cases: with nothing wrong, with a calibration alone, outside of every law."""
CALIBRATIONS = {
    "encoder_zero": tuple(float(np.radians(size)) for size in (0.2, 0.5, 1.0, 2.0)),
    "torque_zero": (0.05, 0.1, 0.3),
    **{f"delay_{clock}": (0.005, 0.01, 0.02, 0.05) for clock in ("voltage", "pressure", "angle", "torque")},
}
"""Calibrations and their sizes in SI units. A torque meter's scale is left out: it looks like other muscles."""
EFFECTS = tuple(dict.fromkeys(form.effect for form in SINGLE))
"""Effects of the catalogue that have forms here; one that a package adds has none."""
_KIND_SHARES = (("single", 0.5), ("pair", 0.2), ("none", 0.15), ("foreign", 0.15))
_OTHER_OF = 4
"""Of so many singles of an effect, all but one are drawn from forms that are truly other ones."""
Item = TypeVar("Item")


@dataclass(frozen=True)
class Channels:
    """What happens at a joint, before any sensor."""

    angle: Floats  # (N,) [rad]
    pressure: Floats  # absolute (N, 2) [Pa]
    torque: Floats  # (N,) [N m]


def values_of(source: Any, channel: str) -> Floats:
    """One of ``CHANNELS`` of a recording, or of what happens at a joint."""
    if channel.startswith("pressure_"):
        return np.asarray(source.pressure[:, int(channel[-1]) - 1])
    return np.asarray(getattr(source, channel))


@dataclass(frozen=True)
class Case:
    """One joint of the battery."""

    name: str  # such as ``012 leak 1``
    kind: str  # one of ``KINDS``
    effects: tuple[tuple[str, int | None], ...]  # name in the catalogue; muscle 1, 2 or None (both, or no muscle's)
    form: tuple[str, ...]  # how they are written
    seed: int  # of everything that is random in it
    # Of each effect: root mean square, over a minute of the free joint, by which it alone moves the channel that it
    # moves most, in noises of a sample.
    sizes: tuple[float, ...]
    # Whether the effects are adjusted until they have these sizes; otherwise they are the forms' amounts, and right to
    # a factor of about three.
    exact: bool = False
    # What the recordings of a joint with nothing wrong need corrected: a name of ``Corrections`` and its value.
    calibration: tuple[str, float] | None = None

    def recordings(self, duration: float = DURATION) -> tuple[Recording, Recording]:
        """The joint free, then locked at 0°; each of a length [s]."""
        free, locked = (self.recording(joint, duration) for joint in JOINTS)
        return free, locked

    def recording(self, joint: str, duration: float = DURATION) -> Recording:
        """One of them, as its sensors show it."""
        true = self.channels(joint, duration)
        made = recorded(
            f"{self.name} {joint}", load_rig(RIG), self.voltage(joint, duration), true.angle, true.pressure,
            true.torque, self._random(joint, "noise"),
        )  # fmt: skip
        if self.calibration is None:
            return made
        undone: dict[str, Any] = {self.calibration[0]: -self.calibration[1]}
        return Corrections(**undone).applied(made)

    def voltage(self, joint: str, duration: float = DURATION) -> Floats:
        """What is put on the valves (N, 2) [V]."""
        period = load_rig(RIG).sample_period
        time = np.asarray(np.arange(1, round(duration / period) + 1) * period)
        return staircase(time, self._random(joint, "voltage"))

    def channels(self, joint: str, duration: float = DURATION) -> Channels:
        """What happens at the joint."""
        period = load_rig(RIG).sample_period
        return _played(self.parameters(joint), self.voltage(joint, duration), self.deviations(), period)

    def parameters(self, joint: str) -> np.ndarray:
        """Base parameters of the joint in one recording (parameters.SIZE,)."""
        return scattered(load_rig(RIG).parameters(joint), SPREAD, self._random(joint, "base"))

    def deviations(self) -> list[Deviation]:
        """What its effects change."""
        if self.exact:
            return [_of_size(self, index)[0] for index in range(len(self.effects))]
        rng, each = np.random.default_rng([self.seed, 1]), zip(self.form, self.sizes, self.effects, strict=False)
        return [FORMS[name].make(size, muscle, rng) for name, size, (_, muscle) in each]

    @property
    def reached(self) -> tuple[float, ...]:
        """Sizes that the effects really have: a form may be too small or too large for the one that is wanted."""
        if not (self.exact and self.effects):
            return self.sizes
        return tuple(_of_size(self, index)[1] for index in range(len(self.effects)))

    def moved(self, duration: float = DURATION) -> dict[str, float]:
        """How far its effects move each channel, root mean square over the sensor's noise, by ``joint channel``."""
        out = {}
        for joint in JOINTS:
            moved = _apart(self.channels(joint, duration), _bare(self.seed, joint, duration))
            out.update({f"{joint} {name}": value for name, value in moved.items()})
        return out

    def _random(self, joint: str, what: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, JOINTS.index(joint), ("base", "voltage", "noise").index(what), 7])


@lru_cache(maxsize=4)
def _bare(seed: int, joint: str, duration: float) -> Channels:
    """A joint without effects: sizes of many effects are measured against the same."""
    return Case("", "none", (), (), seed, ()).channels(joint, duration)


def _apart(one: Channels, other: Channels) -> dict[str, float]:
    """Root mean squares of the differences, in noises of a sample, by channel."""
    out = {}
    for name in CHANNELS:
        noise = load_rig(RIG).sensors.reading(name.partition("_")[0]).std
        out[name] = float(np.sqrt(np.mean(((values_of(one, name) - values_of(other, name)) / noise) ** 2)))
    return out


@lru_cache(maxsize=16)
def _of_size(case: Case, index: int) -> tuple[Deviation, float]:
    """One of a case's effects with the amount that gives it its size, and the size that it then has."""
    form, muscle, size = FORMS[case.form[index]], case.effects[index][1], case.sizes[index]
    p, voltage, period = case.parameters("free"), case.voltage("free"), load_rig(RIG).sample_period
    without = _bare(case.seed, "free", DURATION)
    amount, tried = size, []
    for _ in range(_ROUNDS):
        amount = min(max(amount, form.smallest), form.largest)
        # The same draws for every amount.
        deviation = form.make(amount, muscle, np.random.default_rng([case.seed, 1, index]))
        reached = max(_apart(_played(p, voltage, [deviation], period), without).values())
        tried.append((abs(np.log(max(reached, 1e-9) / size)), reached, deviation))
        if tried[-1][0] < np.log(_CLOSE):
            break
        # What sticks jumps: no leap further than a factor of three.
        amount *= float(np.clip(size / max(reached, 1e-9), 1.0 / 3.0, 3.0))
    _, reached, deviation = min(tried, key=lambda item: item[0])
    return deviation, reached


def staircase(time: Floats, rng: np.random.Generator) -> Floats:
    """Voltages (N, 2) [V] in pieces of 3 to 7 s: a jump to a random level that is held, or a ramp, in 12 bits."""
    edges, values = [0.0], [rng.uniform(_LOWEST, _HIGHEST, 2) if rng.random() < 0.5 else np.full(2, _REST)]
    while edges[-1] <= time[-1]:
        begin, now = edges[-1], values[-1]
        target = rng.uniform(_LOWEST, _HIGHEST, 2)
        if rng.random() < 0.6:
            edges.append(begin + 1e-6)
            values.append(np.where(rng.random(2) < 0.85, target, now))
            target = values[-1]
        edges.append(begin + float(rng.uniform(3.0, 7.0)))
        values.append(target)
    table = np.array(values)
    voltage = np.column_stack([np.interp(time, edges, table[:, i]) for i in (0, 1)])
    return np.asarray(np.rint(voltage / _VOLTAGE_STEP) * _VOLTAGE_STEP)


def _played(p: np.ndarray, voltage: Floats, deviations: Sequence[Deviation], period: float) -> Channels:
    """A joint under these voltages."""
    substeps = max((deviation.substeps for deviation in deviations), default=_SUBSTEPS)
    step = period / substeps
    fine = np.asarray(np.arange(len(voltage) * substeps) * step)
    time = np.asarray(np.arange(1, len(voltage) + 1) * period)
    at_valve: Floats = np.repeat(voltage, substeps, axis=0)
    push, supply = np.zeros(len(voltage)), np.zeros(len(voltage))
    numbers: dict[str, float] = {}
    factors: dict[str, float] = {}
    for deviation in deviations:
        numbers.update(deviation.numbers)
        factors.update(deviation.parameters)
        at_valve = at_valve if deviation.voltage is None else deviation.voltage(fine, at_valve)
        push = push if deviation.push is None else push + deviation.push(time)
        supply = supply if deviation.supply is None else supply + deviation.supply(time)
    changes = {name: p[par.INDEX[name]] * factor for name, factor in factors.items()}
    p = par.changed(p, {**changes, "friction.time_step": step})
    q = physics.numbers(numbers)
    angle, pressure, torque = physics.simulate(0.0, _START_PRESSURE, at_valve, push, supply, p, q, period, substeps)
    for deviation in deviations:
        angle = angle if deviation.angle is None else deviation.angle(angle)
        pressure = pressure if deviation.pressure is None else deviation.pressure(time, pressure)
        torque = torque if deviation.torque is None else deviation.torque(torque)
    return Channels(angle, pressure, torque)


def cases(
    seed: int, count: int, nothing: int = 0, calibrations: int = 0, effect: str | None = None, uncatalogued: int = 0
) -> list[tuple[int, Case]]:
    """A battery: half of it single effects, the rest pairs, nothing at all, and what is in no catalogue.

    Three quarters of the single effects and both of every pair are in forms that the catalogue's law cannot imitate
    (:func:`~validation.battery.forms.is_other`), where the effect has such a form.

    A longer battery of the same seed begins with the shorter one. With `effect`, the cases are all of this effect, in
    all its forms in turn and in sizes that count. Returns each case with its number.
    """
    if effect is not None and effect not in EFFECTS:
        raise BadInput(f"battery: the effect {effect!r} has no forms here; expected one of {', '.join(EFFECTS)}")
    if count > NOTHING_FROM or not count + nothing + calibrations + uncatalogued:
        raise BadInput(
            f"battery: {count} cases, {nothing} with nothing wrong and {calibrations} with a calibration, expected one "
            f"case or more, up to {NOTHING_FROM}"
        )
    draw = _Draw(np.random.default_rng(seed))
    done = {kind: 0 for kind, _ in _KIND_SHARES}
    out = []
    for number in range(count):
        if effect is not None:
            form = draw.next((effect, "form"), [form for form in SINGLE if form.effect == effect])
            out.append(_case(number, "single", [form], seed, draw, LARGE))
            continue
        # The kind that is furthest behind its share.
        kind = max(_KIND_SHARES, key=lambda item: item[1] * (number + 1) - done[item[0]])[0]
        done[kind] += 1
        out.append(_case(number, kind, draw.forms(kind), seed, draw))
    out += [_case(NOTHING_FROM + k, "none", [], seed, draw) for k in range(nothing)]
    # Drawn by themselves, so that they do not depend on how many others there are.
    draw = _Draw(np.random.default_rng([seed, CALIBRATIONS_FROM]))
    out += [_misread(CALIBRATIONS_FROM + k, seed, draw) for k in range(calibrations)]
    draw = _Draw(np.random.default_rng([seed, UNCATALOGUED_FROM]))
    for k in range(uncatalogued):
        out.append(_case(UNCATALOGUED_FROM + k, "foreign", [draw.next("outside", UNCATALOGUED)], seed, draw))
    return out


def _misread(number: int, seed: int, draw: _Draw) -> tuple[int, Case]:
    """A joint with nothing wrong, whose recordings need a calibration."""
    _, case = _case(number, "calibration", [], seed, draw)
    name = draw.next("calibration", tuple(CALIBRATIONS))
    size = draw.next((name, "size"), CALIBRATIONS[name])
    wrong = name, size * float(draw.rng.choice((-1.0, 1.0)))
    return number, replace(case, name=f"{number:03d} {name}", form=(name,), sizes=(size,), calibration=wrong)


def _case(
    number: int, kind: str, forms: Sequence[Form], seed: int, draw: _Draw, least: float = 0.0
) -> tuple[int, Case]:
    effects = [(form.effect, int(draw.rng.integers(1, 3)) if form.by_muscle else None) for form in forms]
    words = " + ".join(f"{effect} {muscle}" if muscle else effect for effect, muscle in effects) or "none"
    seed_of_case = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
    sizes = tuple(draw.size(kind, form, least) for form in forms)
    names = tuple(form.name for form in forms)
    return number, Case(f"{number:03d} {words}", kind, tuple(effects), names, seed_of_case, sizes, exact=True)


class _Draw:
    """What has come up, and what has not yet: items of a deck in random order, shuffled again when all have come up."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._count: dict[str, int] = defaultdict(int)
        self._left: dict[object, list[Any]] = defaultdict(list)

    def forms(self, kind: str) -> list[Form]:
        """The forms of the next case of a kind."""
        if kind == "none":
            return []
        if kind == "foreign":
            return [self.next("foreign", FOREIGN)]
        effect = self.next((kind, "effect"), EFFECTS)
        if kind == "single":
            return [self._form(effect)]
        rest = tuple(name for name in EFFECTS if name != effect)
        return [self._form(effect, always=True), self._form(str(self.rng.choice(rest)), always=True)]

    def size(self, kind: str, form: Form, least: float) -> float:
        """The size of a form in the next case of a kind."""
        least = least if kind == "single" else LARGE
        deck = form.effect if kind == "single" else "size"
        return self.next((kind, deck, "size"), tuple(level for level in LEVELS if level >= least))

    def _form(self, effect: str, always: bool = False) -> Form:
        mine = [form for form in SINGLE if form.effect == effect]
        others, close = ([form for form in mine if is_other(form) is wanted] for wanted in (True, False))
        other = always
        if not always:
            self._count[effect] += 1
            other = self._count[effect] % _OTHER_OF != 0
        chosen = (others if other else close) or others or close
        return self.next((effect, chosen is others), tuple(chosen))

    def next(self, deck: object, items: Sequence[Item]) -> Item:
        """The next item of a deck."""
        if not self._left[deck]:
            self._left[deck] = [items[k] for k in self.rng.permutation(len(items))]
        item: Item = self._left[deck].pop()
        return item
