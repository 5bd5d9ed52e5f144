"""A disturbance torque that comes and goes: in one recording, and whether it explains all, alone or beside effects.

No law gives such a torque, so it is estimated and judged by its course. An observer finds the torque that makes the
model of a free joint follow the measured angle. The disturbance is what exceeds the usual size of that torque. A law
that the model lacks needs such a torque whenever the joint moves. A disturbance acts at some times only. It cannot show
in a locked joint, without a measured angle, or where the angle is the input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist._jit import kernel
from pam_antagonist.diagnosis import findings, thresholds
from pam_antagonist.diagnosis.findings import ModelEffects
from pam_antagonist.diagnosis.hypotheses import Ranking, TriedCandidate, Work
from pam_antagonist.diagnosis.models import (
    Model,
    Residuals,
    evidence,
    explains,
    in_threads,
    price,
    recalibrated,
    removed,
    share_of,
)
from pam_antagonist.diagnosis.result import FoundEffect, Size
from pam_antagonist.diagnosis.search import CatalogueEffect, search
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.gauss_newton import Fitted, cost_of, refit
from pam_antagonist.inference.likelihood import in_mean_squares
from pam_antagonist.inference.point import Point
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.model import equilibrium, integration
from pam_antagonist.model.effects import CATALOGUE, DISTURBANCE, parameter_path

Floats = NDArray[np.float64]

_STIFF = 30.0
"""[N m/rad] Stiffness of the observer: an error of 0.01 rad gives as much torque as a muscle."""
_DAMPING = 0.1
"""[N m s/rad] Damping of the observer."""
_ROUNDS = 4
_SAME = 0.02
"""Least change of a torque (RMS) that is worth another round, as a share of it."""
_SMOOTHED = 0.24
"""[s] Time over which torques are smoothed: shorter than a push by hand."""
_MARGIN = 0.24
"""[s] An episode begins and ends this much outside of what stands out."""
_OF_LARGEST = 0.1
"""Least torque of an episode, as a share of the largest one."""
_SAME_ANGLE = float(np.deg2rad(0.5))
"""[rad] Angles in a bin of this width are the same, for a torque that depends on the angle."""
_APART = 1.0
"""[s] Least distance from an episode that counts as another time."""
_FEWEST = 5
"""[blocks] Fewest over which the torque at an angle is averaged."""
_STEP = 2e-3
"""Step of the differences along the base directions."""
_LINEARISATIONS, _REWEIGHTINGS = 2, 30
_LEAST_TORQUE = 1e-4
"""[N m]"""
_SMALL = 0.3
"""Torques of less than this share of the median count as squares: absolute values have no finite weight at 0."""
_NOTE = (
    "a disturbance torque is known only afterwards: the model alone cannot foresee it, and its errors stay; the "
    "estimator has it as a state"
)
_NOISE = parameter_path(DISTURBANCE, CATALOGUE[DISTURBANCE].parameters[0].name)
_step, _STAGES = integration.rk4_step_within, integration.STAGES


@kernel
def _followed(x0, given, angle, p, dt, substeps, stiff, damping):  # type: ignore[no-untyped-def]
    """Torques (N,) [N m] that make the model follow an angle (N,) [rad]."""
    x = x0.copy()
    u = np.zeros(3)
    out = np.empty(len(angle))
    scratch = np.empty((_STAGES + 1, x.shape[0]))
    for k in range(len(angle)):
        u[0] = given[k, 0]
        u[1] = given[k, 1]
        change = angle[k] - angle[max(k - 1, 0)]
        total = 0.0
        for j in range(substeps):
            wanted = angle[k] - (substeps - 1 - j) / substeps * change
            u[2] = stiff * (wanted - x[0]) - damping * x[1]
            _step(x, u, p, dt / substeps, x, scratch)
            total += u[2]
        out[k] = total / substeps
    return out


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A torque that comes and goes, as an explanation of one recording."""

    experiment: Experiment
    fitted: Fitted
    torque: Floats  # the torque (B,) [N m] in blocks over the whole recording, 0 between the episodes
    active: float
    recurring: float  # share of its square that the torque at the same angle at other times predicts
    # of the held-out and of all excess that it removes; the first is None where nothing of the recording is held out.
    # The torque was estimated from all data, held out or not.
    shares: tuple[float | None, float]
    squares: float
    noise: float  # size of a random walk with the same steps [N m/s^0.5]

    @property
    def episodes(self) -> int:
        """How often it acts."""
        return int(np.sum(np.diff((self.torque != 0.0).astype(int)) == 1)) + int(self.torque[0] != 0.0)

    @property
    def explains(self) -> bool:
        """Whether it acts at some times only, and little of the residual is left."""
        comes_and_goes = self.episodes >= thresholds.LEAST_EPISODES and self.active <= thresholds.MOST_ACTIVE
        gone = self.squares >= thresholds.DISTURBANCE_SQUARES and self.shares[1] >= thresholds.DISTURBANCE_EXCESS
        return comes_and_goes and self.recurring <= thresholds.RECURRING and gone


