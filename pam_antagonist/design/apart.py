"""An experiment that tells two effects apart: the voltages under which neither can imitate the other.

Take the model with effect a. How far recordings of it lie from the best model with effect b instead is

    d² = Δ' (R + J Σ J')⁻¹ Δ,

with Δ what effect a does to the sensors, R their noise, and J the derivatives by all that a fit would move meanwhile:
the base parameters within their priors Σ, and the numbers of effect b without bound, in several shapes. So d² is what
is left of the information about the size of a, when all else is free: a Schur complement. The same is worked out with
the parts exchanged, and the lesser of both counts, since nobody knows which one is there.

``close_loop`` counts one independent error a second, so that d² counts by as much less. Its evidence is then normal
with the mean d² and the variance 4 d², and decides where it is strong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import norm

from pam_antagonist.design.information import (
    GAUGE_1,
    GAUGE_2,
    TANK,
    Course,
    Departure,
    Information,
    predicted_std,
    unknowns,
)
from pam_antagonist.design.limits import Limits, uncertainty_of
from pam_antagonist.design.optimal import BLOCK, FORBIDDEN, REST, STEP, TAIL, Plan, best_block, held, steady_voltage
from pam_antagonist.diagnosis.thresholds import STRONG
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Candidate, moved
from pam_antagonist.inference.likelihood import BLOCKS_PER_ERROR
from pam_antagonist.inference.trial import ANGLE, CHANNELS, TORQUE
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig import Rig
from pam_antagonist.simulation import excitation

Floats = NDArray[np.float64]

SURE = 0.95
"""Chance of a decision from which on an experiment is long enough."""
SHORTEST = 26.0
"""[s] Of an experiment, since ``close_loop`` wants 20 s and more in which the valves move."""
LIKELY = 0.5
"""Chance below which no experiment within the limits is said to tell."""
_WIDE = 10.0
"""Standard deviation of a rival's sizes, in their scales: next to no bound."""
_TYPICAL_S = 20.0
"""[s] Of the steps on which a rival is made to imitate."""
_STEPS = (STEP, 2e-3, 1e-3, 5e-4)
"""[s] Of the integration: the longest is taken that follows both models."""
_SENSORS = {
    ANGLE: "an encoder on the shaft",
    TORQUE: "a torque meter",
    GAUGE_1: "a third pressure sensor at muscle 1",
    GAUGE_2: "a third pressure sensor at muscle 2",
    TANK: "a third pressure sensor at the supply's tank",
}


@dataclass(frozen=True, eq=False)
class Verdict:
    """What an experiment promises.

    Attributes:
        plan: the experiment.
        chance: of a decision, the least over all rivals.
        by_rival: the same for each rival.
        instead: sensors or conditions that would tell where it does not, in words.
    """

    plan: Plan
    chance: float
    by_rival: dict[str, float]
    instead: tuple[str, ...] = ()


def chance(distance: float) -> float:
    """Probability that the evidence is strong.

    Args:
        distance: d², as ``close_loop`` counts it.
    """
    return float(norm.cdf((distance - STRONG) / (2.0 * math.sqrt(max(distance, 1e-9)))))


def without(rig: Rig, effect: str) -> Rig:
    """A rig without an effect.

    Args:
        rig: with it, or not.
        effect: its name.
    """
    return rig.replaced(effects={name: dict(values) for name, values in rig.effects.items() if name != effect})


