"""The missing law: first its place, then what it depends on, then a table; a simulation decides."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.diagnosis import arguments, law_regression, law_simulation, place_search, residual_equations
from pam_antagonist.diagnosis.arguments import Group
from pam_antagonist.diagnosis.law_regression import Regression, Whitened
from pam_antagonist.diagnosis.law_simulation import Course
from pam_antagonist.diagnosis.place_search import Place
from pam_antagonist.diagnosis.residual_equations import Equations
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import parameter_path
from pam_antagonist.rig import Rig
from pam_antagonist.rig.learned import Law, numbers_of

Floats = NDArray[np.float64]

LEAST_GAIN = 40.0
"""Least gain of a law on held-out blocks [nats]."""
LEAST_SHARE = 0.08
"""Least share of what the base leaves that a law removes in a simulation."""
_PLACES, _ARGUMENTS, _FINALISTS = 5, 2, 4
"""How many laws are simulated: so many places, arguments of each, and of these so many further."""
_ROUNDS, _LAST_ROUNDS = 4, 8
"""Steps of Gauss and Newton of a base without a law, and of the best law."""
_STEP = 0.05
_TOGETHER = 30.0
"""Blocks that a systematic error of the model makes worth one."""
_FARTHEST = 6.0
"""Standard deviations by which a step moves a base direction at most."""
_PARTS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("flow", "leak", "valve", "supply", "exchange"), ("air",)),
    **dict.fromkeys(("force", "strength"), ("torque", "angle")),
    **dict.fromkeys(("torque", "friction"), ("angle",)),
    **dict.fromkeys(("sensor", "encoder"), law_simulation.PARTS),
}
"""Parts of the model in which a law at a place shows."""
_AS_GOOD = 0.1
"""A law without memory may leave so much more, on the logarithmic scale."""
_TIE = 0.03
"""Laws that remove so nearly as much cannot be told apart."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A recording in which a law is looked for.

    Attributes:
        name: of the recording.
        stretches: without holes, of the part that may be fitted.
        period: of its samples [s].
        locked: whether the joint was held.
        p: parameter vector of the identified base (m,), free.
    """

    name: str
    stretches: Sequence[Mapping[str, Floats]]
    period: float
    locked: bool
    p: Floats


@dataclass(frozen=True, eq=False)
class Simulated:
    """A law, or none, whose values and base were fitted in a simulation.

    Attributes:
        law: None for none.
        points: parameter vector of each recording, law included.
        excess: mean square error over the noise's of each recording and channel (R, 4).
        left: what is left, on the logarithmic scale on which shares are counted.
        covariance: of the law's values (N, N).
        amounts: of the base directions of each recording, in standard deviations.
        regression: where it started; None for none.
    """

    law: Law | None
    points: tuple[Floats, ...]
    excess: Floats
    left: float
    covariance: Floats
    amounts: tuple[Floats, ...]
    regression: Regression | None = None

    @property
    def channels(self) -> frozenset[int]:
        """Channels in which the law shows: pressures, torque, angle."""
        if self.law is None:
            return frozenset()
        own = (self.law.muscle - 1,) if isinstance(self.law.muscle, int) else (0, 1)
        shown = {"air": own, "torque": (2,), "angle": (3,)}
        return frozenset(channel for part in _PARTS[self.law.place] for channel in shown[part])

    @property
    def acts_by(self) -> tuple[str, str]:
        """Place and argument of the law; empty for none."""
        return ("", "") if self.law is None else (self.law.at, self.law.argument)


@dataclass(frozen=True, eq=False)
class LawSearch:
    """What was found.

    Attributes:
        places: by the likelihood of an unknown input there, the likeliest first.
        regressions: laws by their gain on held-out blocks, the best first.
        without: the base model, recalibrated.
        found: the law; None if none is taken.
        alternatives: laws that simulate as well.
        candidates: all that were simulated, the best first.
        gain: of the taken law, or of the best one, on held-out blocks [nats].
        share: of what the base leaves that it removes in the simulation.
    """

    places: tuple[Place, ...]
    regressions: tuple[tuple[float, Regression], ...]
    without: Simulated
    found: Simulated | None
    alternatives: tuple[Simulated, ...]
    candidates: tuple[Simulated, ...]
    gain: float
    share: float


def law_of(regression: Regression) -> Law | None:
    """A regression's table as a law."""
    group = regression.group
    if group is None:
        return None
    lag = group.operator in ("lag", "high_pass")
    return Law(
        group.kind, tuple(map(float, regression.nodes)), tuple(map(float, regression.values)), group.muscle,
        group.argument, group.operator, group.amount if lag else 0.0,
        group.amount if group.operator in ("play", "stop") else 0.0,
    )  # fmt: skip


