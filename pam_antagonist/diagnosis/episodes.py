"""What the model of a regulator-driven joint lacks, traced to effects and to signals of other joints, by episodes.

Episodes are held out whole, in two ways: the last part of the recording (*later*), and every fifth episode of what
comes before (*interleaved*). No fit and no choice sees either. Of the rest one half is fitted, the other half decides
which effect is taken; of few episodes each quarter is judged by fits to the rest. An episode is one value, and
neighbouring episodes may have similar errors. So all intervals come from a bootstrap of blocks of episodes.

Drift, and the best number of last episodes to fit a model to, are worked out to first order, from products of the
model's derivatives by episode. Errors are those of simulations, but for forecasts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis.thresholds import MARGIN
from pam_antagonist.inference.bootstrap import CHANCE, Interval, ratio, rmse
from pam_antagonist.inference.episode_search import Tried, search, with_effect
from pam_antagonist.inference.episodes import EpisodeModel, Squares
from pam_antagonist.inference.held_episodes import EpisodeSplit, held_out, last, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

WINDOWS = (1.0, 0.5, 0.25, 0.125, 0.0625)
"""Windows for a model of later episodes: shares of the fitted episodes, the last of them."""
PARTS = 8
_FITTED = 100
"""Most episodes of a part that are fitted."""
_POINTS = (1, 2, 3, 5, 9)
"""Numbers of points through which the lines of drifting numbers may go; of one, nothing drifts."""
_GROUPS = 24
"""Groups of neighbouring episodes, each simulated with its own numbers."""
_RIDGE = 1e-3
"""Added to the products of each number with itself, as a share: what few episodes hardly determine stays as it is."""
_LINE_ROUNDS = 2
"""Steps of a fit that begins near its end, each with derivatives of its own."""


@dataclass(frozen=True, eq=False)
class Drift:
    """Parameters and errors of a model over a recording."""

    # its parameters in each part of the recording, fitted to the part alone, with 95 % intervals by episode, by dotted
    # path.
    values: Mapping[str, tuple[Interval, ...]]
    # of each from the first to the last part along a straight line, with an interval that is corrected for the number
    # of parameters.
    changes: Mapping[str, Interval]
    # error [deg] in each part, of the model fitted to all that may be fitted, and of that fitted to the part.
    errors: tuple[tuple[float, float], ...]


class LinearEpisodes:
    """Episodes to first order around a model."""

    def __init__(self, joint: PressureDriven, model: EpisodeModel) -> None:
        self._at, self._model, self._joint = joint.coordinates(model), model, joint
        left = joint.residual(model)
        slopes, parts = joint.slopes(model, left), joint.spans
        self.grams = np.stack([slopes[a:b].T @ slopes[a:b] for a, b in parts])  # by episode (E, K, K)
        self.pulls = np.stack([slopes[a:b].T @ left[a:b].ravel() for a, b in parts])  # likewise (E, K)
        self.sums, self.counts = joint.squares(left)

    def fitted(self, weights: Floats) -> EpisodeModel:
        """The model with the least squared error. `weights`: of the episodes (E,)."""
        step = solved(np.tensordot(weights, self.grams, 1), weights @ self.pulls)
        return self._joint.moved(self._model, self._at + step)

    def left(self, steps: Floats) -> Floats:
        """Squared errors (E,) after steps of the coordinates (E, K)."""
        found = self.sums + 2.0 * np.sum(self.pulls * steps, axis=1)
        return np.asarray(found + np.einsum("ek,ekl,el->e", steps, self.grams, steps))


def solved(gram: Floats, pull: Floats) -> Floats:
    """The step with the least squared error."""
    return np.asarray(-np.linalg.solve(gram + _RIDGE * np.diag(np.diag(gram)) + 1e-12 * np.eye(len(gram)), pull))


def course(joint: PressureDriven, held: EpisodeSplit, everything: EpisodeModel) -> Drift:
    """The model's parameters and errors over the recording, each part fitted by itself.

    `held`: which episodes are held out; the interleaved ones are not used.
    """
    best: list[dict[str, float]] = []
    spread = []
    errors = []
    for number, part in enumerate(np.array_split(np.union1d(held.pool, held.later), PARTS)):
        here = joint.take(thinned(part, _FITTED))
        found = everything
        for _ in range(_LINE_ROUNDS):
            found = LinearEpisodes(here, found).fitted(np.ones(len(here)))
        best.append(here.shown(found))
        spread.append(here.draws(found, number))
        pair = (np.degrees(here.squares(here.residual(m)).rmse) for m in (everything, found))
        errors.append((float(next(pair)), float(next(pair))))
    line = np.linspace(-0.5, 0.5, PARTS)
    line /= line @ line
    values, changes = {}, {}
    for name in best[0]:
        at, drawn = np.array([one[name] for one in best]), np.array([one[name] for one in spread])
        values[name] = tuple(Interval.of(value, row) for value, row in zip(at, drawn, strict=True))
        changes[name] = Interval.of(line @ at, line @ drawn, CHANCE / len(best[0]))
    return Drift(values, changes, tuple(errors))


def forecasts(pool: LinearEpisodes) -> tuple[float, ...]:
    """Errors [deg] of all windows on the episodes that follow them: the last three eighths, one after the other.

    `pool`: episodes that may be fitted.
    """
    count = len(pool.sums)
    edges = [round(count * share / PARTS) for share in (5, 6, 7, 8)]
    out = []
    for window in WINDOWS:
        total = 0.0
        for begin, end in zip(edges[:-1], edges[1:], strict=True):
            fitted = last(np.arange(begin), min(1.0, max(1, round(count * window)) / begin))
            step = solved(pool.grams[fitted].sum(axis=0), pool.pulls[fitted].sum(axis=0))
            total += float(pool.left(np.tile(step, (count, 1)))[begin:end].sum())
        out.append(float(np.degrees(np.sqrt(max(total, 0.0) / pool.counts[edges[0] :].sum()))))
    return tuple(out)


class Lines:
    """A model whose parameters follow lines through some points over a recording.

    The number of points is that with which every other fitted episode tells most of the rest. After the last fitted
    episode the parameters stay, since nothing says that the drift goes on.
    """

    def __init__(self, joint: PressureDriven, pool: Indices, model: EpisodeModel, linear: LinearEpisodes) -> None:
        """`pool`: episodes that are fitted. `linear`: they to first order."""
        self._joint, self._model, self._last = joint, model, float(pool[-1])
        count = len(linear.pulls)
        other = np.arange(count) % 2 == 1
        left = []
        for points in _POINTS:
            hats = self._hats(pool, points)
            steps = hats @ _along(hats[~other], linear.grams[~other], linear.pulls[~other])
            left.append(linear.left(steps)[other].sum())
        self.points = _POINTS[int(np.argmin(left))]
        self._at = np.tile(joint.coordinates(model), (self.points, 1))
        for _ in range(_LINE_ROUNDS):
            parts = [LinearEpisodes(one, here) for one, here in self._groups(pool)]
            grams, pulls = np.concatenate([one.grams for one in parts]), np.concatenate([one.pulls for one in parts])
            self._at = self._at + _along(self._hats(pool, self.points), grams, pulls)

    def _hats(self, episodes: Indices, points: int) -> Floats:
        """Shares of the points in the parameters of episodes (E, P)."""
        at = np.minimum(episodes / self._last, 1.0) * max(points - 1, 1)
        return np.maximum(1.0 - np.abs(at[:, None] - np.arange(points)), 0.0) if points > 1 else np.ones((len(at), 1))

    def _groups(self, episodes: Indices) -> list[tuple[PressureDriven, EpisodeModel]]:
        """Groups of neighbouring episodes with their models."""
        parts = [part for part in np.array_split(episodes, _GROUPS) if len(part)]
        middles = self._hats(np.array([part.mean() for part in parts]), self.points) @ self._at
        models = [self._joint.moved(self._model, at) for at in middles]
        return [(self._joint.take(part), model) for part, model in zip(parts, models, strict=True)]

    def between(self, episodes: Indices) -> Squares:
        """Squared errors of episodes among the fitted ones. `episodes`: numbers of some (K,), in order."""
        sums, counts = zip(*(one.squares(one.residual(here)) for one, here in self._groups(episodes)), strict=True)
        return Squares(np.concatenate(sums), np.concatenate(counts))

    def later(self, unseen: PressureDriven) -> Squares:
        """Squared errors of episodes after the fitted ones."""
        return unseen.squares(unseen.residual(self._joint.moved(self._model, self._at[-1])))


def _along(hats: Floats, grams: Floats, pulls: Floats) -> Floats:
    """Steps at the points of lines (P, K) with the least squared error, from products by episode."""
    points, count = hats.shape[1], pulls.shape[1]
    gram = np.einsum("ep,eq,ekl->pkql", hats, hats, grams, optimize=True).reshape(points * count, points * count)
    return solved(gram, (hats.T @ pulls).ravel()).reshape(points, count)


_USED = 600
"""Most episodes in a final fit: more add little information and take longer."""
_ROUNDS = 4
"""Simulations with derivatives of a fit that begins near its end."""
_BINS = 12
"""Parts of the time since an episode's start, each with its own variance of what the model leaves."""
_IN_95 = 1.96


