"""The pressure regulators of a joint from episodes: from commanded to measured pressures.

The lag is always fitted. Dead time, dead zone, largest rate, threshold and range are found like the effects of a joint,
by the same search (:mod:`pam_antagonist.inference.episode_search`).
"""

from __future__ import annotations

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
from pam_antagonist.inference.held_episodes import Held, thinned
from pam_antagonist.rig import Rig
from pam_antagonist.strict_json import picked

Floats = NDArray[np.float64]

_USED = 300
"""Most episodes that are used: more add little information and take longer."""


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


def of_commands(joint: Episodes, held: Held, progress: Callable[[str], None]) -> RegulatorsFound:
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


def pressures_of(found: RegulatorsFound, joint: Episodes) -> Floats:
    """Pressures that the regulators make of the commands (N, 2) [Pa]."""
    driven = replace(CommandDriven.like(joint), rig=found.on(joint.rig))
    return driven.simulated(driven.as_configured)


def _rms(apart: Floats) -> tuple[float, float]:
    first, second = np.sqrt(np.mean(apart**2, axis=0))
    return float(first), float(second)