def written(p: Floats, law: Law | None, number: int) -> Floats:
    """A parameter vector with a law in it.

    Args:
        p: the vector (m,).
        law: the law; None for none.
        number: of the law in the rig.
    """
    if law is None or law.is_of_readings:
        return p
    return par.changed(p, {parameter_path("learned", name): value for name, value in numbers_of(law, number).items()})


def with_base(p: Floats, groups: Sequence[tuple[tuple[str, ...], float]], amounts: Floats) -> Floats:
    """A parameter vector whose base directions are moved by amounts in standard deviations.

    Args:
        p: the vector (m,).
        groups: of parameters that scale together, with their standard deviations.
        amounts: of each group (D,), in standard deviations.
    """
    factors: dict[str, float] = {}
    for (names, std), amount in zip(groups, amounts, strict=True):
        for name in names:
            factors[name] = factors.get(name, 1.0) * math.exp(std * amount)
    return par.changed(p, {name: p[par.INDEX[name]] * factor for name, factor in factors.items()})


def parts_of_base(names: Sequence[str]) -> tuple[str, ...]:
    """Parts of the model that base parameters act in."""
    if names[0].startswith(("joint.", "friction.")):
        return ("angle",)
    if ".force." in names[0]:
        return ("torque", "angle")
    if names[0].startswith("effects."):
        return law_simulation.PARTS
    return ("air",)


