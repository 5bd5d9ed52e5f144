r"""Creep of a muscle.

```math
F_i = F + c_i - y_i,\qquad \dot c_i = (y_i - c_i)/T,\qquad y_i = \varphi_i F - \kappa\, l_i,\qquad F = F(l_i, P_i).
```

$y_i$ is the force in the parts that give way: a share of the whole force, and a spring of the tube that does not depend
on the pressure. After a step of $F$ the share $1 - \varphi$ comes at once, and the rest with the time constant $T$. A
step of the length is opposed by $\kappa\,\Delta l$ at first. The force of `hysteresis` does not creep.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import (
    Effect,
    EffectParameter,
    Form,
    SealedJoint,
    inlined,
    per_muscle,
    state_per_muscle,
)


@inlined
def relaxing_force(share, stiffness, static_force, muscle_length):
    """Force y [N] that relaxes: a share of the static force, and the tube's own spring.

    `share`: φ [-]. `stiffness`: κ [N/m]. `static_force`: F of the static map [N]. `muscle_length`: l [m].
    """
    return share * static_force - stiffness * muscle_length


@inlined
def late_force(share, stiffness, static_force, muscle_length, creep):
    """Force [N] that creep adds to the contraction force: the late force c minus the relaxing force y.

    `share`: φ [-]. `stiffness`: κ [N/m]. `static_force`: F of the static map [N]. `muscle_length`: l_i [m]. `creep`:
    the late force c [N].
    """
    return creep - relaxing_force(share, stiffness, static_force, muscle_length)


@inlined
def late_rate(share, stiffness, time, static_force, muscle_length, creep):
    """dc/dt [N/s]: the late force follows the relaxing force with the time constant.

    `share`: φ [-]. `stiffness`: κ [N/m]. `static_force`: F of the static map [N]. `muscle_length`: l_i [m]. `time`:
    time constant T [s]. `creep`: the late force c [N].
    """
    return (relaxing_force(share, stiffness, static_force, muscle_length) - creep) / time


EFFECT = Effect(
    name="creep",
    meaning="The muscle gives way slowly after its load or its length has changed: rubber relaxes.",
    law="F_i gains c_i − y_i, dc_i/dt = (y_i − c_i)/T, with y_i = φ_i F_i − κ l_i",
    source="standard linear solid (Zener): a share φ of the whole force, and the stiffness κ of the tube, which does "
    "not depend on the pressure; for muscles: Vo-Minh et al. (2011)",
    signature="Torque and rest angle drift for seconds after a step while the pressures are constant. κ alone "
    "shows only while the joint moves.",
    parameters=(
        *per_muscle("share", "-", -0.5, 0.5, 0.02, "share of a change of force that comes late", symbol=r"\varphi"),
        EffectParameter(
            "stiffness", "N/m", 0.0, -2000.0, 2000.0, 50.0, "stiffness of the part of the tube that relaxes", r"\kappa"
        ),
        EffectParameter("time", "s", 4.0, 0.2, 60.0, 4.0, "time constant", "T"),
    ),
    states=state_per_muscle(
        "creep", "N", "share", 3.0, 1e-2, "stiffness", symbol="c", rate=late_rate, steady_value=relaxing_force
    ),
    hooks={"contraction_force": late_force},
    sentence="the muscles give way slowly (creep)",
    experiment="step the angle and hold for 60 s",
    distinguished_by={
        "thermal": "lock the joint, step the pressure and wait: warmth moves the pressures, creep only the torque",
    },
    sealed=SealedJoint(
        part="balance",
        forms=(Form(tied=True),),
        instead="creep of the muscles explains the data as well",
        experiment="hold the joint at one angle for a minute after a step: creep goes on, friction does not",
    ),
    needs_angle=True,
    tested_with=("valve", "regulator", "command"),
)