@dataclass(frozen=True)
class Row:
    """Errors of one model [deg], as intervals by episode."""

    model: str
    later: Interval
    recent: Interval | None
    interleaved: Interval | None

    @property
    def forecast(self) -> Interval:
        """The error on later episodes of the model that is meant for them."""
        return self.later if self.recent is None else self.recent


@dataclass(frozen=True, eq=False)
class EpisodeDiagnosis:
    """What was found."""

    effects: tuple[str, ...]
    tried: tuple[Tried, ...]
    rows: tuple[Row, ...]  # errors of the models on episodes that no fit and no choice has seen
    model: EpisodeModel  # the extended one, fitted to the last ``window`` of the fitted episodes
    # its parameters that differ from the rig file, with 95 % intervals by episode, by dotted path.
    values: Mapping[str, Interval]
    window: float  # share of the fitted episodes from which a model for later ones is fitted
    forecasts: tuple[float, ...]  # error [deg] of each window of ``WINDOWS`` on fitted episodes that follow it
    drift: Drift  # parameters of the extended model over the recording, fitted to each part of it anew
    counts: tuple[int, int, int]
    # errors of the extended model with parameters that follow lines over the fitted episodes, through so many points.
    lines: Row
    points: int
    # share of the measured angles of later and of interleaved episodes within the free run's 95 % interval.
    coverage: tuple[float, float]
    # names of a rival and of the effect that it replaces, with the errors of the extended model then; for rivals that
    # the episodes do not distinguish from the effect.
    others: tuple[tuple[str, str, Row], ...] = ()
    # squared error on interleaved episodes of the extended model over that of the model with Coulomb friction alone;
    # None if there is no such model.
    ratio: Interval | None = None
    # squared error of the extended model over what the noise of the readings alone would leave.
    left: Interval | None = None
    longest_step: float = 0.0  # of the integration [s]

    @property
    def is_better(self) -> bool:
        """Whether the extended rig is better on held-out episodes than the rig as configured: then it is proposed."""
        given, extended = self.rows[0], self.rows[-1]
        pairs = [(given.forecast, extended.forecast), (given.interleaved, extended.interleaved)]
        ratios = [after.value / before.value for before, after in pairs if before is not None and after is not None]
        return all(ratio <= MARGIN for ratio in ratios) and ratios[0] * MARGIN < 1.0


