"""An experiment that distinguishes two effects: voltages under which neither effect can imitate the other.

Suppose that effect a is present. The distance of its recordings from the best model with effect b instead is

    d² = Δ' (R + J Σ J')⁻¹ Δ.

Δ is the change of the sensors' readings by effect a, and R is the covariance of their noise. J holds the derivatives by
all that a fit would move: the base parameters with their priors Σ, and the sizes of effect b in several shapes, almost
without a prior. So d² is the information about the size of a that is left when all else is free: a Schur complement.
The same is computed with a and b exchanged. The smaller d² counts, since nobody knows which effect is present.

``close_loop`` counts one independent error a second, which reduces d² accordingly. The evidence then has a normal
distribution with mean d² and variance 4 d². The experiment decides if the evidence is strong.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear
from scipy.stats import norm

from pam_antagonist.design import information, optimal
from pam_antagonist.design.information import Departure, Information, SimulatedPiece, predicted_std, unknowns
from pam_antagonist.design.optimal import FORBIDDEN, STEP, Limits, Plan, held
from pam_antagonist.diagnosis.thresholds import STRONG
from pam_antagonist.errors import BadInput
from pam_antagonist.inference.free_parameters import Candidate, moved
from pam_antagonist.inference.likelihood import BLOCKS_PER_ERROR
from pam_antagonist.inference.trial import ANGLE, CHANNELS, TORQUE
from pam_antagonist.model.effects import CATALOGUE, parameter_path
from pam_antagonist.rig import Rig
from pam_antagonist.rig.physical import steady_voltage
from pam_antagonist.simulation import excitation

Floats = NDArray[np.float64]

SURE = 0.95
"""Chance of a decision at which an experiment is long enough."""
SHORTEST = 26.0
"""[s] Shortest experiment: ``close_loop`` needs at least 20 s in which the valves move."""
LIKELY = 0.5
"""Chance below which an experiment does not count as distinguishing the effects."""
_WIDE = 10.0
"""Prior standard deviation of a rival's sizes, in their scales: almost no constraint."""
_TYPICAL_S = 20.0
"""[s] Duration of the voltage steps to which a rival is fitted."""
_STEPS = (STEP, 2e-3, 1e-3, 5e-4)
"""[s] Integration steps: the longest that is stable for both models is used."""
_SENSORS = {
    ANGLE: "an encoder on the shaft",
    TORQUE: "a torque meter",
    information.GAUGE_1: "a third pressure sensor at muscle 1",
    information.GAUGE_2: "a third pressure sensor at muscle 2",
    information.TANK: "a third pressure sensor at the supply's tank",
}


@dataclass(frozen=True, eq=False)
class ExpectedOutcome:
    """The expected outcome of an experiment."""

    plan: Plan
    chance: float
    by_rival: dict[str, float]


def chance(distance: float) -> float:
    """Probability that the evidence is strong. `distance`: d², as ``close_loop`` counts it."""
    return float(norm.cdf((distance - STRONG) / (2.0 * math.sqrt(max(distance, 1e-9)))))


def without(rig: Rig, effect: str) -> Rig:
    """A rig without an effect."""
    return rig.replaced(effects={name: dict(values) for name, values in rig.effects.items() if name != effect})


