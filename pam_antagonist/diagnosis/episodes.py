"""What the model of a regulator-driven joint lacks, traced to effects and to signals of other joints, by episodes.

Episodes are held out whole, in two ways: the last part of the recording (*later*), and every fifth episode of what
comes before (*interleaved*). No fit and no choice sees either. Of the rest one half is fitted, the other half decides
which effect is taken. An episode is one independent value, and neighbouring ones may err alike, so that all intervals
come from a bootstrap of blocks of episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.episode_drift import WINDOWS, Drift, course, forecast
from pam_antagonist.diagnosis.episode_lines import StraightLines
from pam_antagonist.inference.bootstrap import Interval, ratio, rmse
from pam_antagonist.inference.episode_values import intervals
from pam_antagonist.inference.free_parameters import Candidate
from pam_antagonist.inference.held_episodes import Held, held_out, last, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven, PressureModel

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

MOST = 6
"""Effects at most; each signal that friction goes with counts as one."""
LEAST_OF_ALL = 0.01
"""Share of the squared error without effects that an effect removes at least. What is left at the end may be due to the
form of the others: on a simulated joint, creep that was not there removed 5 % of what was nearly nothing."""
_FITTED, _SCORED, _USED = 300, 400, 600
"""Episodes in a fit of the search, in its judgement, and in a final fit: more tell hardly more and take longer."""
_REFITTED = 3
"""Candidates of a round that are fitted: those with the best scores."""


@dataclass(frozen=True)
class Tried:
    """An effect in one round of the search.

    Attributes:
        name: the effect, with the signal by which it goes.
        round: how many effects the model had before, plus one.
        score: share of the squared error that it would remove of what was fitted, to first order.
        removed: share that it removed of episodes that its fit has not seen, with an interval that is corrected for how
            many effects were offered; None where the score was too low for a fit.
        taken: whether it is in the model.
    """

    name: str
    round: int
    score: float
    removed: Interval | None = None
    taken: bool = False


@dataclass(frozen=True)
class Row:
    """Errors of one model [deg], as intervals by episode.

    Attributes:
        model: its name.
        later: on later episodes, fitted to all before.
        recent: on later episodes, fitted to the last ones before.
        interleaved: on every fifth episode, fitted to the others.
    """

    model: str
    later: Interval
    recent: Interval | None
    interleaved: Interval | None


@dataclass(frozen=True, eq=False)
class EpisodeDiagnosis:
    """What was found.

    Attributes:
        effects: names of the effects that were taken, in order.
        tried: all that were tried, by rounds.
        rows: errors of the models on episodes that no fit and no choice has seen.
        model: the extended one, fitted to the last ``window`` of the fitted episodes.
        values: its parameters that differ from the rig file, with 95 % intervals by episode, by dotted path.
        window: share of the fitted episodes from which a model for later ones is fitted.
        forecasts: error [deg] of each window of ``WINDOWS`` on fitted episodes that follow it.
        drift: numbers of the extended model over the recording, fitted to each part of it anew.
        counts: episodes fitted, later and interleaved.
        lines: errors of the extended model with numbers that go along straight lines over the fitted episodes.
        others: errors of the extended model with an effect in the place of one that it was not told apart from, each
            with the names of both: the one, and the one whose place it takes.
        ratio: squared error of the extended model on interleaved episodes by that of the model with Coulomb friction
            alone; None where that is not known.
        left: squared error of the extended model over what the noise of the readings alone would leave.
    """

    effects: tuple[str, ...]
    tried: tuple[Tried, ...]
    rows: tuple[Row, ...]
    model: PressureModel
    values: Mapping[str, Interval]
    window: float
    forecasts: tuple[float, ...]
    drift: Drift
    counts: tuple[int, int, int]
    lines: Row
    others: tuple[tuple[str, str, Row], ...] = ()
    ratio: Interval | None = None
    left: Interval | None = None


@one_blas_thread
def diagnose(
    joint: PressureDriven, share: float, later: PressureDriven | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> EpisodeDiagnosis:  # fmt: skip
    """Trace what the model lacks.

    Args:
        joint: the episodes.
        share: of them that is held out at the end, where no other recording is.
        later: a recording that is held out as a whole, of the same rig with the same further signals; then all of the
            other one may be fitted.
        progress: is called with what is being done.
    """
    held = held_out(len(joint), 0.0 if later is not None else share)
    unseen = joint.take(held.later) if later is None else replace(later, usual=joint.usual)
    progress("base parameters")
    searched = search(joint, held.pool, progress)
    base, model, tried, replaced = searched.base, searched.model, searched.tried, searched.replaced
    coulomb = _with(base, joint.candidates({}).get("friction", ()), {})
    models = {"mechanics with viscous friction": base}
    if coulomb is not None:
        models["with Coulomb friction alone"] = coulomb
    models["extended"] = model
    progress("from how many episodes a model for later ones is fitted")
    forecasts = tuple(forecast(joint, held.pool, model, window) for window in WINDOWS)
    window = WINDOWS[int(np.argmin(forecasts))]
    rows, squares = [_configured(joint, unseen, held)], {}
    for name, start in models.items():
        progress(f"errors: {name}")
        row, squares[name], whole, fitted = _row(joint, unseen, held, name, start, window)
        rows.append(row)
    others = []
    for (name, instead_of), start in replaced.items():
        progress(f"errors: {name} in the place of {instead_of}")
        title = f"extended, {name} in the place of {instead_of}"
        others.append((name, instead_of, _row(joint, unseen, held, title, start, window)[0]))
    progress("errors: numbers along straight lines")
    lines = StraightLines(joint, held, whole)
    drifting = Row(
        "extended, numbers along straight lines", rmse(*lines.later(unseen)), None,
        rmse(*lines.between(joint, held.interleaved)),
    )  # fmt: skip
    recent = joint.take(thinned(last(held.pool, window), _USED))
    progress("drift")
    drift = course(joint, held, whole)
    compared = None
    if coulomb is not None:
        compared = ratio(squares["extended"], squares["with Coulomb friction alone"])
    return EpisodeDiagnosis(
        tuple(item.name for item in tried if item.taken), tried, tuple(rows), fitted, intervals(recent, fitted),
        window, forecasts, drift, (len(held.pool), len(unseen), len(held.interleaved)), drifting, tuple(others),
        compared, searched.left,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search for effects found.

    Attributes:
        base: the model without any.
        model: the extended one.
        tried: all that were tried, by rounds.
        replaced: the extended one with an effect that may remove as much as one that was taken in its place, by both
            their names.
        left: squared error of the extended model over what the noise of the readings alone would leave.
    """

    base: PressureModel
    model: PressureModel
    tried: tuple[Tried, ...]
    replaced: Mapping[tuple[str, str], PressureModel]
    left: Interval