def estimate(experiment: Experiment, fitted: Fitted) -> Disturbance | None:
    """The disturbance in a recording; None where a disturbance cannot show.

    The episodes of the observer's torque are taken for a disturbance, and the base parameters are fitted beside it.
    Both steps are repeated, because the disturbance has biased the parameters at first. A second start has the
    parameters with the least sum of absolute torques: with a right model, nothing acts most of the time.
    """
    trial = experiment.trial
    if trial.joint == "locked" or ANGLE not in experiment.channels or not experiment.runs_by_itself:
        return None
    # Other recordings have episodes of their own, which are not known here.
    experiment = replace(experiment, judged=())
    found = []
    for start in (fitted.point, _least_torque_point(experiment, fitted.point)):
        point, before = start, None
        for _ in range(_ROUNDS):
            found.append(_estimated(experiment, fitted, point))
            torque = found[-1].torque
            # With no torque, or with the same one, the fit would end where it ended.
            if not torque.any() or (before is not None and _is_like(before, torque)):
                break
            point, before = found[-1].fitted.point, torque
    best = max(found, key=lambda disturbance: disturbance.squares)
    return replace(best, fitted=refit(best.experiment, best.fitted.point, fitted.free, rounds=0))


def _is_like(before: Floats, after: Floats) -> bool:
    """Whether two torques (B,) differ by no more than a share of the second one."""
    return float(np.sum((after - before) ** 2)) <= _SAME**2 * float(np.sum(after**2))


