"""The effects that the paper's model leaves out: one file each, and the catalogue of all effects.

``base`` defines the parts of an effect, ``registry`` collects the effects. The catalogue is read when it is first
used, so that a file of an effect can be imported by itself.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pam_antagonist.model.effects.base import (
    AddedState,
    Effect,
    EffectParameter,
    Form,
    SealedJoint,
    per_muscle,
    state_per_muscle,
)

if TYPE_CHECKING:
    from pam_antagonist.model.effects.registry import (
        ADDED_STATES,
        CATALOGUE,
        DISTURBANCE,
        experiment_between,
        parameter_path,
        random_part,
    )

__all__ = [
    "ADDED_STATES",
    "CATALOGUE",
    "DISTURBANCE",
    "AddedState",
    "Effect",
    "EffectParameter",
    "Form",
    "SealedJoint",
    "experiment_between",
    "parameter_path",
    "per_muscle",
    "random_part",
    "state_per_muscle",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from pam_antagonist.model.effects import registry

    return getattr(registry, name)
