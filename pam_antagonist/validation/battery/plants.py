"""Recordings to try a diagnosis on: a free and a locked minute of a joint whose effects only the seed knows.

Every joint has base parameters scattered by a percent, drawn anew for each recording, effects in another form than the
catalogue's (:mod:`forms`), and sensors with noise and converter as the rig declares them. It is a simulator of
this project, though: agreement with it says nothing about a real joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.model import parameters as par
from pam_antagonist.recording import Recording, write_bag
from pam_antagonist.rig import load_rig
from pam_antagonist.simulation.plant import scattered
from pam_antagonist.validation.battery import physics
from pam_antagonist.validation.battery.forms import FOREIGN, SINGLE, Deviation, Form

Floats = NDArray[np.float64]
KINDS = ("single", "pair", "none", "foreign")
JOINTS = ("free", "locked")
RIG = "shin2022"
SPREAD = 0.01
"""Relative standard deviation of the base parameters [-]."""
SMALLEST = 3.0
"""Least size of an effect, in noises of the channel that it moves most."""
DURATION = 60.0
_SUBSTEPS = 4
_FIRST_STAMP_NS = 1_000_000_000_000_000_000
_START_PRESSURE = 450e3
_LOWEST, _HIGHEST, _REST = 4.15, 8.0, 5.5
_VOLTAGE_STEP = 10.0 / 4096
_KIND_SHARES = (("single", 0.5), ("pair", 0.2), ("none", 0.15), ("foreign", 0.15))


@dataclass(frozen=True)
class Channels:
    """What happens at a joint, before any sensor.

    Attributes:
        angle: (N,) [rad].
        pressure: absolute (N, 2) [Pa].
        torque: (N,) [N m].
    """

    angle: Floats
    pressure: Floats
    torque: Floats


@dataclass(frozen=True)
class Case:
    """One joint of the battery.

    Attributes:
        name: such as ``012 leak 1``.
        kind: one of ``KINDS``.
        effects: name in the catalogue and muscle (1, 2 or None: both, or no muscle's) of each effect.
        form: how they are written, in words.
        seed: of everything that is random in it.
        sizes: of each effect, in noises of the channel that it moves most.
    """

    name: str
    kind: str
    effects: tuple[tuple[str, int | None], ...]
    form: tuple[str, ...]
    seed: int
    sizes: tuple[float, ...]

    def recordings(self, duration: float = DURATION) -> tuple[Recording, Recording]:
        """The joint free, then locked at 0°.

        Args:
            duration: of each [s].
        """
        free, locked = (self.recording(joint, duration) for joint in JOINTS)
        return free, locked

    def recording(self, joint: str, duration: float = DURATION) -> Recording:
        """One of them, as its sensors show it."""
        rig = load_rig(RIG)
        voltage = self.voltage(joint, duration)
        true = self.channels(joint, duration)
        sensors = rig.sensors
        rng = self._random(joint, "noise")
        pressure = _measured(true.pressure, sensors.pressure_std, sensors.pressure_step, rng)
        stamps = _FIRST_STAMP_NS + np.rint(np.arange(1, len(voltage) + 1) * rig.sample_period * 1e9).astype(np.int64)
        return Recording(
            path=Path(f"{self.name} {joint}"),
            stamp_ns=stamps,
            pressure=pressure,
            voltage=voltage,
            angle=_measured(true.angle, sensors.angle_std, sensors.angle_step, rng),
            torque=_measured(true.torque, sensors.torque_std, sensors.torque_step, rng),
        )

    def write(self, folder: Path, duration: float = DURATION) -> None:
        """Write both as bags ``free`` and ``locked`` in a folder.

        Raises:
            BadInput: one of them exists already.
        """
        for joint, recording in zip(JOINTS, self.recordings(duration), strict=True):
            write_bag(folder / joint, recording, pressure_variance=load_rig(RIG).sensors.pressure_std ** 2)

    def voltage(self, joint: str, duration: float = DURATION) -> Floats:
        """What is put on the valves (N, 2) [V]."""
        period = load_rig(RIG).sample_period
        time = np.asarray(np.arange(1, round(duration / period) + 1) * period)
        return staircase(time, self._random(joint, "voltage"))

    def channels(
        self, joint: str, duration: float = DURATION, effects: bool = True, parameters: np.ndarray | None = None
    ) -> Channels:
        """What happens at the joint.

        Args:
            joint: ``free`` or ``locked``.
            duration: [s].
            effects: False for the same joint without them.
            parameters: of another joint (parameters.SIZE,); default: this one's.
        """
        rig = load_rig(RIG)
        p = self.parameters(joint) if parameters is None else parameters.copy()
        deviations = self.deviations() if effects else []
        return _played(p, self.voltage(joint, duration), deviations, rig.sample_period)

    def parameters(self, joint: str) -> np.ndarray:
        """Base parameters of the joint in one recording (parameters.SIZE,)."""
        return scattered(load_rig(RIG).parameters(joint), SPREAD, self._random(joint, "base"))

    def deviations(self) -> list[Deviation]:
        """What its effects change."""
        known = {form.name: form for form in (*SINGLE, *FOREIGN)}
        rng = np.random.default_rng([self.seed, 1])
        return [
            known[name].make(size, muscle, rng)
            for name, size, (_, muscle) in zip(self.form, self.sizes, self.effects, strict=True)
        ]

    def moved(self, duration: float = DURATION) -> dict[str, float]:
        """How far its effects move each channel, root mean square over the sensor's noise, by ``joint channel``."""
        sensors = load_rig(RIG).sensors
        out = {}
        for joint in JOINTS:
            with_them, without = (self.channels(joint, duration, effects) for effects in (True, False))
            for channel, std in (("angle", sensors.angle_std), ("torque", sensors.torque_std)):
                difference = getattr(with_them, channel) - getattr(without, channel)
                out[f"{joint} {channel}"] = float(np.sqrt(np.mean(difference**2))) / std
            difference = with_them.pressure - without.pressure
            for i, rms in enumerate(np.sqrt(np.mean(difference**2, axis=0)).tolist(), 1):
                out[f"{joint} pressure_{i}"] = rms / sensors.pressure_std
        return out

    def _random(self, joint: str, what: str) -> np.random.Generator:
        return np.random.default_rng([self.seed, JOINTS.index(joint), ("base", "voltage", "noise").index(what), 7])


def cases(seed: int, count: int) -> list[Case]:
    """A battery: half of it single effects, the rest pairs, nothing at all, and what is in no catalogue.

    Every form comes up before any comes up again, so that a battery of 80 holds them all.

    Args:
        seed: of the battery.
        count: how many cases; a longer battery of the same seed begins with the shorter one.

    Raises:
        BadInput: a negative seed, or fewer than one case.
    """
    if seed < 0 or count < 1:
        raise BadInput(f"battery: seed {seed} and {count} cases, expected a seed of 0 or more and one case or more")
    rng = np.random.default_rng(seed)
    singles, firsts, foreigners = _Deck(SINGLE, rng), _Deck(SINGLE, rng), _Deck(FOREIGN, rng)
    done = dict.fromkeys(KINDS, 0)
    out = []
    for number in range(count):
        # The kind that is furthest behind its share.
        kind = max(_KIND_SHARES, key=lambda item: item[1] * (number + 1) - done[item[0]])[0]
        done[kind] += 1
        forms: list[Form] = []
        if kind == "single":
            forms = [singles.draw()]
        elif kind == "foreign":
            forms = [foreigners.draw()]
        elif kind == "pair":
            first = firsts.draw()
            others = [form for form in SINGLE if form.effect != first.effect]
            forms = [first, others[int(rng.integers(len(others)))]]
        out.append(_case(number, kind, forms, seed, rng))
    return out


def _case(number: int, kind: str, forms: Sequence[Form], seed: int, rng: np.random.Generator) -> Case:
    effects, sizes = [], []
    for form in forms:
        muscle = int(rng.integers(1, 3)) if form.by_muscle else None
        effects.append((form.effect, muscle))
        sizes.append(float(np.exp(rng.uniform(np.log(SMALLEST), np.log(form.largest)))))
    words = " + ".join(f"{effect} {muscle}" if muscle else effect for effect, muscle in effects) or "none"
    return Case(
        name=f"{number:03d} {words}",
        kind=kind,
        effects=tuple(effects),
        form=tuple(form.name for form in forms),
        seed=int(np.random.SeedSequence([seed, number]).generate_state(1)[0]),
        sizes=tuple(sizes),
    )


class _Deck:
    """Forms in random order, shuffled again when all have come up."""

    def __init__(self, forms: Sequence[Form], rng: np.random.Generator) -> None:
        self._forms, self._rng = forms, rng
        self._left: list[Form] = []

    def draw(self) -> Form:
        if not self._left:
            self._left = [self._forms[k] for k in self._rng.permutation(len(self._forms))]
        return self._left.pop()


def staircase(time: Floats, rng: np.random.Generator) -> Floats:
    """Voltages in pieces of 3 to 7 s: a jump to a random level that is held, or a ramp to one, in 12 bits.

    Args:
        time: (N,) [s].
        rng: source of times and levels.

    Returns:
        (N, 2) [V].
    """
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


def _measured(values: Floats, std: float, step: float, rng: np.random.Generator) -> Floats:
    noisy = values + std * rng.standard_normal(values.shape)
    return np.asarray(np.rint(noisy / step) * step if step > 0.0 else noisy)


def _played(p: np.ndarray, voltage: Floats, deviations: Sequence[Deviation], period: float) -> Channels:
    """A joint under these voltages."""
    step = period / _SUBSTEPS
    fine = np.asarray(np.arange(len(voltage) * _SUBSTEPS) * step)
    time = np.asarray(np.arange(1, len(voltage) + 1) * period)
    at_valve: Floats = np.repeat(voltage, _SUBSTEPS, axis=0)
    push, supply = np.zeros(len(voltage)), np.zeros(len(voltage))
    q = physics.numbers()
    factors: dict[str, float] = {}
    for deviation in deviations:
        for name, value in deviation.numbers.items():
            q[physics.Q[name]] = value
        factors.update(deviation.parameters)
        at_valve = at_valve if deviation.voltage is None else deviation.voltage(fine, at_valve)
        push = push if deviation.push is None else push + deviation.push(time)
        supply = supply if deviation.supply is None else supply + deviation.supply(time)
    changes = {name: p[par.INDEX[name]] * factor for name, factor in factors.items()}
    p = par.changed(p, {**changes, "friction.time_step": step})
    angle, pressure, torque = physics.simulate(0.0, _START_PRESSURE, at_valve, push, supply, p, q, period, _SUBSTEPS)
    for deviation in deviations:
        angle = angle if deviation.angle is None else deviation.angle(angle)
        pressure = pressure if deviation.pressure is None else deviation.pressure(time, pressure)
    return Channels(angle, pressure, torque)