def search(joint: PressureDriven, pool: Indices, progress: Callable[[str], None]) -> Searched:
    """Add effects to the base model, one in each round, as long as something is left that is not noise.

    Args:
        joint: the episodes.
        pool: that may be used.
        progress: is called with what is being done.
    """
    fitted, judged = joint.take(thinned(pool[::2], _FITTED)), joint.take(thinned(pool[1::2], _SCORED))
    base = model = fitted.fit(fitted.as_configured)
    whole = float(judged.squares(judged.residual(base)).sums.sum())
    tried: list[Tried] = []
    rivals: dict[tuple[str, str], tuple[PressureModel, PressureModel]] = {}
    for number in range(1, MOST + 1):
        offered = fitted.candidates(model.effects)
        progress(f"round {number}: {len(offered)} candidates")
        scored = sorted(_scores(fitted, model, offered), key=lambda item: -item[1])
        before = judged.squares(judged.residual(model)).sums
        found: list[tuple[Tried, PressureModel | None]] = []
        for place, (name, score, start) in enumerate(scored):
            if place >= _REFITTED or start is None:
                found.append((Tried(name, number, score), None))
                continue
            refitted = fitted.fit(start)
            after = judged.squares(judged.residual(refitted)).sums
            removed = ratio(before - after, before, len(offered))
            found.append((Tried(name, number, score, removed), refitted))
        left = ratio(before, _of_noise(fitted, judged, model))
        near = []
        if left.low > thresholds.EPISODES_ABOVE_NOISE:
            near = _best(judged, joint.take(thinned(pool, _FITTED)), found, float(before.sum()), whole)
        best = near[0][0] if near else None
        tried += [replace(item, taken=item is best) for item, _ in found]
        if best is None:
            break
        rivals |= {(item.name, best.name): (near[0][1], other) for item, other in near[1:]}
        model = near[0][1]
    also = [item.name for item in tried if item.taken]
    replaced = {
        names: _exchanged(model, taken, other) for names, (taken, other) in rivals.items() if names[0] not in also
    }
    return Searched(base, model, tuple(tried), replaced, left)


def _exchanged(model: PressureModel, taken: PressureModel, other: PressureModel) -> PressureModel:
    """A model with what another one has of its own in the place of what it shares with one of its round."""
    out = model.without([path for path in taken.effects if path not in other.effects])
    free = [item for item in other.free if item not in out.free]
    return PressureModel(out.amounts, (*out.free, *free), {**other.effects, **out.effects})


def _best(
    judged: PressureDriven,
    both: PressureDriven,
    found: Sequence[tuple[Tried, PressureModel | None]],
    left: float,
    whole: float,
) -> list[tuple[Tried, PressureModel]]:
    """Effects that may remove as much as the best one, with the fewest numbers first; none that is worth it: none.

    Args:
        judged: episodes that decide.
        both: these and those that were fitted.
        found: effects, those that were fitted with their models.
        left: squared error before them.
        whole: squared error without any effect.
    """
    worth = [
        (item, refitted, judged.squares(judged.residual(refitted)).sums)
        for item, refitted in found
        if item.removed is not None and refitted is not None
        and item.removed.low > 0.0 and item.removed.value >= thresholds.FIRST_SHARE
        and item.removed.value * left >= LEAST_OF_ALL * whole
        and _has_a_size(both, refitted)
    ]  # fmt: skip
    if not worth:
        return []
    first = min(worth, key=lambda entry: entry[2].sum())
    near = [entry for entry in worth if entry is first or ratio(entry[2], first[2], len(found)).low <= 1.0]
    near.sort(key=lambda entry: (len(entry[1].free), entry[2].sum()))
    return [(item, refitted) for item, refitted, _ in near]


