"""The Runge-Kutta step against scipy's integrator at tight tolerances, where the equations are smooth.

Smooth means: the joint slides one way or is locked, and no flow changes its regime. scipy integrates the
transcription, so that equations and integrator are both someone else's.
"""

from __future__ import annotations

import math

import numpy as np
import transcription as paper
from scipy.integrate import solve_ivp
from states import steps

T = paper.CORRECTED
SCALE = np.array([0.1, 10.0, 1e5, 1e5])
"""What the states change by in these runs [rad, rad/s, Pa, Pa]."""


def reference(x, u, duration, locked=False):
    """States of the transcription at 101 times, and that nothing switches among them."""
    times = np.linspace(0.0, duration, 101)
    solution = solve_ivp(
        lambda _, state: paper.derivative(T, state.tolist(), u, locked), (0.0, duration), x, method="DOP853",
        t_eval=times, rtol=1e-12, atol=[1e-14, 1e-12, 1e-6, 1e-6],
    )  # fmt: skip
    states = solution.y.T
    regimes = {(paper.regime(T, s[2]), paper.regime(T, s[3])) for s in states}
    assert len(regimes) == 1, "a flow changes its regime on the way"
    if not locked:
        assert all(paper.slides(T, s) for s in states.tolist())
        assert len({math.copysign(1.0, s[1]) for s in states}) == 1, "the joint turns on the way"
    return states


def errors(x, u, duration, p, divisions, locked=False):
    """Largest errors at the end (len(divisions), 4) with that many steps."""
    end = reference(x, u, duration, locked)[-1]
    return np.array([np.abs(steps(x, p, n, duration / n, u)[-1] - end) for n in divisions])


def test_sliding_joint_converges_to_fourth_order(p):
    x, u = [-0.2, 8.0, 580e3, 480e3], (6.0, 5.0)
    # In one number, since a single state's error may pass through zero between two step sizes.
    error = np.max(errors(x, u, 0.016, p, (8, 16, 32, 64)) / SCALE, axis=1)
    rate = np.log2(error[:-1] / error[1:])
    assert np.all(rate > 3.6)
    assert np.all(rate < 5.0)


def test_sliding_joint_at_the_sample_period(p):
    x, u = [-0.2, 8.0, 580e3, 480e3], (6.0, 5.0)
    error = errors(x, u, 0.016, p, (16,))[0]
    assert np.all(error < 1e-4 * SCALE)


def test_locked_joint_converges_to_fourth_order(p_locked):
    """Both muscles where the inflow is subsonic; steps of 0.2 s and less, since at 1 ms only rounding is left."""
    x, u = [0.0, 0.0, 380e3, 640e3], (6.0, 5.5)
    error = errors(x, u, 1.6, p_locked, (4, 8, 16), locked=True)[:, 2:]
    rate = np.log2(error[:-1] / error[1:])
    assert np.all(rate > 3.7)
    assert np.all(rate < 5.5)


def test_locked_joint_at_the_sample_period(p_locked):
    for x, u in (([0.0, 0.0, 200e3, 370e3], (6.0, 5.0)), ([0.3, 0.0, 380e3, 640e3], (6.0, 5.5))):
        assert np.all(errors(x, u, 0.3, p_locked, (300,), locked=True)[0] < 1e-5)
