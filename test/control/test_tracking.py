"""Tracking error and steady-state performance by hand; to which torques a joint can yield."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pam_antagonist.control.command import Mode, VoltageLimits
from pam_antagonist.control.laws import Laws, Reachable
from pam_antagonist.control.model_law import ModelController, Seen
from pam_antagonist.control.pi import PiController
from pam_antagonist.control.reference import Wanted
from pam_antagonist.control.stiffness import Box
from pam_antagonist.control.tracking import held, largest_torque, tracking
from pam_antagonist.errors import BadInput
from pam_antagonist.estimation import Estimator
from pam_antagonist.rig import Rig, load_rig
from pam_antagonist.simulation.plant import Plant

PERIOD = 1_000_000


def stamps(seconds: float) -> np.ndarray:
    return np.arange(round(seconds * 1000), dtype=np.int64) * PERIOD + 10**18


def test_performance_is_the_paper_s_example() -> None:
    """A worst steady-state error of 2.1° with references of ±20°: 94.75 %."""
    time = stamps(20.0)
    reference = np.where(np.arange(len(time)) < 10_000, 20.0, -20.0)
    measured = reference - np.where(np.arange(len(time)) < 10_000, 1.0, -2.1)
    result = tracking(time, reference, measured)
    assert result.range == 40.0
    assert result.worst_steady_error == pytest.approx(2.1)
    assert result.performance == pytest.approx(0.9475)
    assert [step.reference for step in result.steps] == [20.0, -20.0]
    assert [step.steady_error for step in result.steps] == pytest.approx([1.0, 2.1])


def test_transients_count_for_the_rmse_but_not_as_steady() -> None:
    time = stamps(5.0)
    reference = np.full(len(time), 10.0)
    measured = reference.copy()
    measured[:3900] = 0.0  # 3.9 of 5 s: the last fifth starts at 4 s
    result = tracking(time, reference, measured)
    assert result.worst_steady_error == 0.0
    assert result.largest == 10.0
    assert result.rmse == pytest.approx(10.0 * math.sqrt(0.78))
    assert math.isnan(result.performance)  # one reference has no range
    measured[4100] = 7.0
    assert tracking(time, reference, measured).worst_steady_error == 3.0


def test_a_step_has_settled_from_when_the_error_stays_small() -> None:
    time = stamps(9.0)
    reference = np.repeat([0.0, 10.0, 0.0], 3000)
    measured = reference.copy()
    measured[3000:4000] = 0.0
    measured[4500] = 10.6  # out of the band of 5 % of 10 once more, 1.5 s after the step
    measured[6000:] = 1.0  # never within the band again
    _, up, down = tracking(time, reference, measured).steps
    assert up.settling_s == pytest.approx(1.501)
    assert math.isnan(down.settling_s)


def test_short_steps_have_no_steady_part() -> None:
    time = stamps(4.0)
    reference = np.where(np.arange(len(time)) % 2000 < 1000, 5.0, -5.0)
    result = tracking(time, reference, np.zeros(len(time)))
    assert len(result.steps) == 4
    assert math.isnan(result.worst_steady_error) and math.isnan(result.performance)


def test_what_is_missing_is_left_out() -> None:
    time = stamps(6.0)
    reference = np.full(len(time), 1.0)
    reference[:1000] = np.nan
    measured = np.full(len(time), 0.5)
    measured[-10:] = np.nan
    result = tracking(time, reference, measured)
    assert result.rmse == pytest.approx(0.5)
    assert result.steps[0].length_s == pytest.approx(4.989)
    with pytest.raises(ValueError, match="no sample"):
        tracking(time, np.full(len(time), np.nan), measured)


def test_reference_is_held_until_the_next() -> None:
    time = np.array([0, 1, 2, 3, 4], dtype=np.int64)
    out = held(time, np.array([1, 3, 3]), np.array([5.0, 6.0, 7.0]))
    assert np.isnan(out[0])
    assert list(out[1:]) == [5.0, 5.0, 7.0, 7.0]
    assert np.isnan(held(time, np.array([], dtype=np.int64), np.array([]))).all()


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
        estimate = Seen.of(row)._replace(external_torque=torque, external_variance=0.0)
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
