"""How the numbers of a rig walk from day to day: the prior with which one more recording updates a rig file.

A number stays what it was, but for a walk: friction and leaks change most, geometry hardly. What the recording does not
determine keeps its value, so a short one is enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from pam_antagonist.identification.joint_stage import DELAY, ZERO
from pam_antagonist.inference.free_parameters import EFFECT_PARAMETERS, sizes_of
from pam_antagonist.inference.unknown import Unknown
from pam_antagonist.rig import Rig

_SHARES: Mapping[str, float] = MappingProxyType({
    "friction.": 0.3, "effects.friction": 0.3, "joint.viscous_friction": 0.05, "effects.leak.": 0.5, "effects.": 0.2,
    "muscle_1.force.c6": 0.0003, "muscle_2.force.c6": 0.0003, "muscle_": 0.003, "geometry.": 0.001, "joint.stop": 0.001,
    "joint.inertia": 0.01, "limb": 0.01, "gas.": 0.03, "valve_": 0.03, "supply.pressure": 0.02, "": 0.05,
})  # fmt: skip
"""Standard deviation of a walk, as a share of the value, by the beginning of the number's name; the first that fits."""
_SIZES: Mapping[str, float] = MappingProxyType({ZERO: math.radians(0.1), DELAY: 1e-3})
"""The same of numbers that no rig file has [rad, s]."""
_OF_NOTHING = 0.1
"""The same of an effect that there was none of, as a share of its usual size."""
_REACH = 10.0
"""How far a fit may move a number, in standard deviations of its walk."""


def walking(rig: Rig) -> Callable[[Unknown], Unknown]:
    """What is known of a rig's numbers today: as wide as their walks."""

    def walk(item: Unknown) -> Unknown:
        if item.recording:
            return item
        value = rig.value(item.path) if item.paths else item.start
        # What had vanished may come back.
        start = max(value, _OF_NOTHING * item.start) if item.may_vanish else value
        share = next(share for beginning, share in _SHARES.items() if item.name.startswith(beginning))
        effect = EFFECT_PARAMETERS.get(item.name)
        least = 0.0 if effect is None else _OF_NOTHING * effect.scale
        std = share if item.positive else _SIZES.get(item.name, max(share * abs(start), least))
        return replace(item, start=start, std=std, reach=_REACH)

    return walk


def free_sizes(rig: Rig) -> list[str]:
    """The sizes of the rig file's effects, by dotted path; a limb has no size that walks by itself."""
    return [path for path in sizes_of(rig) if not path.startswith("effects.limb_weight.")]
