"""Range, dead zone and largest rate of pressure regulators from long recordings, by stretches between rests.

A stretch begins where both commands have been constant for a while: there the pressures equal the commands. Stretches
are used as episodes are (:mod:`pam_antagonist.identification.regulators`). A parameter is freed if that explains enough
of stretches that no fit has seen.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pam_antagonist.identification.regulators import of_commands
from pam_antagonist.inference.command_driven import CommandDriven
from pam_antagonist.inference.held_episodes import held_out
from pam_antagonist.inference.trial import ANGLE, PRESSURE_1, Trial
from pam_antagonist.rig import Rig

Indices = NDArray[np.intp]

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


def _begins(trial: Trial) -> Indices:
    """Samples at which a stretch begins: the last ones before the change of a command that was constant."""
    changes = np.flatnonzero(np.any(np.diff(trial.voltage, axis=0) != 0.0, axis=1))  # the next sample has another one
    stood = np.diff(changes, prepend=-1)
    return np.asarray(changes[stood >= trial.samples(_REST_S)])
