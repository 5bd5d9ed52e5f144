"""The joint: torque of the muscles, friction, motion. Equations (8), (9) and (10).

The laws of friction that the paper compares with (10) are here too.
"""

from __future__ import annotations

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model.lane_values import shared
from pam_antagonist.model.numeric import exp
from pam_antagonist.model.parameters import (
    ATMOSPHERE,
    FRICTION_LAW,
    FRICTION_LAWS,
    FRICTION_STEP,
    FRICTION_VELOCITY,
    GRAVITY,
    INERTIA,
    KINETIC_FRICTION,
    LEVER_FORCE,
    MASS,
    MUSCLE_FRICTION,
    PRESSURE_FLOOR,
    RADIUS,
    SHAFT_FRICTION,
    SHAFT_RADIUS,
    STATIC_FRICTION,
    STIFFNESS,
    VISCOUS,
)

_SIMPLE, _NONE = (float(FRICTION_LAWS.index(law)) for law in ("simple", "none"))


@inlined
def muscle_torque(cosine, force_1, force_2, p):
    """τ [N m], equation (9): r cos ψ (F_1 − F_2)."""
    return p[RADIUS] * cosine * (force_1 - force_2)


@inlined
def coulomb_torque(force_1, force_2, pressure_1, pressure_2, p):
    """T_s + T_p [N m]: the shaft's friction and the pressure-dependent friction of tube and mesh.

    T_s = r_p μ_s |F_1 + F_2 − M g|;  T_p = μ_p (1/(P_1 − P_out)² + 1/(P_2 − P_out)²), where μ_p is the
    tables' T_p'. T_p is singular at atmospheric pressure: the gauge pressures in it are bounded below by
    ``friction.pressure_floor``.
    """
    shaft = p[SHAFT_RADIUS] * p[SHAFT_FRICTION] * abs(force_1 + force_2 - p[MASS] * p[GRAVITY])
    gauge_1 = max(pressure_1 - p[ATMOSPHERE], p[PRESSURE_FLOOR])
    gauge_2 = max(pressure_2 - p[ATMOSPHERE], p[PRESSURE_FLOOR])
    square_1 = gauge_1 * gauge_1
    square_2 = gauge_2 * gauge_2
    return shaft + p[MUSCLE_FRICTION] * (square_1 + square_2) / (square_1 * square_2)


@in_place
def _compared_coulomb(velocity, p):
    """Torque [N m] of the other laws. It is a separate function to keep the code of the paper's law small and fast."""
    if shared(p[FRICTION_LAW]) == _SIMPLE:
        return p[LEVER_FORCE] * p[RADIUS]
    fade = exp(-abs(velocity) / p[FRICTION_VELOCITY])
    return (p[STATIC_FRICTION] - p[KINETIC_FRICTION]) * fade + p[KINETIC_FRICTION]


@inlined
def kikuuwe_torque(velocity, applied, coulomb, viscous, p):
    """T_f [N m] by the law of Kikuuwe et al., equation (10), and whether the joint slides.

    ψ̇(k) in the equation is the velocity that the joint would have after a step without friction,
    ψ̇(k−1) + Z T_0(k), with Z = T_stp/J. (The paper prints J/T_stp, which is no velocity per torque.) Used
    inside the Runge-Kutta stages the law is a Coulomb friction whose jump at rest is a steep ramp with
    the time constant T_stp: a body that sticks comes to rest within a few steps and stays.

    The dry friction alone looks a step ahead. In the equation the viscous torque does too, which inside the stages
    would be an inertia of J + T_stp c_s.

    Returns T_f [N m], and 1.0 where the joint slides or 0.0 where it sticks.
    """
    # Divisions are slow. Those of parameters alone are the same in all stages of a step: the compiler does them once.
    steepest = p[INERTIA] / p[FRICTION_STEP]
    viscous = min(viscous, steepest)  # of a more viscous joint a step could not follow the decay
    stopping = (steepest - viscous) * velocity + applied
    if abs(stopping) <= coulomb:
        return stopping + viscous * velocity, 0.0
    return (coulomb if stopping > 0.0 else -coulomb) + viscous * velocity, 1.0


@inlined
def quickest_lag(p):
    """Shortest time constant [s] that a step of the integration follows."""
    return 0.5 * p[FRICTION_STEP]


@inlined
def friction_torque(velocity, applied, coulomb, p):
    """T_f [N m] by the rig's law of friction, and whether the joint slides.

    The laws that the paper compares with (10) (Table III) replace T_s + T_p and have no viscous torque:
    ``simple`` is a constant force on the lever, r F_r sgn ψ̇; ``tondu`` is
    ((f_s − f_k) exp(−|ψ̇|/v) + f_k) sgn ψ̇ (Tondu and Lopez 2000), read as torques; ``none`` is no friction.
    """
    if shared(p[FRICTION_LAW]) == 0.0:
        return kikuuwe_torque(velocity, applied, coulomb, p[VISCOUS], p)
    if shared(p[FRICTION_LAW]) == _NONE:
        return 0.0, 1.0
    free = velocity + p[FRICTION_STEP] / p[INERTIA] * applied
    return kikuuwe_torque(velocity, applied, _compared_coulomb(free, p), 0.0, p)


@inlined
def acceleration(angle, velocity, torque, coulomb, p, effects=True):
    """ψ̈ [rad/s²], equation (8): (τ − T_f − k_s ψ)/J, and whether the joint slides (1.0) or sticks (0.0).

    `effects`: None where the rig is known to be plain, so that the friction law is the paper's own.
    """
    applied = torque - p[STIFFNESS] * angle
    if effects is None:
        friction, slides = kikuuwe_torque(velocity, applied, coulomb, p[VISCOUS], p)
    else:
        friction, slides = friction_torque(velocity, applied, coulomb, p)
    return (applied - friction) * (1.0 / p[INERTIA]), slides
