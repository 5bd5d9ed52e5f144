"""A regulator-driven joint from many short episodes: mechanics from measured pressures, regulators from commands.

The measured pressures drive the mechanics, as always with episodes
(:mod:`pam_antagonist.inference.pressure_driven`). Where commands were recorded, the regulators are found from commands
to measured pressures (:mod:`pam_antagonist.identification.regulators`). Whole episodes are held out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pam_antagonist.blas import one_blas_thread
from pam_antagonist.errors import BadInput, NoResult
from pam_antagonist.identification.held_out import WORSE
from pam_antagonist.identification.regulators import RegulatorsFound, of_commands
from pam_antagonist.inference.bootstrap import Interval, rmse
from pam_antagonist.inference.episodes import EpisodeModel
from pam_antagonist.inference.free_parameters import moved
from pam_antagonist.inference.held_episodes import held_out, thinned
from pam_antagonist.inference.pressure_driven import PressureDriven
from pam_antagonist.inference.unknown import of_effect
from pam_antagonist.model.effects import CATALOGUE
from pam_antagonist.rig import Rig
from pam_antagonist.rig.file import refusal
from pam_antagonist.rig.physical import unphysical
from pam_antagonist.shown import number

_USED = 600
"""Most episodes in a fit: more add little information and take longer."""


@dataclass(frozen=True, eq=False)
class EpisodesIdentified:
    """What was found."""

    start: Rig
    rig: Rig
    values: Mapping[str, Interval]  # fitted values with 95 % intervals by episode, by dotted path
    # RMSE [deg] on later and on interleaved episodes, of the rig as configured and as identified.
    errors: Mapping[str, tuple[Interval, Interval]]
    regulators: RegulatorsFound | None
    counts: tuple[int, int, int]
    is_fair: bool = True  # whether the rig file as given may be compared with this one on these episodes

    @property
    def rejected(self) -> str:
        """Why the identified rig should not be used, in a sentence; empty if it may."""
        before, now = (self.errors[name][0].value for name in ("as configured", "identified"))
        if complaint := refusal(self.rig):
            return f"the values that fit best are impossible ({complaint})."
        if now <= WORSE * before or not self.is_fair:
            return ""
        return (
            f"the error of the angle on later episodes is {number(now)}°, with the rig file as given "
            f"{number(before)}°. The joint drifts, or it moved too little to be identified."
        )

    def to_json(self) -> dict[str, Any]:
        """The keys of ``report.json``."""
        return {
            "values": self.values,
            "errors_deg": {name: {"later": a, "interleaved": b} for name, (a, b) in self.errors.items()},
            "regulators": self.regulators,
            "episodes": dict(zip(("fitted", "later", "interleaved"), self.counts, strict=True)),
            "rig": self.start.name,
        }


@one_blas_thread
def identify(
    joint: PressureDriven, share: float, progress: Callable[[str], None] = lambda text: None
) -> EpisodesIdentified:
    """Identify mechanics, effects that the rig has, and regulators.

    Args:
        joint: the episodes.
        share: of the episodes that is held out at the end; every fifth of the others is held out too.
        progress: is called with what is being done.

    Raises:
        BadInput: a joint that does not move.
        NoResult: identified values that are physically impossible.
    """
    if not np.nanmax(joint.angle) > np.nanmin(joint.angle):
        raise BadInput(f"{joint.name}: the angle never changes; expected a joint that moves")
    held = held_out(len(joint), share)
    fitted = joint.take(thinned(held.pool, _USED))
    progress(f"mechanics from {len(fitted)} episodes")
    step = fitted.step_that_serves(fitted.fit(_start(joint)))
    joint, fitted = (replace(one, longest_step=step) for one in (joint, fitted))
    model = fitted.fit(_start(joint))
    errors = {
        name: (_error(joint.take(held.later), one), _error(joint.take(held.interleaved), one))
        for name, one in (("as configured", joint.as_configured), ("identified", model))
    }
    found = moved(joint.rig, joint.values(model)).replaced(identified=joint.name)
    regulators = None
    if np.isfinite(joint.command).all():
        regulators = of_commands(joint, held, progress)
        found = regulators.on(found)
    complaint = unphysical(found)
    if complaint:
        raise NoResult(
            f"{joint.name}: the values that fit it best are impossible: {complaint}; does the joint move enough?"
        )
    counts = len(held.pool), len(held.later), len(held.interleaved)
    values = fitted.intervals(model)
    return EpisodesIdentified(joint.rig, found, values, errors, regulators, counts, is_fair(joint))


def is_fair(joint: PressureDriven) -> bool:
    """Whether the rig file was not fitted to this recording before: then held-out episodes compare it with others."""
    return joint.name not in joint.rig.identified.split(", ")


def _start(joint: PressureDriven) -> EpisodeModel:
    """The rig's own model; the sizes of the effects that it has may move."""
    free = tuple(
        of_effect((f"effects.{name}.{item.name}",), item)
        for name, values in joint.rig.effects.items()
        if "regulator" in CATALOGUE[name].tested_with
        for item in CATALOGUE[name].parameters
        if item.is_size and values.get(item.name, 0.0)
    )
    values = {item.path: joint.rig.value(item.path) for item in free}
    return EpisodeModel(joint.origin.theta, values, free)


def _error(joint: PressureDriven, model: EpisodeModel) -> Interval:
    return rmse(*joint.squares(joint.residual(model)))
