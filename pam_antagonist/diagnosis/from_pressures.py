"""Which effect the model of any rig lacks, from its measured pressures.

The rig is identified first (:mod:`pam_antagonist.identification.from_pressures`). Then each effect of the catalogue is
added to the part of the model in which it acts: to joint and muscles, which the measured pressures drive, or to
chambers and valves, which the measured motion drives. All values are fitted again with it. An effect is taken if it
removes enough of the squared error on held-out data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.identification.filter_stage import Given
from pam_antagonist.identification.from_pressures import (
    FromPressures,
    concluded,
    fitted_until,
    identify,
    parts_of,
    with_joint,
)
from pam_antagonist.identification.runs import Run
from pam_antagonist.identification.unknowns import Fit, Floats, Unknown, fitted
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, Effect, EffectParameter, parameter_path
from pam_antagonist.rig import Rig

Place = Literal["joint and muscles", "chambers and valves"]
JOINT: Place = "joint and muscles"
AIR: Place = "chambers and valves"

_HOOKS = {
    JOINT: ("contraction_force", "muscle_force", "coulomb_torque", "joint_torque"),
    AIR: (
        "spool_voltage",
        "open_rate",
        "supply_change",
        "mass_loss",
        "cooling",
        "valve_pressure_rate",
        "asked_pressure",
    ),
}
"""Where an effect acts says which part of the model it belongs to."""
_IN_THE_BASE = (
    "load_torque",
    "limb_weight",
    "friction_by_pressure",
    "valve_offset",
    "regulator_lag",
    "regulator_limits",
)
LEAST_GAIN = 0.3
"""Least share of the held-out squared error that an effect removes. It was set with three rigs in view, on which the
effects that are there removed 0.48 to 0.82, and others 0.37 at most beside them."""
_AMBIGUOUS = 0.8
"""An effect that removes so much of what the best one removes cannot be told from it."""
_AS_GOOD = 1.1
"""The filter's error with an effect may be larger by this factor than without it."""
_UNEXPLAINED_ANGLE, _ENCODER = 0.005, 3.0
"""The joint's model errs above noise if it errs by this share of the range and by so many noises of the encoder."""
_UNEXPLAINED_PRESSURE = 7e3
"""[Pa] Error over a second from which on the model of chambers and valves lacks something."""
_EVALUATIONS = 12
_FIRST = 0.2
"""First amount of a size, in standard deviations."""
_SIZE_STD = 5.0
"""Standard deviation of a size, in units of its scale in the catalogue."""


@dataclass(frozen=True, eq=False)
class Tried:
    """An effect that was added to the model."""

    name: str
    muscle: int | None  # 1 or 2; None for both
    place: Place
    gain: float
    delta_bic: float
    fit: Fit

    @property
    def parameters(self) -> dict[str, tuple[float, float, str]]:
        """Value, standard error and unit of each parameter of the effect, by name."""
        found, stds = self.fit.values, self.fit.stds
        return {
            item.name: (found[one.name], stds[one.name], item.unit)
            for one in self.fit.unknowns
            for item in CATALOGUE[self.name].parameters
            if parameter_path(self.name, item.name) in one.paths
        }


