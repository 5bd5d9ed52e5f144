r"""A torque from outside that no law gives.

```math
J\ddot\psi = \tau + d - T_f - k_s\psi,\qquad
d(t)\ \text{a random walk},\quad \mathrm{var}\,\Delta d = \sigma^2\,\Delta t .
```

The model alone has $d = 0$; a filter estimates it (`EstimateRun.added["external_torque"]`). Where the torque from
outside was *measured*, it is an input instead: `u[2]` of `dynamics.rk4_step`, `external_torque` of `simulate_model`.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter, SealedJoint, inlined


@inlined
def disturbance(external_torque):
    """Torque from outside [N m]: the state itself."""
    return external_torque


EFFECT = Effect(
    name="external_torque",
    meaning="Somebody or something pushes the joint now and then.",
    law="τ gains d, a random walk whose increments have the standard deviation σ a square root of a second",
    source="disturbance observer",
    signature="The joint moves without a cause in the pressures, at some times and not at others.",
    parameters=(EffectParameter("noise", "N m/s^0.5", 0.0, 0.0, 10.0, 0.05, "size of the random walk", r"\sigma"),),
    states=(AddedState("external_torque", "N m", "noise", 0.2, "noise", symbol="d"),),
    hooks={"disturbance_torque": disturbance},
    sentence="something pushes the joint now and then (external_torque)",
    experiment="repeat the recording with nobody near the joint",
    distinguished_by={
        "friction": "repeat the same command: friction repeats, a push does not",
        "load_torque": "repeat the same command: a load repeats, a push does not",
    },
    sealed=SealedJoint(part=None, reason="the torque from outside is what was applied"),
    needs_motion=True,
    needs_angle=True,
    deterministic=False,
)
