"""Effects that begin or end during a recording: which, and when.

Where a part of a recording is above noise (:mod:`change_point`), effects are selected that act in that part only. They
are selected on blocks that are held out in turn, since a held-out end would hide what begins late from all fits. The
likelihood of all data then refines begin and end. The same is repeated for what is still above noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import override

from pam_antagonist.diagnosis import change_point, thresholds
from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import Model, explains, explains_in_part, in_threads
from pam_antagonist.diagnosis.preparation import Group
from pam_antagonist.diagnosis.result import FoundEffect
from pam_antagonist.diagnosis.search import CatalogueEffect, search
from pam_antagonist.diagnosis.splits import parted
from pam_antagonist.inference.calibration import is_calibration
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, Linearised, Near, cost_of, refit, relinearised
from pam_antagonist.inference.point import THROUGHOUT, Point, Span
from pam_antagonist.inference.starts import MAY_BE_NOISE

_STEP, _LEAST_STEP = 0.8, 0.02
"""[s] First and last step of the search for an edge."""
_WIDEST = 0.1
"""Largest uncertainty of an edge, as a share of the recording."""
_SEARCHES = 2
_FAR = 1.0
"""[s] Effects are selected once more if an edge turns out to be farther away than this. What was lost while an effect
acted comes back slowly, so that its end looks late."""
_ROUNDS = 4
_SAME = 3.0
"""Edges of two recordings are the same if they differ by less than this, in standard deviations."""
NOTE = (
    "effects begin or end during the recordings, so blocks on either side of each change were held out, and the errors "
    "are those in these blocks. The times of the changes were fitted to all data"
)


@dataclass(frozen=True)
class EffectInPart(CatalogueEffect):
    """An effect of the catalogue that begins or ends during recordings, where what acts throughout leaves more."""

    # whether nothing but noise may be left: then a search that stays far above it is ended early.
    to_noise: bool = False

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        model = now.model
        changes = model.each(change_point.first_change)
        if not any(changes):
            return []
        starts = [f.point if c is None else c.point for f, c in zip(model.fits, changes, strict=True)]
        spans = [THROUGHOUT if change is None else change.span for change in changes]
        for _ in range(_SEARCHES):
            pairs = zip(model.experiments, spans, strict=True)
            split = replace(model, experiments=tuple(_parted(*pair, model.effects) for pair in pairs))
            quiet = _without_effects(split, starts)
            before = split.map(_from, starts) if model.effects else quiet
            # One effect at a time: another one that acts then is found in what is still above noise.
            ranking = search(before, work, first=quiet if model.effects else None, most=len(model.effects) + 1)
            new = [name for name in ranking.model.effects if name not in model.effects]
            if not new:
                return []
            work.progress("when it begins and ends")
            refined = ranking.model.each(_refined)
            others = [[other for other in refined if other is not one] for one in refined]
            refined = in_threads(_best_of_recordings, zip(refined, starts, others, strict=True), model.jobs)
            if self.to_noise and any(np.max(e.times_noise(f.residual)) > MAY_BE_NOISE for e, f in refined):
                return []
            known, spans = spans, [one.experiment.span for one in refined]
            if all(_is_near(*pair) for pair in zip(known, spans, strict=True)):
                break
        own = [{**one.experiment.spans, **dict.fromkeys(new, one.experiment.span)} for one in refined]
        shown = Model(
            tuple(replace(e, spans=spans, span=THROUGHOUT) for (e, _), spans in zip(refined, own, strict=True)),
            tuple(one.fitted for one in refined),
            ranking.model.effects,
        )
        base = _without_effects(shown, [fitted.point for fitted in quiet.fits])
        return [replace(one, model=shown, base=base) if one.effect in new else one for one in ranking.tried]

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        return tried.base is not None


class _Refined(NamedTuple):
    experiment: Experiment
    fitted: Fitted


def begin_and_end(group: Group, found: Ranking, work: Work) -> Ranking | None:
    """Effects that begin or end during the recordings, if they explain what others do not; else None.

    Where effects that act throughout explain the recordings well, others are accepted only if they leave nothing but
    noise: the residual of an effect of another form may come and go as well.

    `found`: by the search for effects that act throughout.
    """
    chosen = found.model
    if not can_change(group) or _is_all_noise(chosen):
        return None
    to_noise = explains(found.base, chosen) and not explains_in_part(found.base, chosen)
    work.progress("whether something begins or ends during the recordings")
    best = None
    # Something may begin beside what acts throughout; but what begins bends the choice of what acts throughout.
    for start in (found.base, chosen) if chosen.effects else (found.base,):
        # Effects of the model act throughout, whatever is found beside them.
        spans = dict.fromkeys(start.effects, THROUGHOUT)
        acting = replace(start, experiments=tuple(replace(one, spans=spans) for one in start.experiments))
        changing = search(acting, work, (EffectInPart(to_noise),))
        if changing.model.effects == start.effects or not _better(chosen, changing.model):
            continue
        if _is_all_noise(changing.model):
            return changing
        best = changing if best is None else best
    return None if to_noise else best


def can_change(group: Group) -> bool:
    """Whether effects of these recordings can begin and end."""
    return not group.held_out and all(experiment.runs_by_itself for experiment in group.experiments)


def _is_near(one: Span, other: Span) -> bool:
    return all(a == b or abs(a - b) <= _FAR for a, b in zip(one.limits, other.limits, strict=True))


def _is_like(one: Span, other: Span) -> bool:
    """Whether two recordings show the same begin and end, within their standard deviations."""
    return all(
        a == b or abs(a - b) <= _SAME * float(np.hypot(own, their))
        for a, b, own, their in zip(one.limits, other.limits, one.std_s, other.std_s, strict=True)
    )


def _is_all_noise(model: Model) -> bool:
    """Whether no stretch of any recording is above noise."""
    return all(change_point.is_noise(e, e.residual(f.point, whole=True)) for e, f in model.pairs)


def _parted(experiment: Experiment, span: Span, effects: Sequence[str]) -> Experiment:
    """A recording with a span for further effects, and with blocks held out in turn on either side of every edge."""
    trial = experiment.trial
    now = replace(experiment, span=span)
    known = {edge for name in effects for edge in now.span_of(name).edges}
    edges = [round(edge / trial.block_s) for edge in sorted({*known, *span.edges})]
    return parted(now, edges)


def _from(experiment: Experiment, fitted: Fitted, point: Point) -> Fitted:
    """A model fitted again from a point nearby."""
    return relinearised(experiment, refit(experiment, point, fitted.free))


def _without_effects(model: Model, points: Sequence[Point]) -> Model:
    """The model without effects, from points nearby; the recordings' calibrations stay free."""

    def one(experiment: Experiment, fitted: Fitted, point: Point) -> Fitted:
        free = tuple(one for one in fitted.free if is_calibration(one.path))
        kept = {path: value for path, value in point.effects.items() if is_calibration(path)}
        return relinearised(experiment, refit(experiment, Point(point.theta, kept), free))

    return replace(model.map(one, points), effects=())


def _shows(experiment: Experiment, fitted: Fitted) -> bool:
    """Whether a recording's model has something that begins or ends in its span."""
    return bool(set(experiment.span.edges) & set(experiment.edges(fitted.point)))


def _refined(experiment: Experiment, fitted: Fitted) -> _Refined:
    """The most likely begin and end of one recording's new effects, by the likelihood with all else fitted again.

    All data count: an edge within what is held out would be anywhere there.
    """
    if not _shows(experiment, fitted):
        return _Refined(experiment, fitted)
    pace = fitted.scale.blocks_per_error
    linear = Linearised.of(replace(experiment, split=None), fitted)
    span, stds, best = experiment.span, [0.0, 0.0], linear.on(np.ones(len(linear.residual), dtype=bool))
    for k, edge in enumerate(span.limits):
        if np.isfinite(edge):
            span, best, stds[k] = _edge(linear, span, k, best)
    moved = replace(experiment, span=span._replace(std_s=(stds[0], stds[1])))
    again = refit(moved, best.point, fitted.free, rounds=_ROUNDS, renewals=1, blocks_per_error=pace, careful=2)
    if np.max(moved.times_noise(again.residual)) < thresholds.CLEAN and pace > 1.0:
        finer = refit(moved, again.point, again.free, renewals=2, blocks_per_error=1.0, careful=0)
        again = finer if np.max(moved.times_noise(finer.residual)) < thresholds.AT_NOISE else again
    return _Refined(moved, relinearised(moved, again))


def _edge(linear: Linearised, span: Span, k: int, best: Near) -> tuple[Span, Near, float]:
    """The most likely place of one edge of a span, the model there, and its standard deviation [s].

    `linear`: the model of all of the recording, with derivatives that serve for other edges as well. `k`: 0 for its
    begin, 1 for its end.
    """
    done: dict[float, Near] = {}
    trial, everything = linear.experiment.trial, np.ones(len(linear.residual), dtype=bool)

    def at(time: float, near: Near) -> Near:
        key = round(time / _LEAST_STEP) * _LEAST_STEP
        if key not in done:
            moved = replace(linear.experiment, span=_with(span, k, key))
            start = replace(linear.fitted, point=near.point)
            done[key] = replace(
                linear, experiment=moved, fitted=start, residual=moved.residual(near.point)
            ).on(everything, exact=False)  # fmt: skip
        return done[key]

    last = len(trial) * trial.dt
    low, high = (0.0, min(span.end_s, last)) if k == 0 else (max(span.begin_s, 0.0), last)
    time, step = span.limits[k], _STEP
    best = at(time, best)
    while step >= _LEAST_STEP:
        around = [other for other in (time - step, time + step) if low < other < high]
        cost, other = min(((at(other, best).cost, other) for other in around), default=(np.inf, time))
        if cost < best.cost:
            time, best = other, at(other, best)
        else:
            step /= 2.0
    time = round(time / _LEAST_STEP) * _LEAST_STEP
    scale, width, rise = linear.fitted.scale, _LEAST_STEP, 0.0
    weights = scale.blocks_per_error / scale.length
    while width < _WIDEST * last:
        sides = (scale.misfits(at(time + way * width, best).residual) for way in (-1.0, 1.0))
        rise = float(np.mean([weights @ (side - scale.misfits(best.residual)) for side in sides]))
        if rise >= 1.0:
            break
        width *= 2.0
    return _with(span, k, time), best, max(width / float(np.sqrt(max(rise, 1e-3))), _LEAST_STEP)


def _with(span: Span, k: int, time: float) -> Span:
    return Span(time, span.end_s) if k == 0 else Span(span.begin_s, time)


def _best_of_recordings(own: _Refined, start: Point, others: Sequence[_Refined]) -> _Refined:
    """The better of a recording's own span and those that start from what other recordings show.

    Edges and size may compensate each other. So a search from the change can end beside the best.
    """
    best = own
    for other in others:
        if not (_shows(*own) and _shows(*other)) or _is_like(other.experiment.span, own.experiment.span):
            continue
        moved = replace(own.experiment, span=other.experiment.span)
        shown = Point(start.theta, {**start.effects, **other.fitted.point.effects})
        tried = _refined(moved, refit(moved, shown, other.fitted.free))
        scale = own.fitted.scale
        on_all = ((replace(one.experiment, split=None), one.fitted.point) for one in (best, tried))
        costs = [cost_of(e, point, e.residual(point), scale) for e, point in on_all]
        best = tried if costs[1] < costs[0] else best
    return best


def _better(chosen: Model, found: Model) -> bool:
    """Whether effects that begin or end make all data clearly more likely than effects that act throughout.

    `chosen`: the model with effects that act throughout, or with none. `found`: effects that begin or end; each edge is
    one more free parameter.
    """
    gain = 0.0
    for (experiment, old), (now, new) in zip(chosen.pairs, found.pairs, strict=True):
        before, after = experiment.residual(old.point, whole=True), now.residual(new.point, whole=True)
        gain += float(np.sum(old.scale.misfits(before) - old.scale.misfits(after))) * old.scale.share
        values = max(len(before) * before.shape[1] / experiment.blocks_per_error, np.e)
        edges = len(now.edges(new.point))
        gain -= (len(new.free) - len(old.free) + edges) * float(np.log(values))
    return gain >= thresholds.STRONG


def dated(effects: Sequence[FoundEffect], model: Model) -> tuple[FoundEffect, ...]:
    """Effects of a model with their begin and end; one that acts at several times becomes several effects."""
    experiments = {experiment.trial.name: experiment for experiment in model.experiments}
    return tuple(one for effect in effects for one in _by_date(effect, experiments))


def _by_date(effect: FoundEffect, experiments: Mapping[str, Experiment]) -> list[FoundEffect]:
    """An effect for each time at which recordings show it, with the most exact begin and end of those."""
    groups: list[list[tuple[str, Span]]] = []
    for name in effect.recordings:
        one = experiments[name].span_of(effect.name)
        group = next((group for group in groups if _is_like(one, group[0][1])), None)
        if group is None:
            groups.append(group := [])
        group.append((name, one))
    out = []
    for group in groups:
        values: dict[str, Any] = {"recordings": tuple(name for name, _ in group)}
        for k, (when, std) in enumerate((("onset_s", "onset_std_s"), ("end_s", "end_std_s"))):
            known = [(one.std_s[k], one.limits[k]) for _, one in group if np.isfinite(one.limits[k])]
            values[std], values[when] = min(known, key=lambda pair: pair[0], default=(None, None))
        out.append(replace(effect, **values))
    return out
