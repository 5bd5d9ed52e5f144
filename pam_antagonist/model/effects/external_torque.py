r"""A torque from outside that no law gives.

```math
J\ddot\psi = \tau + d - T_f - k_s\psi,\qquad
\dot d = -\frac{d}{T} + w,\quad T = \frac{2 s^2}{\sigma^2},\quad \mathrm{var}\int_{\Delta t} w = \sigma^2\,\Delta t .
```

Where nothing shows $d$, its standard deviation grows to $s$ and stays there. Without a declared $s$ it is a random
walk, whose standard deviation grows for ever. $s$ is how hard one pushes, and $T$ how long a push lasts.

Pushes that set in at once are declared by `onset`. An innovation beyond so many standard deviations says that one has
begun or ended: the filter then lets $d$ be anything within $s$. Noise of two pressures at 1 kHz exceeds 5.5 once an
hour.

The model alone has $d = 0$; a filter estimates it (`EstimateRun.added["external_torque"]`). Where the torque from
outside was *measured*, it is an input instead: `u[2]` of `integration.rk4_step`, `external_torque` of `simulate_model`.
"""

from __future__ import annotations

from pam_antagonist.model.effects.base import AddedState, Effect, EffectParameter, SealedJoint, inlined

UNBOUNDED = 1e9
"""[N m] As a prior: none. The decay is then below the last digit of any torque."""
NEVER = 1e9
"""As an onset: none. The torque from outside changes as its random walk does."""


@inlined
def decay(noise, prior, external_torque):
    """dd/dt [N m/s]: back to zero within T = 2 s²/σ².

    `noise`: σ [N m/s^0.5]. `prior`: s [N m], UNBOUNDED for a random walk. `external_torque`: d [N m].
    """
    return -external_torque * (noise * noise / (2.0 * prior * prior))


@inlined
def disturbance(external_torque):
    """Torque from outside [N m]: the state itself."""
    return external_torque


EFFECT = Effect(
    name="external_torque",
    meaning="Somebody or something pushes the joint now and then.",
    law="τ gains d, dd/dt = −d/T + w, T = 2 s²/σ², w white noise of the standard deviation σ a square root of a second",
    source="disturbance observer",
    signature="The joint moves without a cause in the pressures, at some times and not at others.",
    parameters=(
        EffectParameter("noise", "N m/s^0.5", 0.0, 0.0, 10.0, 0.05, "size of the random walk", r"\sigma"),
        EffectParameter(
            "prior", "N m", UNBOUNDED, 1e-3, UNBOUNDED, 0.5, "standard deviation where nothing is observed", "s"
        ),
        EffectParameter(
            "onset", "-", NEVER, 3.0, NEVER, 5.5, "standard deviations of an innovation from which on a push has set in"
        ),
    ),
    states=(AddedState("external_torque", "N m", "noise", 0.2, "noise", symbol="d", rate=decay, prior="prior"),),
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
