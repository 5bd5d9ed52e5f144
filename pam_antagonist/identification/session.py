"""From recordings and start values to an identified rig: everything that ``identify`` computes, without its report."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.errors import BadInput
from pam_antagonist.identification.stages import Stage, run_stages
from pam_antagonist.identification.tuning import INNER_SHARE, Tuned, own_tuning, tune
from pam_antagonist.inference.determined import Evidence, evidence
from pam_antagonist.inference.free_parameters import FreeParameter, free_parameters, moved
from pam_antagonist.inference.joint_fit import Difference, JointFit, check_same_rig, differences, joint_fit
from pam_antagonist.inference.profile import Profile, shared_profiles
from pam_antagonist.inference.spread import Variation, deviations, variations
from pam_antagonist.inference.trial import ANGLE, TORQUE, Trial, check, make_trial
from pam_antagonist.recording import Recording
from pam_antagonist.recording.joint import JointCondition
from pam_antagonist.rig import Rig
from pam_antagonist.shown import Shown

Floats = NDArray[np.float64]

_SHORTEST_HOLDOUT = 1.0
_SEEN_IN_PRESSURES = (
    "valve_1", "valve_2", "gas.polytropic_flow", "gas.polytropic_volume", "supply.pressure", "effects.regulator_",
)  # fmt: skip
_START_STD = 0.5
"""Scatter of further starts about the first one, in standard deviations of the prior."""
_MOST_PROFILES = 6
_WHAT_SHOWS = (
    ("joint.inertia", "a free joint that is made to move fast: large voltage steps in opposite directions"),
    ("joint.viscous_friction", "a free joint that moves fast for long: alternate the valves' extremes every 0.3 s"),
    ("friction.", "a free joint with a measured angle that comes to rest at many angles and pressures"),
    ("force.v", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("force.w", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("force.c", "a free joint over its whole angle range, at low and at high pressures, with torque or angle measured"),
    ("inflow_area", "fast fillings of this muscle from low pressure: steps of its valve to the highest voltage"),
    ("outflow_area", "fast emptyings of this muscle from high pressure: steps of its valve to the lowest voltage"),
    (
        "gas.polytropic_flow",
        "a separate measurement of the chambers' volume or of the orifice areas: a recording shows only both together",
    ),
    ("gas.polytropic_volume", "a free joint that moves while the valves are still, so that only the volume changes"),
    (".volume.", "the volume of the muscle by length in a graduated cylinder (a static CSV)"),
    ("supply.pressure", "a steady pressure with the valve fully open, or a gauge on the tank"),
    ("effects.regulator_", "steps of both commanded pressures of different sizes, a locked joint's as well"),
    ("effects.", "longer recordings in which the effect is at work"),
)


@dataclass(frozen=True)
class Options:
    """Options of an identification.

    Attributes:
        free: names, or beginnings of names, of parameters that may move beside the usual ones.
        frozen: names, or beginnings of names, of parameters that may not move.
        holdout: share at the end of each recording that is not fitted.
        starts: how many starts the joint refinement has.
        seed: of the further starts.
        jobs: threads.
    """

    free: tuple[str, ...] = ()
    frozen: tuple[str, ...] = ()
    holdout: float = 1.0 / 3.0
    starts: int = 1
    seed: int = 0
    jobs: int = 1


@dataclass(frozen=True)
class Start:
    """One start of the joint refinement.

    Attributes:
        name: what the start is.
        cost: final cost of the refinement.
        best: whether this cost was the lowest.
    """

    name: str
    cost: float
    best: bool


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Shown):
    """An identified rig and how it was found.

    Attributes:
        start: the rig as it was configured.
        fitted: with the fitted values, before noise and tuning.
        tuned: the result, with noise and tuning.
        own: for each of several recordings, the rig with its own values in place of the common ones.
        trials: the recordings in full.
        held_from: for each, the time from which on it was held out [s].
        free: the parameters that could move.
        stages: steps of the identification.
        fit: the joint refinement.
        evidence: what is known about each parameter.
        ways: in which recordings may deviate from each other.
        differences: how recordings deviate from each other.
        profiles: profile likelihoods of a few parameters.
        starts: of the joint refinement.
        warnings: what the user should know.
        options: as given.
    """

    start: Rig
    fitted: Rig
    tuned: Tuned
    own: tuple[Rig, ...]
    trials: tuple[Trial, ...]
    held_from: tuple[float, ...]
    free: tuple[FreeParameter, ...]
    stages: tuple[Stage, ...]
    fit: JointFit
    evidence: Mapping[str, Evidence]
    ways: tuple[Variation, ...]
    differences: tuple[Difference, ...]
    profiles: tuple[Profile, ...]
    starts: tuple[Start, ...]
    warnings: tuple[str, ...]
    options: Options


def identify(
    recordings: Sequence[tuple[Recording, JointCondition, str]],
    rig: Rig,
    options: Options,
    progress: Callable[[str], None] | None = None,
) -> Identified:
    """Identify a rig.

    Args:
        recordings: each with its joint's condition and a name for reports.
        rig: start values, priors and bounds.
        options: of the identification.
        progress: called with what is being done.

    Raises:
        BadInput: recordings from which nothing can be learned, or that are not of one rig.
    """
    progress = progress or (lambda text: None)
    trials = [
        make_trial(recording, rig, state.condition, state.lock_angle, name) for recording, state, name in recordings
    ]
    held_from, fitted = [], []
    for trial in trials:
        split = round((1.0 - options.holdout) * len(trial)) * trial.dt
        if len(trial) * trial.dt - split < _SHORTEST_HOLDOUT:
            raise BadInput(
                f"{trial.name}: {len(trial) * trial.dt - split:.1f} s would be held out; expected at least "
                f"{_SHORTEST_HOLDOUT:g} s, to judge the result by"
            )
        part = trial.part(0.0, split)
        check(part, rig.drive)
        held_from.append(split)
        fitted.append(part)
    free, warnings = _chosen_parameters(rig, fitted, options)
    ways = variations(rig, free)
    stages, found = run_stages(rig, fitted, free, options.jobs, ways, progress)
    found, starts = _further_starts(found, ways, options, progress)
    check_same_rig(found, ways)
    chosen = _worth_a_profile(found)
    drawn = shared_profiles(found, chosen, options.jobs, progress)
    result = moved(found.problem.rig, found.values)
    inner = _inner(found, fitted, ways, progress)
    tuned = tune(result, fitted, found, inner, options.jobs, progress)
    own = []
    for index, part in enumerate(fitted if len(fitted) > 1 else []):
        progress(f"own values of {part.name}")
        own.append(own_tuning(tuned, part, found, inner, index, options.jobs))
    return Identified(
        rig,
        result,
        tuned,
        tuple(own),
        tuple(trials),
        tuple(held_from),
        tuple(free),
        tuple(stages),
        found,
        evidence(found, inner, tuple(drawn)),
        ways,
        tuple(differences(found, ways)),
        tuple(drawn),
        tuple(starts),
        tuple(warnings),
        options,
    )


def _inner(
    found: JointFit, trials: Sequence[Trial], ways: tuple[Variation, ...], progress: Callable[[str], None]
) -> JointFit:
    """The joint refinement of the first share of each part, started at the result of the whole."""
    begin = [trial.part(0.0, round(INNER_SHARE * len(trial)) * trial.dt) for trial in trials]
    problem = dataclasses.replace(found.problem, trials=begin, between=None)
    own = deviations(ways, problem.free)
    return joint_fit(problem, found.theta, 2, own, progress=lambda text: progress(f"inner fit, {text}"))


def _chosen_parameters(rig: Rig, trials: Sequence[Trial], options: Options) -> tuple[list[FreeParameter], list[str]]:
    free = free_parameters(rig, options.free, options.frozen)
    if any(trial.has(channel) for trial in trials for channel in (ANGLE, TORQUE)):
        return free, []
    kept = [
        item
        for item in free
        if item.name.startswith(_SEEN_IN_PRESSURES) or any(item.name.startswith(word) for word in options.free)
    ]
    if not kept:
        raise BadInput(
            "no recording has a measured angle or torque, and pressures alone do not determine the free parameters: "
            f"{', '.join(sorted(item.name for item in free))}"
        )
    names = ", ".join(item.name for item in kept)
    return kept, [
        f"No recording has a measured angle or torque: pressures alone determine {names} only; all others stay as "
        "configured. To determine the others, record the angle of a free joint and the torque of a locked one."
    ]


def _further_starts(
    found: JointFit, ways: tuple[Variation, ...], options: Options, progress: Callable[[str], None]
) -> tuple[JointFit, list[Start]]:
    """The joint refinement again from scattered starts; the best result is kept."""
    rng = np.random.default_rng(options.seed)
    fits = [("from the steps", found)]
    plain = found.problem.with_between(None)
    own = deviations(ways, found.problem.free)
    for number in range(1, options.starts):
        begin = found.theta[: len(plain.free)] + _START_STD * rng.standard_normal(len(plain.free))
        name = f"scattered start {number}"
        named = functools.partial(lambda name, text: progress(f"{name}, {text}"), name)
        fits.append((name, joint_fit(plain, begin, deviations=own, progress=named)))
    best = min(range(len(fits)), key=lambda k: fits[k][1].cost)
    starts = [Start(name, item.cost, k == best) for k, (name, item) in enumerate(fits)]
    return fits[best][1], starts


def _worth_a_profile(found: JointFit) -> list[str]:
    """Friction, force offset and polytropic index, then the least certain parameters: a handful."""
    stds = np.sqrt(np.diag(found.covariance))
    order = np.argsort(stds)
    names = [item.name for item in found.problem.free]
    # Friction and force offsets decide about angle and torque whatever else is free.
    first = [name for name in ("friction.shaft", "muscle_1.force.w2", "gas.polytropic_volume") if name in names]
    worst = [names[k] for k in order[::-1] if names[k] not in first]
    return [*first, *worst][:_MOST_PROFILES]


def relative(value: float, reference: float) -> float:
    """Relative difference of two values; NaN where the reference is zero."""
    return (value - reference) / abs(reference) if reference else math.nan


def recording_that_shows(name: str) -> str:
    """What to record so that a parameter shows.

    Args:
        name: its dotted path.
    """
    return next((text for part, text in _WHAT_SHOWS if part in name), "a longer recording with larger steps")