@dataclass(frozen=True, eq=False)
class FoundFromPressures:
    """A diagnosis from measured pressures."""

    recalibrated: FromPressures
    extended: FromPressures | None  # the same with the taken effects; None if none was taken
    tried: tuple[Tried, ...]
    taken: tuple[Tried, ...]
    # of the base model on held-out data: angle, driven by the measured pressures [rad], and pressure over a second
    # [Pa]; RMS, NaN where unknown.
    errors: tuple[float, float]
    # parts of the model that err by more than their sensors and for which no effect was taken.
    unexplained: tuple[Place, ...]

    @property
    def verdict(self) -> Literal["effect", "none", "unexplained"]:
        """The result in a word."""
        return "effect" if self.taken else "unexplained" if self.unexplained else "none"

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Effects that cannot be told from the taken ones."""
        names = [
            other.name
            for best in self.taken
            for other in self.tried
            if other.place == best.place and other.name != best.name and other.gain >= _AMBIGUOUS * best.gain
        ]
        return tuple(dict.fromkeys(names))

    @property
    def proposed(self) -> FromPressures | None:
        """The result whose rig is best on held-out data; None if that is the rig as configured."""
        base, extended = (None if one is None or one.rejected else one for one in (self.recalibrated, self.extended))
        if base is None or extended is None:
            return extended or base
        # An effect of the air hardly changes the angle, since the measured pressures drive the joint.
        worse = extended.pooled("identified") > _AS_GOOD * base.pooled("identified")
        return base if worse else extended


def diagnose(
    recordings: Sequence[Given],
    rig: Rig,
    holdout: float = 1.0 / 3.0,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[str], None] | None = None,
    whole: int = 0,
) -> FoundFromPressures:
    """Find the effect that the model of a rig lacks.

    Args:
        recordings: each with its joint's condition and a name.
        rig: with forces of the form ``braided``, from data sheets or identified.
        holdout: share of the data that is held out.
        seed: of the further start of the fit.
        jobs: threads.
        progress: called with a text about each step.
        whole: number of recordings at the end that are held out as a whole, in place of the share.

    Raises:
        BadInput: no free joint with a measured angle.
    """
    progress = progress or (lambda text: None)
    base = identify(recordings, rig, holdout, 2, seed, jobs, progress, whole)
    ends = fitted_until(recordings, holdout, whole)
    own, corrected = with_joint(rig, base.joint, recordings)
    runs, held = parts_of(recordings, ends), parts_of(recordings, ends, held_out=True)
    moving, judged = air_stage.usable(parts_of(corrected, ends)), air_stage.usable(parts_of(corrected, ends, True))
    tried = _each(rig, JOINT, base.joint, partial(joint_stage.residual_of, rig, runs, horizon=math.inf),
                  partial(_angle_errors, rig, held), _seconds(runs), jobs, progress)  # fmt: skip
    if base.air is not None and judged:
        residual = partial(air_stage.residual_of, own, moving, 0.0, air_stage.HORIZONS[-1])
        tried += _each(own, AIR, base.air, residual, partial(_pressure_errors, own, judged), _seconds(moving), jobs,
                       progress)  # fmt: skip
    tried.sort(key=lambda item: -item.gain)
    progress("comparison of the effects")
    best = {place: next((item for item in tried if item.place == place), None) for place in (JOINT, AIR)}
    taken = tuple(item for item in best.values() if item is not None and item.gain >= LEAST_GAIN)
    fits = {item.place: item.fit for item in taken}
    extended = None
    if taken:
        joint = fits.get(JOINT, base.joint)
        extended = concluded(recordings, ends, rig, joint, fits.get(AIR, base.air), jobs, progress)
    errors = (
        _rms(_angle_errors(rig, held, base.joint)),
        math.nan if base.air is None or not judged else _rms(_pressure_errors(own, judged, base.air)),
    )
    left = tuple(place for place in _above_noise(rig, held, errors) if place not in fits)
    return FoundFromPressures(base, extended, tuple(tried), taken, errors, left)


def _above_noise(rig: Rig, held: Sequence[Run], errors: tuple[float, float]) -> list[Place]:
    angle = np.concatenate([np.zeros(1), *(run.angle[np.isfinite(run.angle)] for run in held)])
    bound = max(_UNEXPLAINED_ANGLE * float(np.ptp(angle)), _ENCODER * rig.sensors.error("angle"))
    return [
        place for place, error, most in ((JOINT, errors[0], bound), (AIR, errors[1], _UNEXPLAINED_PRESSURE))
        if error > most
    ]  # fmt: skip


def _each(
    rig: Rig,
    place: Place,
    base: Fit,
    residual: Callable[..., Callable[..., Floats]],
    errors: Callable[[Fit], Floats],
    seconds: float,
    jobs: int,
    progress: Callable[[str], None],
) -> list[Tried]:
    """Every effect that may act in a part of the model, fitted with it."""
    before, out = float(np.sum(errors(base) ** 2)), []
    for effect in CATALOGUE.values():
        if not _may_act(effect, place, rig):
            continue
        for muscle in _muscles(effect, place):
            extra = _unknowns(effect, muscle)
            progress(f"{place}: {effect.title}" + (f" of muscle {muscle}" if muscle else ""))
            unknown = [*base.unknowns, *extra]
            begin = np.concatenate([base.amounts, [0.0 if item.positive else _FIRST for item in extra]])
            found = fitted(unknown, residual(unknown=unknown), begin, _EVALUATIONS, jobs)
            gain = 1.0 - float(np.sum(errors(found) ** 2)) / before
            values = 10.0 * seconds
            evidence = values * math.log(base.cost / found.cost) - len(extra) * math.log(values)
            out.append(Tried(effect.name, muscle, place, gain if math.isfinite(gain) else -math.inf, evidence, found))
    return out


def _may_act(effect: Effect, place: Place, rig: Rig) -> bool:
    """Whether an effect is one law that acts in a part of the model, and is not in the rig or in the base model."""
    if not effect.deterministic or effect.of_tables or effect.name.endswith("_by_signal"):
        return False
    if effect.name in (*_IN_THE_BASE, *rig.effects):
        return False
    if not any(hook in effect.hooks for hook in _HOOKS[place]):
        return False
    of_regulators = effect.name.startswith("regulator_")
    return place == JOINT or of_regulators == (rig.drive == "regulator")


def _muscles(effect: Effect, place: Place) -> tuple[int | None, ...]:
    """Both muscles alike; in the air each alone as well, which its own pressure shows."""
    own = any(item.muscle is not None and item.is_size for item in effect.parameters)
    return (None, 1, 2) if place == AIR and own else (None,)


def _unknowns(effect: Effect, muscle: int | None) -> list[Unknown]:
    """Parameters of an effect; those of both muscles have one value."""
    families: dict[str, list[str]] = {}
    items: dict[str, EffectParameter] = {}
    for item in effect.parameters:
        if muscle is None or item.muscle in (None, muscle):
            families.setdefault(item.family, []).append(parameter_path(effect.name, item.name))
            items.setdefault(item.family, item)
    out = []
    for family, paths in families.items():
        item = items[family]
        if item.is_size:
            out.append(Unknown(paths[0], tuple(paths), 0.0, _SIZE_STD * item.scale, low=item.low, high=item.high))
        else:
            start = min(max(item.scale, item.low), item.high)
            out.append(Unknown(paths[0], tuple(paths), start, 1.5, True, item.low, item.high))
    return out


def _angle_errors(rig: Rig, runs: Sequence[Run], fit: Fit) -> Floats:
    """Errors of the simulated angle [rad] of runs that the measured pressures drive."""
    values = fit.values
    changes = {**joint_stage.model_values(fit.unknowns, values), **NO_REGULATORS}
    p = par.changed(rig.parameters(), changes)
    zero, delay = values.get(joint_stage.ZERO, 0.0), values.get(joint_stage.DELAY, 0.0)
    left = [run.angle - joint_stage.simulated(run, p, zero, delay) for run in runs]
    return np.concatenate([np.zeros(0), *(item[np.isfinite(run.angle)] for item, run in zip(left, runs, strict=True))])


def _pressure_errors(rig: Rig, runs: Sequence[Run], fit: Fit) -> Floats:
    """Errors of the simulated pressures [Pa] over a second, of runs that commands and measured motion drive."""
    p = par.changed(rig.parameters("locked"), fit.parameters)
    out = [np.zeros(0)]
    for run in runs:
        shown, starts = air_stage.simulated(run, p, 0.0, air_stage.HORIZONS[-1])
        out.append((run.pressure - shown)[~starts].ravel())
    return np.concatenate(out)


def _seconds(runs: Sequence[Run]) -> float:
    return sum(float(run.time[-1] - run.time[0]) for run in runs)


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan
