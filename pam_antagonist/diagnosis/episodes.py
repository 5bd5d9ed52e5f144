"""What the model of a regulator-driven joint lacks, traced to effects and to signals of other joints, by episodes.

Episodes are held out whole, in two ways: the last part of the recording (*later*), and every fifth episode of what
comes before (*interleaved*). No fit and no choice sees either. Of the rest one half is fitted, the other half decides
which effect is taken; of few episodes each quarter is judged by fits to the rest. What no single effect explains is
left to many weak laws at once, with the joint's drift (:mod:`~pam_antagonist.inference.weak_laws`): one half decides
whether they are taken. An episode is one value, and neighbouring episodes may have similar errors. So all intervals
come from a bootstrap of blocks of episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis.remaining import RemainingResidual, Surroundings, described
from pam_antagonist.diagnosis.thresholds import EXPLAINED, MARGIN
from pam_antagonist.diagnosis.verdicts import EFFECT, NONE, UNEXPLAINED, Verdict
from pam_antagonist.inference.bootstrap import Interval, ratio, rmse
from pam_antagonist.inference.episode_search import ABOVE_NOISE, LEAST_REMOVED, Searched, Tried, search, with_effect
from pam_antagonist.inference.episodes import EpisodeModel, Squares
from pam_antagonist.inference.held_episodes import EpisodeSplit, held_out, thinned
from pam_antagonist.inference.point import Channel
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.total_slopes import TotalSlope, total_slopes
from pam_antagonist.inference.weak_laws import WEAK_LAWS, WeakFit, WeakModel
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Progress = Callable[[str], None]

_USED = 600
"""Most episodes in a final fit without weak laws: more add little information and take longer."""
_ROUNDS = 4
"""Simulations with derivatives of a fit that begins near its end."""
_FORECASTS = ((0.5, 0.75), (0.75, 1.0))
"""Parts of the fitted episodes that are forecast from those before them."""
_BINS = 12
"""Parts of the way that the joint has gone since an episode's start, each with its own variance of the error."""
_IN_95 = 1.96
NAMED = "with the effects"
"""Name of the model with the effects that have a name, without weak laws."""


@dataclass(frozen=True)
class Row:
    """Errors of one model [deg], as intervals by episode."""

    model: str
    later: Interval
    interleaved: Interval


@dataclass(frozen=True, eq=False)
class EpisodeDiagnosis:
    """What was found."""

    effects: tuple[str, ...]
    tried: tuple[Tried, ...]
    rows: tuple[Row, ...]  # errors of the models on episodes that no fit and no choice has seen
    model: EpisodeModel  # the last one, without its weak laws
    # the parameters of the effects alone that differ from the rig file, with 95 % intervals by episode, by dotted path.
    values: Mapping[str, Interval]
    weak: tuple[WeakFit, WeakModel] | None  # the weak laws; None if they are not taken
    # share of the squared error of unseen episodes that they remove; None where nothing above noise was left to them.
    removed: Interval | None
    slopes: tuple[TotalSlope, ...]  # how torque and friction go with what was measured, over the recording
    forecast: Interval  # error [deg] on fitted episodes by models of those before them
    counts: tuple[int, int, int]
    # share of the measured angles of later and of interleaved episodes within the free run's 95 % interval.
    coverage: tuple[float, float]
    # names of a rival and of the effect that it replaces, with the errors of the effects alone then; for rivals that
    # the episodes do not distinguish from the effect.
    others: tuple[tuple[str, str, Row], ...] = ()
    # squared error on interleaved episodes of the effects alone over that of the model with Coulomb friction alone;
    # None if there is no such model.
    ratio: Interval | None = None
    # squared error of the effects alone over what the noise of the readings alone would leave.
    left: Interval | None = None
    longest_step: float = 0.0  # of the integration [s]
    remaining: tuple[RemainingResidual, ...] = ()  # what the last model leaves above noise

    @property
    def share(self) -> float:
        """Share of the excess over noise that effects and weak laws remove, of later episodes after recalibration."""
        named = next((row for row in self.rows if row.model == NAMED), self.rows[-1])
        noise = 0.0 if self.left is None else named.later.value**2 / max(self.left.value, 1.0)
        before, after = (row.later.value**2 for row in (self.rows[1], self.rows[-1]))
        return (before - after) / (before - noise) if before > noise else 0.0

    @property
    def verdict(self) -> Verdict:
        """By the rule of all recordings: an effect explains enough of the excess, or there is hardly any."""
        if self.effects and self.share >= EXPLAINED:
            return EFFECT
        hardly_any = not self.effects and self.left is not None and self.left.low <= ABOVE_NOISE
        return NONE if hardly_any else UNEXPLAINED

    @property
    def is_better(self) -> bool:
        """Whether the extended rig is better on held-out episodes than the rig as configured: then it is proposed."""
        given, extended = self.rows[0], self.rows[-1]
        ratios = [getattr(extended, part).value / getattr(given, part).value for part in ("later", "interleaved")]
        return all(ratio <= MARGIN for ratio in ratios) and ratios[0] * MARGIN < 1.0

    def in_rig(self, rig: Rig) -> Rig:
        """A rig with the weak laws, as they are at the end of the fitted episodes."""
        return rig if self.weak is None else self.weak[0].in_rig(rig, self.weak[1])


