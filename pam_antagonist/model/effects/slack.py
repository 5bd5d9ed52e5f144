r"""A muscle that only pulls.

```math
F_i \to \tfrac12\left(F_i + \sqrt{F_i^2 + w^2}\right) .
```

$F_i$ is the whole contraction force, with what other effects add. A muscle is a braided tube, which buckles where it
should push. Well above the width $w$ nothing changes. At $F_i = 0$ the muscle pulls with $w/2$. Where (6) would push by
more than $w$, hardly any force is left. Without the effect, $w = 0$, the force has no bound and may push (see [where it
does](explanation/model.md#the-muscle-2-3-6-7)).
"""

from __future__ import annotations

import math

from pam_antagonist.model.effects.base import Effect, EffectParameter, SealedJoint, inlined


@inlined
def pull(width, muscle_force):
    """Contraction force of a muscle that only pulls [N].

    `width`: w [N]. `muscle_force`: F [N], which may be negative.
    """
    return 0.5 * (muscle_force + math.sqrt(muscle_force * muscle_force + width * width))


EFFECT = Effect(
    name="slack",
    meaning="A muscle only pulls: where its force would be negative it goes slack.",
    law="F_i becomes (F_i + √(F_i² + w²))/2",
    source="a braided tube buckles under compression: Chou and Hannaford (1996), Tondu and Lopez (2000); smooth "
    "maximum of the force and 0",
    signature="Torque and rest angle are wrong where one muscle is short and its pressure is low, and right elsewhere.",
    parameters=(EffectParameter("width", "N", 0.0, 0.0, 20.0, 2.0, "force over which the bend is rounded", "w"),),
    hooks={"muscle_force": pull},
    sentence="a muscle goes slack where it would have to push (slack)",
    experiment="vent one muscle and turn the joint slowly to the side on which that muscle is short",
    distinguished_by={
        "load_torque": "raise both pressures: a load stays, a slack muscle pulls again",
    },
    sealed=SealedJoint(part=None, reason="both muscles are charged, and pull at every angle"),
    needs_angle=True,
    tested_with=("valve", "command"),
)
