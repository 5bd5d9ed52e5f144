"""Effects that begin during a recording: when, and which.

A recording is a candidate if its base model is at the noise up to some time and not afterwards. That time is a change
point of the residual's likelihood. The effects are then selected with that onset, on blocks that are held out in turn,
since what begins late lies in a part that would not be fitted otherwise. The likelihood of the chosen model refines it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from pam_antagonist.diagnosis import thresholds
from pam_antagonist.diagnosis.candidates import Model
from pam_antagonist.diagnosis.checkpoint import Checkpoint
from pam_antagonist.diagnosis.preparation import Group
from pam_antagonist.diagnosis.result import Judged
from pam_antagonist.diagnosis.selection import Selection, select
from pam_antagonist.diagnosis.splits import in_turn
from pam_antagonist.diagnosis.stretches import clearest
from pam_antagonist.inference.experiment import Experiment, Point
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit, relinearised
from pam_antagonist.inference.valve_driven import ValveDriven

Floats = NDArray[np.float64]

_FIRST_PART = 0.25
"""Share of a recording on which a base model is tried that nothing has bent yet."""
_THIRDS = 3
"""Blocks of such a recording that are counted in turn; the last of each three is held out in the selection."""
_HELD_LENGTH = 5.0
"""[s] About so much is held out at once."""
_BUFFER = 1.0
"""[s] Between what is fitted and what is held out: one independent error."""
_STEP, _LEAST_STEP = 0.8, 0.02
"""[s] Of the search for the onset: the first, and the last."""
_ROUNDS = 4


class Onset(NamedTuple):
    """When an effect begins to act.

    Attributes:
        time_s: since the first sample [s].
        std_s: its standard deviation [s].
    """

    time_s: float
    std_s: float


_Refined = tuple[Experiment, Fitted, "Onset | None"]


@dataclass(frozen=True, eq=False)
class Late:
    """A selection in recordings that change.

    Attributes:
        group: the recordings, each with its onset and with blocks held out in turn.
        selection: what was tried on them.
        onsets: of each recording; None where it does not change.
    """

    group: Group
    selection: Selection
    onsets: tuple[Onset | None, ...]


def search(
    group: Group, base: Model, chosen: Model, jobs: int, progress: Callable[[str], None], checkpoint: Checkpoint
) -> Late | None:
    """Effects that begin during the recordings, where these explain what others do not; else None.

    Args:
        group: the recordings.
        base: the recalibrated model.
        chosen: the model of the selection of effects that act throughout.
        jobs: threads.
        progress: is called with what is being done.
        checkpoint: keeps finished candidates.
    """
    experiments = group.experiments
    if group.held_out or not all(isinstance(experiment, ValveDriven) for experiment in experiments):
        return None
    if all(_is_noise(e, e.residual(f.point, whole=True)) for e, f in zip(experiments, chosen.fits, strict=True)):
        return None
    progress("whether something begins during the recordings")
    begun = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(first_change)(*pair) for pair in zip(experiments, base.fits, strict=True)
    )
    if all(change is None for change in begun):
        return None
    now = [change[0] if change is not None else None for change in begun]
    starts = [fitted.point if change is None else change[1] for fitted, change in zip(base.fits, begun, strict=True)]
    late = tuple(_late(experiment, time) for experiment, time in zip(experiments, now, strict=True))
    quiet = _recalibrated(late, starts, jobs)
    selection = select(late, quiet, jobs, progress, checkpoint)
    if not selection.model.effects:
        return None
    progress("when it begins")
    refined = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(_refined)(*pair) for pair in zip(late, selection.model.fits, strict=True)
    )
    refined = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(_best_onset)(one, start, [other for other in refined if other is not one])
        for one, start in zip(refined, starts, strict=True)
    )
    late = tuple(experiment for experiment, _, _ in refined)
    model = Model(selection.model.effects, tuple(fitted for _, fitted, _ in refined))
    quiet = _recalibrated(late, [fitted.point for fitted in quiet.fits], jobs)
    if not _better(experiments, chosen, late, model):
        return None
    changed = replace(group, experiments=late)
    return Late(changed, Selection(quiet, model, selection.tried), tuple(onset for _, _, onset in refined))


def first_change(experiment: Experiment, fitted: Fitted) -> tuple[float, Point] | None:
    """When a recording leaves its noise [s], and its base model until then; None where it does not, or is never at it.

    Args:
        experiment: the recording.
        fitted: its recalibrated model.
    """
    block = experiment.trial.block
    part = round(_FIRST_PART * (len(experiment.trial) // block))
    point = fitted.point
    if not _is_noise(experiment, experiment.residual(point, whole=True)[: -(-experiment.fitted // block)]):
        point = refit(replace(experiment, fitted=part * block), point).point
    found = None
    for _ in range(2):
        residual = experiment.residual(point, whole=True)
        if not _is_noise(experiment, residual[:part]) or _is_noise(experiment, residual):
            return found
        change = change_point(residual, experiment.noise)
        found = change * experiment.trial.block_s, point
        # All that is before the change may be fitted, which shows the change more clearly.
        part = max(change - round(_BUFFER / experiment.trial.block_s), part)
        before = replace(experiment, fitted=part * block)
        point = refit(before, point, rounds=_ROUNDS, renewals=2, blocks_per_error=1.0).point
    return found


def change_point(residual: Floats, noise: Floats) -> int:
    """Block from which on a residual is most likely more than noise.

    Before it the residual is noise; from it on its variance is each channel's own.

    Args:
        residual: (B, C).
        noise: standard deviation of each channel (C,).
    """
    squares = (residual / noise) ** 2
    before = np.concatenate([[0.0], np.cumsum(squares.sum(axis=1))[:-1]])
    left = np.arange(len(squares), 0, -1)[:, None]
    variances = np.maximum(np.cumsum(squares[::-1], axis=0)[::-1] / left, 1.0)
    after = (left * np.log(variances) + np.cumsum(squares[::-1], axis=0)[::-1] / variances).sum(axis=1)
    return int(np.argmin(before + after))


def _is_noise(experiment: Experiment, residual: Floats) -> bool:
    return clearest(experiment, residual) is None


def _late(experiment: Experiment, time: float | None) -> Experiment:
    """A recording with an onset, and blocks held out in turn on either side of it."""
    block = experiment.trial.block_s
    count = len(experiment.trial) // experiment.trial.block
    edges = () if time is None else (round(time / block),)
    split = in_turn(count, _THIRDS, _HELD_LENGTH / block, round(_BUFFER / block), experiment.fitted, edges)[-1]
    return replace(experiment, fitted=count * experiment.trial.block, split=split, onset=time)


def _recalibrated(experiments: Sequence[Experiment], starts: Sequence[Point], jobs: int) -> Model:
    """The models without effects, from points nearby."""
    fits = Parallel(n_jobs=jobs, prefer="threads")(
        delayed(lambda e, p: relinearised(e, refit(e, p)))(*pair) for pair in zip(experiments, starts, strict=True)
    )
    return Model((), tuple(fits))


def _refined(experiment: Experiment, fitted: Fitted) -> _Refined:
    """The most likely onset of one recording's effects, by the likelihood with all else fitted again.

    Args:
        experiment: with the onset of the change point.
        fitted: its model.
    """
    if experiment.onset is None or not fitted.free:
        return experiment, fitted, None
    done: dict[float, Fitted] = {}

    def at(time: float, near: Fitted) -> Fitted:
        key = round(time / _LEAST_STEP) * _LEAST_STEP
        if key not in done:
            moved = replace(experiment, onset=key)
            pace = fitted.scale.blocks_per_error
            done[key] = refit(moved, near.point, near.free, near.base, _ROUNDS, 0, pace, careful=2)
        return done[key]

    time, step = experiment.onset, _STEP
    best = at(time, fitted)
    last = len(experiment.trial) * experiment.trial.dt
    while step >= _LEAST_STEP:
        around = [other for other in (time - step, time + step) if 0.0 < other < last]
        tried = [(at(other, best).cost, other) for other in around]
        cost, other = min(tried)
        if cost < best.cost:
            time, best = other, at(other, best)
        else:
            step /= 2.0
    time = round(time / _LEAST_STEP) * _LEAST_STEP
    scale = best.scale
    weights = scale.blocks_per_error / scale.length
    width, rise = _LEAST_STEP, 0.0
    while width < 0.1 * last:
        each = [
            weights @ (scale.misfits(at(time + way * width, best).residual) - scale.misfits(best.residual))
            for way in (-1.0, 1.0)
        ]
        rise = float(np.mean(each))
        if rise >= 1.0:
            break
        width *= 2.0
    std = max(width / float(np.sqrt(max(rise, 1e-3))), _LEAST_STEP)
    moved = replace(experiment, onset=time)
    pace = scale.blocks_per_error
    if np.max(moved.times_noise(best.residual)) < 2.0 and pace > 1.0:
        finer = refit(moved, best.point, best.free, renewals=2, blocks_per_error=1.0, careful=0)
        best = finer if np.max(moved.times_noise(finer.residual)) < thresholds.AT_NOISE else best
    return moved, relinearised(moved, best), Onset(time, std)


def _best_onset(own: _Refined, start: Point, others: Sequence[_Refined]) -> _Refined:
    """The better of a recording's own onset and those that start from what other recordings show.

    Onset and size may stand for one another, so that a search from the change point can end beside the best.

    Args:
        own: the recording with the onset of its own search.
        start: its base model until the change.
        others: the other recordings.
    """
    best = own
    experiment, fitted, onset = own
    for _, shown, other in others:
        if onset is None or other is None:
            continue
        moved = replace(experiment, onset=other.time_s)
        tried = _refined(moved, refit(moved, Point(start.theta, shown.point.effects), shown.free))
        costs = [cost_of(e, f.point, f.residual, fitted.scale) for e, f, _ in (best, tried)]
        best = tried if costs[1] < costs[0] else best
    return best


def _better(experiments: Sequence[Experiment], chosen: Model, late: Sequence[Experiment], model: Model) -> bool:
    """Whether effects that begin make all data clearly more likely than effects that act throughout.

    Args:
        experiments: the recordings.
        chosen: the model with effects that act throughout, or with none.
        late: the recordings with their onsets.
        model: the one with effects from then on.
    """
    gain = 0.0
    for experiment, old, changed, new in zip(experiments, chosen.fits, late, model.fits, strict=True):
        before, after = experiment.residual(old.point, whole=True), changed.residual(new.point, whole=True)
        gain += float(np.sum(old.scale.misfits(before) - old.scale.misfits(after))) * old.scale.share
        values = max(len(before) * before.shape[1] / experiment.blocks_per_error, np.e)
        gain -= (len(new.free) - len(old.free) + (changed.onset is not None)) * float(np.log(values))
    return gain >= thresholds.STRONG


def dated(judged: Judged, late: Late) -> Judged:
    """A verdict with the onset of each effect: that of the recording which shows it most exactly.

    Args:
        judged: the verdict on the recordings with their onsets.
        late: these.
    """
    by_name = {e.trial.name: onset for e, onset in zip(late.group.experiments, late.onsets, strict=True)}
    effects = []
    for effect in judged.effects:
        known = [onset for name in effect.recordings if (onset := by_name[name]) is not None]
        best = min(known, key=lambda onset: onset.std_s, default=None)
        effects.append(effect if best is None else replace(effect, onset_s=best.time_s, onset_std_s=best.std_s))
    if not effects:
        return judged
    each = "; ".join(
        f"{name}: {onset.time_s:.2f} ± {onset.std_s:.2f} s" for name, onset in by_name.items() if onset is not None
    )
    note = (
        f"the effect begins during the recordings ({each}); it was fitted to blocks in turn, so that the last part of "
        "each recording is not wholly held out"
    )
    return replace(judged, effects=tuple(effects), warnings=(*judged.warnings, note))
