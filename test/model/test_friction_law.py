"""The friction law of Kikuuwe et al.: what it is meant to do, whatever its formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
import transcription as paper
from states import ATMOSPHERE, held, steps

from pam_antagonist.model import joint
from pam_antagonist.model import parameters as par

T = paper.CORRECTED
Z = T["T_stp"] / T["J"]
PRESSURES = (400e3, 450e3)


def test_it_is_coulomb_friction_by_implicit_euler(p):
    """The law is the solution of T_f ∈ T_c sgn(ψ̇⁺) + c_s ψ̇ with ψ̇⁺ = ψ̇ + Z (T_0 − T_f), the velocity after
    the step: sliding on with the full friction, or at rest with whatever dry friction that takes. With the printed
    Z = J/T_stp (0.43 instead of 2.35) neither holds."""
    rng = np.random.default_rng(14)
    rested = 0
    for velocity, applied, coulomb in zip(
        rng.normal(0.0, 0.5, 400), rng.normal(0.0, 0.2, 400), rng.uniform(0.0, 0.4, 400), strict=True
    ):
        friction, slides = joint.friction_torque(velocity, applied, coulomb, p)
        after = velocity + Z * (applied - friction)
        if slides:
            assert friction == pytest.approx(coulomb * np.sign(after) + T["c_s"] * velocity, rel=1e-9)
        else:
            assert after == pytest.approx(0.0, abs=1e-15)
            assert abs(friction - T["c_s"] * velocity) <= coulomb
            rested += 1
    assert 50 < rested < 350


@pytest.mark.parametrize("period", [1e-3, 1e-4, 1e-5])
def test_it_is_equation_10_but_for_an_inertia_that_grows_with_the_step(rig, period):
    """Equation (10) in a Runge-Kutta stage gives a sliding joint an inertia of J + T_stp c_s; here it is J."""
    p = par.changed(rig.parameters(), {"friction.time_step": period})
    velocity, applied, coulomb = 0.7, 0.2, 0.11
    printed = paper.printed_friction({**T, "T_stp": period}, velocity, applied, coulomb)
    friction, slides = joint.friction_torque(velocity, applied, coulomb, p)
    assert slides
    assert applied - printed == pytest.approx((applied - friction) / (1.0 + period * T["c_s"] / T["J"]), rel=1e-12)


def test_a_joint_that_slides_does_not_depend_on_the_step(rig):
    """A swing of 20 ms without a reversal, in steps of 1 ms and of 4 ms."""
    start = [0.2, 0.0, 300e3, 500e3]
    fine, coarse = held(rig), par.changed(held(rig), {"friction.time_step": 4e-3})
    slow = steps(start, coarse, 5, dt=4e-3)
    quick = steps(start, fine, 20)
    assert abs(quick[-1, 1]) > 0.5
    assert slow[-1, 1] == pytest.approx(quick[-1, 1], rel=1e-3)


def test_the_printed_z_does_not_hold_a_joint_at_rest(rig):
    """Z = J/T_stp, 0.43: the sticking branch is then too steep for the step, and the least push sets it creeping."""
    start = [paper.rest(T, *PRESSURES, 0.3), 1e-6, *PRESSURES]
    printed = par.changed(held(rig), {"friction.time_step": T["J"] ** 2 / T["T_stp"]})
    assert printed[par.FRICTION_STEP] / T["J"] == pytest.approx(T["J"] / T["T_stp"])
    assert abs(steps(start, printed, 3000)[-1, 0] - start[0]) > math.radians(0.1)
    assert abs(steps(start, held(rig), 3000)[-1, 0] - start[0]) < 1e-8


@pytest.mark.parametrize("share", [-0.999, -0.5, 0.0, 0.5, 0.999])
def test_a_joint_at_rest_stays_while_the_torque_is_below_the_coulomb_torque(rig, share):
    """For 3 s, without creep: rest is a fixed point of the step but for rounding."""
    start = paper.rest(T, *PRESSURES, share)
    states = steps([start, 0.0, *PRESSURES], held(rig), 3000)
    assert np.max(np.abs(states[:, 0] - start)) < 1e-14
    assert np.max(np.abs(states[:, 1])) < 1e-15


@pytest.mark.parametrize("share", [-1.01, 1.01])
def test_a_joint_at_rest_leaves_when_the_torque_is_above(rig, share):
    start = paper.rest(T, *PRESSURES, share)
    states = steps([start, 0.0, *PRESSURES], held(rig), 3000)
    # Towards the balance, and to rest again within the band in which it sticks.
    assert (states[-1, 0] - start) * share > 1e-4
    assert abs(states[-1, 1]) < 1e-12
    assert abs(states[-1, 0] - start) < abs(paper.rest(T, *PRESSURES, 1.01) - paper.rest(T, *PRESSURES, -1.01))


def test_muscle_friction_falls_with_pressure_and_is_bounded_at_the_atmosphere(p):
    """μ_p/(P − P_out)² is singular at P_out. Both terms are bounded at 20 kPa gauge, 1 N m each."""
    weight = T["M"] * T["g"]  # no shaft friction at this load

    def muscle(pressure):
        return joint.coulomb_torque(weight, 0.0, pressure, 10e6, p) - T["T_p'"] / (10e6 - ATMOSPHERE) ** 2

    pressures = np.linspace(50e3, 750e3, 300)
    values = np.array([muscle(pressure) for pressure in pressures])
    assert np.all(np.diff(values) <= 0.0)
    assert muscle(200e3) == pytest.approx(4e8 / 98.7e3**2, rel=1e-9)
    for pressure in (0.0, ATMOSPHERE - 1.0, ATMOSPHERE, ATMOSPHERE + 1.0, ATMOSPHERE + 20e3):
        assert muscle(pressure) == pytest.approx(1.0, rel=1e-9)
    assert muscle(ATMOSPHERE + 21e3) < 0.95
