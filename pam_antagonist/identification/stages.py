"""The order in which a rig is identified: that of Proposition 1, then everything together.

Steady-state characteristics do not depend on orifice areas and polytropic indices, and friction decides where
the joint stops (Proposition 1). So the force map comes first, from torques and measured pressures alone; then
the valve curve, where the recordings hold steady pressures; then friction, from the angles at which the joint
came to rest; then areas and indices, from the way pressures move; at last all of it by prediction error, which
the single steps only have to bring near.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.fit import Fit, fit
from pam_antagonist.identification.freedom import FreeParameter
from pam_antagonist.identification.prediction import Problem
from pam_antagonist.identification.trial import ANGLE, CHANNELS, PRESSURE_1, TORQUE, Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_PRESSURES = (PRESSURE_1, PRESSURE_1 + 1)


@dataclass(frozen=True)
class Stage:
    """One step of the identification.

    Attributes:
        name: what it identifies.
        source: what it takes it from.
        parameters: names of the parameters that it moved; empty where it was skipped.
        before: RMS residual by channel before it [rad, N m, Pa, Pa], None where a channel says nothing.
        after: the same after it.
        note: why it was skipped, or what is to be known about it.
    """

    name: str
    source: str
    parameters: tuple[str, ...]
    before: tuple[float | None, ...]
    after: tuple[float | None, ...]
    note: str = ""


@dataclass(frozen=True)
class _Plan:
    name: str
    source: str
    groups: tuple[str, ...]
    channels: tuple[int, ...]
    joints: tuple[str, ...]


_PLANS = (
    _Plan("flow", "pressures in motion", ("valve_", "gas."), _PRESSURES, ("free", "locked")),
    _Plan("force map", "torque at measured pressures", ("force.",), (TORQUE,), ("locked",)),
    _Plan("friction", "where the joint comes to rest", ("friction.",), (ANGLE,), ("free",)),
)


def run_stages(
    rig: Rig,
    trials: Sequence[Trial],
    free: Sequence[FreeParameter],
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
) -> tuple[list[Stage], Fit]:
    """Identify step by step, then by one joint refinement.

    Args:
        rig: start values.
        trials: recordings.
        free: parameters that may move.
        jobs: threads.
        progress: told what is being done.

    Returns:
        The steps, the joint refinement last, and its fit.
    """
    whole = Problem(rig, trials, free, jobs=jobs)
    theta = np.zeros(whole.size)
    stages = []
    for plan in _PLANS:
        if progress:
            progress(plan.name)
        stage, theta = _run(plan, whole, theta)
        stages.append(stage)
    if progress:
        progress("joint refinement")
    before = _rms(whole, theta)
    final = fit(whole, theta, progress=progress)
    names = tuple(item.name for item in free)
    stages.append(Stage("joint refinement", "all channels of all recordings", names, before, _rms(whole, final.theta)))
    return stages, final


def _run(plan: _Plan, whole: Problem, theta: Floats) -> tuple[Stage, Floats]:
    """One step: a fit of some parameters to some channels, the others kept where they are."""
    chosen = [k for k, item in enumerate(whole.free) if any(group in item.name for group in plan.groups)]
    fitting = [trial.joint in plan.joints and any(map(trial.has, plan.channels)) for trial in whole.trials]
    used = [k for k, fits in enumerate(fitting) if fits]
    before = _rms(whole, theta)
    if not chosen or not used:
        why = (
            "no parameter of it is free" if not chosen else f"no recording of a {' or '.join(plan.joints)} joint has it"
        )
        return Stage(plan.name, plan.source, (), before, before, f"skipped: {why}"), theta
    count = len(whole.free)
    rig_now = moved(whole.rig, whole.values(theta))
    part = Problem(
        rig_now,
        [whole.trials[k] for k in used],
        [_from_here(whole.free[k], whole.values(theta)) for k in chosen],
        plan.channels,
        whole.jobs,
    )
    found = fit(part, rounds=2)
    result = theta.copy()
    for k, item in zip(chosen, part.free, strict=True):
        result[k] = (found.values[item.name] - whole.free[k].start) / whole.free[k].prior_std
    for place, k in enumerate(used):
        source = len(chosen) + 3 * place
        result[count + 3 * k : count + 3 * k + 3] = found.theta[source : source + 3]
    names = tuple(whole.free[k].name for k in chosen)
    return Stage(plan.name, plan.source, names, before, _rms(whole, result)), result


def _from_here(item: FreeParameter, values: dict[str, float]) -> FreeParameter:
    return FreeParameter(item.name, values[item.name], item.prior_std, item.low, item.high)


def _rms(problem: Problem, theta: Floats) -> tuple[float | None, ...]:
    """RMS of the block residuals of each channel over all trials."""
    total, number = np.zeros(len(CHANNELS)), np.zeros(len(CHANNELS))
    for trial, part in zip(problem.trials, problem.residuals(theta), strict=True):
        for column, channel in enumerate(problem.counted(trial)):
            good = np.isfinite(part[:, column])
            total[channel] += float(np.sum(part[good, column] ** 2))
            number[channel] += int(good.sum())
    return tuple(float(np.sqrt(t / n)) if n else None for t, n in zip(total, number, strict=True))


def moved(rig: Rig, values: dict[str, float]) -> Rig:
    """A rig with other values.

    Args:
        rig: the rig.
        values: by dotted path.
    """
    result = rig
    for name, value in values.items():
        result = _put(result, name.split("."), value)
    return result


def _put(model: Any, path: list[str], value: float) -> Any:
    if len(path) == 1:
        return model.replaced(**{path[0]: value})
    return model.replaced(**{path[0]: _put(getattr(model, path[0]), path[1:], value)})
