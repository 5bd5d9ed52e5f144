"""Which effect the model of a rig lacks that data sheets describe, or that short trials show.

Nothing in such a joint is known well enough to let the model run by its commands alone for minutes. So the rig is
identified first (:mod:`pam_antagonist.identification.from_pressures`), and its two parts are compared with the
recordings: joint and muscles, which the measured pressures drive, and chambers and valves, which the measured motion
drives. Both are experiments of all recordings together, with the identification's priors. The search and the rules of
the verdict are those of all other joints.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.diagnosis.ambiguity import not_told_apart
from pam_antagonist.diagnosis.hypotheses import TriedCandidate
from pam_antagonist.diagnosis.learned_law import of_part
from pam_antagonist.diagnosis.pipeline import verdicts
from pam_antagonist.diagnosis.preparation import DRIVEN, Group, Prepared, Settings, Timings
from pam_antagonist.diagnosis.result import FoundEffect, Judged
from pam_antagonist.diagnosis.verdicts import NONE, UNEXPLAINED, Verdict, overall
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
from pam_antagonist.identification.said import put_back
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.free_parameters import Candidate, FreeDirection, FreeEffectParameter
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.inference.trial import ANGLE, BLOCK_S, CHANNELS, PRESSURE_1, PRESSURE_2, TORQUE, Trial
from pam_antagonist.inference.unknowns import Fit, Unknown, fitted, within_bounds
from pam_antagonist.inference.valve_driven import TITLES
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, parameter_path, places
from pam_antagonist.rig import Rig
from pam_antagonist.shown import Shown, number, percent

Floats = NDArray[np.float64]
Place = Literal["joint and muscles", "chambers and valves"]
JOINT: Place = "joint and muscles"
AIR: Place = "chambers and valves"

_HOOKS: Mapping[Place, frozenset[str]] = {
    JOINT: frozenset({"contraction_force", "muscle_force", "coulomb_torque", "joint_torque"}),
    AIR: frozenset({
        "spool_voltage", "open_rate", "supply_change", "mass_loss", "cooling", "valve_pressure_rate", "asked_pressure",
    }),
}  # fmt: skip
"""Where an effect acts says which part of the model it belongs to."""
_IN_THE_BASE = (
    "load_torque", "limb_weight", "friction_by_pressure", "valve_offset", "regulator_lag", "regulator_limits",
    "learned",
)  # fmt: skip
_ANGLE, _PRESSURE = 0.005, 7e3
"""Errors that say nothing where only a data sheet tells the law: of the angle as a share of the range that was seen, of
the pressures [Pa] over a second. That of the torque is the fit's share of one muscle's torque: a share of the torque
that was seen would grow with a locked recording, and hide what a free joint shows."""
_DISSIPATES = {"friction": {"coulomb": 0.0, "stribeck": 0.0}, "hysteresis": {"amplitude": 0.0}}
"""Least sizes of effects that take energy. The base has friction of its own, which is free: none has to be undone."""
_AS_GOOD = 1.1
"""The filter's error with an effect may be larger by this factor than without it."""
_EVALUATIONS = 12
_ANEW_S = air_stage.HORIZONS[-1]
_SIZE_STD, _SHAPE_STD = 5.0, 1.5
"""Priors of an effect's parameters in the last fit: of sizes in their scales, of shapes on the logarithmic scale."""


@dataclass(frozen=True)
class _OfUnknown(FreeDirection):
    """An unknown of the identification, whose amounts are in standard deviations of its prior."""

    item: Unknown = field(kw_only=True)

    @override
    def in_words(self, amount: float) -> str:
        if self.item.positive:
            return f"{100.0 * (self.item.value(amount) / self.item.start - 1.0):+.0f} %"
        return f"{amount * self.item.std:+.2g} in SI units"


