r"""A force map that drifts with running time.

```math
F_i = F(l_i, P_i) - s_i\, w\,\big(F(l_i, P_i) - F(l_i, P_{out})\big),\qquad \dot w = (1 - w)/T,\qquad w(0) = 0 .
```

The muscle loses the share $s_i$ of what the pressure adds to its force. A negative share is a gain. The force at the
atmosphere's pressure stays as it was identified. The clock starts with the recording. A muscle that is warm by then
does not drift. The parts of `hysteresis` and `creep` do not drift.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import (
    AddedState,
    Effect,
    EffectParameter,
    Form,
    SealedJoint,
    inlined,
    per_muscle,
)


@inlined
def lost_force(share, warmed, static_force, passive_force):
    """Force [N] that warming adds to the contraction force: minus a share of the pressure's part.

    `share`: s [-]. `warmed`: w [-]. `static_force`: F(l, P) [N]. `passive_force`: F(l, P_out) [N].
    """
    return -share * warmed * (static_force - passive_force)


@inlined
def warming(time, warmed):
    """dw/dt [1/s]. `time`: T [s]. `warmed`: w [-]."""
    return (1.0 - warmed) / time


EFFECT = Effect(
    name="warm_up",
    meaning="The muscles get weaker or stronger with running time, as they warm up.",
    law="F_i loses s_i w (F(l_i, P_i) − F(l_i, P_out)), dw/dt = (1 − w)/T, w = 0 at the start",
    source="first-order warming; that a muscle's force drifts with its temperature in long runs: Andrikopoulos, "
    "Nikolakopoulos and Manesis (2012); force by gauge pressure: Chou and Hannaford (1996)",
    signature="Torque and rest angle drift from the start on, by more at higher pressure. No step of voltage "
    "or angle starts the drift, and the pressures are right.",
    parameters=(
        *per_muscle("share", "-", -0.3, 0.3, 0.02, "lost share of the force that the pressure adds", symbol="s"),
        EffectParameter("time", "s", 40.0, 5.0, 600.0, 40.0, "time constant of the warming", "T"),
    ),
    states=(AddedState("warmed", "-", "share_1", 0.1, 1e-3, ("share_2",), symbol="w", rate=warming),),
    hooks={"contraction_force": lost_force},
    sentence="the force of the muscles drifts with running time (warm_up)",
    experiment="record for ten minutes, and again directly afterwards: a warm muscle does not drift",
    distinguished_by={
        "creep": "hold voltages and angle for ten minutes, then step: creep begins anew with each step, warming does "
        "not",
        "pressure_sensor": "compare the sensor with a gauge at the start and at the end",
    },
    # A diagnosis looks for a loss only: a gain would fit any slow drift. The bound was set after a diagnosis of a
    # recording of rig A had named this effect beside hysteresis.
    form=Form(low={"share": 0.0}),
    sealed=SealedJoint(part=None, reason="within one recording a slow drift of the force looks like creep"),
    needs_angle=True,
    tested_with=("valve", "command"),
)
