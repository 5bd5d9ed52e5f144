"""Table II's p_w22: what the joint does with the sign that is printed, and with the one that fits the paper's figures.

The figures (docs/explanation/model.md, correction 1) are where the joint comes to rest when it is drawn slowly from 0°
by pressures that are held: friction decides, for the joint sticks in a whole range of angles, and it stops at the end
of that range that is nearer to where it comes from. Without the mechanical stop, since one of the figures lies beyond
it.
"""

from __future__ import annotations

import math

import pytest
import transcription as paper
from states import held, steps

from pam_antagonist.model import dynamics, equilibrium
from pam_antagonist.rig import load_rig

LOW_HIGH, HIGH_LOW, EQUAL = (200e3, 700e3), (700e3, 200e3), (450e3, 450e3)
FIGURES = [
    ("shin2022", LOW_HIGH, -21.6),
    ("shin2022", HIGH_LOW, 20.1),
    ("shin2022_as_printed", EQUAL, 8.6),
    ("shin2022_as_printed", LOW_HIGH, -11.7),
    ("shin2022_as_printed", HIGH_LOW, 30.6),
]
TABLES = {"shin2022": paper.CORRECTED, "shin2022_as_printed": paper.AS_PRINTED}


def end(name, pressures, **changes):
    """Angle [deg] at which a joint that starts at 0° at rest has come to rest after 5 s under held pressures."""
    states = steps([0.0, 0.0, *pressures], held(load_rig(name), **changes), 5000)
    assert abs(states[-1, 1]) < 1e-9, "it still moves"
    assert tuple(states[-1, 2:]) == pressures
    return math.degrees(states[-1, 0])


def sticking_range(name, pressures):
    """Angles [deg] between which the joint stays at rest, from the transcription."""
    ends = [math.degrees(paper.rest(TABLES[name], *pressures, share)) for share in (1.0, -1.0)]
    return min(ends), max(ends)


@pytest.mark.parametrize(("name", "pressures", "degrees"), FIGURES)
def test_slow_approach_ends_at_the_figure(name, pressures, degrees):
    """Viscous friction of 1 N m s/rad (440 times the rig's) makes the approach slow and is without effect at rest.
    0.06°: the figures are given to 0.1°."""
    assert end(name, pressures, joint__viscous_friction=1.0) == pytest.approx(degrees, abs=0.06)


@pytest.mark.parametrize(("name", "pressures", "degrees"), FIGURES)
def test_figure_is_the_near_end_of_the_sticking_range(name, pressures, degrees):
    low, high = sticking_range(name, pressures)
    near = low if degrees > 0.0 else high
    assert near == pytest.approx(degrees, abs=0.06)
    # The range is 0.9° to 1.8° wide: without friction the figures would lie half of that further out.
    assert 0.9 < high - low < 1.9
    balance = math.degrees(equilibrium.rest_angle(*pressures, held(load_rig(name))))
    assert low < balance < high
    assert abs(balance) - abs(degrees) > 0.4


def test_at_equal_pressures_the_joint_rests_at_zero():
    """0.0° is where it stands: it sticks there, and the balance without friction is 0.1° away, not 9°."""
    assert end("shin2022", EQUAL) == pytest.approx(0.0, abs=1e-9)
    assert end("shin2022", EQUAL, joint__viscous_friction=1.0) == pytest.approx(0.0, abs=1e-9)
    low, high = sticking_range("shin2022", EQUAL)
    assert (low, high) == (pytest.approx(-1.03, abs=0.01), pytest.approx(0.84, abs=0.01))
    assert abs(math.degrees(equilibrium.rest_angle(*EQUAL, load_rig("shin2022").parameters()))) < 0.2
    printed = load_rig("shin2022_as_printed").parameters()
    assert math.degrees(equilibrium.rest_angle(*EQUAL, printed)) == pytest.approx(9.27, abs=0.01)


@pytest.mark.parametrize(
    ("name", "pressures", "newton_metres"),
    [
        ("shin2022", LOW_HIGH, -2.63),
        ("shin2022", HIGH_LOW, 2.61),
        ("shin2022_as_printed", LOW_HIGH, -1.48),
        ("shin2022_as_printed", HIGH_LOW, 3.76),
    ],
)
def test_locked_torque(name, pressures, newton_metres):
    """Locked at 0° there is no motion and no friction: the muscles' torque, to the rounding of the figures."""
    p = load_rig(name).parameters("locked")
    states = steps([0.0, 0.0, *pressures], p, 0)
    assert dynamics.torque(states[0], p) == pytest.approx(newton_metres, abs=0.006)
