"""To which torques a joint can yield, against equation (5) and against what the law does with a simulated joint."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.cli.tried_gains import seen
from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.laws import Laws, Reachable
from pam_antagonist.control.model_law import ModelController
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.control.tracking import largest_torque
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import Plant

RIG = load_rig("shin2022")
P, BOX = RIG.parameters(), Box.of(RIG.parameters())
SMOOTH = RIG.replaced(friction=RIG.friction.replaced(shaft=0.002, muscle=4.0e6))


def pushed(rig: Rig, reference: Wanted, push: np.ndarray) -> np.ndarray:
    """Angles of a joint that the law through the model controls, which is told of a torque from outside."""
    plant, estimator = Plant(rig), Estimator(rig)
    p, period = rig.parameters(), rig.sample_period
    valves = VoltageLimits(rig.valves.voltage_min, rig.valves.voltage_max)
    pi = PiController(sample_period=period, limits=valves)
    laws = Laws(pi, ModelController(p, BOX, sample_period=period, limits=valves), Reachable(p, BOX), "model", None)
    voltage, angle = pi.safe_voltage, []
    for k, torque in enumerate(push.tolist()):
        sample = plant.step(voltage, torque)
        row = estimator.step((k + 1) * round(period * 1e9), *sample.pressure, *sample.voltage)
        estimate = seen(row)._replace(external_torque=torque, external_variance=0.0)
        voltage = laws.step(reference, estimate).voltage
        angle.append(sample.truth[0])
    return np.array(angle)


def transfer(rig: Rig, torque: float, frequency: float, stiffness: float, damping: float) -> complex:
    """Angle over torque of the joint that yields, over that of the spring and damper."""
    period, cycles = rig.sample_period, 4
    turn = 2.0 * math.pi * frequency * period
    count = 500 + round(cycles / frequency / period)
    reference = Wanted(Mode.IMPEDANCE, 0.0, stiffness=stiffness, damping=damping)
    push = torque * np.sin(turn * np.arange(count))
    angle = pushed(rig, reference, push)
    k = np.arange(count - round((cycles - 1) / frequency / period), count)
    carrier = np.exp(-1j * turn * k)
    ratio = np.mean((angle[k] - np.mean(angle[k])) * carrier) / np.mean(push[k] * carrier)
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
