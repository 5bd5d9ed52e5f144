"""Table II's p_w22: what the joint does with the sign that is printed, and with the one that fits the paper's figures.

The figures (docs/explanation/model.md, correction 1) are where the joint comes to rest when it is drawn slowly from 0°
by pressures that are held: friction decides, for the joint sticks in a whole range of angles, and it stops at the end
of that range that is nearer to where it comes from. Without the mechanical stop, since one of the figures lies beyond
it.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from states import held, steps

from pam_antagonist.model import dynamics
from pam_antagonist.rig import load_rig

LOW_HIGH, HIGH_LOW, EQUAL = (200e3, 700e3), (700e3, 200e3), (450e3, 450e3)


@pytest.mark.parametrize(
    ("name", "pressures", "degrees", "newton_metres"),
    [
        ("shin2022", EQUAL, 0.0, None),
        ("shin2022", LOW_HIGH, -21.6, -2.63),
        ("shin2022", HIGH_LOW, 20.1, 2.61),
        ("shin2022_as_printed", EQUAL, 8.6, None),
        ("shin2022_as_printed", LOW_HIGH, -11.7, -1.48),
        ("shin2022_as_printed", HIGH_LOW, 30.6, 3.76),
    ],
)
def test_a_slow_approach_ends_at_the_figure_and_a_locked_joint_has_its_torque(name, pressures, degrees, newton_metres):
    """Viscous friction of 1 N m s/rad (440 times the rig's) makes the approach slow and is without effect at rest.

    The figures are given to 0.1° and 0.01 N m. Locked at 0° there is no motion and no friction.
    """
    rig = load_rig(name)
    states = steps([0.0, 0.0, *pressures], held(rig, joint__viscous_friction=1.0), 5000)
    assert abs(states[-1, 1]) < 1e-9, "it still moves"
    assert math.degrees(states[-1, 0]) == pytest.approx(degrees, abs=0.06)
    if newton_metres is not None:
        locked = np.array([0.0, 0.0, *pressures])
        assert dynamics.torque(locked, rig.parameters("locked")) == pytest.approx(newton_metres, abs=0.006)