@one_blas_thread
def diagnose(
    joint: PressureDriven, share: float, later: PressureDriven | None = None,
    progress: Callable[[str], None] = lambda text: None,
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
    unseen = joint.take(held.later) if later is None else replace(later, usual=joint.usual)
    progress("base parameters")
    searched = search(joint, held.pool, progress)
    joint, unseen = (replace(one, longest_step=searched.longest_step) for one in (joint, unseen))
    base, model, tried, replaced = searched.base, searched.model, searched.tried, searched.replaced
    coulomb = with_effect(base, joint.candidates({}).get("friction", ()), {})
    models = {"mechanics with viscous friction": base}
    if coulomb is not None:
        models["with Coulomb friction alone"] = coulomb
    models["extended"] = model
    pool = joint.take(thinned(held.pool, _USED))
    progress("from how many episodes a model for later ones is fitted")
    whole = pool.fit(model, _ROUNDS)
    linear = LinearEpisodes(pool, whole)
    expected = forecasts(linear)
    window = WINDOWS[int(np.argmin(expected))]
    judged = {}
    for name, start in models.items():
        progress(f"errors: {name}")
        fitted = whole if start is model else pool.fit(start)
        judged[name] = _judged(joint, unseen, held, name, fitted, window)
    extended = judged["extended"]
    others = []
    for (name, instead_of), start in replaced.items():
        progress(f"errors: {name} in the place of {instead_of}")
        title = f"extended, {name} in the place of {instead_of}"
        others.append((name, instead_of, _judged(joint, unseen, held, title, pool.fit(start, _ROUNDS), window).row))
    progress("errors: numbers along lines")
    lines = Lines(joint, thinned(held.pool, _USED), whole, linear)
    drifting = Row(
        "extended, numbers along lines", rmse(*lines.later(unseen)), None, rmse(*lines.between(held.interleaved))
    )  # fmt: skip
    progress("drift")
    recent = joint.take(thinned(last(held.pool, window), _USED))
    values = recent.intervals(extended.recent)
    coverage = (
        covered(recent, unseen, extended.recent), covered(pool, joint.take(held.interleaved), whole)
    )  # fmt: skip
    compared = None
    if coulomb is not None:
        compared = ratio(extended.squares, judged["with Coulomb friction alone"].squares)
    rows = (_configured(joint, unseen, held), *(one.row for one in judged.values()))
    return EpisodeDiagnosis(
        tuple(item.name for item in tried if item.taken), tried, rows, extended.recent, values, window, expected,
        course(joint, held, whole), (len(held.pool), len(unseen), len(held.interleaved)), drifting, lines.points,
        coverage, tuple(others), compared, searched.left, searched.longest_step,
    )  # fmt: skip


def covered(fitted: PressureDriven, unseen: PressureDriven, model: EpisodeModel) -> float:
    """Share of the measured angles within the 95 % interval of a free run.

    The interval's variance is that of the numbers, carried to the angle by their derivatives, plus that of what the
    model leaves of each fitted episode, fitted without it, at the same time since the start.
    """
    linear = LinearEpisodes(fitted, model)
    whole = linear.grams.sum(axis=0)
    inverse = np.linalg.pinv(whole, hermitian=True)
    covariance = inverse @ (linear.pulls.T @ linear.pulls) @ inverse
    left, since = fitted.residual(model), _since_start(fitted)
    change = fitted.slopes(model, left)
    left = left[:, 0].copy()
    for (begin, end), gram, pull in zip(fitted.spans, linear.grams, linear.pulls, strict=True):
        left[begin:end] -= change[begin:end] @ solved(whole - gram, pull)
    left = left**2
    counts = (since > 0.0) & np.isfinite(fitted.angle)
    edges = np.quantile(since[counts], np.linspace(0.0, 1.0, _BINS + 1))
    bins = np.digitize(since, edges[1:-1])
    variances = [np.mean(left[counts & (bins == k)]) for k in range(_BINS)]
    apart = unseen.residual(model)
    slopes = unseen.slopes(model, apart)
    of_numbers = np.einsum("nk,kl,nl->n", slopes, covariance, slopes, optimize=True)
    own = np.interp(_since_start(unseen), 0.5 * (edges[1:] + edges[:-1]), variances)
    judged = (_since_start(unseen) > 0.0) & np.isfinite(unseen.angle)
    inside = np.abs(apart[:, 0]) <= _IN_95 * np.sqrt(of_numbers + own)
    return float(np.mean(inside[judged]))


def _since_start(joint: PressureDriven) -> Floats:
    """Time since the start of its episode (N,) [s]."""
    return np.asarray(joint.time - np.repeat(joint.time[joint.first[:-1]], np.diff(joint.first)))


def _configured(joint: PressureDriven, unseen: PressureDriven, held: EpisodeSplit) -> Row:
    between = joint.take(held.interleaved)
    model = joint.as_configured
    return Row(
        "rig as configured", rmse(*unseen.squares(unseen.residual(model))), None,
        rmse(*between.squares(between.residual(model))),
    )  # fmt: skip


class _Judged(NamedTuple):
    """A model that was fitted anew, and its errors."""

    row: Row
    squares: Floats
    recent: EpisodeModel


def _judged(
    joint: PressureDriven, unseen: PressureDriven, held: EpisodeSplit, name: str, whole: EpisodeModel, window: float
) -> _Judged:
    """`whole`: the model fitted to all episodes that may be fitted."""
    later = rmse(*unseen.squares(unseen.residual(whole)))
    forecast_error, recent = later, whole
    if window < 1.0:
        near = joint.take(thinned(last(held.pool, window), _USED))
        recent = near.fit(LinearEpisodes(near, whole).fitted(np.ones(len(near))), _ROUNDS // 2)
        forecast_error = rmse(*unseen.squares(unseen.residual(recent)))
    between = joint.take(held.interleaved)
    squares = between.squares(between.residual(whole))
    return _Judged(Row(name, later, forecast_error, rmse(*squares)), squares.sums, recent)