class Distinction:
    """Whether one effect can be distinguished from another, updated as an experiment grows from the begin of a plan.

    `channels` are those that are measured, indices of ``CHANNELS`` or of the gauges; `step` of the integration [s].
    """

    def __init__(
        self, rig: Rig, effect: str, rival: str, start: Plan, channels: Sequence[int], step: float = STEP
    ) -> None:
        sizes = {parameter_path(effect, item.name) for item in CATALOGUE[effect].parameters if item.is_size}
        size = Departure(effect, adds={path: rig.value(path) for path in sizes if rig.value(path)}, share=-0.1)
        base = [item for item in unknowns(without(rig, effect)) if not item.name.startswith("effects.")]
        others = _departures(rig, rival)
        further, self._spread = optimal.uncertainty_of(rig, base)
        placed = [*base, *further, *others, size]
        # The uncertain directions come first; a prediction takes the others as certain.
        self._spread = np.vstack([self._spread, np.zeros((len(others) + 1, self._spread.shape[1]))])
        seen = tuple(channel for channel in channels if start.joint == "free" or channel != ANGLE)
        self._work = Information(rig, placed, start.joint, start.lock_angle, channels=seen, step=step)
        prior = np.ones(len(placed) - 1)
        prior[len(base) + len(further) :] = _WIDE**-2
        self._prior = np.diag(np.append(prior, 0.0))
        self._matrix = np.zeros((len(placed), len(placed)))
        self._states = self._work.start((start.pressure, start.pressure), np.array(start.rest))

    def _distance(self, matrix: Floats) -> float:
        known = matrix / BLOCKS_PER_ERROR + self._prior
        rest, across = known[:-1, :-1], known[:-1, -1]
        return max(0.0, float(known[-1, -1] - across @ np.linalg.solve(rest, across)))

    @property
    def distance(self) -> float:
        """d² of what was added so far."""
        return self._distance(self._matrix)

    def course(self, voltage: Floats) -> SimulatedPiece:
        """The simulated experiment under voltages (N, 2) [V]."""
        return self._work.along(self._states, voltage)

    def stable(self, bounds: tuple[float, float], step: float) -> bool:
        """Whether integration steps [s] of this length are stable over the whole range of the voltages [V]."""
        low, high = bounds
        course = self.course(held(np.array([(high, low), (low, high), (high, high), (low, low)]), 4.0, step))
        return bool(np.isfinite(course.slopes).all() and np.isfinite(course.shown).all())

    def std(self, course: SimulatedPiece) -> Floats:
        """Standard deviations of a prediction (N, 4)."""
        return predicted_std(course, self._spread)

    def with_course(self, course: SimulatedPiece, rows: int) -> float:
        """d² with the first rows of a course in addition."""
        return self._distance(self._matrix + self._work.matrix(replace(course, slopes=course.slopes[:rows])))

    def take(self, course: SimulatedPiece) -> None:
        """Add a course, and continue from its end."""
        self._matrix = self._matrix + self._work.matrix(course)
        self._states = course.ends


def _departures(rig: Rig, rival: str) -> list[Departure]:
    """Directions towards a rival, one for each of its sizes with each of the shapes that a search tries."""
    candidate = Candidate(rival)
    out = []
    for shapes in candidate.grid():
        for size in candidate.sizes:
            name = f"{size.path} {shapes}"
            out.append(Departure(name, adds=dict.fromkeys(size.paths, size.item.scale), fixed=shapes))
    return out


def imitation(rig: Rig, effect: str, rival: str) -> Rig:
    """The rig with a rival in place of an effect, fitted so that typical recordings differ little.

    A rival that cannot imitate the effect at all gets a typical size.
    """
    plain = without(rig, effect)
    departures, base = _departures(plain, rival), unknowns(plain)
    pressure = 0.5 * (rig.atmosphere.pressure + rig.supply.pressure)
    rest = np.array(steady_voltage(plain, pressure))
    best: tuple[float, Rig] | None = None
    for step in _STEPS:
        voltage = excitation.profile("steps", _TYPICAL_S, step, 1, excitation.DriveVoltages(rest=rest[0]))
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
) -> ExpectedOutcome:
    """The experiment that best distinguishes an effect from its rivals, no longer than needed.

    `seconds` is its longest time [s], :data:`SHORTEST` at least; `channels` are those that are measured.
    """
    for name in (effect, *rivals):
        if name not in CATALOGUE:
            raise BadInput(f"effect {name!r}: expected one of {', '.join(CATALOGUE)}")
    start = Plan.at_rest(rig, limits, joint, lock_angle)
    by_rival, step = _questions(rig, effect, rivals, start, channels)
    questions = [question for pair in by_rival.values() for question in pair]
    tail = held(np.array(start.rest)[None], optimal.TAIL, step)

    def merit(rows: Floats) -> float:
        whole, least = np.concatenate([rows, tail]), math.inf
        for question in questions:
            course = question.course(whole)
            over = limits.excess(course.states, question.std(course))
            if over > 0.0:
                return FORBIDDEN * (1.0 + over)
            least = min(least, question.with_course(course, len(rows)))
        return -least if math.isfinite(least) else 2.0 * FORBIDDEN

    def take(rows: Floats) -> None:
        for question in questions:
            question.take(question.course(rows))

    def blocks() -> Iterator[float]:
        length = optimal.REST
        while length + optimal.BLOCK + optimal.REST <= max(seconds, SHORTEST) and (
            length + optimal.REST < SHORTEST or _surest(questions) < SURE
        ):
            yield optimal.BLOCK
            length += optimal.BLOCK

    plan = optimal.grown(start, merit, take, blocks(), step, seed, progress)
    chances = {rival: _surest(pair) for rival, pair in by_rival.items()}
    return ExpectedOutcome(plan, min(chances.values()), chances)


