"""A part of the model of a rig as an experiment: joint and muscles, or chambers and valves.

The measured pressures drive joint and muscles. Commands and the measured motion drive chambers and valves, or
regulators, anew from each second on. Each is an experiment of all recordings together, with the identification's
priors, so that the search and the rules of the verdict are those of all other joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from pam_antagonist.diagnosis.preparation import DRIVEN, Group, Settings
from pam_antagonist.identification import air_stage, joint_stage
from pam_antagonist.identification.filter_stage import Given
from pam_antagonist.identification.from_pressures import parts_of
from pam_antagonist.identification.runs import Run
from pam_antagonist.inference.experiment import Experiment
from pam_antagonist.inference.fit import Fit
from pam_antagonist.inference.free_parameters import Candidate, off_stop
from pam_antagonist.inference.point import Channel, Point
from pam_antagonist.inference.pressure_driven import NO_REGULATORS
from pam_antagonist.inference.trial import ANGLE, BLOCK_S, CHANNELS, PRESSURE_1, PRESSURE_2, TORQUE, Trial
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.inference.valve_driven import TITLES
from pam_antagonist.model import parameters as par
from pam_antagonist.model.effects import CATALOGUE, places
from pam_antagonist.rig import Rig

Floats = NDArray[np.float64]
Part = Literal["joint and muscles", "chambers and valves"]
JOINT: Part = "joint and muscles"
AIR: Part = "chambers and valves"

_HOOKS: Mapping[Part, frozenset[str]] = {
    JOINT: frozenset({"contraction_force", "muscle_force", "coulomb_torque", "joint_torque"}),
    AIR: joint_stage.AIR_HOOKS,
}
"""Where an effect acts says which part of the model it belongs to."""
_IN_THE_BASE = (
    "load_torque", "limb_weight", "friction_by_pressure", "valve_offset", "regulator_lag", "regulator_limits",
    "learned",
)  # fmt: skip
_ANGLE, _PRESSURE = 0.005, 7e3
"""Errors that say nothing where only a data sheet tells the law: of the angle as a share of the range that was seen, of
the pressures [Pa] over a second. That of the torque is the fit's share of one muscle's torque: a share of the torque
that was seen would grow with a locked recording, and hide what a free joint shows."""
_DISSIPATES = {
    "friction": {"coulomb": 0.0, "stribeck": 0.0}, "hysteresis": {"amplitude": 0.0}, "creep": {"share": 0.0},
    "thermal": {"share": 0.0},
}  # fmt: skip
"""Least sizes of effects that take energy. Friction, force and polytropic index of the base are free: less than nothing
of such an effect, which took the errors of a fresh rig with nothing wrong, stands for something else."""
_ANEW_S = air_stage.HORIZONS[-1]


@dataclass(frozen=True, eq=False)
class ModelPart(Experiment):
    """All runs of the recordings as one experiment of a part of the model.

    The measured pressures drive joint and muscles. Commands and the measured motion drive chambers and valves, or
    regulators, anew from each second on.
    """

    part: Part = JOINT
    runs: tuple[Run, ...] = ()  # each cut to whole blocks
    start: Fit = Fit((), np.zeros(0), np.zeros((0, 0)), 0.0)  # of the identification

    @property
    @override
    def directions(self) -> tuple[Unknown, ...]:
        return self.start.unknowns

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
        wanted = (ANGLE, TORQUE) if self.part == JOINT else (PRESSURE_1,)
        return tuple(c for c in wanted if self.trial.has(c))

    @property
    @override
    def titles(self) -> tuple[Channel, ...]:
        return tuple(TITLES[c] for c in self.channels) if self.part == JOINT else (Channel("Pressures", "kPa", 1e-3),)

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
        """What a data sheet's law leaves, or a known joint by errors of the measured pressures.

        Known valves leave the error of the reading at which they began anew: a shut one keeps it for the second.
        """
        if self.part == AIR:
            return np.hypot(self.noise, _PRESSURE if self.rig.is_from_data_sheets else self.noise)
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
        if self.part == JOINT:
            return places.of_parts([places.JOINT])
        return places.of_parts([places.AIR] if self.rig.drive == "regulator" else [places.AIR, places.VALVES])

    @cached_property
    @override
    def vector(self) -> Floats:
        return self.rig.parameters("free" if self.part == JOINT else "locked")

    def vectors(self, points: Sequence[Point], known: Sequence[Mapping[str, float]]) -> dict[str, list[Floats]]:
        """Parameter vectors of several models for each recording, by its name. `known`: :meth:`values` of each."""
        off = NO_REGULATORS if self.part == JOINT else {}
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
        return [_laid(self.part, of_each) for of_each in zip(*shown, strict=True)]

    def run_shown(self, run: Run, vectors: Sequence[Floats], encoders: Sequence[tuple[float, float]]) -> list[Floats]:
        """What the sensors would show over a run (N, 4) of each model, NaN of what this part does not give.

        `encoders`: zero [rad] and delay [s] of each.
        """
        out = [np.full((len(run), len(CHANNELS)), np.nan) for _ in vectors]
        if self.part == AIR:
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
            acts = _HOOKS[self.part] & set(effect.hooks)
            of_drive = self.part == JOINT or name.startswith("regulator_") == (self.rig.drive == "regulator")
            if name in present or not (acts and of_drive and effect.deterministic) or name.endswith("_by_signal"):
                continue
            # The share of each muscle in the motion is not observable; its own pressure shows its air.
            form = replace(effect.form, low={**effect.form.low, **_DISSIPATES.get(name, {})})
            out += [Candidate(name, replace(form, tied=True))]
            out += [Candidate(name, form)] if self.part == AIR and not form.tied else []
        return tuple(out)


def group_of(
    part: Part, rig: Rig, start: Fit, recordings: Sequence[Given], ends: Sequence[float], settings: Settings
) -> Group | None:
    """A part of the model with what is fitted and what is held out; None if either is missing."""
    parts = []
    for held_out in (False, True):
        runs = parts_of(recordings, ends, held_out)
        one = _experiment(part, rig, start, air_stage.usable(runs) if part == AIR else runs, settings)
        if one is None:
            return None
        parts.append(one)
    held = replace(parts[1], fitted=0)
    return Group(part, (replace(parts[0], judged=(held,)),), (0,), (held,))


def _experiment(part: Part, rig: Rig, start: Fit, runs: Sequence[Run], settings: Settings) -> ModelPart | None:
    if not runs:
        return None
    period = float(np.median([run.period for run in runs]))
    block = max(1, round(BLOCK_S / period))
    cut = tuple(run.first(len(run) // block * block) for run in runs if len(run) >= block)
    stop = off_stop(rig)
    columns = [
        np.column_stack([
            np.full(len(r), np.nan) if r.locked else r.angle, joint_stage.muscle_torque(r, stop), r.pressure
        ])
        for r in cut
    ]  # fmt: skip
    names = ", ".join(dict.fromkeys(run.name for run in cut))
    measured = _laid(part, columns)
    commands = np.resize(np.concatenate([run.command for run in cut]), (len(measured), 2))
    trial = Trial(names, DRIVEN, 0.0, period, commands, measured)
    out = ModelPart(rig, trial, len(trial), seed=settings.seed, jobs=settings.jobs, part=part, runs=cut, start=start)
    return out if out.channels else None


def _laid(part: Part, runs: Sequence[Floats]) -> Floats:
    """Columns of all runs (N, 4) one behind the other; of the air those of chamber 2 behind those of chamber 1.

    The chambers are of one kind. If each had an error of its own size, a fit would give up one for the other.
    """
    columns = np.concatenate(runs)
    return columns if part == JOINT else np.vstack([columns, columns[:, [ANGLE, TORQUE, PRESSURE_2, PRESSURE_1]]])