class Question:
    """Whether one effect can be told from another, as an experiment goes on.

    Args:
        rig: with the effect at the size that is supposed.
        effect: which is there.
        rival: which is not.
        joint: ``free`` or ``locked``.
        lock_angle: [rad], of a locked joint.
        pressure: of both muscles at the start [Pa].
        rest: voltages there (2,) [V].
        channels: what is measured, indices of ``CHANNELS``.
        step: of the integration [s].
    """

    def __init__(
        self,
        rig: Rig,
        effect: str,
        rival: str,
        joint: str,
        lock_angle: float,
        pressure: float,
        rest: Floats,
        channels: Sequence[int],
        step: float = STEP,
    ) -> None:
        sizes = {parameter_path(effect, item.name) for item in CATALOGUE[effect].parameters if item.is_size}
        size = Departure(effect, {path: rig.value(path) for path in sizes if rig.value(path)}, share=-0.1)
        base = [item for item in unknowns(without(rig, effect)) if not item.name.startswith("effects.")]
        others = _departures(rig, rival)
        further, self._open = uncertainty_of(rig, base)
        placed = [*base, *further, *others, size]
        # What is uncertain stands in front: the columns behind it are certain in a prediction.
        self._open = np.vstack([self._open, np.zeros((len(others) + 1, self._open.shape[1]))])
        self._work = Information(rig, placed, joint, lock_angle, channels=_seen(joint, channels), step=step)
        prior = np.ones(len(placed) - 1)
        prior[len(base) + len(further) :] = _WIDE**-2
        self._prior = np.diag(np.append(prior, 0.0))
        self._matrix = np.zeros((len(placed), len(placed)))
        self._states = self._work.start((pressure, pressure), rest)

    def _distance(self, matrix: Floats) -> float:
        known = matrix / BLOCKS_PER_ERROR + self._prior
        rest, across = known[:-1, :-1], known[:-1, -1]
        return max(0.0, float(known[-1, -1] - across @ np.linalg.solve(rest, across)))

    @property
    def distance(self) -> float:
        """d² of what was added so far."""
        return self._distance(self._matrix)

    def course(self, voltage: Floats) -> Course:
        """What comes of voltages (N, 2) [V]."""
        return self._work.along(self._states, voltage)

    def stable(self, bounds: tuple[float, float], step: float) -> bool:
        """Whether steps of this length follow the models wherever the valves can bring them.

        Args:
            bounds: least and largest voltage [V].
            step: [s].
        """
        low, high = bounds
        course = self.course(held(np.array([(high, low), (low, high), (high, high), (low, low)]), 4.0, step))
        return bool(np.isfinite(course.slopes).all() and np.isfinite(course.shown).all())

    def std(self, course: Course) -> Floats:
        """Standard deviations of a prediction (N, 4)."""
        return predicted_std(course, self._open)

    def with_course(self, course: Course, rows: int) -> float:
        """d² with so many rows of a course in addition."""
        return self._distance(self._matrix + self._work.matrix(replace(course, slopes=course.slopes[:rows])))

    def take(self, course: Course) -> None:
        """Go on from the end of a course."""
        self._matrix = self._matrix + self._work.matrix(course)
        self._states = course.ends


def _seen(joint: str, channels: Sequence[int]) -> tuple[int, ...]:
    return tuple(channel for channel in channels if joint == "free" or channel != ANGLE)


def _departures(rig: Rig, rival: str) -> list[Departure]:
    """Directions towards a rival, for each of its sizes in each of the shapes that a search tries."""
    candidate = Candidate(rival)
    out = []
    for shapes in candidate.grid():
        for size in candidate.sizes:
            name = f"{size.path} {shapes}"
            out.append(Departure(name, dict.fromkeys(size.paths, size.item.scale), fixed=shapes))
    return out


def imitation(rig: Rig, effect: str, rival: str) -> Rig:
    """The rig with a rival in the place of an effect, such that typical recordings show little difference.

    A rival that can do nothing of what the effect does has a typical size.

    Args:
        rig: with the effect.
        effect: its name.
        rival: name of the rival.
    """
    plain = without(rig, effect)
    departures, base = _departures(plain, rival), unknowns(plain)
    pressure = 0.5 * (rig.atmosphere.pressure + rig.supply.pressure)
    rest = np.array(steady_voltage(plain, pressure))
    best: tuple[float, Rig] | None = None
    for step in _STEPS:
        voltage = excitation.profile("steps", _TYPICAL_S, step, 1, excitation.Span(rest=rest[0]))
        work, there = Information(plain, (*base, *departures), step=step), Information(rig, (), step=step)
        course = work.along(work.start((pressure, pressure), rest), voltage)
        shown = there.along(there.start((pressure, pressure), rest), voltage).shown - course.shown
        if np.isfinite(course.slopes).all() and np.isfinite(shown).all():
            break
    scale = np.ptp(course.shown, axis=0) + 1e-9
    target = (shown / scale)[::5].ravel()
    columns = (course.slopes / scale[:, None])[::5].reshape(len(target), -1)
    sizes = Candidate(rival).sizes
    unbounded = np.full(len(base), np.inf)
    bounds = (
        np.append(-unbounded, [size.item.low / size.item.scale for size in sizes]),
        np.append(unbounded, [size.item.high / size.item.scale for size in sizes]),
    )
    for k, shapes in enumerate(Candidate(rival).grid()):
        first = len(base) + k * len(sizes)
        chosen = np.column_stack([columns[:, : len(base)], columns[:, first : first + len(sizes)]])
        weights = np.append(np.full(len(base), 0.1), np.full(len(sizes), 1e-3))
        rows = np.vstack([chosen, np.diag(weights)])
        amounts = lsq_linear(rows, np.append(target, np.zeros(len(weights))), bounds).x
        left = float(np.sum((target - chosen @ amounts) ** 2))
        values = dict(shapes)
        for size, amount in zip(sizes, amounts[len(base) :], strict=True):
            values |= dict.fromkeys(size.paths, size.bounded(float(amount) * size.item.scale))
        if any(values[path] for size in sizes for path in size.paths) and (best is None or left < best[0]):
            best = left, moved(plain, values)
    if best is None:
        shapes = next(iter(Candidate(rival).grid()))
        return moved(plain, {**shapes, **{path: size.item.scale for size in sizes for path in size.paths}})
    return best[1]


def told_apart(
    rig: Rig,
    effect: str,
    rivals: Sequence[str],
    limits: Limits,
    seconds: float = 60.0,
    joint: str = "free",
    lock_angle: float = 0.0,
    seed: int = 0,
    channels: Sequence[int] = tuple(range(len(CHANNELS))),
    progress: Callable[[float], None] | None = None,
) -> Verdict:
    """The experiment that tells an effect from its rivals best, as short as it may be.

    Args:
        rig: with the effect as it was found.
        effect: its name.
        rivals: effects that explain the recordings as well.
        limits: that the experiment keeps.
        seconds: longest time [s]; :data:`SHORTEST` at least.
        joint: ``free`` or ``locked``.
        lock_angle: [rad], of a locked joint.
        seed: of the search.
        channels: what is measured, indices of ``CHANNELS``.
        progress: takes how many seconds more are designed.

    Raises:
        BadInput: an effect that the catalogue or the rig does not have.
    """
    for name in (effect, *rivals):
        if name not in CATALOGUE:
            raise BadInput(f"effect {name!r}: expected one of {', '.join(CATALOGUE)}")
    pressure = 0.5 * (limits.pressure[0] + limits.pressure[1])
    rest = np.array(steady_voltage(rig, pressure))
    rng = np.random.default_rng(seed)
    questions, step = _questions(rig, effect, rivals, limits, joint, lock_angle, pressure, rest, channels)
    everyone = [question for pair in questions.values() for question in pair]

    def merit(rows: Floats) -> float:
        whole = np.concatenate([rows, held(rest[None], TAIL, step)])
        least = math.inf
        for question in everyone:
            course = question.course(whole)
            over = limits.excess(course.states, question.std(course))
            if over > 0.0:
                return FORBIDDEN * (1.0 + over)
            least = min(least, question.with_course(course, len(rows)))
        return -least if math.isfinite(least) else 2.0 * FORBIDDEN

    def go_on(rows: Floats) -> None:
        for question in everyone:
            question.take(question.course(rows))
        taken.append(rows)

    taken: list[Floats] = []
    go_on(held(rest[None], REST, step))
    while (length := sum(map(len, taken)) * step) + BLOCK + REST <= max(seconds, SHORTEST) and (
        length + REST < SHORTEST or min(chance(question.distance) for question in everyone) < SURE
    ):
        rows = best_block(merit, limits.voltage, rest, BLOCK, step, rng)
        go_on(held(rest[None], BLOCK, step) if rows is None else rows)
        if progress is not None:
            progress(BLOCK)
    go_on(held(rest[None], REST, step))
    chosen = np.concatenate(taken)
    samples = np.arange(round(len(chosen) * step / rig.sample_period)) * rig.sample_period
    voltage = chosen[np.minimum((samples / step + 1e-6).astype(np.int64), len(chosen) - 1)]
    first, second = float(rest[0]), float(rest[1])
    plan = Plan(voltage, rig.sample_period, joint, lock_angle, limits, pressure, (first, second))
    by_rival = {rival: min(chance(question.distance) for question in pair) for rival, pair in questions.items()}
    return Verdict(plan, min(by_rival.values()), by_rival)


