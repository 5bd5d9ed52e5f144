"""The stages in which a rig is identified: in the order of Proposition 1, then everything together.

Steady-state characteristics do not depend on orifice areas and polytropic indices, and friction decides where the joint
stops (Proposition 1). So the order is:

1. the force map, from torques at measured pressures;
2. the valve curve, where the recordings hold steady pressures, or the regulators;
3. friction, from the balance of the joint while it slides;
4. areas and indices, from pressures in motion;
5. everything together, by prediction error. The other stages only provide its start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.balance import Balance, fit_force_map, fit_friction
from pam_antagonist.identification.stretches import beside_the_lag
from pam_antagonist.identification.valve_curve import CurveFinding, identify_curves
from pam_antagonist.inference.free_parameters import FreeParameter, moved
from pam_antagonist.inference.joint_fit import JointFit, joint_fit
from pam_antagonist.inference.joint_problem import JointProblem
from pam_antagonist.inference.spread import Variation, deviations
from pam_antagonist.inference.trial import CHANNELS, PRESSURE_1, Trial
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]

_PRESSURES = (PRESSURE_1, PRESSURE_1 + 1)
MEASURED = (
    "geometry.radius", "geometry.length", "joint.shaft_radius", "joint.mass", "joint.gravity", "joint.stop",
    "joint.stiffness", "atmosphere.pressure", "gas.temperature", "gas.constant", "gas.heat_ratio",
    "muscle_1.volume.d1", "muscle_1.volume.d2", "muscle_1.volume.d3",
    "muscle_2.volume.d1", "muscle_2.volume.d2", "muscle_2.volume.d3",
)  # fmt: skip
"""Parameters that Proposition 1 takes as directly measured, and the volume, which a graduated cylinder gives."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One step of the identification.

    Attributes:
        name: what it identifies.
        source: the data that it uses.
        values: parameters that it moved: value before and after; empty where it was skipped.
        before: RMS residual of the simulated model by channel before it [rad, N m, Pa, Pa], None where a channel has
            no data.
        after: the same after it.
        note: why it was skipped, or what a user should know about it.
        balance: torques of a step that works on measured pressures.
        curves: what steady pressures say about the valves.
        traces: block residuals of the simulated model before and after, one pair of (B, 4) a trial.
    """

    name: str
    source: str
    values: dict[str, tuple[float, float]]
    before: tuple[float | None, ...]
    after: tuple[float | None, ...]
    note: str = ""
    balance: Balance | None = None
    curves: tuple[CurveFinding, ...] = ()
    traces: tuple[tuple[Floats, Floats], ...] = field(default=(), repr=False)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that it moved."""
        return tuple(self.values)


@dataclass
class _Progress:
    """The state of the identification."""

    whole: JointProblem
    theta: Floats
    stages: list[Stage] = field(default_factory=list)

    @property
    def rig(self) -> Rig:
        return moved(self.whole.rig, self.whole.values(self.theta))

    def chosen(self, *groups: str) -> list[int]:
        return [k for k, item in enumerate(self.whole.free) if any(group in item.name for group in groups)]

    def put(self, values: dict[str, float]) -> dict[str, tuple[float, float]]:
        """Take new values, and return each before and after."""
        old = self.whole.values(self.theta)
        for k, item in enumerate(self.whole.free):
            if item.name in values:
                self.theta[k] = (values[item.name] - item.start) / item.prior_std
        return {name: (old[name], value) for name, value in values.items()}

    def end(self, name: str, source: str, earlier: list[Floats], values: dict, note: str = "", **more) -> None:  # type: ignore[no-untyped-def,type-arg]
        later = padded(self.whole, self.theta) if values or more.get("curves") else earlier
        traces = tuple(zip(earlier, later, strict=True))
        self.stages.append(Stage(name, source, values, rms(earlier), rms(later), note, traces=traces, **more))


def run_stages(
    rig: Rig,
    trials: Sequence[Trial],
    free: Sequence[FreeParameter],
    jobs: int = 1,
    ways: Sequence[Variation] = (),
    progress: Callable[[str], None] | None = None,
) -> tuple[list[Stage], JointFit]:
    """Identify step by step, then by one joint refinement.

    Args:
        rig: start values.
        trials: recordings.
        free: parameters that may move.
        jobs: threads.
        ways: in which trials may deviate from each other.
        progress: called with what is being done.

    Returns:
        The stages, the joint refinement last, and the fit of the latter. The fit's problem holds the rig with the
        curves that were found.
    """
    progress = progress or (lambda text: None)
    whole = JointProblem(rig, trials, free, jobs=jobs)
    state = _Progress(whole, np.zeros(whole.size))
    progress("force map")
    _force_map(state, ways)
    if rig.drive == "regulator":
        progress("regulators")
        _regulators(state)
    else:
        progress("valve curve")
        _curves(state)
    progress("friction")
    _friction(state)
    progress("flow")
    _flow(state, ways)
    earlier = padded(state.whole, state.theta)
    before = state.whole.values(state.theta)
    own = deviations(ways, state.whole.free)
    final = joint_fit(
        state.whole, state.theta, deviations=own, progress=lambda text: progress(f"joint refinement, {text}")
    )
    later = padded(final.problem, final.theta)
    values = {name: (before[name], value) for name, value in final.values.items()}
    traces = tuple(zip(earlier, later, strict=True))
    source = "all channels of all recordings, by prediction error"
    note = ""
    if final.spread is not None:
        note = "each recording may deviate from the common values; residuals are those with its own"
    state.stages.append(Stage("joint refinement", source, values, rms(earlier), rms(later), note, traces=traces))
    return state.stages, final