def _of_noise(fitted: PressureDriven, judged: PressureDriven, model: PressureModel) -> Floats:
    """Squared errors by episode that the noise of the readings alone would leave, in start, input and fit (E,).

    Args:
        fitted: episodes that the model was fitted to.
        judged: those that decide.
        model: taken to be right.
    """
    refitted, seen = fitted.as_if(model).fit(model), judged.as_if(model)
    return seen.squares(seen.residual(refitted)).sums


def _has_a_size(joint: PressureDriven, model: PressureModel) -> bool:
    """Whether the effect that was freed last differs from none, by its sizes' intervals by episode.

    Args:
        joint: episodes to fit it to.
        model: with the effect.
    """
    effect = model.free[-1].paths[0].rsplit(".", 1)[0]
    sizes = [item.paths[0] for item in model.free if item.item.is_size and item.paths[0].startswith(f"{effect}.")]
    values = intervals(joint, joint.fit(model))
    return any(not values[path].low <= 0.0 <= values[path].high for path in sizes)


def _with(
    model: PressureModel,
    forms: Sequence[Candidate],
    shape: Mapping[str, float],
    sizes: Mapping[str, float] | None = None,
) -> PressureModel | None:
    """A model with the simplest form of a candidate at the scale of its sizes, or at given sizes."""
    if not forms:
        return None
    candidate = forms[0]
    values = {path: (sizes or {}).get(free.path, free.item.scale) for free in candidate.sizes for path in free.paths}
    values |= {path: shape.get(free.path, free.item.neutral) for free in candidate.shapes for path in free.paths}
    return PressureModel(model.amounts, (*model.free, *candidate.free), {**model.effects, **values})


def _scores(
    joint: PressureDriven, model: PressureModel, offered: Mapping[str, Sequence[Candidate]]
) -> list[tuple[str, float, PressureModel | None]]:
    """Share of the squared error that each candidate would remove, to first order, and where its fit starts."""
    left = joint.residual(model)
    basis = np.linalg.qr(joint.jacobian(model, left))[0]
    rest = left - basis @ (basis.T @ left)
    total = float(left @ left)
    out = []
    for name, forms in offered.items():
        best, start = 0.0, None
        for candidate in forms:
            for shape in candidate.grid():
                columns = []
                for size in candidate.sizes:
                    only = {other.path: size.item.scale * (other == size) for other in candidate.sizes}
                    point = _with(model, (candidate,), shape, only)
                    assert point is not None
                    column = joint.residual(point) - left
                    columns.append(column - basis @ (basis.T @ column))
                matrix = np.column_stack(columns)
                step = np.linalg.lstsq(matrix, -rest, rcond=None)[0]
                gain = float(rest @ rest - np.sum((rest + matrix @ step) ** 2)) / total
                if gain > best * 1.05:
                    # To first order a large size promises more than it holds.
                    sizes = {
                        size.path: size.bounded(size.item.scale * float(np.clip(part, -3.0, 3.0)))
                        for size, part in zip(candidate.sizes, step, strict=True)
                    }
                    best, start = gain, _with(model, (candidate,), shape, sizes)
        out.append((name, best, start))
    return out


def _configured(joint: PressureDriven, unseen: PressureDriven, held: Held) -> Row:
    between = joint.take(held.interleaved)
    model = joint.as_configured
    return Row(
        "rig as configured", rmse(*unseen.squares(unseen.residual(model))), None,
        rmse(*between.squares(between.residual(model))),
    )  # fmt: skip


def _row(
    joint: PressureDriven, unseen: PressureDriven, held: Held, name: str, start: PressureModel, window: float
) -> tuple[Row, Floats, PressureModel, PressureModel]:
    """Errors of a model that is fitted for each way of holding out, squares of the interleaved, and the fits.

    The first fit is to all that may be fitted, the second one, for later episodes, to the last of them.
    """
    pool = joint.take(thinned(held.pool, _USED))
    everything = pool.fit(start)
    later = rmse(*unseen.squares(unseen.residual(everything)))
    recent, fitted = later, everything
    if window < 1.0:
        fitted = joint.take(thinned(last(held.pool, window), _USED)).fit(everything)
        recent = rmse(*unseen.squares(unseen.residual(fitted)))
    between = joint.take(held.interleaved)
    squares = between.squares(between.residual(everything))
    return Row(name, later, recent, rmse(*squares)), squares.sums, everything, fitted