class _Episodes(NamedTuple):
    """All episodes of one recording, or of two: the fitted ones and later ones."""

    joint: PressureDriven
    unseen: PressureDriven | None  # a recording that is held out as a whole; None: the end of the same one
    held: EpisodeSplit

    def of_model(self, model: EpisodeModel) -> tuple[Squares, Squares]:
        """Squared errors of later and of interleaved episodes."""
        later = self.joint.take(self.held.later) if self.unseen is None else self.unseen
        return _squares(later, model), _squares(self.joint.take(self.held.interleaved), model)

    @property
    def whole(self) -> tuple[PressureDriven, Indices]:
        """All episodes as of one recording, later ones last, and which are these."""
        if self.unseen is None:
            return self.joint, self.held.later
        return self.joint.followed_by(self.unseen), np.arange(len(self.joint), len(self.joint) + len(self.unseen))


@one_blas_thread
def diagnose(
    joint: PressureDriven, share: float, later: PressureDriven | None = None,
    progress: Progress = lambda text: None,
) -> EpisodeDiagnosis:  # fmt: skip
    """Trace what the model lacks.

    Args:
        joint: the episodes.
        share: of them that is held out at the end, where no other recording is.
        later: a recording of the same rig with the same further signals, held out as a whole. All episodes of
            ``joint`` may be fitted then.
        progress: is called with what is being done.
    """
    held = held_out(len(joint), 0.0 if later is not None else share)
    unseen = None if later is None else replace(later, usual=joint.usual)
    progress("base parameters")
    searched = search(joint, held.pool, progress)
    joint = replace(joint, longest_step=searched.longest_step)
    unseen = None if unseen is None else replace(unseen, longest_step=searched.longest_step)
    episodes = _Episodes(joint, unseen, held)
    base, model, tried = searched.base, searched.model, searched.tried
    coulomb = with_effect(base, joint.candidates({}).get("friction", ()), {})
    starts = {"mechanics with viscous friction": base}
    starts |= {} if coulomb is None else {"with Coulomb friction alone": coulomb}
    pool = joint.take(thinned(held.pool, _USED))
    fits, squares = {}, {"rig as configured": episodes.of_model(joint.as_configured)}
    for name, start in {**starts, NAMED: model}.items():
        progress(f"errors: {name}")
        fits[name] = pool.fit(start, _ROUNDS)
        squares[name] = episodes.of_model(fits[name])
    named = fits[NAMED]
    others = []
    for (name, instead_of), start in searched.replaced.items():
        progress(f"errors: {name} in the place of {instead_of}")
        row = _row(f"{name} in the place of {instead_of}", episodes.of_model(pool.fit(start, _ROUNDS)))
        others.append((name, instead_of, row))
    weak, removed = _weak_laws(episodes, named, searched, progress)
    taken = tuple(item.name for item in tried if item.taken)
    slopes: tuple[TotalSlope, ...] = ()
    if weak is not None:
        whole, last = episodes.whole
        squares["and with weak laws"] = (
            weak[0].squares(last, weak[1], joint.jobs), weak[0].squares(held.interleaved, weak[1], joint.jobs)
        )  # fmt: skip
        progress("what torque and friction go with")
        slopes = total_slopes(*weak, held.pool)
    forecast, coverage = _forecast(episodes, named, weak, progress)
    compared = None
    if coulomb is not None:
        compared = ratio(squares[NAMED][1].sums, squares["with Coulomb friction alone"][1].sums)
    return EpisodeDiagnosis(
        effects=(*taken, *(() if weak is None else (WEAK_LAWS,))),
        tried=tried,
        rows=tuple(_row(name, pair) for name, pair in squares.items()),
        model=named if weak is None else weak[1].model,
        values=pool.intervals(named),
        weak=weak,
        removed=removed,
        slopes=slopes,
        forecast=forecast,
        counts=(len(held.pool), len(episodes.whole[1]), len(held.interleaved)),
        coverage=coverage,
        others=tuple(others),
        ratio=compared,
        left=searched.left,
        longest_step=searched.longest_step,
        remaining=_remaining(episodes, named, weak, searched.left),
    )