@dataclass(eq=False)
class _Problem:
    """Simulations of a law with the base of each recording."""

    rig: Rig
    subjects: Sequence[Subject]
    courses: Sequence[Sequence[Course]]
    groups: Sequence[Sequence[tuple[tuple[str, ...], float]]]
    points: list[Floats] = field(default_factory=list)
    number: int = 1
    slopes: list[list[Floats]] = field(default_factory=list)
    """Of the errors by each base direction, by recording: those that were worked out last."""

    def errors(self, r: int, law: Law | None, amounts: Floats, parts: Sequence[str] = law_simulation.PARTS) -> Floats:
        p = written(with_base(self.points[r], self.groups[r], amounts), law, self.number)
        shown = law if law is not None and law.is_of_readings else None
        return law_simulation.errors(self.courses[r], p, self.rig, parts, shown)

    def excess(self, errors: Floats) -> Floats:
        bounded = np.where(np.isfinite(errors), np.clip(errors, -1e4, 1e4), np.where(np.isnan(errors), np.nan, 1e4))
        there = np.isfinite(bounded).any(axis=0)
        out = np.full(errors.shape[1], np.nan)
        out[there] = np.nanmean(bounded[:, there] ** 2, axis=0)
        return out

    def left(self, excess: Floats) -> float:
        """Half the logarithm of the excesses, by channel: what a channel with an unknown noise loses a block."""
        return float(np.nansum(0.5 * np.log(np.maximum(excess, 1.0))))

    def evaluated(self, law: Law | None, amounts: Sequence[Floats]) -> tuple[Floats, float]:
        excess = np.array([self.excess(self.errors(r, law, a)) for r, a in enumerate(amounts)])
        return excess, self.left(excess)

    def fitted(self, law: Law | None, amounts: Sequence[Floats], rounds: int, anew: bool = False) -> Simulated:
        """Gauss-Newton on values of the law and base directions; channels weigh by what they have left.

        Args:
            law: with the values to begin with; None for none.
            amounts: of the base directions of each recording to begin with.
            rounds: most steps.
            anew: whether the slopes by base directions are worked out anew before the first step.
        """
        amounts = [a.copy() for a in amounts]
        excess, left = self.evaluated(law, amounts)
        covariance = np.zeros((0, 0))
        for number in range(rounds):
            steps, covariance = self._step(law, amounts, excess, anew and number == 0)
            better = False
            for share in (1.0, 0.4, 0.15, 0.05):
                moved = [a + share * s for a, s in zip(amounts, steps[1], strict=True)]
                changed = None if law is None else _moved_law(law, share * steps[0])
                after, rest = self.evaluated(changed, moved)
                if rest < left:
                    better = left - rest > 1e-3 * max(left, 1e-9)
                    law, amounts, excess, left = changed, moved, after, rest
                    break
            if not better:
                break
        points = tuple(
            written(with_base(p, groups, a), law, self.number)
            for p, groups, a in zip(self.points, self.groups, amounts, strict=True)
        )
        return Simulated(law, points, excess, left, covariance, tuple(amounts))

    def _slopes(self, r: int, law: Law | None, amounts: Floats) -> list[Floats]:
        now, out = self.errors(r, law, amounts), []
        for k, (names, _) in enumerate(self.groups[r]):
            moved = amounts.copy()
            moved[k] += _STEP
            out.append((self.errors(r, law, moved, parts_of_base(names)) - now) / _STEP)
        return out

    def _step(
        self, law: Law | None, amounts: Sequence[Floats], excess: Floats, anew: bool
    ) -> tuple[tuple[Floats, list[Floats]], Floats]:
        values, acts_in = (0, ()) if law is None else (len(law.values), _PARTS[law.place])
        unit = 1.0 if law is None else max(np.max(np.abs(law.values)), 1e-30)
        memory = int(law is not None and law.operator != "none")
        extra = values + memory
        sizes = [len(a) for a in amounts]
        total = sum(sizes) + extra
        if anew or not self.slopes:
            self.slopes = [self._slopes(r, law, own) for r, own in enumerate(amounts)]
        matrix, right, at = np.zeros((total, total)), np.zeros(total), 0
        for r, own in enumerate(amounts):
            now = self.errors(r, law, own)
            # What lies above the noise hangs together: it is worth fewer values.
            above = np.maximum(np.nan_to_num(excess[r], nan=1.0), 1.0)
            weight = 1.0 / np.sqrt(above * np.minimum(above, _TOGETHER))
            columns = list(self.slopes[r])
            for k in range(extra):
                step = np.zeros(extra)
                step[k] = _STEP * (unit if k < values else 1.0)
                columns.append((self.errors(r, _moved_law(law, step), own, acts_in) - now) / _STEP)
            jacobian = np.nan_to_num(np.array(columns) * weight, nan=0.0, posinf=0.0, neginf=0.0)
            jacobian = np.clip(jacobian, -1e6, 1e6).reshape(len(columns), -1)
            residual = np.clip(np.nan_to_num(now * weight, nan=0.0, posinf=0.0, neginf=0.0), -1e3, 1e3).ravel()
            where = np.r_[at : at + sizes[r], total - extra : total]
            matrix[np.ix_(where, where)] += jacobian @ jacobian.T
            right[where] -= jacobian @ residual
            at += sizes[r]
        prior = np.eye(total)
        flat = np.concatenate(list(amounts))
        right[: len(flat)] -= flat
        if values:
            scale = np.trace(matrix[total - extra : total - memory, total - extra : total - memory]) / values
            second = np.diff(np.eye(values), 2, axis=0) if values > 2 else np.zeros((0, values))
            rough = 1e-4 * scale * (second.T @ second)
            rows = slice(total - extra, total - memory)
            prior[rows, rows] = rough + 1e-6 * max(scale, 1e-9) * np.eye(values)
            right[rows] -= rough @ (np.array(law.values) / unit)  # type: ignore[union-attr]
        if memory:
            prior[-1, -1] = 1.0
        inverse = np.linalg.inv(matrix + prior)
        step = inverse @ right
        step *= min(1.0, _FARTHEST / max(float(np.max(np.abs(step[: len(flat)]))), 1e-9))
        covariance = inverse[total - extra : total - memory, total - extra : total - memory] * unit**2
        parts, at = [], 0
        for size in sizes:
            parts.append(step[at : at + size])
            at += size
        law_step = step[total - extra :].copy()
        law_step[:values] *= unit
        return (law_step, parts), covariance