def _surest(questions: Sequence[Distinction]) -> float:
    """Chance that the evidence decides, whichever effect is present."""
    return min(chance(question.distance) for question in questions)


def _questions(
    rig: Rig, effect: str, rivals: Sequence[str], start: Plan, channels: Sequence[int]
) -> tuple[dict[str, list[Distinction]], float]:
    """For each rival both questions (effect or rival present), and the integration step [s]."""
    pairs = {rival: ((rig, effect, rival), (imitation(rig, effect, rival), rival, effect)) for rival in rivals}
    for step in _STEPS:
        questions = {rival: [Distinction(*one, start, channels, step) for one in pair] for rival, pair in pairs.items()}
        if all(question.stable(start.limits.voltage, step) for pair in questions.values() for question in pair):
            break
    return questions, step


def promised(rig: Rig, effect: str, rivals: Sequence[str], plan: Plan, channels: Sequence[int]) -> float:
    """Chance that a recording of a plan decides, with the channels that are measured."""
    by_rival, step = _questions(rig, effect, rivals, plan, channels)
    questions = [question for pair in by_rival.values() for question in pair]
    for question in questions:
        question.take(question.course(optimal.resampled(plan.voltage, plan.period, step, plan.duration)))
    return _surest(questions)


def instead_of(
    rig: Rig, effect: str, rivals: Sequence[str], verdict: ExpectedOutcome, channels: Sequence[int]
) -> tuple[str, ...]:
    """Further sensors, or the other condition of the joint, that would decide; each is tried by a design."""
    plan = verdict.plan
    shown = (*channels, ANGLE) if plan.joint == "locked" else channels
    missing = [channel for channel in _SENSORS if channel not in shown]
    # First with the same voltages, which is fast: a further sensor never reduces the information.
    by_sensor = {channel: promised(rig, effect, rivals, plan, (*channels, channel)) for channel in missing}
    if not any(value >= LIKELY for value in by_sensor.values()):
        given = (rig, effect, rivals, plan.limits, plan.duration, plan.joint, plan.lock_angle)
        by_sensor = {channel: told_apart(*given, channels=(*channels, channel)).chance for channel in missing}
    out = [f"{_SENSORS[channel]} ({value:.0%})" for channel, value in by_sensor.items() if value >= LIKELY]
    other = "locked" if plan.joint == "free" else "free"
    if not (other == "locked" and any(CATALOGUE[name].needs_motion for name in (effect, *rivals))):
        further = told_apart(rig, effect, rivals, plan.limits, plan.duration, other, channels=channels)
        if further.chance >= LIKELY:
            out.append(f"the joint {other} ({further.chance:.0%})")
    return tuple(out)


def no_motion_decides(
    rig: Rig, effect: str, rivals: Sequence[str], verdict: ExpectedOutcome, channels: Sequence[int]
) -> str:
    """That no experiment within the limits decides, and what would."""
    text, instead = "No motion within the limits distinguishes them", instead_of(rig, effect, rivals, verdict, channels)
    return text + (f"; this would: {'; '.join(instead)}" if instead else ", nor does another sensor or a lock")