def _remaining(
    episodes: _Episodes, named: EpisodeModel, weak: tuple[WeakFit, WeakModel] | None, left: Interval
) -> tuple[RemainingResidual, ...]:
    """What the last model leaves of the angle, described on the fitted episodes; none where it is hardly noise."""
    whole, later = episodes.whole
    some = thinned(np.concatenate([episodes.held.pool, later]), _USED)
    seen = whole.take(some)
    part, model = (seen, named) if weak is None else (weak[0].part(some, weak[1].numbers)[0], weak[1].model)
    states = part.course(model)
    values, counts = np.degrees(part.apart(states[:, :1])[:, 0]), _counts(part)
    alone = np.degrees(seen.apart(seen.simulated(named)))[counts, 0]
    noise = float(np.sqrt(np.mean(alone**2) / max(left.value, 1.0)))
    over = float(np.sqrt(np.mean(values[counts] ** 2))) / noise
    if over**2 <= ABOVE_NOISE:
        return ()
    late = np.repeat(np.isin(some, later), np.diff(part.first))[counts]
    time = part.time[counts]
    around = Surroundings(part.pressure[counts], None, time - time[0], states[counts, 0], states[counts, 1])
    angle, step = Channel("Angle", "°", 1.0), float(np.median(np.diff(part.time)))
    return (described(part.name, angle, over, (values[counts], noise), late, around, step),)


def _row(name: str, squares: tuple[Squares, Squares]) -> Row:
    return Row(name, *(rmse(*one) for one in squares))


def _squares(joint: PressureDriven, model: EpisodeModel) -> Squares:
    return joint.squares(joint.residual(model))


def _weak_laws(
    episodes: _Episodes, named: EpisodeModel, searched: Searched, progress: Progress
) -> tuple[tuple[WeakFit, WeakModel] | None, Interval | None]:
    """The weak laws if they remove enough of what the effects leave of unseen episodes, and what they remove."""
    if searched.left.low <= ABOVE_NOISE:
        return None, None
    joint, pool, jobs = episodes.joint, episodes.held.pool, episodes.joint.jobs
    fitted, judged = pool[::2], pool[1::2]
    alone = joint.take(thinned(fitted, _USED)).fit(named, _ROUNDS)
    half = WeakFit.of(joint, alone, fitted)
    before = _squares(joint.take(judged), alone).sums
    after = half.squares(judged, half.fitted(alone, fitted, jobs, progress), jobs).sums
    removed = ratio(before - after, before)
    if removed.low <= 0.0 or removed.value < LEAST_REMOVED:
        return None, removed
    whole = WeakFit.of(episodes.whole[0], named, pool)
    return (whole, whole.fitted(named, pool, jobs, progress)), removed


def _forecast(
    episodes: _Episodes, named: EpisodeModel, weak: tuple[WeakFit, WeakModel] | None, progress: Progress
) -> tuple[Interval, tuple[float, float]]:
    """The error on fitted episodes by models of those before them, and coverage of intervals as wide as it says.

    The error grows with the way that the joint has gone since an episode's start.
    """
    joint, pool = episodes.joint, episodes.held.pool
    parts, sums = [], []
    for begin, end in _FORECASTS:
        before, after = (pool[round(len(pool) * a) : round(len(pool) * b)] for a, b in ((0.0, begin), (begin, end)))
        alone = joint.take(thinned(before, _USED)).fit(named, _ROUNDS)
        if weak is None:
            part, model = joint.take(after), alone
        else:
            fit = WeakFit.of(joint, alone, before)
            found = fit.fitted(alone, before, joint.jobs, lambda text: progress(f"forecasts, {text}"))
            (part, _), model = fit.part(after, found.numbers), found.model
        angle = part.simulated(model)
        left = part.apart(angle)
        parts.append((_way(part, angle), left[:, 0], _counts(part)))
        sums.append(part.squares(left))
    way, left, counts = (np.concatenate(each) for each in zip(*parts, strict=True))
    edges = np.unique(np.quantile(way[counts], np.linspace(0.0, 1.0, _BINS + 1)))
    bins = np.digitize(way, edges[1:-1])
    std = np.sqrt([np.mean(left[counts & (bins == k)] ** 2) for k in range(len(edges) - 1)])
    whole, later = episodes.whole

    def covered(some: Indices) -> float:
        part, model = (
            (whole.take(some), named) if weak is None else (weak[0].part(some, weak[1].numbers)[0], weak[1].model)
        )
        angle = part.simulated(model)
        inside = np.abs(part.apart(angle)[:, 0]) <= _IN_95 * std[np.digitize(_way(part, angle), edges[1:-1])]
        return float(np.mean(inside[_counts(part)]))

    said = rmse(*(np.concatenate(each) for each in zip(*sums, strict=True)))
    return said, (covered(later), covered(episodes.held.interleaved))


def _way(joint: PressureDriven, angle: Floats) -> Floats:
    """How far a model has turned since the start of its episode, to and fro (N,) [rad]. `angle`: its own (N, 1)."""
    moved = np.abs(np.diff(angle[:, 0], prepend=0.0))
    moved[joint.first[:-1]] = 0.0
    total = np.cumsum(moved)
    return np.asarray(total - np.repeat(total[joint.first[:-1]], np.diff(joint.first)))


def _counts(joint: PressureDriven) -> NDArray[np.bool_]:
    """The rows whose angle is simulated and was measured (N,)."""
    out = np.isfinite(joint.angle)
    out[joint.first[:-1]] = False
    return out