@dataclass(frozen=True, eq=False)
class _Part(Experiment):
    """All runs of the recordings as one experiment of a part of the model.

    The measured pressures drive joint and muscles. Commands and the measured motion drive chambers and valves, or
    regulators, anew from each second on.
    """

    place: Place = JOINT
    runs: tuple[Run, ...] = ()  # each cut to whole blocks
    start: Fit = Fit((), np.zeros(0), np.zeros((0, 0)), 0.0)  # of the identification

    @cached_property
    @override
    def directions(self) -> tuple[FreeDirection, ...]:
        items = self.start.unknowns
        return tuple(_OfUnknown(item.name, dict.fromkeys(item.paths, 0.0), 1.0, item=item) for item in items)

    @property
    @override
    def origin(self) -> Point:
        """The identified model: the middle of the priors, the description, is too far from it."""
        return Point(self.start.amounts)

    def values(self, point: Point) -> dict[str, float]:
        """Value of each unknown of the base, by name."""
        known = zip(self.start.unknowns, point.theta, strict=True)
        return {item.name: item.value(float(np.clip(amount, *item.bounds))) for item, amount in known}

    @override
    def changes(self, point: Point) -> dict[str, float]:
        return joint_stage.model_values(self.start.unknowns, self.values(point))

    @cached_property
    @override
    def channels(self) -> tuple[int, ...]:
        wanted = (ANGLE, TORQUE) if self.place == JOINT else (PRESSURE_1,)
        return tuple(c for c in wanted if self.trial.has(c))

    @property
    @override
    def titles(self) -> tuple[Channel, ...]:
        return tuple(TITLES[c] for c in self.channels) if self.place == JOINT else (Channel("Pressures", "kPa", 1e-3),)

    @cached_property
    @override
    def noise(self) -> Floats:
        return np.array([self.rig.sensors.error(name) for name in self._sensors])

    @property
    def _sensors(self) -> list[str]:
        return [CHANNELS[channel].split("_")[0] for channel in self.channels]

    @cached_property
    @override
    def tolerated(self) -> Floats:
        """What a data sheet's law leaves; known valves leave nothing, a known joint what the measured pressures err."""
        if self.place == AIR:
            return np.hypot(self.noise, _PRESSURE) if self.rig.is_from_data_sheets else self.noise
        seen = np.nanmax(self.measured, axis=0) - np.nanmin(self.measured, axis=0)
        torque = joint_stage.TORQUE_SHARE * joint_stage.torque_scale(self.rig)
        return np.hypot(self.noise, np.where(np.array(self.channels) == ANGLE, _ANGLE * seen, torque))

    @override
    def excess_removed(self, before: Floats, after: Floats) -> tuple[float, float]:
        """In mean squares, in units of what is tolerated: measured inputs keep a model near what is measured.

        In units of the noise, the sensor that is best beside what the law leaves would decide alone.
        """

        def excess(residual: Floats) -> float:
            squares = np.mean(residual**2, axis=0) if len(residual) else self.noise**2
            return float(np.sum(np.maximum(squares - self.noise**2, 0.0) / self.tolerated**2))

        return excess(before) - excess(after), excess(before)

    @property
    @override
    def noise_memory(self) -> float:
        return self.blocks_per_error

    @property
    @override
    def runs_by_itself(self) -> bool:
        return False

    @property
    @override
    def in_one_piece(self) -> bool:
        return False

    @property
    @override
    def law_places(self) -> tuple[str, ...]:
        if self.place == JOINT:
            return places.of_parts([places.JOINT])
        return places.of_parts([places.AIR] if self.rig.drive == "regulator" else [places.AIR, places.VALVES])

    @cached_property
    @override
    def vector(self) -> Floats:
        return self.rig.parameters("free" if self.place == JOINT else "locked")

    def vectors(self, points: Sequence[Point], known: Sequence[Mapping[str, float]]) -> dict[str, list[Floats]]:
        """Parameter vectors of several models for each recording, by its name. `known`: :meth:`values` of each."""
        off = NO_REGULATORS if self.place == JOINT else {}
        return {
            name: [
                par.changed(
                    self.vector, {**joint_stage.model_values(self.start.unknowns, values, name), **point.effects, **off}
                )
                for values, point in zip(known, points, strict=True)
            ]
            for name in dict.fromkeys(run.name for run in self.runs)
        }  # fmt: skip

    @override
    def simulated_each(self, points: Sequence[Point], whole: bool = False) -> list[Floats]:
        known = [self.values(point) for point in points]
        vectors = self.vectors(points, known)
        encoders = [(one.get(joint_stage.ZERO, 0.0), -one.get(joint_stage.DELAY, 0.0)) for one in known]
        shown = [self.run_shown(run, vectors[run.name], encoders) for run in self.runs]
        return [_laid(self.place, of_each) for of_each in zip(*shown, strict=True)]

    def run_shown(self, run: Run, vectors: Sequence[Floats], encoders: Sequence[tuple[float, float]]) -> list[Floats]:
        """What the sensors would show over a run (N, 4) of each model, NaN of what this part does not give.

        `encoders`: zero [rad] and delay [s] of each.
        """
        out = [np.full((len(run), len(CHANNELS)), np.nan) for _ in vectors]
        if self.place == AIR:
            for one, pressures in zip(out, air_stage.simulated_each(run, vectors, 0.0, _ANEW_S)[0], strict=True):
                one[:, PRESSURE_1:] = pressures
            return out
        if not np.isfinite(run.angle).any():
            return out
        if not run.locked:
            for one, angle in zip(out, joint_stage.simulated_each(run, vectors, encoders), strict=True):
                one[:, ANGLE] = angle
        if np.isfinite(run.torque).any():
            for one, torque in zip(out, joint_stage.torques_each(run, vectors, encoders), strict=True):
                one[np.isfinite(run.angle), TORQUE] = torque
        return out

    @override
    def states(self, point: Point) -> tuple[Floats, Floats]:
        shown, measured = self.simulated(point, whole=True), self.trial.measured
        angle, torque, *pressures = np.where(np.isfinite(shown), shown, measured).T
        held, velocity = (
            np.resize(np.concatenate(columns), len(angle))
            for columns in ([run.angle for run in self.runs], [run.velocity for run in self.runs])
        )
        # The angle of a locked joint is neither simulated nor compared.
        angle = np.where(np.isnan(angle), held, angle)
        return np.column_stack([angle, velocity, *pressures]), torque

    @override
    def candidates(self, taken: Mapping[str, float]) -> tuple[Candidate, ...]:
        present = {*_IN_THE_BASE, *self.rig.effects, *(path.split(".")[1] for path in taken)}
        out = []
        for name, effect in CATALOGUE.items():
            acts = _HOOKS[self.place] & set(effect.hooks)
            of_drive = self.place == JOINT or name.startswith("regulator_") == (self.rig.drive == "regulator")
            if name in present or not (acts and of_drive and effect.deterministic) or name.endswith("_by_signal"):
                continue
            # The share of each muscle in the motion is not observable; its own pressure shows its air.
            form = replace(effect.form, low={**effect.form.low, **_DISSIPATES.get(name, {})})
            out += [Candidate(name, replace(form, tied=True))]
            out += [Candidate(name, form)] if self.place == AIR and not form.tied else []
        return tuple(out)