def _moved_law(law: Law | None, step: Floats) -> Law:
    """A law whose values, and then the logarithm of its memory, are moved."""
    assert law is not None
    count = len(law.values)
    moved = replace(law, values=tuple(float(v) for v in np.array(law.values) + step[:count]))
    if len(step) > count:
        factor = math.exp(min(max(float(step[count]), -0.7), 0.7))
        moved = replace(moved, time=law.time * factor, width=law.width * factor)
    return moved


def law_search(
    subjects: Sequence[Subject], rig: Rig, progress: Callable[[str], None] = lambda text: None, number: int = 1
) -> LawSearch:
    """Look for one law that the model lacks.

    Args:
        subjects: recordings of one rig.
        rig: for sensors and uncertain directions.
        progress: called with what is being done.
        number: of the law in the rig.
    """
    progress("recalibrating the base parameters")
    courses = [law_simulation.courses(s.stretches, s.period, s.locked) for s in subjects]
    groups = [residual_equations.base_groups(rig)] * len(subjects)
    problem = _Problem(rig, subjects, courses, groups, [s.p for s in subjects], number)
    without = problem.fitted(None, [np.zeros(len(g)) for g in groups], _ROUNDS, anew=True)
    progress("residual equations")
    equations = [
        residual_equations.equations(s.name, rig, p, s.stretches, s.period, s.locked, amounts)
        for s, p, amounts in zip(subjects, without.points, without.amounts, strict=True)
    ]
    whitened = [Whitened.of(one) for one in equations]
    products = law_regression.grams(whitened, None)
    assert products is not None
    null = law_regression.regression(products, None)
    level = law_regression.regression(products, None, level=True)
    progress("place")
    places = place_search.search(equations)
    progress("what it depends on")
    ranked = _regressions(whitened, equations, places, (null, level))
    progress("simulation")
    tried = _simulated(problem, ranked, without.amounts)
    best = tried[0] if tried else None
    share = 0.0 if best is None else 1.0 - best.left / max(without.left, 1e-9)
    gain = max((g for g, r in ranked if best is not None and r.group == best.regression.group), default=0.0)  # type: ignore[union-attr]
    taken = best if best is not None and share >= LEAST_SHARE and gain >= LEAST_GAIN else None
    others = tuple(
        t for t in tried[1:]
        if taken is not None and t.left - taken.left < _TIE * without.left and t.acts_by != taken.acts_by
    )  # fmt: skip
    return LawSearch(tuple(places), tuple(ranked), without, taken, others, tuple(tried), gain, share)


def is_further(first: LawSearch, second: LawSearch) -> bool:
    """Whether a law that was looked for beside another one is taken.

    It removes enough of what there was, and it shows in other channels: in those of the first one it would correct the
    first one's form. Then it is taken only if it says so, by the same place and argument.

    Args:
        first: search for the first law.
        second: search for the second one, with the first one in the model.
    """
    if first.found is None or second.found is None:
        return False
    removed = second.without.left - second.found.left
    other = not first.found.channels & second.found.channels or first.found.acts_by == second.found.acts_by
    return other and removed >= LEAST_SHARE * first.without.left


def _regressions(
    whitened: Sequence[Whitened],
    equations: Sequence[Equations],
    places: Sequence[Place],
    without: tuple[Regression, Regression],
) -> list[tuple[float, Regression]]:
    """Laws by their gain on held-out blocks, each with and without a random walk beside it."""
    found: list[tuple[float, Regression]] = []

    def tried(group: Group) -> None:
        products = law_regression.grams(whitened, group)
        if products is not None:
            for flat in (False, True):
                one = law_regression.regression(products, group, level=flat)
                found.append((one.gain(without[int(flat)]), one))

    names = [place.name for place in places if place.gain > 0.0]
    for group in arguments.plain_groups(names):
        tried(group)
    best = sorted((item for item in found if item[1].group is not None), key=lambda item: -item[0])
    for group in dict.fromkeys(one.group for _, one in best[: 2 * _PLACES] if one.group is not None):
        if group.argument != "none":
            tried(replace(group, number=arguments.FINE))
    span = lambda group: float(np.ptp(arguments.nodes_of(group, equations)))  # noqa: E731
    for group in arguments.groups_with_memory(_leading(found, places), span):
        tried(group)
    return sorted(found, key=lambda item: -item[0])


def _leading(found: Sequence[tuple[float, Regression]], places: Sequence[Place]) -> list[str]:
    """The places at which laws with memory are tried: those of the best laws, and the likeliest ones."""
    by_gain = sorted(found, key=lambda item: -item[0])
    names = [item.group.place for _, item in by_gain if item.group is not None]
    likely = [place.name for place in places]
    mixed = [name for pair in zip(dict.fromkeys(names), likely, strict=False) for name in pair]
    return list(dict.fromkeys(mixed))[: _PLACES + 1]


def _simulated(
    problem: _Problem, ranked: Sequence[tuple[float, Regression]], begin: Sequence[Floats]
) -> list[Simulated]:
    """The best laws, simulated and fitted there, in rounds of fewer and fewer; what is left decides."""
    starts: dict[Group, Simulated] = {}
    for group in _chosen(ranked):
        for _, one in ranked:
            law = law_of(one)
            if one.group != group or law is None or not any(law.values):
                continue
            near = tuple(a + b for a, b in zip(begin, one.base, strict=True))
            excess, left = problem.evaluated(law, near)
            if group not in starts or left < starts[group].left:
                starts[group] = Simulated(law, (), excess, left, np.zeros((0, 0)), near, one)
    standing = list(starts.values())
    for most, rounds in ((len(standing), 1), (_FINALISTS, 2), (1, _LAST_ROUNDS)):
        fitted = [
            replace(problem.fitted(item.law, item.amounts, rounds, anew=most == 1), regression=item.regression)
            for item in standing[:most]
        ]
        standing = sorted([*fitted, *standing[most:]], key=lambda item: item.left)
    return _simplest(problem, standing, ranked) if standing else standing


def _chosen(ranked: Sequence[tuple[float, Regression]]) -> list[Group]:
    """Laws to simulate: of the places with the best ones, with and without a walk, those by the best arguments."""
    chosen: dict[Group, None] = {}
    for level in (False, True):
        by_place: dict[str, dict[tuple[str, bool], Group]] = {}
        for gain, one in ranked:
            law = law_of(one)
            if gain < LEAST_GAIN or bool(np.all(one.walks == 0)) is not level or law is None or one.group is None:
                continue
            if law.complaint() and not law.is_of_readings:
                continue
            if one.group.place in by_place or len(by_place) < _PLACES:
                own = by_place.setdefault(one.group.place, {})
                key = one.group.argument, one.group.operator == "none"
                if key in own or len(own) < _ARGUMENTS:
                    own.setdefault(key, one.group)
        chosen.update(dict.fromkeys(group for own in by_place.values() for group in own.values()))
    return list(chosen)


def _simplest(problem: _Problem, done: list[Simulated], ranked: Sequence[tuple[float, Regression]]) -> list[Simulated]:
    """The same, and the best law without its memory where that simulates as well."""
    best = done[0]
    assert best.regression is not None and best.regression.group is not None and best.law is not None
    if best.law.operator == "none":
        return done
    bare = replace(best.regression.group, operator="none", amount=0.0)
    starts = [best.law] if best.law.operator in ("lag", "play") else []
    starts += [law for _, one in ranked if one.group == bare and (law := law_of(one)) is not None and any(law.values)]
    plain = [
        problem.fitted(replace(law, operator="none", time=0.0, width=0.0), amounts, _ROUNDS)
        for law in starts[:2]
        for amounts in (best.amounts,)
        if law.argument != "draw"
    ]
    plain.sort(key=lambda item: item.left)
    if plain and plain[0].left <= best.left + _AS_GOOD:
        return [replace(plain[0], regression=replace(best.regression, group=bare)), *done[1:]]
    return done