def _force_map(state: _Progress, ways: Sequence[Variation]) -> None:
    source = "torque at measured pressures and angles"
    earlier = padded(state.whole, state.theta)
    chosen = state.chosen(".force.")
    if not chosen:
        return state.end("force map", source, earlier, {}, "skipped: no parameter of it is free")
    std = state.whole.rig.sensors.torque_std
    of_force = [way for way in ways if all(".force." in name for name in way.changes)]
    found = fit_force_map(
        state.whole.trials, state.rig.parameters(), [state.whole.free[k] for k in chosen], std, of_force
    )
    if found is None:
        return state.end("force map", source, earlier, {}, "skipped: no recording has torque and angle to go by")
    note = "volumes are taken as measured"
    if not any(trial.joint == "free" for trial in state.whole.trials):
        note += "; with locked recordings alone only the force at the lock angle shows"
    return state.end("force map", source, earlier, state.put(found[0]), note, balance=found[1])


def _regulators(state: _Progress) -> None:
    source = "measured pressures and commands, in stretches that begin after constant commands"
    earlier = padded(state.whole, state.theta)
    rig = state.whole.rig
    found, note = beside_the_lag(rig, state.whole.trials, state.whole.jobs)
    if not found:
        return state.end("regulators", source, earlier, {}, note)
    state.whole = JointProblem(moved(rig, found), state.whole.trials, state.whole.free, jobs=state.whole.jobs)
    return state.end("regulators", source, earlier, {path: (rig.value(path), found[path]) for path in found}, note)


def _curves(state: _Progress) -> None:
    source = "steady pressures: open rate → pressure, voltage → pressure, the two combined"
    earlier = padded(state.whole, state.theta)
    rig = state.whole.rig
    changed, findings = identify_curves(rig, state.whole.trials)
    if any(finding.replaced for finding in findings):
        whole = JointProblem(changed, state.whole.trials, state.whole.free, jobs=state.whole.jobs)
        state.whole = whole
    note = "; ".join(finding.note for finding in findings)
    return state.end("valve curve", source, earlier, {}, note, curves=tuple(findings))


def _friction(state: _Progress) -> None:
    source = "what the balance of torques leaves while the joint slides"
    earlier = padded(state.whole, state.theta)
    chosen = state.chosen("friction.", "joint.viscous_friction")
    if not chosen:
        return state.end("friction", source, earlier, {}, "skipped: no parameter of it is free")
    if state.whole.rig.model.friction != "kikuuwe":
        return state.end("friction", source, earlier, {}, "skipped: left to the joint refinement for this law")
    std = state.whole.rig.sensors.torque_std
    found = fit_friction(state.whole.trials, state.rig.parameters(), [state.whole.free[k] for k in chosen], std)
    if found is None:
        return state.end("friction", source, earlier, {}, "skipped: no recording of a free joint that slides has it")
    return state.end("friction", source, earlier, state.put(found[0]), "", balance=found[1])


def _flow(state: _Progress, ways: Sequence[Variation]) -> None:
    source = "pressures in motion"
    earlier = padded(state.whole, state.theta)
    chosen = state.chosen("valve_", "gas.", "supply.", "effects.regulator_", "effects.valve_offset.")
    if not chosen:
        return state.end("flow", source, earlier, {}, "skipped: no parameter of it is free")
    now = state.whole.values(state.theta)
    part = JointProblem(
        state.rig,
        state.whole.trials,
        [_from_here(state.whole.free[k], now) for k in chosen],
        _PRESSURES,
        state.whole.jobs,
    )
    names = {item.name for item in part.free}
    own = deviations([way for way in ways if names.issuperset(way.changes)], part.free)
    return state.end("flow", source, earlier, state.put(joint_fit(part, rounds=2, deviations=own).values))


def _from_here(item: FreeParameter, values: dict[str, float]) -> FreeParameter:
    return FreeParameter(item.name, values[item.name], item.prior_std, item.low, item.high)


def padded(problem: JointProblem, theta: Floats) -> list[Floats]:
    """Block residuals of all four channels, one (B, 4) a trial; NaN where a channel has no data."""
    out = []
    for trial, part in zip(problem.trials, problem.residuals(theta), strict=True):
        full = np.full((len(trial) // trial.block, len(CHANNELS)), np.nan)
        full[:, problem.counted(trial)] = np.where(np.isinf(part), np.nan, part)
        out.append(full)
    return out


def rms(parts: Sequence[Floats]) -> tuple[float | None, ...]:
    """RMS of the block residuals of each channel over all trials, None where there are none."""
    joined = np.concatenate(parts)
    known = np.isfinite(joined)
    power = np.where(known, joined, 0.0) ** 2
    return tuple(
        float(np.sqrt(power[:, c].sum() / known[:, c].sum())) if known[:, c].any() else None
        for c in range(len(CHANNELS))
    )
