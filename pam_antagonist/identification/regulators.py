"""The pressure regulators of a joint from episodes: from commanded to measured pressures.

The lag is always fitted. Dead time, dead zone, largest rate, threshold and range are found like the effects of a joint,
by the same search (:mod:`pam_antagonist.inference.episode_search`).

A long recording is cut into stretches between rests. A stretch begins where both commands have been constant for a
while: there the pressures equal the commands. Stretches are used as episodes are. A parameter is freed if that explains
enough of stretches that no fit has seen.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.inference.bootstrap import Interval
from pam_antagonist.inference.command_driven import CommandDriven
from pam_antagonist.inference.episode_search import Begun, Tried, search
from pam_antagonist.inference.episodes import EpisodeModel, Episodes
from pam_antagonist.inference.free_parameters import Candidate, moved
from pam_antagonist.inference.held_episodes import EpisodeSplit, held_out, thinned
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.rig import Rig
from pam_antagonist.strict_json import picked

Floats = NDArray[np.float64]

_USED = 300
"""Most episodes that are used: more add little information and take longer."""
_REST_S = 0.25
"""[s] Time for which commands are constant before a stretch: over ten time constants of a regulator."""
_LEAST_S, _LONGEST_S = 0.2, 1.0
"""[s] Shortest and longest stretch; after the latter a regulator shows nothing new."""
_FEWEST = 12
"""Fewest stretches that can be fitted, judged and distinguished from chance."""
_PATHS = (
    "regulator_lag.dead_zone",
    "regulator_lag.largest_rate",
    "regulator_limits.lowest",
    "regulator_limits.highest",
)
_SHARE = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class RegulatorsFound:
    """Regulators that were identified."""

    values: Mapping[str, Interval]  # with 95 % intervals by episode, by dotted path
    tried: tuple[Tried, ...]
    errors: tuple[float, float]  # RMSE [Pa] of each muscle's pressure on later episodes
    command_errors: tuple[float, float]  # RMSE [Pa] of the command itself against each measured pressure
    # measured over modelled pressure on fitted episodes, of each muscle; 1 where both are on one scale.
    gains: tuple[float, float]

    @property
    def resonance(self) -> float:
        """Highest gain of the lag over its gain at rest [-]; 1 for regulators that do not resonate."""
        d = self.values["effects.regulator_lag.damping"].value
        return 1.0 / (2.0 * d * math.sqrt(1.0 - d * d)) if d < math.sqrt(0.5) else 1.0

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        errors = {"errors_pa": self.errors, "command_errors_pa": self.command_errors}
        return picked(self, "values", "tried") | errors | picked(self, "gains", "resonance")

    def on(self, rig: Rig) -> Rig:
        """A rig with these regulators."""
        return moved(rig, {name: interval.value for name, interval in self.values.items()})


def of_commands(joint: Episodes, held: EpisodeSplit, progress: Callable[[str], None]) -> RegulatorsFound:
    """Identify both regulators."""
    driven = CommandDriven.like(joint)
    pool = thinned(held.pool, _USED)
    searched = search(driven, pool, lambda text: progress(f"regulators, {text}"), _all_of_them, few=0)
    fitted = driven.take(pool)
    model = fitted.fit(searched.model)
    later = driven.take(held.later)
    shown = fitted.simulated(model)
    gains = [float(np.polyfit(shown[:, k], fitted.pressure[:, k], 1)[0]) for k in (0, 1)]
    return RegulatorsFound(
        fitted.intervals(model), searched.tried, _rms(later.residual(model)), _rms(later.command - later.pressure),
        (gains[0], gains[1]),
    )  # fmt: skip


def _all_of_them(fitted: Episodes, model: EpisodeModel, offered: Mapping[str, Sequence[Candidate]]) -> list[Begun]:
    """A start for every candidate: beside a lag that was fitted alone, first-order scores may miss them."""
    return [Begun(name, None, CommandDriven.like(fitted).starts(model, forms[0])) for name, forms in offered.items()]


def pressures_of(regulators: RegulatorsFound, joint: Episodes) -> Floats:
    """Pressures that the regulators make of the commands (N, 2) [Pa]."""
    driven = replace(CommandDriven.like(joint), rig=regulators.on(joint.rig))
    return driven.simulated(driven.as_configured)


def _rms(apart: Floats) -> tuple[float, float]:
    first, second = np.sqrt(np.mean(apart**2, axis=0))
    return float(first), float(second)


def beside_the_lag(rig: Rig, trials: Sequence[Trial], jobs: int) -> tuple[dict[str, float], str]:
    """Range, dead zone and largest rate of both regulators, as far as the recordings show them.

    Returns values that differ from the rig's, by dotted path [Pa, Pa/s], and a sentence.
    """
    joint = _stretches(rig, trials, jobs)
    if len(joint) < _FEWEST:
        return (
            {},
            f"skipped: both commands are constant for {_REST_S:g} s before {len(joint)} stretches, expected {_FEWEST}",
        )
    found = of_commands(joint, held_out(len(joint), _SHARE), lambda text: None)
    known = {path: interval.value for path, interval in found.values.items()}
    values = {path: known[path] for path in (f"effects.{name}" for name in _PATHS) if path in known}
    taken = [item.name for item in found.tried if item.taken]
    others = [name for name in taken if name in ("dead time", "threshold")]
    note = f"{len(joint)} stretches determine {', '.join(taken) if taken else 'nothing beside the lag'}"
    if others:
        shown = {path: value for path, value in known.items() if path not in values and "regulator_lag" not in path}
        listed = ", ".join(f"{path.removeprefix('effects.')}: {value:.3g}" for path, value in shown.items())
        note += f"; write into the rig file, under effects: {listed}"
    return values, note


def _stretches(rig: Rig, trials: Sequence[Trial], jobs: int) -> CommandDriven:
    """All stretches of all recordings, one behind the other."""
    parts: list[Mapping[str, NDArray[np.float64]]] = []
    for trial in trials:
        angle = np.where(np.isfinite(trial.measured[:, ANGLE]), trial.measured[:, ANGLE], trial.lock_angle)
        pressure = trial.measured[:, PRESSURE_1 : PRESSURE_1 + 2]
        begins = _begins(trial)
        for begin, end in itertools.pairwise([*begins.tolist(), len(trial)]):
            rows = slice(begin, min(end, begin + trial.samples(_LONGEST_S)))
            if rows.stop - begin >= trial.samples(_LEAST_S) and np.isfinite(pressure[rows]).all():
                parts.append({
                    "time": trial.time[rows], "angle": angle[rows], "pressure": pressure[rows],
                    "command": trial.voltage[rows],
                })  # fmt: skip
    lengths = [len(part["time"]) for part in parts]
    joined = {
        name: np.concatenate([part[name] for part in parts]) if parts else np.empty((0, 2))
        for name in ("time", "angle", "pressure", "command")
    }
    first = np.concatenate([[0], np.cumsum(lengths)]).astype(np.intp)
    return CommandDriven(
        rig, "stretches", first, joined["time"], joined["angle"], joined["pressure"],
        np.empty((int(first[-1]), 0)), joined["command"], jobs,
    )  # fmt: skip


def _begins(trial: Trial) -> NDArray[np.intp]:
    """Samples at which a stretch begins: the last ones before the change of a command that was constant."""
    changes = np.flatnonzero(np.any(np.diff(trial.voltage, axis=0) != 0.0, axis=1))  # the next sample has another one
    stood = np.diff(changes, prepend=-1)
    return np.asarray(changes[stood >= trial.samples(_REST_S)])