@dataclass(frozen=True, eq=False, repr=False)
class FoundFromPressures(Shown):
    """A diagnosis by parts of the model."""

    recalibrated: FromPressures
    extended: FromPressures | None  # the same with the found effects; None if none was found
    judged: tuple[Judged, ...]  # the verdict on each part

    @property
    def verdict(self) -> Verdict:
        """``effect``, ``none`` or ``unexplained``."""
        return overall(one.verdict for one in self.judged)

    @property
    def placed(self) -> tuple[tuple[Place, FoundEffect], ...]:
        """The found effects, each with its part of the model."""
        return tuple((place_of(one), effect) for one in self.judged for effect in one.effects)

    @property
    def tried(self) -> tuple[tuple[Place, TriedCandidate], ...]:
        """Every candidate, each with its part of the model, the best first."""
        every = [(place_of(one), item) for one in self.judged for item in one.ranking.tried]
        return tuple(sorted(every, key=lambda pair: (-pair[1].standing, -pair[1].score)))

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Effects that the recordings cannot tell from the detected ones."""
        return not_told_apart(self.judged, ())

    @property
    def unexplained(self) -> tuple[Place, ...]:
        """Parts of the model that err, and nothing says by what."""
        return tuple(place_of(one) for one in self.judged if one.verdict == UNEXPLAINED)

    @property
    def proposed(self) -> FromPressures | None:
        """The result whose rig is best on held-out data; None if that is the rig as configured."""
        base, extended = (None if one is None or one.rejected else one for one in (self.recalibrated, self.extended))
        if base is None or extended is None:
            return extended or base
        # An effect of the air hardly changes the angle, since the measured pressures drive the joint.
        worse = extended.pooled("identified") > _AS_GOOD * base.pooled("identified")
        return base if worse else extended


def place_of(judged: Judged) -> Place:
    """The part of the model that a verdict is on."""
    return JOINT if judged.group.name == JOINT else AIR


def diagnose(recordings: Sequence[Given], rig: Rig, settings: Settings, whole: int = 0) -> FoundFromPressures:
    """Find the effect that the model of a rig lacks.

    Args:
        recordings: each with its joint's condition and a name.
        rig: from data sheets, or a known one of which short trials were recorded.
        settings: share that is held out, threads, seed and progress count here.
        whole: number of recordings at the end that are held out as a whole, in place of the share.

    Raises:
        BadInput: no free joint with a measured angle.
    """
    progress, jobs = settings.progress, settings.jobs
    base = identify(recordings, rig, settings.holdout, 2, settings.seed, jobs, progress, whole)
    ends = fitted_until(recordings, settings.holdout, whole)
    own, corrected = with_joint(rig, base.joint, recordings)
    groups = [group_of(JOINT, rig, base.joint.moved, recordings, ends, settings)]
    if base.air is not None:
        groups.append(group_of(AIR, own, base.air.moved, corrected, ends, settings))
    there = tuple(group for group in groups if group is not None)
    prepared = Prepared(rig, rig, (), tuple(group.experiments[0].trial for group in there), there, len(recordings))
    with_laws = [of_part(one, progress) for one in verdicts(prepared, settings, Timings())]
    judged = tuple(one for one, _ in with_laws)
    laws = {place_of(one): learned for one, learned in with_laws if learned is not None}
    while places_found := [place_of(one) for one in judged if one.effects]:
        progress("all values once more, with the effects")
        fits = {place_of(one): _with_effects(one) for one in judged if one.effects}
        found = tuple(_with_values(one, fits[place_of(one)]) if one.effects else one for one in judged)
        joint, air = fits.get(JOINT, base.joint), fits.get(AIR, base.air)
        # What met a bound before the effects were known has no part in the fits with them.
        before = {JOINT: base.joint, AIR: base.air}
        earlier = [text for place in fits if (fit := before[place]) is not None for text in put_back(fit)]
        own = functools.reduce(lambda known, learned: learned.in_rig(known), laws.values(), rig)
        extended = concluded(recordings, ends, own, joint, air, jobs, progress, earlier=earlier)
        if not _contradicts(base, extended):
            return FoundFromPressures(base, extended, found)
        # What changes the pressures within the muscles acts on the joint too, which the air alone does not show.
        doubted = AIR if AIR in places_found else JOINT
        laws.pop(doubted, None)
        judged = tuple(_doubted(one, base, extended) if place_of(one) == doubted else one for one in judged)
    return FoundFromPressures(base, None, judged)


_OF_THE_WHOLE = {
    "identified": "the filter errs",
    "model_alone": "the model alone",
    "pressures_alone": "the joint along the pressures",
}


def _contradicts(base: FromPressures, extended: FromPressures) -> bool:
    """Whether a model with effects of its parts is worse in all that held-out data show of the whole joint."""
    pairs = [(base.pooled(name), extended.pooled(name)) for name in _OF_THE_WHOLE]
    return all(not after <= _AS_GOOD * before for before, after in pairs if math.isfinite(before))


def _doubted(judged: Judged, base: FromPressures, extended: FromPressures) -> Judged:
    """A verdict on a part of the model whose effects the whole joint contradicts."""
    names = " and ".join(effect.name for effect in judged.effects)
    errors = ", ".join(
        f"{words} by {number(extended.pooled(name))}° in place of {number(base.pooled(name))}°"
        for name, words in _OF_THE_WHOLE.items()
        if math.isfinite(base.pooled(name))
    )
    note = (
        f"{names} would explain {percent(judged.share)} of what is left in {place_of(judged)}. It is not the cause: "
        f"with it {errors} on held-out data."
    )
    verdict: Verdict = UNEXPLAINED if judged.base.has_significant_excess else NONE
    return replace(
        judged, verdict=verdict, share=None, model=judged.base, effects=(), values={}, firmness={}, warnings=(note,)
    )


def group_of(
    place: Place, rig: Rig, start: Fit, recordings: Sequence[Given], ends: Sequence[float], settings: Settings
) -> Group | None:
    """A part of the model with what is fitted and what is held out; None if either is missing."""
    parts = []
    for held_out in (False, True):
        runs = parts_of(recordings, ends, held_out)
        one = _experiment(place, rig, start, air_stage.usable(runs) if place == AIR else runs, settings)
        if one is None:
            return None
        parts.append(one)
    held = replace(parts[1], fitted=0)
    return Group(place, (replace(parts[0], judged=(held,)),), (0,), (held,))


def _experiment(place: Place, rig: Rig, start: Fit, runs: Sequence[Run], settings: Settings) -> _Part | None:
    if not runs:
        return None
    period = float(np.median([run.period for run in runs]))
    block = max(1, round(BLOCK_S / period))
    cut = tuple(run.first(len(run) // block * block) for run in runs if len(run) >= block)
    stop = joint_stage.off_stop(rig)
    columns = [
        np.column_stack([
            np.full(len(r), np.nan) if r.locked else r.angle, joint_stage.muscle_torque(r, stop), r.pressure
        ])
        for r in cut
    ]  # fmt: skip
    names = ", ".join(dict.fromkeys(run.name for run in cut))
    measured = _laid(place, columns)
    commands = np.resize(np.concatenate([run.command for run in cut]), (len(measured), 2))
    trial = Trial(names, DRIVEN, 0.0, period, commands, measured)
    out = _Part(rig, trial, len(trial), seed=settings.seed, jobs=settings.jobs, place=place, runs=cut, start=start)
    return out if out.channels else None


def _laid(place: Place, runs: Sequence[Floats]) -> Floats:
    """Columns of all runs (N, 4) one behind the other; of the air those of chamber 2 behind those of chamber 1.

    The chambers are of one kind. If each had an error of its own size, a fit would give up one for the other.
    """
    columns = np.concatenate(runs)
    return columns if place == JOINT else np.vstack([columns, columns[:, [ANGLE, TORQUE, PRESSURE_2, PRESSURE_1]]])


def _with_effects(judged: Judged) -> Fit:
    """The values of a part of the model with its effects, fitted once more with the identification's own weights."""
    (experiment,), (found,) = judged.model.experiments, judged.model.fits
    assert isinstance(experiment, _Part)
    extra = [_unknown(free) for free in found.free]
    unknown = [*experiment.start.unknowns, *extra]
    known = [item.amount(found.point.effects[free.path]) for item, free in zip(extra, found.free, strict=True)]
    begin, runs, rig = np.concatenate([found.point.theta, known]), experiment.runs, experiment.rig
    if experiment.place == JOINT:
        residual = joint_stage.residual_of(rig, runs, unknown, math.inf)
    else:
        residual = air_stage.residual_of(rig, runs, 0.0, air_stage.HORIZONS[-1], unknown)
    last = fitted(unknown, residual, begin, _EVALUATIONS, experiment.jobs)
    return within_bounds(last, residual, _EVALUATIONS, experiment.jobs, {item.name for item in extra})


def _with_values(judged: Judged, fit: Fit) -> Judged:
    """A verdict with the effects' values of the last fit, which the rig file has."""
    values = fit.parameters
    return replace(
        judged,
        effects=tuple(
            replace(effect, parameters={
                name: size._replace(value=values.get(parameter_path(effect.name, name), size.value))
                for name, size in effect.parameters.items()
            })
            for effect in judged.effects
        ),
    )  # fmt: skip


def _unknown(free: FreeEffectParameter) -> Unknown:
    item, paths = free.item, free.paths
    if item.is_size:
        return Unknown(paths[0], paths, 0.0, _SIZE_STD * item.scale, low=item.low, high=item.high)
    start = min(max(item.scale, item.low), item.high)
    return Unknown(paths[0], paths, start, _SHAPE_STD, True, item.low, item.high)