def _estimated(experiment: Experiment, fitted: Fitted, point: Point) -> Disturbance:
    """The disturbance by the observer of one point of the model, and the base parameters fitted beside it."""
    trial = experiment.trial
    seen = _observed(experiment, point)
    torque = np.where(_episodes(seen, trial), seen, 0.0)
    samples = np.repeat(torque, trial.block)
    samples = np.concatenate([samples, np.zeros(len(trial) - len(samples))])
    known = np.zeros(len(trial)) if trial.external is None else np.nan_to_num(trial.external)
    disturbed = replace(experiment, trial=replace(trial, external=known + samples))
    # During episodes the observer makes every model fit, so the angle there says nothing.
    measured = trial.measured.copy()
    measured[: len(torque) * trial.block][np.repeat(torque != 0.0, trial.block), ANGLE] = np.nan
    without = replace(disturbed, trial=replace(disturbed.trial, measured=measured))
    beside = refit(without, point, fitted.free, renewals=2)
    (before,) = Model((experiment,), (fitted,)).left
    left = disturbed.residual(beside.point, whole=True)
    after = Residuals(disturbed.held(left), disturbed.fitted_rows(left[: disturbed.fitted // trial.block]))
    squares = [in_mean_squares(*pair, experiment.noise) for pair in zip(before, after, strict=True)]
    gone = removed(experiment, before, before, after)
    width = trial.block_count(_SMOOTHED)
    steps = np.diff(torque[::width])
    return Disturbance(
        experiment=disturbed,
        fitted=beside,
        torque=torque,
        active=float(np.mean(torque != 0.0)),
        recurring=_recurring(seen, torque != 0.0, _angle(experiment), trial.block_count(_APART)),
        shares=(share_of(gone[:1]) if len(before.held) else None, share_of(gone)),
        squares=share_of(squares),
        noise=float(np.sqrt(np.mean(steps**2) / (width * trial.block_s))),
    )


def _least_torque_point(experiment: Experiment, point: Point) -> Point:
    """The point whose observer needs the least sum of absolute torques, given the base parameters' prior.

    It is found by iteratively reweighted least squares. A torque counts once a second, as an error does in a fit.
    """
    directions = len(experiment.directions)
    prior, theta, trial = experiment.prior[:directions], point.theta.copy(), experiment.trial
    for _ in range(_LINEARISATIONS):
        torque, columns = _smooth(_observed(experiment, Point(theta, point.effects)), trial), []
        for k in range(directions):
            moved = Point(theta + _STEP * np.eye(len(theta))[k], point.effects)
            columns.append((_smooth(_observed(experiment, moved), trial) - torque) / _STEP)
        matrix = np.stack(columns, axis=1)
        step: Floats = np.zeros(directions)
        for _ in range(_REWEIGHTINGS):
            size = np.abs(torque + matrix @ step)
            usual = max(float(np.median(size)), _LEAST_TORQUE)
            weights = 1.0 / (np.maximum(size, _SMALL * usual) * usual * experiment.blocks_per_error)
            information = (matrix * weights[:, None]).T @ matrix + np.diag(prior)
            slope = matrix.T @ (weights * torque) + prior * theta[:directions]
            step = np.asarray(-np.linalg.solve(information, slope))
        theta[:directions] += step
    return Point(theta, point.effects)


def _observed(experiment: Experiment, point: Point) -> Floats:
    """Torque (B,) [N m] that makes the model follow the measured angle."""
    experiment, point = experiment.corrected(point)
    trial = experiment.trial
    angle = _angle(experiment)
    measured = np.interp(np.arange(len(trial)), (np.arange(len(angle)) + 0.5) * trial.block, angle)
    p = experiment.parameters(point)
    # No more than the first sample of the model's course is needed.
    start = replace(experiment, fitted=trial.block, split=None).simulated(point)[0]
    x0 = equilibrium.initial_state(measured[0], start[PRESSURE_1], start[PRESSURE_1 + 1], trial.given[0], p)
    torque = _followed(x0, trial.given, measured, p, trial.dt, trial.substeps, _STIFF, _DAMPING)
    return trial.blocks(torque[:, None])[:, 0]


def _angle(experiment: Experiment) -> Floats:
    """Measured angle (B,) [rad], interpolated where it is missing."""
    angle = experiment.measured[:, experiment.channels.index(ANGLE)]
    known = np.isfinite(angle)
    return np.interp(np.arange(len(angle)), np.flatnonzero(known), angle[known])


def _recurring(seen: Floats, active: NDArray[np.bool_], angle: Floats, apart: int) -> float:
    """Share of the disturbance's squares that the mean torque at the same angle at other times predicts.

    Args:
        seen: torque (B,) [N m] that makes the model follow the measured angle.
        active: when there is an episode (B,).
        angle: measured (B,) [rad].
        apart: least distance from an episode that counts as another time [blocks].
    """
    places = np.rint(angle / _SAME_ANGLE).astype(int)
    places -= places.min()

    def sums(part: slice) -> tuple[Floats, Floats]:
        count = places.max() + 1
        torque, times = np.bincount(places[part], seen[part], count), np.bincount(places[part], minlength=count)
        return np.asarray(torque), np.asarray(times, dtype=float)

    total, often = sums(slice(None))
    edges = np.flatnonzero(np.diff(active, prepend=False, append=False))
    left = 0.0
    for begin, end in edges.reshape(-1, 2):
        near, times = sums(slice(max(begin - apart, 0), end + apart))
        elsewhere = often - times
        predicted = np.where(elsewhere >= _FEWEST, (total - near) / np.maximum(elsewhere, 1), 0.0)
        left += float(np.sum((seen[begin:end] - predicted[places[begin:end]]) ** 2))
    squares = float(np.sum(seen[active] ** 2))
    return 1.0 - left / squares if squares > 0.0 else 0.0


def _episodes(torque: Floats, trial: Trial) -> NDArray[np.bool_]:
    """When there is an episode (B,): the torque stands out from its median size, with what is just before and after."""
    smooth = _smooth(torque, trial)
    out = np.abs(smooth) > max(
        thresholds.DISTURBANCE_STANDS_OUT * float(np.median(np.abs(smooth))),
        _OF_LARGEST * float(np.max(np.abs(smooth))),
    )
    return np.convolve(out, np.ones(2 * trial.block_count(_MARGIN) + 1), mode="same") > 0.0


def _smooth(torque: Floats, trial: Trial) -> Floats:
    width = trial.block_count(_SMOOTHED)
    return np.asarray(np.convolve(torque, np.ones(width) / width, mode="same"))


@dataclass(frozen=True, eq=False)
class Disturbed(TriedCandidate):
    """Recordings with a disturbance as an input."""

    noises: tuple[float, ...] = ()  # size of a random walk like it, one a recording; 0 where there is none
    left: tuple[int, ...] = ()  # recordings above noise in which no disturbance can show
    found: FoundEffect | None = None  # what a report says of it


class DisturbanceTorque(CatalogueEffect):
    """A torque that comes and goes, in every recording above noise that can show one, if it explains all of these."""

    @override
    def propose(self, now: Ranking, number: int, work: Work) -> list[TriedCandidate]:
        work.progress("looking for a disturbance torque")
        model = now.model
        noisy = [
            r for r, (e, fitted) in enumerate(model.pairs) if np.max(e.times_noise(fitted.residual)) >= thresholds.CLEAN
        ]
        every = in_threads(estimate, (model.pairs[r] for r in noisy), model.jobs)
        seen = {r: one for r, one in zip(noisy, every, strict=True) if one is not None}
        if not seen or not all(one.explains for one in seen.values()):
            return []
        gained, experiments, fits = 0.0, list(model.experiments), list(model.fits)
        for r, one in seen.items():
            experiment, fitted = model.pairs[r]
            experiments[r], fits[r] = one.experiment, one.fitted
            gain = cost_of(experiment, fitted.point, fitted.residual, fitted.scale)
            gain -= cost_of(experiment, one.fitted.point, one.fitted.residual, fitted.scale)
            gained += fitted.scale.share * gain - price(fitted, thresholds.PARAMETERS_OF_EPISODE * one.episodes)
        noise = float(np.sqrt(np.mean([one.noise**2 for one in seen.values()])))
        spread = float(np.ptp([one.noise for one in seen.values()])) / 2.0
        # Relative error of a root mean square over n episodes: 1/√(2 n).
        std = max(spread, noise / np.sqrt(2.0 * sum(one.episodes for one in seen.values())))
        share = min((one.shares[0] for one in seen.values() if one.shares[0] is not None), default=None)
        there = tuple(model.experiments[r].trial.name for r in seen)
        size = {"noise": Size(noise, std, "N m/s^0.5")}
        return [
            Disturbed(
                DISTURBANCE, number, np.nan, gained,
                model=replace(model, experiments=tuple(experiments), fits=tuple(fits)),
                noises=tuple(seen[r].noise if r in seen else 0.0 for r in range(len(fits))),
                left=tuple(r for r in noisy if r not in seen),
                found=FoundEffect(DISTURBANCE, None, size, gained, share, there),
            )
        ]  # fmt: skip

    @override
    def is_worth_taking(self, tried: TriedCandidate) -> bool:
        return tried.standing >= thresholds.DISTURBANCE_BESIDE


_Explanation = tuple[Model, ModelEffects]
"""A model of all recordings with a disturbance, with effects beside it where there are any, and what a report says."""


def _asked(model: Model, work: Work) -> Disturbed | None:
    found = DisturbanceTorque().propose(Ranking(model, model), 1, work)
    return found[0] if found and isinstance(found[0], Disturbed) else None


def instead_of_effects(found: Ranking, work: Work) -> _Explanation | None:
    """Explain all recordings by a disturbance, if it comes and goes and leaves little; else None.

    The disturbance is searched for beside the base model first, then beside effects. These are the effects that explain
    the recordings in which no disturbance can show, or else the chosen ones. With the disturbance as an input, effects
    may show that it had hidden.

    `found`: by the search for effects, whose model did not explain enough.
    """
    first = _asked(found.base, work)
    if first is not None and not first.left and first.model is not None:
        beside = search(first.model, Work(work.progress), first=found.base).model
        return _explanation(first, first.model, beside, found.base)
    apart = None if first is None else _effects_elsewhere(found.base, first.left, work)
    effects, known = (found.model, ()) if first is None or apart is None else (apart, first.left)
    second = _asked(effects, work) if effects.effects else None
    if second is None:
        return None
    others = [[r] for r in second.left if r not in known]
    if not all(explains(found.base.of(one), effects.of(one)) for one in others):
        return None
    return _beside_effects(second, effects)


def beside_effects(effects: Model, work: Work) -> _Explanation | None:
    """A disturbance beside effects that are the explanation already, if the evidence for it is strong; else None."""
    found = _asked(effects, work)
    if found is None or not DisturbanceTorque().is_worth_taking(found):
        return None
    return _beside_effects(found, effects)


def _beside_effects(found: Disturbed, effects: Model) -> _Explanation:
    """A disturbance that was found beside effects, and these where they are still needed."""
    assert found.model is not None
    return _explanation(found, recalibrated(found.model.experiments, effects), found.model, effects)


def _explanation(found: Disturbed, base: Model, model: Model, recorded: Model) -> _Explanation:
    """A disturbance, and the effects of a model beside it that are needed, in the recordings as they were made."""
    assert found.found is not None
    beside = ModelEffects((), {}, [])
    if model.effects:
        model = findings.backward_elimination(base, model)
        beside, _ = findings.found(base, model)
    # With an unknown torque as a random walk, as an estimator has it.
    fits = tuple(
        replace(fitted, point=Point(fitted.point.theta, {**fitted.point.effects, _NOISE: noise})) if noise else fitted
        for fitted, noise in zip(model.fits, found.noises, strict=True)
    )
    return Model(recorded.experiments, fits, (*model.effects, DISTURBANCE)), ModelEffects(
        tuple(sorted((*beside.effects, found.found), key=lambda effect: -effect.delta_bic)),
        {**beside.values, _NOISE: found.found.parameters["noise"].value},
        [*beside.contradictions, _NOTE],
    )


def _effects_elsewhere(base: Model, still: Sequence[int], work: Work) -> Model | None:
    """Effects that explain the recordings in which no disturbance can show, for all recordings; None if none do."""
    apart = base.of(still)
    effects = search(apart, Work(work.progress)).model
    if not explains(apart, effects):
        return None
    fits = dict(zip(still, effects.fits, strict=True))
    triples = zip(apart.experiments, apart.fits, effects.fits, strict=True)
    shows = max(triples, key=lambda seen: evidence(*seen))[2]
    for r, experiment in enumerate(base.experiments):
        if r not in fits:
            # A disturbance biases a fit of the effects too. So their values are taken over until it is known.
            point = Point(base.fits[r].point.theta, shows.point.effects)
            fits[r] = refit(experiment, point, shows.free, rounds=0)
    return Model(base.experiments, tuple(fits[r] for r in range(len(base.fits))), effects.effects)
