"""To which torques a joint can yield, against equation (5) and against what the law does with a simulated joint."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.command import Mode
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.control.tracking import largest_torque
from pam_antagonist.errors import BadInput
from pam_antagonist.rig import Rig, load_rig
from validation.control.loop import make_laws, run

RIG = load_rig("shin2022")
P, BOX = RIG.parameters(), Box.of(RIG.parameters())
SMOOTH = RIG.replaced(friction=RIG.friction.replaced(shaft=0.002, muscle=4.0e6))


def transfer(rig: Rig, torque: float, frequency: float, stiffness: float, damping: float) -> complex:
    """Angle over torque of the joint that yields, over that of the spring and damper."""
    period, cycles = rig.sample_period, 4
    turn = 2.0 * math.pi * frequency * period
    count = 500 + round(cycles / frequency / period)
    reference = Wanted(Mode.IMPEDANCE, 0.0, stiffness=stiffness, damping=damping)
    course = run(
        rig, make_laws(rig, "model"), [reference] * count, mismatch=0.0, push=lambda k: torque * math.sin(turn * k),
        push_is_known=True,
    )  # fmt: skip
    k = np.arange(count - round((cycles - 1) / frequency / period), count)
    carrier = np.exp(-1j * turn * k)
    ratio = np.mean((course.angle[k] - np.mean(course.angle[k])) * carrier) / np.mean(course.push[k] * carrier)
    return complex(ratio * (stiffness + 2j * math.pi * frequency * damping))


def test_quicker_and_more_damped_motion_takes_more_flow() -> None:
    found = {(f, d): largest_torque(P, BOX, 6.0, d, f) for f in (0.5, 1.0, 2.0, 4.0) for d in (0.0, 0.5)}
    for damping in (0.0, 0.5):
        assert found[0.5, damping] > found[1.0, damping] > found[2.0, damping] > found[4.0, damping] > 0.05
    assert found[2.0, 0.5] < 0.6 * found[2.0, 0.0]
    areas = RIG.valve_1.replaced(inflow_area=2 * RIG.valve_1.inflow_area, outflow_area=2 * RIG.valve_1.outflow_area)
    wider = RIG.replaced(valve_1=areas, valve_2=areas).parameters()
    assert largest_torque(wider, BOX, 6.0, 0.5, 2.0) == pytest.approx(2.0 * found[2.0, 0.5], rel=0.1)


def test_a_stiffness_that_the_muscles_do_not_have_leaves_nothing() -> None:
    assert largest_torque(P, BOX, 60.0, 0.5, 1.0) == 0.0


def test_within_its_limit_the_joint_yields_as_asked_and_beyond_it_does_not() -> None:
    """Without friction, to which no valve is quick enough. At 2 Hz, which a lag of 1/25 s would turn into 0.62."""
    most = largest_torque(P, BOX, 6.0, 0.5, 2.0)
    within, beyond = (transfer(SMOOTH, share * most, 2.0, 6.0, 0.5) for share in (0.8, 4.0))
    assert 0.85 < abs(within) < 1.15, within
    assert abs(beyond) < 0.82, beyond


@pytest.mark.parametrize(
    ("stiffness", "damping", "frequency"), [(0.0, 0.5, 1.0), (6.0, -1.0, 1.0), (6.0, 0.5, math.nan)]
)
def test_what_no_spring_and_damper_can_be_is_refused(stiffness: float, damping: float, frequency: float) -> None:
    with pytest.raises(BadInput, match="expected finite numbers, the first and the last above 0"):
        largest_torque(P, BOX, stiffness, damping, frequency)


def test_regulators_have_no_flow_that_is_known() -> None:
    p = load_rig("shin2022_regulators", regulators=True).parameters()
    with pytest.raises(BadInput, match="expected valves"):
        largest_torque(p, BOX, 6.0, 0.5, 1.0)