def _questions(
    rig: Rig,
    effect: str,
    rivals: Sequence[str],
    limits: Limits,
    joint: str,
    lock_angle: float,
    pressure: float,
    rest: Floats,
    channels: Sequence[int],
) -> tuple[dict[str, list[Question]], float]:
    """For each rival whether the effect can be told from it, and it from the effect; and the step to integrate [s]."""
    pairs = {rival: ((rig, effect, rival), (imitation(rig, effect, rival), rival, effect)) for rival in rivals}
    for step in _STEPS:
        questions = {
            rival: [Question(*one, joint, lock_angle, pressure, rest, channels, step) for one in pair]
            for rival, pair in pairs.items()
        }
        if all(question.stable(limits.voltage, step) for pair in questions.values() for question in pair):
            break
    return questions, step


def promised(rig: Rig, effect: str, rivals: Sequence[str], plan: Plan, channels: Sequence[int]) -> float:
    """Chance that a plan's recording decides.

    Args:
        rig: with the effect as it was found.
        effect: its name.
        rivals: effects that explain the recordings as well.
        plan: the experiment.
        channels: what is measured, indices of ``CHANNELS`` or gauges beside them.
    """
    given = (plan.limits, plan.joint, plan.lock_angle, plan.pressure, np.array(plan.rest))
    questions, step = _questions(rig, effect, rivals, *given, channels)
    times = np.arange(round(plan.duration / step)) * step
    rows = plan.voltage[np.minimum((times / plan.period + 1e-6).astype(np.int64), len(plan.voltage) - 1)]
    everyone = [question for pair in questions.values() for question in pair]
    for question in everyone:
        question.take(question.course(rows))
    return min(chance(question.distance) for question in everyone)


def instead_of(
    rig: Rig, effect: str, rivals: Sequence[str], verdict: Verdict, channels: Sequence[int]
) -> tuple[str, ...]:
    """What else would tell: sensors that were not there, or the other condition of the joint, each tried by a design.

    Args:
        rig: with the effect as it was found.
        effect: its name.
        rivals: effects that explain the recordings as well.
        verdict: of the experiment that does not tell.
        channels: what is measured, indices of ``CHANNELS``.
    """
    plan, out = verdict.plan, []
    missing = [channel for channel in _SENSORS if channel not in channels]
    if plan.joint == "locked":
        missing = [channel for channel in missing if channel != ANGLE]
    # First by the same voltages, which is quick; with a sensor more they tell no less than before.
    by_sensor = {channel: promised(rig, effect, rivals, plan, (*channels, channel)) for channel in missing}
    if not any(value >= LIKELY for value in by_sensor.values()):
        given = (rig, effect, rivals, plan.limits, plan.duration, plan.joint, plan.lock_angle)
        by_sensor = {channel: told_apart(*given, channels=(*channels, channel)).chance for channel in missing}
    out += [f"{_SENSORS[channel]} ({value:.0%})" for channel, value in by_sensor.items() if value >= LIKELY]
    other = "locked" if plan.joint == "free" else "free"
    if not (other == "locked" and any(CATALOGUE[name].needs_motion for name in (effect, *rivals))):
        further = told_apart(rig, effect, rivals, plan.limits, plan.duration, other, channels=channels)
        if further.chance >= LIKELY:
            out.append(f"the joint {other} ({further.chance:.0%})")
    return tuple(out)
